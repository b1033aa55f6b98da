"""Pictures of the test cases of MPC 2021: snapshots as in its figures, and what was measured."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.robot import Robot
from omniman_ros.studies.mpc_cases import Planned, Scene, diagonals, steady_power
from omniman_ros.studies.scene_geometry import Wall

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon

Array = NDArray[np.float64]

INK, FAINT, GREY = "#1f2933", "#c3cad2", "#5f6b7a"
START, GOAL, NOW, PLAN = "#d62828", "#2f6fde", "#7b8794", "#d6009a"
OBSTACLE, AHEAD = "#e9a23b", "#b86e00"
WALL = "#5b5f66"
SPEED_ONLY, ALL_LIMITS = "#5f9ea0", "#a3c9a8"
STYLE: Any = {
    "font.size": 9, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": GREY, "ytick.color": GREY, "axes.spines.top": False,
    "axes.spines.right": False, "axes.titlesize": 9.5, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "figure.dpi": 130, "lines.linewidth": 1.4,
    "lines.markersize": 4, "legend.frameon": False, "legend.fontsize": 8,
}  # fmt: skip
BARS = (
    ("energy_j", PLAN, "planner"),
    ("speed_only_j", SPEED_ONLY, "straight line, slower"),
    ("all_limits_j", ALL_LIMITS, "straight line, slower and softer"),
)
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
ROOM = 0.25
"""Around everything that is drawn [m]."""
FRAMES = 10
"""Of an animation in each second, as many as it shows."""
NEARBY = 1.2
"""Gaps up to here are drawn [m]."""
PREDICTED = 0.5
"""Time between two predicted places of an obstacle [s]."""


# ---- a scene from above -------------------------------------------------------------------------


class TopView:
    """One drive from above, at any of its times.

    Args:
        robot: The robot, for its box and wheels.
        scene: Start, goal and obstacles.
        ride: What happened.
    """

    def __init__(self, robot: Robot, scene: Scene, ride: Planned) -> None:
        self.robot, self.scene, self.ride = robot, scene, ride
        self.half = 0.5 * np.array([robot.body.length, robot.body.width])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which obstacles move, at first."""
        if not self.scene.obstacles:
            return np.zeros(0, dtype=bool)
        return np.array([np.ptp([o.place(0.0), o.place(1.0)], axis=0).any()
                         for o in self.scene.obstacles])  # fmt: skip

    def bounds(self, times: Sequence[float]) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max of all that is drawn at any of these times [m]."""
        radius = math.hypot(*self.half)
        poses = np.vstack([self.ride.drive.poses[:, :2], [self.scene.start[:2]],
                           [self.scene.goal[:2]]])  # fmt: skip
        low, high = poses.min(axis=0) - radius, poses.max(axis=0) + radius
        for wall in self.scene.walls:
            corners = _wall(wall)
            low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
        for obstacle in self.scene.obstacles:
            size = max(obstacle.semi_axes)
            places = np.array([obstacle.place(time + self._since) for time in times])
            low = np.minimum(low, places.min(axis=0) - size)
            high = np.maximum(high, places.max(axis=0) + size)
        return low[0] - ROOM, high[0] + ROOM, low[1] - ROOM, high[1] + ROOM

    @property
    def _since(self) -> float:
        """Time on the clock of the obstacles at which the robot was sent off [s]."""
        return self.ride.since

    def draw(self, axes: Any, time: float) -> None:
        """Draw the drive at a time [s] since the robot was sent off."""
        drive, trace = self.ride.drive, self.ride.trace
        row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
        cycle = max(int(np.searchsorted(trace.times, time + 1e-9)) - 1, 0)
        self._obstacles(axes, time, cycle)
        for pose, colour in ((self.scene.start, START), (self.scene.goal, GOAL)):
            self._robot(axes, np.array(pose), colour, filled=False)
        self._robot(axes, drive.poses[row], NOW)
        axes.plot(*drive.poses[: row + 1, :2].T, color=INK, lw=1.0, zorder=5)
        if cycle in self.ride.planning:
            axes.plot(*self._plan(cycle, time).T, color=PLAN, lw=2.0, zorder=6,
                      solid_capstyle="round")  # fmt: skip
        axes.plot(*drive.poses[row, :2], "o", color=INK, ms=2.5, zorder=7)

    def _plan(self, cycle: int, time: float) -> Array:
        """What is still to come of the motion that is followed, (k, 2)."""
        trace = self.ride.trace
        times, places = trace.plan_times[cycle], trace.plans[cycle][:, :2]
        now = time + self._since
        fine = np.linspace(now, max(float(times[-1]), now), 40)
        return np.column_stack([np.interp(fine, times, places[:, k]) for k in (0, 1)])

    def _obstacles(self, axes: Any, time: float, cycle: int) -> None:
        for wall in self.scene.walls:
            axes.add_patch(Polygon(_wall(wall), closed=True, zorder=2, fc=WALL, ec=WALL, lw=0.3))
        known, now = self.ride.trace.known[cycle], time + self._since
        moves = np.hypot(*known.velocities.T) > 0.05 if len(known) else np.zeros(0, bool)
        reach = float(self.ride.trace.plan_times[cycle][-1]) - now
        outline: dict[str, Any] = {"fc": "none", "ec": AHEAD, "lw": 0.6, "alpha": 0.55}
        for ahead in np.arange(PREDICTED, max(reach, 0.0) + 1e-9, PREDICTED):
            centers = known.centers_at(np.array([now + ahead]))[0]
            for row in np.flatnonzero(moves).tolist():
                a, b = known.semi_axes[row]
                _ellipse(axes, centers[row], a, b, known.angles[row], zorder=1, **outline)
        for k, obstacle in enumerate(self.scene.obstacles):
            place = obstacle.place(now)
            axes.text(*place, f"{k + 1}", ha="center", va="center", fontsize=7, clip_on=True,
                      zorder=2.5)  # fmt: skip
            a, b = obstacle.semi_axes
            _ellipse(
                axes, place, a, b, obstacle.angle, zorder=2, fc=OBSTACLE, ec=AHEAD, lw=0.8
            )  # fmt: skip

    def trail(self, axes: Any, every: float) -> None:
        """Draw the whole drive, the robot each so many seconds."""
        drive = self.ride.drive
        self._obstacles(axes, 0.0, 0)
        for pose, colour in ((self.scene.start, START), (self.scene.goal, GOAL)):
            self._robot(axes, np.array(pose), colour, filled=False)
        for time in np.arange(every, _end(self.ride), every):
            row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
            box = _placed(CORNERS * self.half, drive.poses[row])
            nose = _placed(np.array([[1.0, 0.0], [0.7, 0.3], [0.7, -0.3]]) * self.half,
                           drive.poses[row])  # fmt: skip
            for points, alpha in ((box, 0.12), (nose, 0.6)):
                axes.add_patch(Polygon(points, closed=True, zorder=4, fc=NOW, lw=0, alpha=alpha))
            axes.add_patch(Polygon(box, closed=True, zorder=4, fc="none", ec=NOW, lw=0.7))
        axes.plot(*drive.poses[:, :2].T, color=INK, lw=1.0, zorder=5)

    def _robot(self, axes: Any, pose: Array, colour: str, filled: bool = True) -> None:
        """Box, wheels, and a mark in front."""
        fill: dict[str, Any] = {"fc": colour, "alpha": 0.35} if filled else {"fc": "none"}
        box = _placed(CORNERS * self.half, pose)
        order = 4 if filled else 3
        axes.add_patch(Polygon(box, closed=True, zorder=order, lw=0, **fill))
        axes.add_patch(Polygon(box, closed=True, zorder=order, fc="none", ec=colour, lw=1.2))
        nose = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]]) * self.half
        axes.add_patch(Polygon(_placed(nose, pose), closed=True, zorder=order, fc=colour, lw=0))
        wheels = self.robot.wheels
        for x, y, heading, radius in zip(
            wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True
        ):
            tread = _placed(CORNERS * [radius, 0.35 * radius], np.array([x, y, heading]))
            axes.add_patch(
                Polygon(_placed(tread, pose), closed=True, zorder=order, fc=colour, lw=0,
                        alpha=0.8 if filled else 0.5)
            )  # fmt: skip


def _ellipse(axes: Any, place: Array, a: float, b: float, angle: float, **options: Any) -> None:
    x, y = place.tolist()
    axes.add_patch(Ellipse((x, y), 2 * a, 2 * b, angle=math.degrees(angle), **options))


def _wall(wall: Wall) -> Array:
    """Corners (4, 2) in odom."""
    size = 0.5 * np.array([wall.length, wall.width])
    return _placed(CORNERS * size, np.array([wall.x, wall.y, wall.heading]))


def _placed(points: Array, pose: Array) -> Array:
    """Points (k, 2) of the robot in odom."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Array = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return result


