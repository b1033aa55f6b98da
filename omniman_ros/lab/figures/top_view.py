"""Drives from above: the robot, obstacles and walls, the driven path and the planned motion."""

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

START_COLOUR = RED  # colour of the robot's outline at the start
GOAL_COLOUR = BLUE  # colour of the robot's outline at the goal
ROBOT_COLOUR = NEUTRAL  # colour of the robot while it drives
PLAN_COLOUR = PINK  # colour of the planned motion
OBSTACLE_COLOUR = SAND  # colour of the area of obstacles
PREDICTION_COLOUR = BRONZE  # colour of the outline of obstacles and of their predicted positions
WALL_COLOUR = GREY  # colour of walls
BOX_MARKER: dict[str, Any] = {"marker": "s", "ls": "", "ms": 7}
"""Legend marker of a robot: keyword arguments of `Line2D`."""
DISC_MARKER: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
"""Legend marker of an obstacle: keyword arguments of `Line2D`."""


FRONT_MARK = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]])
"""Corners (3, 2) of the triangle that marks the robot's front, in half lengths and half widths."""
MOVING_SPEED = 0.05  # speed above which an obstacle is shown with its predicted positions [m/s]
BOX_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
"""Corners (4, 2) of a box, in half lengths and half widths."""
MARGIN = 0.25  # margin between the drawn objects and the frame of the axes [m]
PREDICTION_STEP = 0.5  # time between two predicted positions of an obstacle [s]


class TopView:
    """View of a drive from above, at a single time or as a trail.

    Attributes:
        half: (2,) half length and half width of the robot [m].
    """

    def __init__(self, robot: Robot, scene: Scene, planned: PlannedDrive) -> None:
        self.robot, self.scene, self.planned = robot, scene, planned
        self.half = 0.5 * np.array([robot.body.length, robot.body.width])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(m,) Whether each obstacle moves within the first second."""
        if not self.scene.obstacles:
            return np.zeros(0, dtype=bool)
        return np.array(
            [np.ptp([o.place(0.0), o.place(1.0)], axis=0).any() for o in self.scene.obstacles]
        )

    def bounds(self, times: Sequence[float]) -> tuple[float, float, float, float]:
        """Return the bounds of everything that is drawn at the given times."""
        radius = math.hypot(*self.half)
        poses = np.vstack(
            [self.planned.drive.poses[:, :2], [self.scene.start[:2]], [self.scene.goal[:2]]]
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
        return self.planned.since

    def draw(self, axes: Any, time: float) -> None:
        """Draw the drive at one time."""
        drive, trace = self.planned.drive, self.planned.trace
        row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
        cycle = max(int(np.searchsorted(trace.times, time + 1e-9)) - 1, 0)
        self._draw_obstacles(axes, time, cycle)
        for pose, colour in ((self.scene.start, START_COLOUR), (self.scene.goal, GOAL_COLOUR)):
            draw_robot(axes, self.robot, np.array(pose), colour, filled=False)
        draw_robot(axes, self.robot, drive.poses[row], ROBOT_COLOUR)
        axes.plot(*drive.poses[: row + 1, :2].T, color=INK, lw=1.0, zorder=5)
        if cycle in self.planned.planning:
            axes.plot(
                *self._plan(cycle, time).T,
                color=PLAN_COLOUR,
                lw=2.0,
                zorder=6,
                solid_capstyle="round",
            )
        axes.plot(*drive.poses[row, :2], "o", color=INK, ms=2.5, zorder=7)

    def _plan(self, cycle: int, time: float) -> Array:
        """Return the positions (k, 2) of the rest of the motion that the robot follows [m]."""
        trace = self.planned.trace
        times, places = trace.plan_times[cycle], trace.plans[cycle][:, :2]
        now = time + self._since
        fine = np.linspace(now, max(float(times[-1]), now), 40)
        return np.column_stack([np.interp(fine, times, places[:, k]) for k in (0, 1)])

    def _draw_obstacles(self, axes: Any, time: float, cycle: int) -> None:
        """Draw walls, true obstacles and the predictions that the planner made in a cycle."""
        for wall in self.scene.walls:
            axes.add_patch(
                Polygon(
                    wall_corners(wall),
                    closed=True,
                    zorder=2,
                    fc=WALL_COLOUR,
                    ec=WALL_COLOUR,
                    lw=0.3,
                )
            )
        known, now = self.planned.trace.known[cycle], time + self._since
        is_moving = (
            np.hypot(*known.velocities.T) > MOVING_SPEED if len(known) else np.zeros(0, bool)
        )
        reach = float(self.planned.trace.plan_times[cycle][-1]) - now
        outline: dict[str, Any] = {"fc": "none", "ec": PREDICTION_COLOUR, "lw": 0.6, "alpha": 0.55}
        for ahead in np.arange(PREDICTION_STEP, max(reach, 0.0) + 1e-9, PREDICTION_STEP):
            centers = known.centers_at(np.array([now + ahead]))[0]
            for row in np.flatnonzero(is_moving).tolist():
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
                axes,
                position,
                a,
                b,
                obstacle.angle,
                zorder=2,
                fc=OBSTACLE_COLOUR,
                ec=PREDICTION_COLOUR,
                lw=0.8,
            )

    def draw_trail(self, axes: Any, interval: float) -> None:
        """Draw the whole drive, with the robot at regular intervals."""
        drive = self.planned.drive
        self._draw_obstacles(axes, 0.0, 0)
        for pose, colour in ((self.scene.start, START_COLOUR), (self.scene.goal, GOAL_COLOUR)):
            draw_robot(axes, self.robot, np.array(pose), colour, filled=False)
        for time in np.arange(interval, end_of(self.planned), interval):
            row = min(int(np.searchsorted(drive.times, time)), len(drive.times) - 1)
            box = to_odom(BOX_CORNERS * self.half, drive.poses[row])
            nose = to_odom(FRONT_MARK * self.half, drive.poses[row])
            for points, alpha in ((box, 0.12), (nose, 0.6)):
                axes.add_patch(
                    Polygon(points, closed=True, zorder=4, fc=ROBOT_COLOUR, lw=0, alpha=alpha)
                )
            axes.add_patch(Polygon(box, closed=True, zorder=4, fc="none", ec=ROBOT_COLOUR, lw=0.7))
        axes.plot(*drive.poses[:, :2].T, color=INK, lw=1.0, zorder=5)


def draw_robot(axes: Any, robot: Robot, pose: Array, colour: str, filled: bool = True) -> None:
    """Draw a robot from above: its outline, its wheels and the front mark.

    Args:
        pose: (3,) pose in odom [m, m, rad].
    """
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    fill: dict[str, Any] = {"fc": colour, "alpha": 0.35} if filled else {"fc": "none"}
    box = to_odom(BOX_CORNERS * half, pose)
    order = 4 if filled else 3
    axes.add_patch(Polygon(box, closed=True, zorder=order, lw=0, **fill))
    axes.add_patch(Polygon(box, closed=True, zorder=order, fc="none", ec=colour, lw=1.2))
    axes.add_patch(
        Polygon(to_odom(FRONT_MARK * half, pose), closed=True, zorder=order, fc=colour, lw=0)
    )
    wheels = robot.wheels
    for x, y, heading, radius in zip(
        wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True
    ):
        tread = to_odom(BOX_CORNERS * [radius, 0.35 * radius], np.array([x, y, heading]))
        axes.add_patch(
            Polygon(
                to_odom(tread, pose),
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
    """Draw an ellipse.

    Args:
        center: (2,) centre in odom [m].
    """
    x, y = center.tolist()
    axes.add_patch(Ellipse((x, y), 2 * a, 2 * b, angle=math.degrees(angle), **options))


def wall_corners(wall: Wall) -> Array:
    """Return the corners (4, 2) of a wall in odom [m]."""
    size = 0.5 * np.array([wall.length, wall.width])
    return to_odom(BOX_CORNERS * size, np.array([wall.x, wall.y, wall.heading]))


def to_odom(points: Array, pose: Array) -> Array:
    """Transform points (k, 2) [m] from base_link to odom, given the pose (3,) of base_link."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    result: Array = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return result


