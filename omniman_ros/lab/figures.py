"""Pictures of the reproduced experiments, drawn with matplotlib.

Drives are seen from above: the robot, obstacles and walls, the driven path and the planned motion.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon

from omniman_ros.console.figure_style import (
    BLUE,
    BRONZE,
    CYAN,
    FAINT,
    GREEN,
    GREY,
    INK,
    MINT,
    NEUTRAL,
    ORANGE,
    PINK,
    RED,
    SAND,
    SERIES,
    figure_style,
    save_figure,
)
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.lab.studies import handover, tool_path
from omniman_ros.lab.studies.coupling import OWN_CONTROLLER, PAPER_CONTROLLER, CouplingRun
from omniman_ros.lab.studies.handover import KEPT_TIME
from omniman_ros.lab.studies.mpc_cases import MpcCase
from omniman_ros.lab.studies.mpc_loop import MpcSceneCycle
from omniman_ros.lab.studies.planned_drives import PlannedDrive
from omniman_ros.lab.studies.scene_geometry import WallRectangle
from omniman_ros.motion.figure7 import Figure7, waypoints

BOX_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
#: Corners of a box and of the triangle that marks its front, in half lengths and half widths
FRONT_MARK = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]])
OUTLINE_SPACING = 1.0  #: distance along the path of Fig. 7 between two outlines of the robot [m]
SNAPSHOT_PERIOD = 4.0  #: time between two outlines of robots side by side [s]
ROUND_WAYS = 0.8  #: margin around their ways from above [m]
BEFORE, AFTER = 2.0, 1.0  #: time that is shown before and after the judged time [s]
COLUMNS = 3  #: of snapshots of a case
SNAPSHOTS = 5  #: where the scene defines none
TRAIL_INTERVAL = 0.8  #: time between two drawings of the robot on a trail [s]
MAX_GAP = 1.2  #: largest gap that is drawn [m]
MOVING_SPEED = 0.05  #: from which an obstacle is shown with its predicted positions [m/s]
MARGIN = 0.25  #: between the drawn objects and the frame of the axes [m]
PREDICTION_STEP = 0.5  #: between two predicted positions of an obstacle [s]


# ---- CCTA 2017, Fig. 7 --------------------------------------------------------------------------


def draw_coupling(
    robot: Platform,
    course: Figure7,
    runs: Sequence[CouplingRun],
    result: Mapping[str, Any],
    path: Path,
) -> None:
    """Draw the coupling errors over time and the path as a PNG file."""
    with figure_style():
        figure = plt.figure(figsize=(11.5, 3.8), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(2.9, 1))
        _errors_over_time(figure.add_subplot(grid[0]), course, select_median(runs), result)
        _path_of_figure7(figure.add_subplot(grid[1]), robot, course)
        save_figure(figure, path)


def select_median(runs: Sequence[CouplingRun]) -> list[CouplingRun]:
    """Return the drives of group P with the wheels whose uncontrolled error is the median."""
    uncontrolled = sorted(
        (run for run in runs if run.case.group == "P" and run.case.gain == 0.0),
        key=lambda run: run.outcome.epsilon_max,
    )
    sample = uncontrolled[len(uncontrolled) // 2].case.sample
    return [run for run in runs if run.case.group == "P" and run.case.sample == sample]


def _errors_over_time(
    axes: Any, course: Figure7, runs: Sequence[CouplingRun], result: Mapping[str, Any]
) -> None:
    """Draw the coupling error by (24) over time; as in the paper, red is without control."""
    for leg in course.legs(0.0):
        axes.axvspan(leg.begin, leg.preview.end, color=FAINT, alpha=0.25, lw=0)
        style = {"ha": "center", "va": "bottom", "color": GREY, "fontsize": 8}
        middle = 0.5 * (leg.begin + leg.preview.end)
        axes.text(middle, 1.01, leg.name, transform=axes.get_xaxis_transform(), **style)
    own, paper, printed = (result[f"{name}_gain"] for name in ("chosen", "paper", "printed"))
    styles = {
        (OWN_CONTROLLER, 0.0): (RED, "off"),
        (PAPER_CONTROLLER, paper): (CYAN, f"the paper's, k = {paper:g}, $J_a$ corrected"),
        (PAPER_CONTROLLER, printed): (BLUE, f"the paper's, k = {paper:g}, as printed"),
        (OWN_CONTROLLER, own): (GREEN, f"this package's, k = {own:g}"),
    }
    for run in runs:
        if (run.case.controller, run.case.gain) in styles:
            colour, label = styles[run.case.controller, run.case.gain]
            epsilon = run.epsilon[:, 0]
            if run.epsilon.shape[1] > 1:
                epsilon = np.linalg.norm(run.epsilon, axis=1)
            axes.plot(run.time, epsilon, color=colour, label=label)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)
    axes.set_xlim(0.0, course.duration)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("coupling error ε, never reset [rad]")
    axes.set_title("Coupling error over time, P velocity loops", pad=16)
    axes.legend(loc="best")


def _path_of_figure7(axes: Any, robot: Platform, course: Figure7) -> None:
    """Draw the path from above: x (forward) points up, y (left) to the left."""
    poses = waypoints(0.02, course.length)
    axes.plot(-poses[:, 1], poses[:, 0], color=INK, lw=1.2, zorder=5)
    for x, y, theta in waypoints(OUTLINE_SPACING, course.length):
        draw_robot(axes, robot, np.array([-y, x, theta + 0.5 * math.pi]), FAINT)
    axes.plot(0.0, 0.0, "o", color=GREEN, zorder=6)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"The path, lines of {course.length:g} m")


# ---- handing over a load ------------------------------------------------------------------------


def draw_handover(
    robot: Platform,
    runs: Sequence[handover.HandoverRun],
    position_bound: float,
    heading_bound: float,
    path: Path,
) -> None:
    """Draw the study as a PNG file."""
    by_course = {run.case.course: run for run in reversed(runs)}
    courses = list(dict.fromkeys(run.case.course for run in runs))
    with figure_style():
        figure, axes = plt.subplots(
            len(courses),
            3,
            squeeze=False,
            layout="constrained",
            figsize=(14.0, 0.6 + 3.6 * len(courses)),
            width_ratios=(1.5, 1.0, 1.0),
        )
        for row, course in zip(axes, courses, strict=True):
            _from_above(row[0], robot, by_course[course])
            driven = [run for run in runs if run.case.course == course]
            _station_errors(row[1], driven, position_bound, heading_bound)
            _side_gaps(row[2], driven)
        axes[0][0].plot([], [], color=ORANGE, label="leader")
        axes[0][0].plot([], [], color=BLUE, label="follower")
        axes[0][0].legend(loc="lower right")
        axes[0][1].legend(loc="upper right", fontsize=7)
        save_figure(figure, path)


def _from_above(axes: Any, robot: Platform, run: handover.HandoverRun) -> None:
    """Draw the ways of both robots, and their outlines at the same times."""
    rows = np.searchsorted(run.times, np.arange(0.0, run.times[-1], SNAPSHOT_PERIOD))
    for poses, colour in ((run.leader, ORANGE), (run.follower, BLUE)):
        axes.plot(poses[:, 0], poses[:, 1], color=colour, lw=0.8)
        axes.plot(poses[run.kept, 0], poses[run.kept, 1], color=colour, lw=3.0)
        for row in rows:
            draw_robot(axes, robot, poses[row], colour)
    for row in rows:
        axes.plot(*np.vstack([run.leader[row, :2], run.follower[row, :2]]).T, color=GREY, lw=0.5)
    places = np.vstack([run.leader[:, :2], run.follower[:, :2]])
    low, high = places.min(axis=0) - ROUND_WAYS, places.max(axis=0) + ROUND_WAYS
    frame_axes(axes, (low[0], high[0], low[1], high[1]))
    axes.set_title(f"{run.case.course}: every {SNAPSHOT_PERIOD:g} s; thick: the judged time")


def _station_errors(
    axes: Any, runs: Sequence[handover.HandoverRun], position_bound: float, heading_bound: float
) -> None:
    """Draw distance and heading error over time, each as a fraction of its bound."""
    for run, colour in zip(runs, SERIES, strict=False):
        errors = run.errors()
        times = run.times - run.kept_from
        distance = np.hypot(errors[:, 0], errors[:, 1]) / position_bound
        axes.plot(
            times,
            distance,
            color=colour,
            lw=1.0,
            label=handover.HANDOVER_WHEELS[run.case.wheels].about,
        )
        axes.plot(times, np.abs(errors[:, 2]) / heading_bound, color=colour, lw=1.0, ls=":")
    axes.axhline(1.0, color=GREY, lw=0.8, ls="--")
    axes.axvspan(0.0, KEPT_TIME, color=MINT, alpha=0.3, lw=0)
    axes.set_xlim(-BEFORE, KEPT_TIME + AFTER)
    axes.set_yscale("log")
    axes.set_ylim(1e-3, 30.0)
    bounds = f"{1e3 * position_bound:g} mm; dotted: {math.degrees(heading_bound):g}°"
    label_axes(
        axes, f"True error over its bound: {bounds}", "time since the judged time began [s]"
    )


def _side_gaps(axes: Any, runs: Sequence[handover.HandoverRun]) -> None:
    """Draw the gap between the outlines of the robots over time."""
    for run, colour in zip(runs, SERIES, strict=False):
        axes.plot(run.times, run.gaps(), color=colour, lw=1.0)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.set_ylim(bottom=-0.1)
    label_axes(axes, "True gap between the robots [m]", "time since the request [s]")


def label_axes(axes: Any, title: str, across: str) -> None:
    """Set title, label of the abscissa, and grid of axes."""
    axes.set_title(title)
    axes.set_xlabel(across)
    axes.grid(color=FAINT, lw=0.4)


# ---- cases of MPC 2021 and workshop -------------------------------------------------------------


def draw_case(robot: Platform, scene: MpcCase, planned: PlannedDrive, path: Path) -> None:
    """Draw a drive with its gaps: with a map as a trail, else as snapshots."""
    (draw_snapshots if scene.grid is None else draw_trail)(robot, scene, planned, path)


def draw_snapshots(robot: Platform, scene: MpcCase, planned: PlannedDrive, path: Path) -> None:
    """Draw snapshots of a drive as a PNG file, as in Fig. 4 and 5 of MPC 2021, and its gaps."""
    evenly = [end_of(planned) * (k + 0.6) / SNAPSHOTS for k in range(SNAPSHOTS)]
    times = list(scene.snapshots) or evenly
    view = TopView(robot, scene, planned)
    bounds = view.bounds(times)
    rows = math.ceil((len(times) + 1) / COLUMNS)
    width = 12.0 / COLUMNS
    height = width * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0]) + 0.55
    with figure_style():
        figure = plt.figure(figsize=(12.0, rows * height + 0.3), layout="constrained")
        grid = figure.add_gridspec(rows, COLUMNS)
        for i, time in enumerate(times):
            axes = figure.add_subplot(grid[i // COLUMNS, i % COLUMNS])
            view.draw(axes, time)
            frame_axes(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")
        last = figure.add_subplot(grid[len(times) // COLUMNS, len(times) % COLUMNS :])
        _gaps(last, planned, times, len(scene.obstacles))
        draw_legend(figure)
        save_figure(figure, path)


def draw_trail(robot: Platform, scene: MpcCase, planned: PlannedDrive, path: Path) -> None:
    """Draw a drive through a building as a PNG file, and its gaps."""
    view = TopView(robot, scene, planned)
    bounds = view.bounds([0.0])
    height = 12.0 * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
    with figure_style():
        figure = plt.figure(figsize=(12.0, height + 2.2), layout="constrained")
        grid = figure.add_gridspec(2, 1, height_ratios=(height, 1.6))
        axes = figure.add_subplot(grid[0])
        view.draw_trail(axes, TRAIL_INTERVAL)
        frame_axes(axes, bounds)
        _gaps(figure.add_subplot(grid[1]), planned, [], len(scene.obstacles))
        save_figure(figure, path)


def _gaps(axes: Any, planned: PlannedDrive, times: Sequence[float], obstacles: int) -> None:
    """Draw the true gaps over time; a column beyond those of obstacles is that of the walls."""
    drive = planned.drive
    for k, gaps in enumerate(drive.gaps.T):
        near = np.where(gaps < MAX_GAP, gaps, np.nan)
        axes.plot(drive.times, near, lw=1.2, label="walls" if k == obstacles else f"{k + 1}")
    for time in times:
        axes.axvline(time, color=FAINT, lw=0.8, zorder=0)
    axes.axhline(0.0, color=RED, lw=1.0)
    axes.set_xlim(0.0, end_of(planned))
    axes.set_ylim(min(-0.05, drive.clearance - 0.05), 1.25 * MAX_GAP)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("true gap [m]")
    if drive.gaps.shape[1]:
        axes.set_title(f"Least gap {1e3 * drive.clearance:.0f} mm")
        axes.legend(loc="upper center", ncols=4, handlelength=1.0, columnspacing=1.0)


class TopView:
    """View of a drive from above, at a single time or as a trail."""

    def __init__(self, robot: Platform, scene: MpcCase, planned: PlannedDrive) -> None:
        self.robot, self.scene, self.planned = robot, scene, planned

    def bounds(self, times: Sequence[float]) -> tuple[float, float, float, float]:
        """Return x_min, x_max, y_min, y_max of everything that is drawn at times [m]."""
        radius = math.hypot(self.robot.body.length, self.robot.body.width) / 2.0
        ends = [self.scene.start[:2], self.scene.goal[:2]]
        poses = np.vstack([self.planned.drive.poses[:, :2], ends])
        points = [poses - radius, poses + radius, *map(_wall_corners, self.scene.walls)]
        for obstacle in self.scene.obstacles:
            size = max(obstacle.semi_axes)
            places = np.array([obstacle.place(time + self.planned.since) for time in times])
            points += [places - size, places + size]
        low, high = np.vstack(points).min(axis=0), np.vstack(points).max(axis=0)
        return low[0] - MARGIN, high[0] + MARGIN, low[1] - MARGIN, high[1] + MARGIN

    def draw(self, axes: Any, time: float) -> None:
        """Draw the drive at one time since the robot was sent off [s]."""
        drive, now = self.planned.drive, time + self.planned.since
        row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
        times = [cycle.time for cycle in self.planned.cycles]
        number = max(int(np.searchsorted(times, now + 1e-9)) - 1, 0)
        cycle = self.planned.cycles[number]
        self._draw_surroundings(axes, time, cycle)
        draw_robot(axes, self.robot, drive.poses[row], NEUTRAL, fill=0.35)
        axes.plot(*drive.poses[: row + 1, :2].T, color=INK, lw=1.0, zorder=5)
        if number in self.planned.planning:
            fine = np.linspace(now, max(float(cycle.plan_times[-1]), now), 40)
            plan = [np.interp(fine, cycle.plan_times, column) for column in cycle.plan.T[:2]]
            axes.plot(*plan, color=PINK, lw=2.0, zorder=6, solid_capstyle="round")

    def draw_trail(self, axes: Any, interval: float) -> None:
        """Draw the whole drive, with the robot at regular intervals [s]."""
        drive = self.planned.drive
        self._draw_surroundings(axes, 0.0, self.planned.cycles[0])
        for time in np.arange(interval, end_of(self.planned), interval):
            row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
            draw_robot(axes, self.robot, drive.poses[row], NEUTRAL, fill=0.12)
        axes.plot(*drive.poses[:, :2].T, color=INK, lw=1.0, zorder=5)

    def _draw_surroundings(self, axes: Any, time: float, cycle: MpcSceneCycle) -> None:
        """Draw start, goal, walls, true obstacles and their predictions of a planner's cycle."""
        for pose, colour in ((self.scene.start, RED), (self.scene.goal, BLUE)):
            draw_robot(axes, self.robot, np.array(pose), colour)
        for wall in self.scene.walls:
            axes.add_patch(Polygon(_wall_corners(wall), zorder=2, fc=GREY, ec=GREY, lw=0.3))
        known, now = cycle.known, time + self.planned.since
        moving = np.flatnonzero(np.hypot(*known.velocities.T) > MOVING_SPEED).tolist()
        reach = float(cycle.plan_times[-1]) - now
        faint: dict[str, Any] = {"fc": "none", "ec": BRONZE, "lw": 0.6, "alpha": 0.55}
        for ahead in np.arange(PREDICTION_STEP, max(reach, 0.0) + 1e-9, PREDICTION_STEP):
            centers = known.centers_at(np.array([now + ahead]))[0]
            for k in moving:
                draw_ellipse(
                    axes, centers[k], known.semi_axes[k], known.angles[k], zorder=1, **faint
                )
        text: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7, "clip_on": True}
        solid: dict[str, Any] = {"fc": SAND, "ec": BRONZE, "lw": 0.8, "zorder": 2}
        for k, obstacle in enumerate(self.scene.obstacles):
            position = obstacle.place(now)
            axes.text(*position, f"{k + 1}", zorder=2.5, **text)
            draw_ellipse(axes, position, obstacle.semi_axes, obstacle.angle, **solid)