def _frame(axes: Any, bounds: tuple[float, float, float, float], labels: bool = True) -> None:
    axes.set_xlim(*bounds[:2])
    axes.set_ylim(*bounds[2:])
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    if labels:
        axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def moments(scene: Scene, ride: Planned, count: int = 5) -> list[float]:
    """Times of the snapshots [s]: the scene's, or evenly spread over the drive."""
    if scene.snapshots:
        return list(scene.snapshots)
    return [_end(ride) * (k + 0.6) / count for k in range(count)]


# ---- the sheets ---------------------------------------------------------------------------------


def draw_free(
    robot: Robot, scene: Scene, ride: Planned, result: dict[str, Any], path: Path
) -> None:
    """Draw Fig. 4 of MPC 2021, how the robot turns on its way, and what it takes.

    Args:
        robot: The robot.
        scene: The free case.
        ride: How it was driven.
        result: What is published as JSON: `variants`, `energy`.
        path: Of the PNG file.
    """
    with plt.rc_context(STYLE):
        sheet = plt.figure(figsize=(12.0, 6.8), layout="constrained")
        grid = sheet.add_gridspec(1, 2, width_ratios=(1.15, 1))
        times = moments(scene, ride)
        left = grid[0].subgridspec(len(times), 1)
        view = TopView(robot, scene, ride)
        for i, time in enumerate(times):
            axes = sheet.add_subplot(left[i])
            view.draw(axes, time)
            _frame(axes, view.bounds(times), labels=i == len(times) - 1)
            axes.set_title(f"t = {time:g} s")
        right = grid[1].subgridspec(3, 1, height_ratios=(1.1, 1, 1.2))
        _slant(sheet.add_subplot(right[0]), robot, ride)
        _power(sheet.add_subplot(right[1]), robot)
        _bars(sheet.add_subplot(right[2]), result["energy"])
        _legend(sheet, scene)
        _save(sheet, path)


