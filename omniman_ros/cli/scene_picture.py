"""Pictures of drives through random scenes: where robot and obstacles were, and when."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli.mpc_picture import (
    AHEAD,
    CORNERS,
    FAINT,
    GOAL,
    GREY,
    INK,
    NOW,
    OBSTACLE,
    START,
    STYLE,
    plt,
)
from omniman_ros.core.robot import Robot
from omniman_ros.studies.scene_generator import AREA
from omniman_ros.studies.scenes import Outcome

from matplotlib.lines import Line2D  # isort: skip
from matplotlib.patches import Ellipse, Polygon, Rectangle  # isort: skip

Array = NDArray[np.float64]

COLUMNS = 3
MOMENTS = 6
"""At which robot and moving obstacles are shown."""
ROOM = 0.9
"""Around the area that is shown [m]."""


def draw(robot: Robot, outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw drives from above, one panel each.

    Args:
        robot: For its box.
        outcomes: The drives, one at least.
        path: Of the PNG file.
    """
    columns = min(COLUMNS, len(outcomes))
    rows = math.ceil(len(outcomes) / columns)
    half = 0.5 * np.array([robot.body.length, robot.body.width])
    with plt.rc_context(STYLE):
        sheet = plt.figure(figsize=(4.6 * columns, 4.0 * rows + 0.4), layout="constrained")
        for i, outcome in enumerate(outcomes):
            panel(sheet.add_subplot(rows, columns, i + 1), half, outcome)
        sheet.legend(handles=_marks(), loc="outside lower left", ncols=7)
        path.parent.mkdir(parents=True, exist_ok=True)
        sheet.savefig(path)
        plt.close(sheet)


def panel(axes: Any, half: Array, outcome: Outcome) -> None:
    """Draw one drive; half is half length and half width of the robot [m]."""
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
                Ellipse(tuple(obstacle.place(time)), 2 * a, 2 * b,
                        angle=math.degrees(obstacle.angle), fc=colour, ec=AHEAD, lw=0.8,
                        alpha=0.2 + 0.8 * alpha, zorder=2)
            )  # fmt: skip
        places = obstacle.place.at(np.linspace(moments[0], moments[-1], 200))
        axes.plot(*places.T, color=AHEAD, lw=0.6, ls=":", zorder=1)
        axes.text(*obstacle.place(moments[-1]), f"{k + 1}", ha="center", va="center", fontsize=7,
                  clip_on=True, zorder=6)  # fmt: skip
    for pose, colour in ((made.start, START), (made.goal, GOAL)):
        _box(axes, half, np.array(pose), colour, 3, lw=1.2)
    course = [*drive.poses[:, :2].T, np.unwrap(drive.poses[:, 2])]
    for i, time in enumerate(moments.tolist()):
        now = np.array([np.interp(time, drive.times, column) for column in course])
        last = i == len(moments) - 1
        _box(axes, half, now, NOW, 4, lw=1.0 if last else 0.6, fill=0.4 if last else 0.12)
    axes.plot(drive.poses[:, 0], drive.poses[:, 1], color=INK, lw=1.0, zorder=5)
    if made.workspace is not None:
        x, y, far, high = made.workspace
        axes.add_patch(Rectangle((x, y), far - x, high - y, fc="none", ec=GREY, lw=1.0, ls="--"))
    axes.set_xlim(AREA[0] - ROOM, AREA[2] + ROOM)
    axes.set_ylim(AREA[1] - ROOM, AREA[3] + ROOM)
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
    told = f"{took:.1f} s, least gap {1e3 * outcome.verdict.gap:.0f} mm"
    if outcome.reached:
        return name + ("left its workspace, " if outcome.left else "") + told
    return name + f"{outcome.off[0]:.1f} m short" + ("" if outcome.solvable else ", no way known")


def _box(
    axes: Any, half: Array, pose: Array, colour: str, order: int, lw: float, fill: float = 0.0
) -> None:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[c, s], [-s, c]])
    box = CORNERS * half @ turn + pose[:2]
    if fill:
        axes.add_patch(Polygon(box, closed=True, zorder=order, fc=colour, lw=0, alpha=fill))
    axes.add_patch(Polygon(box, closed=True, zorder=order, fc="none", ec=colour, lw=lw))
    nose = np.array([[1.0, 0.0], [0.72, 0.3], [0.72, -0.3]]) * half @ turn + pose[:2]
    axes.add_patch(Polygon(nose, closed=True, zorder=order, fc=colour, lw=0))


def _marks() -> list[Any]:
    box: dict[str, Any] = {"marker": "s", "ls": "", "ms": 7}
    disc: dict[str, Any] = {"marker": "o", "ls": "", "ms": 8}
    return [
        Line2D([], [], color=START, mfc="none", label="start", **box),
        Line2D([], [], color=GOAL, mfc="none", label="goal", **box),
        Line2D([], [], color=NOW, alpha=0.7, label="robot, at six times", **box),
        Line2D([], [], color=INK, lw=1.0, label="driven"),
        Line2D([], [], color=OBSTACLE, mec=AHEAD, label="obstacle, at the end", **disc),
        Line2D([], [], color=AHEAD, mfc="none", label="before", **disc),
        Line2D([], [], color=GREY, lw=1.0, ls="--", label="workspace"),
    ]
