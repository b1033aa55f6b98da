"""Drives from above: the robot, obstacles and walls, and what is driven and planned."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon
from numpy.typing import NDArray

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

START = RED
GOAL = BLUE
ROBOT = NEUTRAL
PLAN = PINK
OBSTACLE = SAND
PREDICTION = BRONZE
"""Colour of the outline of obstacles and of their predicted positions."""
WALL = GREY
BOX_MARKER: dict[str, Any] = {"marker": "s", "ls": "", "ms": 7}
"""Style of a robot in a legend."""
DISC_MARKER: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
"""Style of an obstacle in a legend."""


NOSE = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]])
"""Corners of the mark in front of the robot, in half lengths and half widths."""
MOVING_SPEED = 0.05
"""Speed above which an obstacle is shown with its predicted positions [m/s]."""
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
"""Corners of a box, in half lengths and half widths."""
MARGIN = 0.25
"""Margin around everything that is drawn [m]."""
PREDICTION_STEP = 0.5
"""Time between two predicted positions of an obstacle [s]."""


class TopView:
    """A drive from above, at any of its times.

    Args:
        robot: The robot, for its outline and wheels.
        scene: Start, goal and obstacles.
        ride: The drive.
    """

    def __init__(self, robot: Robot, scene: Scene, ride: PlannedDrive) -> None:
        self.robot, self.scene, self.ride = robot, scene, ride
        self.half = 0.5 * np.array([robot.body.length, robot.body.width])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(M,) whether each obstacle moves within the first second."""
        if not self.scene.obstacles:
            return np.zeros(0, dtype=bool)
        return np.array(
            [np.ptp([o.place(0.0), o.place(1.0)], axis=0).any() for o in self.scene.obstacles]
        )

    def bounds(self, times: Sequence[float]) -> tuple[float, float, float, float]:
        """Return x_min, x_max, y_min, y_max of all that is drawn at any of these times [m]."""
        radius = math.hypot(*self.half)
        poses = np.vstack(
            [self.ride.drive.poses[:, :2], [self.scene.start[:2]], [self.scene.goal[:2]]]
        )
        low, high = poses.min(axis=0) - radius, poses.max(axis=0) + radius
        for wall in self.scene.walls:
            corners = wall_corners(wall)
            low, high = np.minimum(low, corners.min(axis=0)), np.maximum(high, corners.max(axis=0))
        for obstacle in self.scene.obstacles:
            size = max(obstacle.semi_axes)
            places = np.array([obstacle.place(time + self._since) for time in times])
            low = np.minimum(low, places.min(axis=0) - size)
            high = np.maximum(high, places.max(axis=0) + size)
        return low[0] - MARGIN, high[0] + MARGIN, low[1] - MARGIN, high[1] + MARGIN

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
        self._robot(axes, drive.poses[row], ROBOT)
        axes.plot(*drive.poses[: row + 1, :2].T, color=INK, lw=1.0, zorder=5)
        if cycle in self.ride.planning:
            axes.plot(
                *self._plan(cycle, time).T, color=PLAN, lw=2.0, zorder=6, solid_capstyle="round"
            )
        axes.plot(*drive.poses[row, :2], "o", color=INK, ms=2.5, zorder=7)

    def _plan(self, cycle: int, time: float) -> Array:
        """Return the positions (k, 2) that the followed motion has still ahead."""
        trace = self.ride.trace
        times, places = trace.plan_times[cycle], trace.plans[cycle][:, :2]
        now = time + self._since
        fine = np.linspace(now, max(float(times[-1]), now), 40)
        return np.column_stack([np.interp(fine, times, places[:, k]) for k in (0, 1)])

    def _obstacles(self, axes: Any, time: float, cycle: int) -> None:
        for wall in self.scene.walls:
            axes.add_patch(
                Polygon(wall_corners(wall), closed=True, zorder=2, fc=WALL, ec=WALL, lw=0.3)
            )
        known, now = self.ride.trace.known[cycle], time + self._since
        moves = np.hypot(*known.velocities.T) > MOVING_SPEED if len(known) else np.zeros(0, bool)
        reach = float(self.ride.trace.plan_times[cycle][-1]) - now
        outline: dict[str, Any] = {"fc": "none", "ec": PREDICTION, "lw": 0.6, "alpha": 0.55}
        for ahead in np.arange(PREDICTION_STEP, max(reach, 0.0) + 1e-9, PREDICTION_STEP):
            centers = known.centers_at(np.array([now + ahead]))[0]
            for row in np.flatnonzero(moves).tolist():
                a, b = known.semi_axes[row]
                draw_ellipse(axes, centers[row], a, b, known.angles[row], zorder=1, **outline)
        for k, obstacle in enumerate(self.scene.obstacles):
            position = obstacle.place(now)
            axes.text(
                *position,
                f"{k + 1}",
                ha="center",
                va="center",
                fontsize=7,
                clip_on=True,
                zorder=2.5,
            )
            a, b = obstacle.semi_axes
            draw_ellipse(
                axes, position, a, b, obstacle.angle, zorder=2, fc=OBSTACLE, ec=PREDICTION, lw=0.8
            )

    def trail(self, axes: Any, every: float) -> None:
        """Draw the whole drive, with the robot at intervals [s]."""
        drive = self.ride.drive
        self._obstacles(axes, 0.0, 0)
        for pose, colour in ((self.scene.start, START), (self.scene.goal, GOAL)):
            self._robot(axes, np.array(pose), colour, filled=False)
        for time in np.arange(every, end_of(self.ride), every):
            row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
            box = place(CORNERS * self.half, drive.poses[row])
            nose = place(NOSE * self.half, drive.poses[row])
            for points, alpha in ((box, 0.12), (nose, 0.6)):
                axes.add_patch(Polygon(points, closed=True, zorder=4, fc=ROBOT, lw=0, alpha=alpha))
            axes.add_patch(Polygon(box, closed=True, zorder=4, fc="none", ec=ROBOT, lw=0.7))
        axes.plot(*drive.poses[:, :2].T, color=INK, lw=1.0, zorder=5)

    def _robot(self, axes: Any, pose: Array, colour: str, filled: bool = True) -> None:
        """Draw outline and wheels of the robot, and a mark in front."""
        fill: dict[str, Any] = {"fc": colour, "alpha": 0.35} if filled else {"fc": "none"}
        box = place(CORNERS * self.half, pose)
        order = 4 if filled else 3
        axes.add_patch(Polygon(box, closed=True, zorder=order, lw=0, **fill))
        axes.add_patch(Polygon(box, closed=True, zorder=order, fc="none", ec=colour, lw=1.2))
        axes.add_patch(
            Polygon(place(NOSE * self.half, pose), closed=True, zorder=order, fc=colour, lw=0)
        )
        wheels = self.robot.wheels
        for x, y, heading, radius in zip(
            wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True
        ):
            tread = place(CORNERS * [radius, 0.35 * radius], np.array([x, y, heading]))
            axes.add_patch(
                Polygon(
                    place(tread, pose),
                    closed=True,
                    zorder=order,
                    fc=colour,
                    lw=0,
                    alpha=0.8 if filled else 0.5,
                )
            )