def draw_case(
    robot: Robot, scene: Scene, ride: Planned, path: Path, count: int = 5, columns: int = 3
) -> None:
    """Draw snapshots of a drive among obstacles, as in Fig. 5 of MPC 2021, and the gaps kept.

    Args:
        robot: The robot.
        scene: The case.
        ride: How it was driven.
        path: Of the PNG file.
        count: Snapshots, where the scene names none.
        columns: Of the sheet.
    """
    times = moments(scene, ride, count)
    view = TopView(robot, scene, ride)
    bounds = view.bounds(times)
    count = len(times)
    rows = math.ceil((count + 1) / columns)
    width = 12.0 / columns
    height = width * (bounds[3] - bounds[2]) / (bounds[1] - bounds[0]) + 0.55
    with plt.rc_context(STYLE):
        sheet = plt.figure(figsize=(12.0, rows * height + 0.3), layout="constrained")
        grid = sheet.add_gridspec(rows, columns)
        for i, time in enumerate(times):
            axes = sheet.add_subplot(grid[i // columns, i % columns])
            view.draw(axes, time)
            _frame(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")
        right = sheet.add_subplot(grid[count // columns, count % columns :])
        _gaps(right, ride, times, len(scene.obstacles))
        _legend(sheet, scene, bool(view.moving.any()))
        _save(sheet, path)


def draw_trail(robot: Robot, scene: Scene, ride: Planned, path: Path, every: float = 0.8) -> None:
    """Draw a drive through a building, the robot every so many seconds, and the gaps kept."""
    view = TopView(robot, scene, ride)
    bounds = view.bounds([0.0])
    with plt.rc_context(STYLE):
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        sheet = plt.figure(figsize=(12.0, 12.0 * ratio + 2.2), layout="constrained")
        grid = sheet.add_gridspec(2, 1, height_ratios=(12.0 * ratio, 1.6))
        axes = sheet.add_subplot(grid[0])
        view.trail(axes, every)
        _frame(axes, bounds)
        _gaps(sheet.add_subplot(grid[1]), ride, [], len(scene.obstacles))
        _save(sheet, path)


def animate(robot: Robot, scene: Scene, ride: Planned, path: Path) -> None:
    """Draw a drive as a GIF that moves in true time."""
    times = np.arange(0.0, _end(ride) + 1.0, 1.0 / FRAMES)
    view = TopView(robot, scene, ride)
    bounds = view.bounds([0.0, 0.5 * _end(ride)])
    with plt.rc_context(STYLE):
        ratio = (bounds[3] - bounds[2]) / (bounds[1] - bounds[0])
        sheet, axes = plt.subplots(figsize=(7.0, 7.0 * ratio + 0.5), dpi=60, layout="constrained")

        def show(time: float) -> None:
            axes.clear()
            view.draw(axes, time)
            _frame(axes, bounds)
            axes.set_title(f"t = {time:.1f} s")

        # The layout is made once: a frame takes half of the time, and none of them jumps.
        show(0.0)
        sheet.canvas.draw()
        sheet.set_layout_engine("none")
        film = FuncAnimation(sheet, show, frames=times.tolist(), init_func=lambda: None)
        path.parent.mkdir(parents=True, exist_ok=True)
        film.save(path, writer=PillowWriter(fps=FRAMES))
        plt.close(sheet)


def _save(sheet: Any, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.savefig(path)
    plt.close(sheet)


def _legend(sheet: Any, scene: Scene, moves: bool = False) -> None:
    box: dict[str, Any] = {"marker": "s", "ls": "", "ms": 7}
    marks = [
        Line2D([], [], color=START, mfc="none", label="start", **box),
        Line2D([], [], color=GOAL, mfc="none", label="goal", **box),
        Line2D([], [], color=NOW, alpha=0.7, label="robot", **box),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D([], [], color=PLAN, lw=2.0, label="planned"),
    ]
    disc: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
    if scene.obstacles:
        marks.append(Line2D([], [], color=OBSTACLE, mec=AHEAD, label="obstacle", **disc))
    if moves:
        marks.append(
            Line2D([], [], color=AHEAD, mfc="none", mew=0.6, alpha=0.7,
                       label=f"where it is expected, each {PREDICTED:g} s", **disc)
        )  # fmt: skip
    sheet.legend(handles=marks, loc="outside lower left", ncols=len(marks))


def _slant(axes: Any, robot: Robot, ride: Planned) -> None:
    """Direction of travel as seen from the robot, over time."""
    times, angles = ride.drive.slant()
    axes.plot(times, np.degrees(angles), color=INK, label="travel, in base_link")
    turned = np.degrees(ride.drive.poses[:, 2] - ride.drive.poses[0, 2])
    axes.plot(ride.drive.times, turned, color=START, lw=1.0, label="heading")
    for k, diagonal in enumerate(np.degrees(diagonals(robot))):
        axes.axhline(diagonal, color=GREY, ls="--", lw=0.8,
                     label="roller diagonals" if k == 0 else None)  # fmt: skip
    axes.set_xlim(0.0, _end(ride))
    axes.set_ylim(-100.0, 100.0)
    axes.set_yticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("angle [°]")
    axes.set_title("Does it turn to a roller diagonal?", pad=18)
    axes.legend(loc="lower left", ncols=3, bbox_to_anchor=(-0.02, 0.97), borderpad=0.1)


def _power(axes: Any, robot: Robot, speed: float = 0.85) -> None:
    directions = np.linspace(-90.0, 90.0, 361)
    axes.plot(directions, steady_power(robot, speed, np.radians(directions)), color=INK)
    for diagonal in np.degrees(diagonals(robot)):
        axes.axvline(diagonal, color=GREY, ls="--", lw=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(-90.0, 90.0)
    axes.set_xticks([-90, -45, 0, 45, 90])
    axes.set_xlabel("direction of travel in base_link [°]")
    axes.set_ylabel("power [W]")
    axes.set_title(f"Power that friction takes at {speed:g} m/s")


def _bars(axes: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Energies at equal arrival times."""
    place = np.arange(len(rows), dtype=float)
    table = np.array([[_number(row[name]) for name, _, _ in BARS] for row in rows])
    table = np.nan_to_num(table.reshape(-1, len(BARS)))
    used = [k for k in range(len(BARS)) if table[:, k].any()]
    for i, k in enumerate(used):
        shift = (i - 0.5 * (len(used) - 1)) * 0.8 / len(used)
        axes.bar(place + shift, table[:, k], width=0.75 / len(used), color=BARS[k][1],
                 label=BARS[k][2])  # fmt: skip
    tops = table.max(axis=1, initial=0.0)
    for x, top, row in zip(place, tops, rows, strict=True):
        if math.isfinite(_number(row["ratio"])):
            axes.text(x, top, f"{row['ratio']:.2f}", ha="center", va="bottom", fontsize=7.5)
    names = [f"{row['distance_m']:g} m\n{row['bearing_deg']:g}°" for row in rows]
    axes.set_xticks(place, names, fontsize=7.5 if len(rows) > 10 else 8.5)
    axes.set_ylabel("energy [J]")
    axes.set_ylim(0.0, 1.3 * max(float(tops.max(initial=0.0)), 1.0))
    axes.set_title("Energy at equal arrival times, and their ratio")
    axes.legend(loc="upper left", ncols=1)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _gaps(axes: Any, ride: Planned, times: Sequence[float], obstacles: int) -> None:
    """True gaps over time to so many obstacles, and to the walls."""
    drive = ride.drive
    for k, gaps in enumerate(drive.gaps.T):
        near = np.where(gaps < NEARBY, gaps, np.nan)
        label = "walls" if k == obstacles else f"{k + 1}"
        axes.plot(drive.times, near, lw=1.2, label=label)
    for time in times:
        axes.axvline(time, color=FAINT, lw=0.8, zorder=0)
    axes.axhline(0.0, color=START, lw=1.0)
    axes.set_xlim(0.0, _end(ride))
    axes.set_ylim(min(-0.05, drive.clearance - 0.05), 1.25 * NEARBY)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("true gap [m]")
    axes.set_title(f"Least gap {1e3 * drive.clearance:.0f} mm")
    axes.legend(loc="upper center", ncols=4, handlelength=1.0, columnspacing=1.0, borderpad=0.1)


def _end(ride: Planned) -> float:
    """When a drive is over [s]."""
    arrival = ride.drive.arrival
    return arrival if math.isfinite(arrival) else float(ride.drive.times[-1])
