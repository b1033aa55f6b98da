"""Picture of the study of handing over a load: both robots from above, errors and gap in time."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from omniman_ros.console.figure_style import (
    BLUE,
    FAINT,
    GREY,
    MINT,
    ORANGE,
    SERIES,
    figure_style,
    save_figure,
)
from omniman_ros.core.robot import Robot
from omniman_ros.lab.figures.top_view import draw_robot, frame_axes
from omniman_ros.lab.studies.handover import KEPT_TIME, Run

LEADER_COLOUR = ORANGE
FOLLOWER_COLOUR = BLUE
SNAPSHOT_PERIOD = 4.0  # time between two outlines of the robots [s]
MARGIN = 0.8  # margin around the ways from above [m]
BEFORE, AFTER = 2.0, 1.0  # time that is shown before and after the judged time [s]


def draw(
    robot: Robot, runs: Sequence[Run], position_bound: float, heading_bound: float, path: Path
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
            _errors(row[1], driven, position_bound, heading_bound)
            _gaps(row[2], driven)
        axes[0][0].plot([], [], color=LEADER_COLOUR, label="leader")
        axes[0][0].plot([], [], color=FOLLOWER_COLOUR, label="follower")
        axes[0][0].legend(loc="lower right")
        axes[0][1].legend(loc="upper right", fontsize=7)
        save_figure(figure, path)


def _from_above(axes: Any, robot: Robot, run: Run) -> None:
    """Draw the ways of both robots, and their outlines at the same times."""
    rows = np.searchsorted(run.times, np.arange(0.0, run.times[-1], SNAPSHOT_PERIOD))
    for poses, colour in ((run.leader, LEADER_COLOUR), (run.follower, FOLLOWER_COLOUR)):
        axes.plot(poses[:, 0], poses[:, 1], color=colour, lw=0.8)
        axes.plot(poses[run.kept, 0], poses[run.kept, 1], color=colour, lw=3.0)
        for row in rows:
            draw_robot(axes, robot, poses[row], colour)
    for row in rows:
        axes.plot(*np.vstack([run.leader[row, :2], run.follower[row, :2]]).T, color=GREY, lw=0.5)
    places = np.vstack([run.leader[:, :2], run.follower[:, :2]])
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    frame_axes(axes, (low[0], high[0], low[1], high[1]))
    axes.set_title(f"{run.case.course}: every {SNAPSHOT_PERIOD:g} s; thick: the judged time")


def _errors(axes: Any, runs: Sequence[Run], position_bound: float, heading_bound: float) -> None:
    """Draw distance and heading error over time, each as a share of its bound."""
    for run, colour in zip(runs, SERIES, strict=False):
        errors = run.errors()
        times = run.times - run.kept_from
        distance = np.hypot(errors[:, 0], errors[:, 1]) / position_bound
        axes.plot(times, distance, color=colour, lw=1.0, label=_name(run))
        axes.plot(times, np.abs(errors[:, 2]) / heading_bound, color=colour, lw=1.0, ls=":")
    axes.axhline(1.0, color=GREY, lw=0.8, ls="--")
    axes.axvspan(0.0, KEPT_TIME, color=MINT, alpha=0.3, lw=0)
    axes.set_xlim(-BEFORE, KEPT_TIME + AFTER)
    axes.set_yscale("log")
    axes.set_ylim(1e-3, 30.0)
    axes.set_title(
        f"True error over its bound: {1e3 * position_bound:g} mm; "
        f"dotted: {math.degrees(heading_bound):g}°"
    )
    axes.set_xlabel("time since the judged time began [s]")
    axes.grid(color=FAINT, lw=0.4)


def _gaps(axes: Any, runs: Sequence[Run]) -> None:
    """Draw the gap between the outlines of the robots over time."""
    for run, colour in zip(runs, SERIES, strict=False):
        axes.plot(run.times, run.gaps(), color=colour, lw=1.0)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.set_ylim(bottom=-0.1)
    axes.set_title("True gap between the robots [m]")
    axes.set_xlabel("time since the request [s]")
    axes.grid(color=FAINT, lw=0.4)


def _name(run: Run) -> str:
    if run.case.follower == "mpc_planner":
        return "the planner"
    return {"PI": "wheels of the demo", "P": "larger mismatch", "radii": "radii off"}[
        run.case.wheels
    ]