def draw_ellipse(
    axes: Any, center: Array, a: float, b: float, angle: float, **options: Any
) -> None:
    """Draw an ellipse with its centre (2,) and semi-axes in odom [m] and its angle [rad]."""
    x, y = center.tolist()
    axes.add_patch(Ellipse((x, y), 2 * a, 2 * b, angle=math.degrees(angle), **options))


def wall_corners(wall: Wall) -> Array:
    """Return the corners (4, 2) of a wall in odom."""
    size = 0.5 * np.array([wall.length, wall.width])
    return place(CORNERS * size, np.array([wall.x, wall.y, wall.heading]))


def place(points: Array, pose: Array) -> Array:
    """Transform points (k, 2) of base_link into odom."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Array = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return result


def frame_axes(axes: Any, bounds: tuple[float, float, float, float], labels: bool = True) -> None:
    """Set limits, grid and labels of axes that show odom from above."""
    axes.set_xlim(*bounds[:2])
    axes.set_ylim(*bounds[2:])
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    if labels:
        axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_legend(sheet: Any, scene: Scene, moves: bool = False) -> None:
    """Draw the legend of a figure of a scene, whose obstacles may move."""
    marks = [
        Line2D([], [], color=START, mfc="none", label="start", **BOX_MARKER),
        Line2D([], [], color=GOAL, mfc="none", label="goal", **BOX_MARKER),
        Line2D([], [], color=ROBOT, alpha=0.7, label="robot", **BOX_MARKER),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D([], [], color=PLAN, lw=2.0, label="planned"),
    ]
    if scene.obstacles:
        marks.append(
            Line2D([], [], color=OBSTACLE, mec=PREDICTION, label="obstacle", **DISC_MARKER)
        )
    if moves:
        marks.append(
            Line2D(
                [],
                [],
                color=PREDICTION,
                mfc="none",
                mew=0.6,
                alpha=0.7,
                label=f"predicted, every {PREDICTION_STEP:g} s",
                **DISC_MARKER,
            )
        )
    sheet.legend(handles=marks, loc="outside lower left", ncols=len(marks))


def end_of(ride: PlannedDrive) -> float:
    """Return the time at which a drive ends [s]."""
    arrival = ride.drive.arrival
    return arrival if math.isfinite(arrival) else float(ride.drive.times[-1])
