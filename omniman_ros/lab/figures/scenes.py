"""Picture of drives through random scenes: the robot and the obstacles at several times."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon, Rectangle

from omniman_ros.console.figure_style import FAINT, GREY, INK, figure_style, save_figure
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.figures.top_view import (
    BOX_CORNERS,
    BOX_MARKER,
    DISC_MARKER,
    FRONT_MARK,
    GOAL_COLOUR,
    OBSTACLE_COLOUR,
    PREDICTION_COLOUR,
    ROBOT_COLOUR,
    START_COLOUR,
    to_odom,
)
from omniman_ros.lab.studies.scene_generator import AREA
from omniman_ros.lab.studies.scenes import Outcome

MAX_COLUMNS = 3  # largest number of columns of the picture
SNAPSHOTS = 6
"""Number of times at which the robot and moving obstacles are shown; the legend names it, too."""
MARGIN = 0.9  # margin between the area of the scenes and the frame of the axes [m]


def draw(robot: Robot, outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw drives from above as a PNG file, with one panel for each drive."""
    columns = min(MAX_COLUMNS, len(outcomes))
    rows = math.ceil(len(outcomes) / columns)
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    with figure_style():
        figure = plt.figure(figsize=(4.6 * columns, 4.0 * rows + 0.4), layout="constrained")
        for i, outcome in enumerate(outcomes):
            draw_panel(figure.add_subplot(rows, columns, i + 1), half, outcome)
        figure.legend(handles=_legend_handles(), loc="outside lower left", ncols=7)
        save_figure(figure, path)


def draw_panel(axes: Any, half: Array, outcome: Outcome) -> None:
    """Draw one drive with its scene.

    Args:
        half: (2,) half length and half width of the robot [m].
    """
    scene, drive = outcome.scene, outcome.drive
    end = drive.times[-1]
    if outcome.verdict.collided:
        end = outcome.verdict.contact
    times = np.linspace(drive.times[0], end, SNAPSHOTS)
    for k, obstacle in enumerate(scene.obstacles):
        shown = times[-1:] if obstacle.fixed else times
        for i, time in enumerate(shown.tolist()):
            alpha = (i + 1) / len(shown)
            colour = OBSTACLE_COLOUR if alpha == 1.0 else "none"
            a, b = obstacle.semi_axes
            axes.add_patch(
                Ellipse(
                    tuple(obstacle.place(time)),
                    2 * a,
                    2 * b,
                    angle=math.degrees(obstacle.angle),
                    fc=colour,
                    ec=PREDICTION_COLOUR,
                    lw=0.8,
                    alpha=0.2 + 0.8 * alpha,
                    zorder=2,
                )
            )
        positions = obstacle.place.at(np.linspace(times[0], times[-1], 200))
        axes.plot(*positions.T, color=PREDICTION_COLOUR, lw=0.6, ls=":", zorder=1)
        axes.text(
            *obstacle.place(times[-1]),
            f"{k + 1}",
            ha="center",
            va="center",
            fontsize=7,
            clip_on=True,
            zorder=6,
        )
    for pose, colour in ((scene.start, START_COLOUR), (scene.goal, GOAL_COLOUR)):
        _draw_robot(axes, half, np.array(pose), colour, 3, lw=1.2)
    motion = [*drive.poses[:, :2].T, np.unwrap(drive.poses[:, 2])]
    for i, time in enumerate(times.tolist()):
        robot_pose = np.array([np.interp(time, drive.times, column) for column in motion])
        is_last = i == len(times) - 1
        _draw_robot(
            axes,
            half,
            robot_pose,
            ROBOT_COLOUR,
            4,
            lw=1.0 if is_last else 0.6,
            fill=0.4 if is_last else 0.12,
        )
    axes.plot(drive.poses[:, 0], drive.poses[:, 1], color=INK, lw=1.0, zorder=5)
    if scene.workspace is not None:
        x_min, y_min, x_max, y_max = scene.workspace
        axes.add_patch(
            Rectangle(
                (x_min, y_min), x_max - x_min, y_max - y_min, fc="none", ec=GREY, lw=1.0, ls="--"
            )
        )
    axes.set_xlim(AREA[0] - MARGIN, AREA[2] + MARGIN)
    axes.set_ylim(AREA[1] - MARGIN, AREA[3] + MARGIN)
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    axes.set_title(_title(outcome))


def _title(outcome: Outcome) -> str:
    """Return seed and outcome of a drive as the title of its panel."""
    name = f"seed {outcome.scene.seed}: "
    if outcome.verdict.collided:
        return f"{name}contact after {outcome.verdict.contact - outcome.drive.times[0]:.1f} s"
    duration = float(outcome.drive.times[-1] - outcome.drive.times[0])
    figures = f"{duration:.1f} s, least gap {1e3 * outcome.verdict.gap:.0f} mm"
    if outcome.reached:
        return name + ("left its workspace, " if outcome.left_workspace else "") + figures
    return f"{name}{outcome.goal_error[0]:.1f} m short"


def _draw_robot(
    axes: Any, half: Array, pose: Array, colour: str, zorder: int, lw: float, fill: float = 0.0
) -> None:
    """Draw outline and front mark of the robot at a pose (3,) in odom.

    Args:
        half: (2,) half length and half width of the robot [m].
        pose: (3,) pose in odom [m, m, rad].
    """
    box = to_odom(BOX_CORNERS * half, pose)
    if fill:
        axes.add_patch(Polygon(box, closed=True, zorder=zorder, fc=colour, lw=0, alpha=fill))
    axes.add_patch(Polygon(box, closed=True, zorder=zorder, fc="none", ec=colour, lw=lw))
    axes.add_patch(
        Polygon(to_odom(FRONT_MARK * half, pose), closed=True, zorder=zorder, fc=colour, lw=0)
    )


def _legend_handles() -> list[Any]:
    """Return the entries of the legend."""
    return [
        Line2D([], [], color=START_COLOUR, mfc="none", label="start", **BOX_MARKER),
        Line2D([], [], color=GOAL_COLOUR, mfc="none", label="goal", **BOX_MARKER),
        Line2D(
            [],
            [],
            color=ROBOT_COLOUR,
            alpha=0.7,
            label=f"robot, at {SNAPSHOTS} times",
            **BOX_MARKER,
        ),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D(
            [],
            [],
            color=OBSTACLE_COLOUR,
            mec=PREDICTION_COLOUR,
            label="obstacle, at the end",
            **DISC_MARKER,
        ),
        Line2D(
            [], [], color=PREDICTION_COLOUR, mfc="none", label="obstacle, earlier", **DISC_MARKER
        ),
        Line2D([], [], color=GREY, lw=1.0, ls="--", label="workspace"),
    ]
