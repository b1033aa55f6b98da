"""A picture of the demo's drive: where the robot went, and how its errors went with time."""

import math
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.score import DrivenGoal, DrivenLeg, DrivenTwist, Reference, pose_errors
from omniman_ros.cli.tool_leg import ToolTrack
from omniman_ros.core.robot import Robot

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Circle, Polygon

Array = NDArray[np.float64]

INK, FAINT, TWISTS, PATH, TRUTH, ROBOT, GOAL, OBSTACLE, TOOL = (
    "#1f2933", "#c3cad2", "#2f6fde", "#d9480f", "#0b8043", "#5f6b7a", "#b5179e", "#8d6e63",
    "#0891b2",
)  # fmt: skip
LINES = 16
"""Times at which a line is drawn from the platform to the tool."""
OUTLINES = 10
"""Poses along the way at which the robot is outlined, the first and last included."""
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


def draw(
    robot: Robot,
    recording: Recording,
    twists: list[DrivenTwist],
    legs: list[DrivenLeg],
    path: Path,
    goal: DrivenGoal | None = None,
    tool: ToolTrack | None = None,
) -> None:
    """Draw the demo into a PNG file."""
    odom, truth = np.array(recording.odom), np.array(recording.truth)
    begin = twists[0].start
    style: dict[str, Any] = {
        "font.size": 9, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "text.color": INK,
        "xtick.color": ROBOT, "ytick.color": ROBOT, "axes.spines.top": False,
        "axes.spines.right": False, "axes.titlesize": 10, "axes.titleweight": "bold",
        "axes.titlelocation": "left", "figure.dpi": 130,
    }  # fmt: skip
    with plt.rc_context(style):
        count = 3 + bool(recording.arm) + (tool is not None)
        sheet = plt.figure(figsize=(11, 2.0 * count), layout="constrained")
        grid = sheet.add_gridspec(count, 2, width_ratios=(1.15, 1))
        _way(sheet.add_subplot(grid[:, 0]), robot, odom, truth, legs, goal, tool)
        rows = [sheet.add_subplot(grid[i, 1]) for i in range(count)]
        _speeds(rows[0], odom, begin)
        _coupling(rows[1], np.array(recording.coupling), begin)
        _tracking(rows[2], odom, Reference(recording.reference), legs, begin)
        if recording.arm:
            _arm(rows[3], np.array(recording.arm), begin)
        if tool is not None:
            _tool(rows[-1], tool, begin)
        marked = legs if goal is None else [*legs, DrivenLeg("goal", goal.start, goal.end)]
        if tool is not None:
            marked = [*marked, DrivenLeg("tool", tool.times[0], tool.times[-1])]
        for axes in rows:
            _mark(axes, twists, marked, begin)
            axes.set_xlim(0.0, odom[-1, 0] - begin)
        for axes in rows[:-1]:
            axes.tick_params(labelbottom=False)
        rows[-1].set_xlabel("time [s]")
        path.parent.mkdir(parents=True, exist_ok=True)
        sheet.savefig(path)
        plt.close(sheet)


def _way(
    axes: Any,
    robot: Robot,
    odom: Array,
    truth: Array,
    legs: list[DrivenLeg],
    goal: DrivenGoal | None,
    tool: ToolTrack | None,
) -> None:
    """Top view: x forward is up, y left is left, as the robot sees it at the start."""
    if goal is not None:
        _among_obstacles(axes, odom, goal)
    on_path = odom[:, 0] >= legs[0].start
    axes.plot(
        -odom[~on_path, 2], odom[~on_path, 1], color=TWISTS, lw=2.0, zorder=4, label="cmd_vel"
    )
    axes.plot(-odom[on_path, 2], odom[on_path, 1], color=PATH, lw=2.0, zorder=4, label="path")
    axes.plot(
        -truth[:, 2],
        truth[:, 1],
        color=TRUTH,
        lw=1.0,
        ls=(0, (4, 4)),
        zorder=5,
        label="ground truth",
    )
    if tool is not None:
        x, y = tool.measured[:, 0, 3], tool.measured[:, 1, 3]
        axes.plot(-y, x, color=TOOL, lw=1.6, zorder=5.5, label="tool")
        for k in np.linspace(0, len(x) - 1, LINES).astype(int):
            base = tool.platform[k]
            axes.plot([-base[1], -y[k]], [base[0], x[k]], color=TOOL, lw=0.6, alpha=0.5, zorder=5)
    for i in np.linspace(0, len(odom) - 1, OUTLINES).astype(int)[1:-1]:
        _outline(axes, robot, odom[i, 1:4], alpha=0.5)
    _robot(axes, robot, odom[-1, 1:4])
    axes.set_aspect("equal")
    axes.set_title("Way of the platform in odom")
    axes.set_xlabel("← y [m]")
    axes.set_ylabel("x [m] →")
    axes.xaxis.set_major_formatter(lambda value, _: f"{-value + 0.0:g}")
    axes.grid(color=FAINT, lw=0.4)
    axes.legend(frameon=False, loc="best")