def draw_robot(axes: Any, robot: Platform, pose: Array, colour: str, fill: float = 0.0) -> None:
    """Draw outline and front mark of a robot at a pose (3,), its area with an opacity."""
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    box, nose = _to_odom(BOX_CORNERS * half, pose), _to_odom(FRONT_MARK * half, pose)
    order = 4 if fill else 3
    axes.add_patch(Polygon(box, zorder=order, fc=colour, lw=0, alpha=fill))
    axes.add_patch(Polygon(box, zorder=order, fc="none", ec=colour, lw=1.0))
    axes.add_patch(Polygon(nose, zorder=order, fc=colour, lw=0, alpha=0.8))


def draw_ellipse(axes: Any, center: Array, semi_axes: Any, angle: float, **style: Any) -> None:
    """Draw an ellipse with semi-axes [m] at an angle [rad] in odom."""
    a, b = semi_axes
    axes.add_patch(Ellipse(tuple(center), 2 * a, 2 * b, angle=math.degrees(angle), **style))


def _wall_corners(wall: WallRectangle) -> Array:
    size = 0.5 * np.array([wall.length, wall.width])
    return _to_odom(BOX_CORNERS * size, np.array([wall.x, wall.y, wall.heading]))


def _to_odom(points: Array, pose: Array) -> Array:
    """Transform points (k, 2) [m] from base_link to odom, given the pose (3,) of base_link."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Array = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return result


def frame_axes(axes: Any, bounds: tuple[float, float, float, float]) -> None:
    """Set limits, grid and labels of axes that show the plane of odom."""
    axes.set_xlim(*bounds[:2])
    axes.set_ylim(*bounds[2:])
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_legend(figure: Any) -> None:
    """Draw the legend of a figure of a scene."""
    box: dict[str, Any] = {"marker": "s", "ls": "", "ms": 7}
    disc: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
    about = f"obstacle, predicted every {PREDICTION_STEP:g} s"
    handles = [
        Line2D([], [], color=RED, mfc="none", label="start", **box),
        Line2D([], [], color=BLUE, mfc="none", label="goal", **box),
        Line2D([], [], color=NEUTRAL, alpha=0.7, label="robot", **box),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D([], [], color=PINK, lw=2.0, label="planned"),
        Line2D([], [], color=SAND, mec=BRONZE, label=about, **disc),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))


def end_of(planned: PlannedDrive) -> float:
    """Return the time of arrival, or of the last sample if the robot did not arrive [s]."""
    arrival = planned.drive.arrival
    return arrival if math.isfinite(arrival) else float(planned.drive.times[-1])


# ---- tool paths ---------------------------------------------------------------------------------


def draw_tool_path(
    runs: Sequence[tool_path.ToolPathRun], rms_bound: float, max_bound: float, path: Path
) -> None:
    """Draw the study as a PNG file: a row for each course, a column for each kind of wheels."""
    courses = list(dict.fromkeys(run.case.course for run in runs))
    wheels = list(dict.fromkeys(run.case.wheels.about for run in runs))
    with figure_style():
        figure, axes = plt.subplots(
            len(courses),
            1 + len(wheels),
            squeeze=False,
            layout="constrained",
            figsize=(3.2 + 3.6 * len(wheels), 0.6 + 2.4 * len(courses)),
            width_ratios=[1.0] + [1.3] * len(wheels),
        )
        for row, course in zip(axes, courses, strict=True):
            _paths(row[0], next(run for run in runs if run.case.course == course))
            for cell, name in zip(row[1:], wheels, strict=True):
                driven = [
                    run
                    for run in runs
                    if (run.case.course, run.case.wheels.about) == (course, name)
                ]
                _tool_errors(cell, driven, rms_bound, max_bound)
                if course == courses[0]:
                    cell.set_title(f"Tracking error of the tool [mm]: {name}")
                if course == courses[-1]:
                    cell.set_xlabel("time [s]")
        axes[0][1].legend(loc="center", frameon=False)
        save_figure(figure, path)


def _paths(axes: Any, run: tool_path.ToolPathRun) -> None:
    """Draw the paths of tool and platform from above: x (forward) points up, y to the left."""
    for positions, colour, label in (
        (run.base, GREY, "base_link"),
        (run.reference, INK, "tool0"),
    ):
        axes.plot(-positions[:, 1], positions[:, 0], color=colour, lw=1.2, label=label)
    axes.plot(-run.reference[0, 1], run.reference[0, 0], "o", color=GREEN)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    axes.set_title(f"{run.case.course}: tool0, and base_link in grey")


def _tool_errors(
    axes: Any, runs: Sequence[tool_path.ToolPathRun], rms_bound: float, max_bound: float
) -> None:
    """Draw the errors of the drives over time, their RMS (dotted) and the bounds [m] (dashed)."""
    for run in sorted(runs, key=lambda run: run.case.options.correction):
        has_correction = run.case.options.correction
        colour = GREEN if has_correction else RED
        label = f"{'with' if has_correction else 'without'} correction"
        axes.plot(run.times, 1e3 * run.error, color=colour, lw=1.0, label=label)
        axes.axhline(1e3 * tool_path.rms(run.error), color=colour, lw=0.6, ls=":")
    for bound, text in ((rms_bound, "RMS"), (max_bound, "max")):
        axes.axhline(1e3 * bound, color=GREY, lw=0.8, ls="--")
        axes.text(
            1.0,
            1e3 * bound,
            text,
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            color=GREY,
            fontsize=7,
        )
    axes.set_ylim(bottom=0.0)
    axes.grid(color=FAINT, lw=0.4)
