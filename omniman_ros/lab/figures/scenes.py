"""The picture of drives through random scenes: where robot and obstacles were, and when."""

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
    BOX_MARKER,
    CORNERS,
    DISC_MARKER,
    GOAL,
    NOSE,
    OBSTACLE,
    PREDICTION,
    ROBOT,
    START,
    place,
)
from omniman_ros.lab.studies.scene_generator import AREA
from omniman_ros.lab.studies.scenes import Outcome

COLUMNS = 3
"""Most columns of the picture."""
MOMENTS = 6
"""Number of times at which robot and moving obstacles are shown."""
MARGIN = 0.9
"""Margin around the area of the scenes [m]."""


def draw(robot: Robot, outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw drives from above, one panel each.

    Args:
        robot: The robot, for its outline.
        outcomes: The drives, at least one.
        path: Path of the PNG file.
    """
    columns = min(COLUMNS, len(outcomes))
    rows = math.ceil(len(outcomes) / columns)
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    with figure_style():
        sheet = plt.figure(figsize=(4.6 * columns, 4.0 * rows + 0.4), layout="constrained")
        for i, outcome in enumerate(outcomes):
            panel(sheet.add_subplot(rows, columns, i + 1), half, outcome)
        sheet.legend(handles=_marks(), loc="outside lower left", ncols=7)
        save_figure(sheet, path)


def panel(axes: Any, half: Array, outcome: Outcome) -> None:
    """Draw one drive.

    Args:
        axes: Axes of the panel.
        half: (2,) half length and half width of the robot [m].
        outcome: The drive and its judgement.
    """
    made, drive = outcome.scene, outcome.drive
    ends = drive.times[-1]
    if outcome.verdict.collided:
        ends = outcome.verdict.contact
    moments = np.linspace(drive.times[0], ends, MOMENTS)
    for k, obstacle in enumerate(made.obstacles):
        shown = moments[-1:] if obstacle.fixed else moments
        for i, time in enumerate(shown.tolist()):
            alpha = (i + 1) / len(shown)
            colour = OBSTACLE if alpha == 1.0 else "none"
            a, b = obstacle.semi_axes
            axes.add_patch(
                Ellipse(
                    tuple(obstacle.place(time)),
                    2 * a,
                    2 * b,
                    angle=math.degrees(obstacle.angle),
                    fc=colour,
                    ec=PREDICTION,
                    lw=0.8,
                    alpha=0.2 + 0.8 * alpha,
                    zorder=2,
                )
            )
        places = obstacle.place.at(np.linspace(moments[0], moments[-1], 200))
        axes.plot(*places.T, color=PREDICTION, lw=0.6, ls=":", zorder=1)
        axes.text(
            *obstacle.place(moments[-1]),
            f"{k + 1}",
            ha="center",
            va="center",
            fontsize=7,
            clip_on=True,
            zorder=6,
        )
    for pose, colour in ((made.start, START), (made.goal, GOAL)):
        _box(axes, half, np.array(pose), colour, 3, lw=1.2)
    course = [*drive.poses[:, :2].T, np.unwrap(drive.poses[:, 2])]
    for i, time in enumerate(moments.tolist()):
        now = np.array([np.interp(time, drive.times, column) for column in course])
        last = i == len(moments) - 1
        _box(axes, half, now, ROBOT, 4, lw=1.0 if last else 0.6, fill=0.4 if last else 0.12)
    axes.plot(drive.poses[:, 0], drive.poses[:, 1], color=INK, lw=1.0, zorder=5)
    if made.workspace is not None:
        x, y, far, high = made.workspace
        axes.add_patch(Rectangle((x, y), far - x, high - y, fc="none", ec=GREY, lw=1.0, ls="--"))
    axes.set_xlim(AREA[0] - MARGIN, AREA[2] + MARGIN)
    axes.set_ylim(AREA[1] - MARGIN, AREA[3] + MARGIN)
    axes.set_aspect("equal")
    axes.grid(color=FAINT, lw=0.4)
    axes.set_axisbelow(True)
    axes.set_title(_title(outcome))


def _title(outcome: Outcome) -> str:
    name = f"seed {outcome.scene.seed}: "
    if outcome.verdict.collided:
        when = outcome.verdict.contact - outcome.drive.times[0]
        return name + ("" if outcome.own else "unavoidable ") + f"contact after {when:.1f} s"
    took = float(outcome.drive.times[-1] - outcome.drive.times[0])
    figures = f"{took:.1f} s, least gap {1e3 * outcome.verdict.gap:.0f} mm"
    if outcome.reached:
        return name + ("left its workspace, " if outcome.left else "") + figures
    return name + f"{outcome.off[0]:.1f} m short" + ("" if outcome.solvable else ", no way known")


def _box(
    axes: Any, half: Array, pose: Array, colour: str, order: int, lw: float, fill: float = 0.0
) -> None:
    box = place(CORNERS * half, pose)
    if fill:
        axes.add_patch(Polygon(box, closed=True, zorder=order, fc=colour, lw=0, alpha=fill))
    axes.add_patch(Polygon(box, closed=True, zorder=order, fc="none", ec=colour, lw=lw))
    axes.add_patch(Polygon(place(NOSE * half, pose), closed=True, zorder=order, fc=colour, lw=0))


def _marks() -> list[Any]:
    return [
        Line2D([], [], color=START, mfc="none", label="start", **BOX_MARKER),
        Line2D([], [], color=GOAL, mfc="none", label="goal", **BOX_MARKER),
        Line2D([], [], color=ROBOT, alpha=0.7, label="robot, at six times", **BOX_MARKER),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D(
            [], [], color=OBSTACLE, mec=PREDICTION, label="obstacle, at the end", **DISC_MARKER
        ),
        Line2D([], [], color=PREDICTION, mfc="none", label="before", **DISC_MARKER),
        Line2D([], [], color=GREY, lw=1.0, ls="--", label="workspace"),
    ]