def frame_axes(axes: Any, bounds: tuple[float, float, float, float], labels: bool = True) -> None:
    """Set limits, grid and labels of axes that show the plane of odom."""
    axes.set_xlim(*bounds[:2])
    axes.set_ylim(*bounds[2:])
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    if labels:
        axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_legend(figure: Any, scene: Scene, has_moving: bool = False) -> None:
    """Draw the legend of a figure of a scene."""
    handles = [
        Line2D([], [], color=START_COLOUR, mfc="none", label="start", **BOX_MARKER),
        Line2D([], [], color=GOAL_COLOUR, mfc="none", label="goal", **BOX_MARKER),
        Line2D([], [], color=ROBOT_COLOUR, alpha=0.7, label="robot", **BOX_MARKER),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D([], [], color=PLAN_COLOUR, lw=2.0, label="planned"),
    ]
    if scene.obstacles:
        handles.append(
            Line2D(
                [],
                [],
                color=OBSTACLE_COLOUR,
                mec=PREDICTION_COLOUR,
                label="obstacle",
                **DISC_MARKER,
            )
        )
    if has_moving:
        handles.append(
            Line2D(
                [],
                [],
                color=PREDICTION_COLOUR,
                mfc="none",
                mew=0.6,
                alpha=0.7,
                label=f"predicted, every {PREDICTION_STEP:g} s",
                **DISC_MARKER,
            )
        )
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))


def end_of(planned: PlannedDrive) -> float:
    """Return the time of arrival, or of the last sample if the robot did not arrive [s]."""
    arrival = planned.drive.arrival
    return arrival if math.isfinite(arrival) else float(planned.drive.times[-1])
