"""Drives from above: the robot, obstacles and walls, the driven path and the planned motion."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon

from omniman_ros.console.figure_style import (
    BLUE,
    BRONZE,
    FAINT,
    GREY,
    INK,
    NEUTRAL,
    PINK,
    RED,
    SAND,
)
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.planned_drives import PlannedDrive
from omniman_ros.lab.studies.scene_geometry import Wall

BOX_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
FRONT_MARK = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]])
"""Corners of a box and of the triangle that marks its front, in half lengths and half widths."""
MOVING_SPEED = 0.05  # from which an obstacle is shown with its predicted positions [m/s]
MARGIN = 0.25  # between the drawn objects and the frame of the axes [m]
PREDICTION_STEP = 0.5  # between two predicted positions of an obstacle [s]


class TopView:
    """View of a drive from above, at a single time or as a trail."""

    def __init__(self, robot: Robot, scene: Scene, planned: PlannedDrive) -> None:
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
        drive, trace = self.planned.drive, self.planned.trace
        row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
        cycle = max(int(np.searchsorted(trace.times, time + 1e-9)) - 1, 0)
        self._draw_surroundings(axes, time, cycle)
        draw_robot(axes, self.robot, drive.poses[row], NEUTRAL, fill=0.35)
        axes.plot(*drive.poses[: row + 1, :2].T, color=INK, lw=1.0, zorder=5)
        if cycle in self.planned.planning:
            plan_times, now = trace.plan_times[cycle], time + self.planned.since
            fine = np.linspace(now, max(float(plan_times[-1]), now), 40)
            plan = [np.interp(fine, plan_times, column) for column in trace.plans[cycle].T[:2]]
            axes.plot(*plan, color=PINK, lw=2.0, zorder=6, solid_capstyle="round")

    def draw_trail(self, axes: Any, interval: float) -> None:
        """Draw the whole drive, with the robot at regular intervals [s]."""
        drive = self.planned.drive
        self._draw_surroundings(axes, 0.0, 0)
        for time in np.arange(interval, end_of(self.planned), interval):
            row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
            draw_robot(axes, self.robot, drive.poses[row], NEUTRAL, fill=0.12)
        axes.plot(*drive.poses[:, :2].T, color=INK, lw=1.0, zorder=5)

    def _draw_surroundings(self, axes: Any, time: float, cycle: int) -> None:
        """Draw start, goal, walls, true obstacles and their predictions of a planner's cycle."""
        for pose, colour in ((self.scene.start, RED), (self.scene.goal, BLUE)):
            draw_robot(axes, self.robot, np.array(pose), colour)
        for wall in self.scene.walls:
            axes.add_patch(Polygon(_wall_corners(wall), zorder=2, fc=GREY, ec=GREY, lw=0.3))
        known, now = self.planned.trace.known[cycle], time + self.planned.since
        moving = np.flatnonzero(np.hypot(*known.velocities.T) > MOVING_SPEED).tolist()
        reach = float(self.planned.trace.plan_times[cycle][-1]) - now
        faint: dict[str, Any] = {"fc": "none", "ec": BRONZE, "lw": 0.6, "alpha": 0.55}
        for ahead in np.arange(PREDICTION_STEP, max(reach, 0.0) + 1e-9, PREDICTION_STEP):
            centers = known.centers_at(np.array([now + ahead]))[0]
            for k in moving:
                _ellipse(axes, centers[k], known.semi_axes[k], known.angles[k], zorder=1, **faint)
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7, "clip_on": True}
        solid: dict[str, Any] = {"fc": SAND, "ec": BRONZE, "lw": 0.8, "zorder": 2}
        for k, obstacle in enumerate(self.scene.obstacles):
            position = obstacle.place(now)
            axes.text(*position, f"{k + 1}", zorder=2.5, **style)
            _ellipse(axes, position, obstacle.semi_axes, obstacle.angle, **solid)


def draw_robot(axes: Any, robot: Robot, pose: Array, colour: str, fill: float = 0.0) -> None:
    """Draw outline and front mark of a robot at a pose (3,), its area with an opacity."""
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    box, nose = _to_odom(BOX_CORNERS * half, pose), _to_odom(FRONT_MARK * half, pose)
    order = 4 if fill else 3
    axes.add_patch(Polygon(box, zorder=order, fc=colour, lw=0, alpha=fill))
    axes.add_patch(Polygon(box, zorder=order, fc="none", ec=colour, lw=1.0))
    axes.add_patch(Polygon(nose, zorder=order, fc=colour, lw=0, alpha=0.8))


def _ellipse(axes: Any, center: Array, semi_axes: Any, angle: float, **style: Any) -> None:
    a, b = semi_axes
    axes.add_patch(Ellipse(tuple(center), 2 * a, 2 * b, angle=math.degrees(angle), **style))


def _wall_corners(wall: Wall) -> Array:
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