def _among_obstacles(axes: Any, odom: Array, goal: DrivenGoal) -> None:
    """The way to the goal, and where the obstacles went: as discs where they were nearest."""
    during = odom[(odom[:, 0] >= goal.start) & (odom[:, 0] <= goal.end)]
    axes.plot(-during[:, 2], during[:, 1], color=GOAL, lw=2.0, zorder=4.5, label="goal")
    axes.plot(-goal.goal[1], goal.goal[0], "*", color=GOAL, ms=11, zorder=6)
    crossing = goal.crossing
    nearest = crossing.gaps(during[:, :4], (0.0, 0.0)).argmin(axis=0)
    begin, end = crossing.at(goal.start), crossing.at(goal.end)
    for k, radius in enumerate(crossing.radii.tolist()):
        x, y = crossing.at(float(during[nearest[k], 0]))[k]
        axes.add_patch(Circle((-y, x), radius, facecolor=OBSTACLE, edgecolor="none", alpha=0.45))
        axes.plot(
            [-begin[k, 1], -end[k, 1]], [begin[k, 0], end[k, 0]], color=OBSTACLE, lw=1.0, ls=":"
        )


def _outline(axes: Any, robot: Robot, pose: Array, **options: Any) -> None:
    """Bounding box and a mark in front."""
    corners = CORNERS * [robot.body.length / 2, robot.body.width / 2]
    nose = np.array([[0.5, 0.0], [0.42, 0.06], [0.42, -0.06]]) * robot.body.length
    axes.add_patch(_patch(corners, pose, facecolor="none", edgecolor=FAINT, **options))
    axes.add_patch(_patch(nose, pose, facecolor=FAINT, edgecolor="none", **options))


def _robot(axes: Any, robot: Robot, pose: Array) -> None:
    """Outline, and wheels with a line along the axis of the roller on the floor."""
    _outline(axes, robot, pose)
    wheels = robot.wheels
    for x, y, heading, roller, radius in zip(
        wheels.x, wheels.y, wheels.heading, wheels.roller_angle, wheels.radius, strict=True
    ):
        tread = CORNERS * [radius, 0.4 * radius]
        inside = _turn(tread, heading) + [x, y]
        axes.add_patch(_patch(inside, pose, facecolor="#9aa5b1", edgecolor=ROBOT, lw=0.5))
        axis = _turn(np.array([[-0.6 * radius, 0.0], [0.6 * radius, 0.0]]), heading + roller)
        line = _place(axis + [x, y], pose)
        axes.plot(*line.T, color="white", lw=1.2, zorder=1.5)


def _turn(points: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _place(points: Array, pose: Array) -> Array:
    """Points of the robot in the picture's axes (-y, x)."""
    x, y = (_turn(points, pose[2]) + pose[:2]).T
    return np.column_stack([-y, x])


def _patch(points: Array, pose: Array, **options: Any) -> Polygon:
    return Polygon(_place(points, pose), closed=True, zorder=1, **options)


def _speeds(axes: Any, odom: Array, begin: float) -> None:
    time = odom[:, 0] - begin
    for column, name, color in ((4, "x' [m/s]", TWISTS), (5, "y' [m/s]", PATH),
                                (6, "θ' [rad/s]", TRUTH)):  # fmt: skip
        axes.plot(time, odom[:, column], color=color, lw=1.2, label=name)
    axes.set_title("Twist in base_link, from the encoders")
    axes.legend(frameon=False, ncols=3, loc="lower left")


def _coupling(axes: Any, coupling: Array, begin: float) -> None:
    axes.set_title("Coupling error ε [rad]")
    if coupling.shape[1] < 2:
        axes.text(
            0.5, 0.5, "three wheels have no constraint", transform=axes.transAxes, ha="center"
        )
        return
    for column in range(1, coupling.shape[1]):
        axes.plot(coupling[:, 0] - begin, coupling[:, column], color=INK, lw=1.2)


def _tracking(
    axes: Any, odom: Array, reference: Reference, legs: list[DrivenLeg], begin: float
) -> None:
    for leg in legs:
        during = odom[reference.during(odom[:, 0], [leg])]
        error = 1e3 * pose_errors(during, reference)[0]
        axes.plot(during[:, 0] - begin, error, color=PATH, lw=1.2)
    axes.set_title("Tracking error on the path [mm]")
    axes.set_ylim(bottom=0.0)


def _arm(axes: Any, arm: Array, begin: float) -> None:
    """Joint angles from where they were in the beginning."""
    for column in range(1, arm.shape[1]):
        axes.plot(arm[:, 0] - begin, arm[:, column] - arm[0, column], lw=1.2, label=str(column))
    axes.set_title("Joints of the arm, measured, from the start [rad]")
    axes.legend(frameon=False, ncols=6, loc="lower left")


def _tool(axes: Any, tool: ToolTrack, begin: float) -> None:
    """Distance of the tool from the timed point of its path."""
    axes.plot(tool.times - begin, 1e3 * tool.errors, color=TOOL, lw=1.0, label="in odom")
    axes.plot(
        tool.times - begin, 1e3 * tool.true_errors, color=TRUTH, lw=1.0, ls=(0, (4, 4)),
        label="ground truth",
    )  # fmt: skip
    axes.set_title("Tool off its path, timed [mm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, loc="upper left")


def _mark(axes: Any, twists: list[DrivenTwist], legs: list[DrivenLeg], begin: float) -> None:
    """Light bands where something is driven."""
    parts = [(driven.start, driven.phase.duration) for driven in twists]
    parts += [(leg.start, leg.end - leg.start) for leg in legs]
    for start, duration in parts:
        axes.axvspan(start - begin, start - begin + duration, color="#eef2f7", zorder=0, lw=0)
