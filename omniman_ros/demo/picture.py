"""Picture of the demo: the path of the robot from above, and its errors over time.

Importing this module raises ImportError if matplotlib is not installed.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Circle, Polygon

from omniman_ros.console.figure_style import (
    BLUE,
    BROWN,
    CYAN,
    FAINT,
    GREEN,
    GREY,
    INK,
    MAGENTA,
    ORANGE,
    figure_style,
    save_figure,
)
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.demo.demo import Demo
from omniman_ros.demo.figures import DrivenGoal, Reference, ToolTrack, obstacle_gaps, tool_track
from omniman_ros.demo.perception import Perception
from omniman_ros.demo.recorder import DemoRecording

TWISTS = BLUE  #: Colour of the part that is driven through `cmd_vel`
PATH = ORANGE  #: Colour of the part that follows paths
TRUTH = GREEN  #: Colour of the ground truth
GOAL = MAGENTA  #: Colour of the part that drives to the goal
OBSTACLE = BROWN  #: Colour of the obstacles
SCAN = "#e03131"  #: Colour of the points of a scan
TRACK = "#0b7285"  #: Colour of tracked persons and their velocities
TOOL = CYAN  #: Colour of the tool's path
WHEEL = "#9aa5b1"  #: Colour of the robot's wheels
BAND = "#eef2f7"  #: Colour of the bands behind the intervals in which the robot was driven
DASHED = (0, (4, 4))  #: Line style of the ground truth
OCCUPIED = 60  #: Occupancy above which a cell of the map is drawn [%]
ARROWS = 12  #: Number of velocities of tracked persons drawn, each as long as the way in 1 s
AROUND = 1.6  #: Distance around the robot's way up to which the map is shown [m]
TOOL_LINES = 16  #: Number of instants for which a line is drawn from the platform to the tool
OUTLINES = 10  #: Number of poses along the path, with the ends, at which the robot is outlined
#: Corners (4, 2) of a square with sides of length 2 about the origin, in clockwise order
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


def draw_demo(demo: Demo, recording: DemoRecording, path: Path) -> Path:
    """Draw the demo, driven and measured, into a file, and return the file's path."""
    odom = np.array(recording.odom)
    tool = None
    if demo.model and demo.tool:
        tool = tool_track(recording, demo.model, demo.tool.interval)
    start = demo.twists[0].start
    with figure_style(axes_titlesize=10, legend_fontsize=9, lines_linewidth=1.2):
        below = 1 + bool(recording.arm) + (tool is not None)
        figure = plt.figure(figsize=(13, 8.6), layout="constrained")
        grid = figure.add_gridspec(3, 6)  # the top view, two panels beside it, the others below
        _draw_top_view(figure.add_subplot(grid[:2, :4]), demo, recording, tool)
        places = [grid[0, 4:], grid[1, 4:]]
        places += [grid[2, 6 // below * i : 6 // below * (i + 1)] for i in range(below)]
        panels = [figure.add_subplot(place) for place in places]
        _draw_twist(panels[0], odom, start)
        _draw_coupling(panels[1], np.array(recording.coupling), start)
        _draw_tracking(panels[2], odom, Reference(recording.reference), demo, start)
        if recording.arm:
            _draw_arm(panels[3], np.array(recording.arm), start)
        if tool is not None:
            _draw_tool(panels[-1], tool, start)
        for axes in panels:
            for begin, end in _driven_spans(demo):
                axes.axvspan(begin - start, end - start, color=BAND, zorder=0, lw=0)
            axes.set_xlim(0.0, odom[-1, 0] - start)
        panels[0].tick_params(labelbottom=False)
        for axes in panels[1:]:
            axes.set_xlabel("time [s]")
        return save_figure(figure, path)


def _draw_legend(axes: Any) -> None:
    """Draw a legend in a line between the title and the axes, where it covers no curve."""
    count = len(axes.get_legend_handles_labels()[1])
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    axes.legend(ncols=count, handlelength=1.2, columnspacing=1.0, borderpad=0.0, **place)
    axes.set_title(axes.get_title(loc="left"), pad=20.0)


def _driven_spans(demo: Demo) -> list[tuple[float, float]]:
    """Return the ROS times [s] between which the robot was driven."""
    motions = [motion.interval for motion in (demo.goal, demo.tool) if motion]
    return [(phase.start, phase.start + phase.duration) for phase in demo.twists] + [
        (interval.start, interval.end) for interval in (*demo.path_intervals, *motions)
    ]


# ---- top view -------------------------------------------------------------------------------


def _draw_top_view(
    axes: Any, demo: Demo, recording: DemoRecording, tool: ToolTrack | None
) -> None:
    """Draw the path of platform and tool: x points up, y to the left."""
    odom, truth = np.array(recording.odom), np.array(recording.truth)
    if demo.goal is not None:
        _draw_goal(axes, odom, demo.goal)
    on_path = odom[:, 0] >= demo.movements[0].start
    wide, thin = {"lw": 2.0, "zorder": 4}, {"lw": 1.0, "ls": DASHED, "zorder": 5}
    for rows, colour, name, style in (
        (odom[~on_path], TWISTS, "cmd_vel", wide),
        (odom[on_path], PATH, "path", wide),
        (truth, TRUTH, "ground truth", thin),
    ):
        axes.plot(-rows[:, 2], rows[:, 1], color=colour, label=name, **style)
    if tool is not None:
        _draw_tool_path(axes, demo.robot, tool)
    for i in np.linspace(0, len(odom) - 1, OUTLINES).astype(int)[1:-1]:
        _draw_outline(axes, demo.robot, odom[i, 1:4], alpha=0.5)
    _draw_robot(axes, demo.robot, odom[-1, 1:4])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("Path of the platform in odom")
    axes.set_xlabel("← y [m]")
    axes.set_ylabel("x [m] →")
    axes.xaxis.set_major_formatter(lambda value, _: f"{-value + 0.0:g}")
    axes.grid(color=FAINT, lw=0.4)
    _draw_legend(axes)


def _draw_tool_path(axes: Any, robot: Platform, tool: ToolTrack) -> None:
    """Draw the path of the tool, lines to it from the platform, and outlines of the platform."""
    x, y = tool.measured[:, :2].T
    axes.plot(-y, x, color=TOOL, lw=1.6, zorder=5.5, label="tool")
    instants = np.linspace(0, len(x) - 1, TOOL_LINES).astype(int)
    for k in instants:
        base = tool.platform[k]
        axes.plot([-base[1], -y[k]], [base[0], x[k]], color=TOOL, lw=0.6, alpha=0.5, zorder=5)
    for k in instants[:: TOOL_LINES // 3]:
        _draw_outline(axes, robot, tool.platform[k])


def _draw_goal(axes: Any, odom: Array, driven: DrivenGoal) -> None:
    """Draw the path to the goal, and each obstacle where it was nearest to the robot."""
    during = odom[driven.interval.contains(odom[:, 0])]
    axes.plot(-during[:, 2], during[:, 1], color=GOAL, lw=2.0, zorder=4.5, label="goal")
    axes.plot(-driven.goal[1], driven.goal[0], "*", color=GOAL, ms=11, zorder=6)
    obstacles = driven.obstacles
    if driven.perception is not None:
        _draw_perception(axes, odom, driven.perception)
    if not len(obstacles.radii):
        return
    nearest = obstacle_gaps(driven.obstacles, during[:, :4], (0.0, 0.0)).argmin(axis=0)
    ways = np.array([obstacles.at(time) for time in during[::20, 0].tolist()])
    for k, radius in enumerate(obstacles.radii.tolist()):
        x, y = obstacles.at(float(during[nearest[k], 0]))[k]
        axes.add_patch(Circle((-y, x), radius, facecolor=OBSTACLE, edgecolor="none", alpha=0.45))
        axes.plot(-ways[:, k, 1], ways[:, k, 0], color=OBSTACLE, lw=1.0, ls=":")


def _draw_perception(axes: Any, odom: Array, perception: Perception) -> None:
    """Draw what stands by the map, a scan from the middle of the way, and the tracked persons."""
    if perception.map is not None:
        known = perception.map
        rows, columns = np.nonzero(known.values > OCCUPIED)
        local = known.resolution * (np.column_stack((columns, rows)).astype(np.float64) + 0.5)
        x, y = (_rotate(local, known.origin[2]) + known.origin[:2]).T
        axes.plot(-y, x, "s", color=INK, ms=2.2, mew=0.0, zorder=0.5, label="map")
    if perception.scans:
        time, points = perception.scans[len(perception.scans) // 2]
        pose = odom[np.abs(odom[:, 0] - time).argmin(), 1:4]
        axes.plot(*_to_axes(points, pose).T, ".", color=SCAN, ms=2.0, zorder=3, label="scan")
    tracks = np.concatenate([np.zeros((0, 4)), *perception.tracks])
    axes.plot(-tracks[:, 1], tracks[:, 0], ".", color=TRACK, ms=2.5, zorder=3, label="tracked")
    for x, y, vx, vy in tracks[:: len(tracks) // ARROWS + 1].tolist():
        arrow = {"arrowstyle": "->", "color": TRACK, "lw": 1.0}
        axes.annotate("", xy=(-y - vy, x + vx), xytext=(-y, x), arrowprops=arrow, zorder=3)
    x, y = odom[:, 1], odom[:, 2]
    # With auto, matplotlib does not warn that it widens one of them for the aspect.
    axes.set_xlim(-y.max() - AROUND, -y.min() + AROUND, auto=True)
    axes.set_ylim(x.min() - AROUND, x.max() + AROUND, auto=True)


def _draw_outline(axes: Any, robot: Platform, pose: Array, **options: Any) -> None:
    """Draw the bounding box of the robot with a mark at its front."""
    corners = CORNERS * [robot.body.length / 2, robot.body.width / 2]
    nose = np.array([[0.5, 0.0], [0.42, 0.06], [0.42, -0.06]]) * robot.body.length
    axes.add_patch(_polygon(corners, pose, facecolor="none", edgecolor=FAINT, **options))
    axes.add_patch(_polygon(nose, pose, facecolor=FAINT, edgecolor="none", **options))


def _draw_robot(axes: Any, robot: Platform, pose: Array) -> None:
    """Draw the robot with its wheels, each with the axis of the roller on the floor."""
    _draw_outline(axes, robot, pose)
    wheels = robot.wheels
    for x, y, heading, roller, radius in zip(
        wheels.x, wheels.y, wheels.heading, wheels.roller_angle, wheels.radius, strict=True
    ):
        tread = _rotate(CORNERS * [radius, 0.4 * radius], heading) + [x, y]
        axes.add_patch(_polygon(tread, pose, facecolor=WHEEL, edgecolor=GREY, lw=0.5))
        axis = _rotate(np.array([[-0.6 * radius, 0.0], [0.6 * radius, 0.0]]), heading + roller)
        line = _to_axes(axis + [x, y], pose)
        axes.plot(*line.T, color="white", lw=1.2, zorder=1.5)


def _rotate(points: Array, angle: float) -> Array:
    """Rotate points (k, 2) about the origin."""
    result: Array = points @ se2.rotation(angle)[:2, :2]
    return result


def _to_axes(points: Array, pose: Array) -> Array:
    """Transform points (k, 2) of a robot at a pose to the axes of the top view, (-y, x)."""
    x, y = (_rotate(points, pose[2]) + pose[:2]).T
    return np.column_stack([-y, x])


def _polygon(points: Array, pose: Array, **options: Any) -> Polygon:
    """Return a polygon of points (k, 2) of a robot at a pose."""
    return Polygon(_to_axes(points, pose), closed=True, zorder=1, **options)


# ---- panels over time -----------------------------------------------------------------------


def _draw_twist(axes: Any, odom: Array, start: float) -> None:
    series = ((4, "x' [m/s]", TWISTS), (5, "y' [m/s]", PATH), (6, "θ' [rad/s]", TRUTH))
    for column, name, colour in series:
        axes.plot(odom[:, 0] - start, odom[:, column], color=colour, label=name)
    axes.set_title("Twist in base_link, from the encoders")
    _draw_legend(axes)


def _draw_coupling(axes: Any, coupling: Array, start: float) -> None:
    axes.set_title("Coupling error ε, not reset at rest [rad]")
    if coupling.shape[1] < 2:
        text = "three wheels have no constraint"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center")
    for column in coupling[:, 1:].T:
        axes.plot(coupling[:, 0] - start, column, color=INK)


def _draw_tracking(axes: Any, odom: Array, reference: Reference, demo: Demo, start: float) -> None:
    for interval in demo.path_intervals:
        during = odom[reference.during(odom[:, 0], [interval])]
        axes.plot(during[:, 0] - start, 1e3 * reference.errors(during)[0], color=PATH)
    axes.set_title("Tracking error on the path [mm]")
    axes.set_ylim(bottom=0.0)


def _draw_arm(axes: Any, arm: Array, start: float) -> None:
    for column in range(1, arm.shape[1]):
        axes.plot(arm[:, 0] - start, arm[:, column] - arm[0, column], label=str(column))
    axes.set_title("Measured joint angles, relative to the start [rad]")
    _draw_legend(axes)


def _draw_tool(axes: Any, tool: ToolTrack, start: float) -> None:
    times = tool.times - start
    axes.plot(times, 1e3 * tool.errors, color=TOOL, lw=1.0, label="in odom")
    axes.plot(times, 1e3 * tool.true_errors, color=TRUTH, lw=1.0, ls=DASHED, label="ground truth")
    axes.set_title("Tracking error of the tool [mm]")
    axes.set_ylim(bottom=0.0)
    _draw_legend(axes)
