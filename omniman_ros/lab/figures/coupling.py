"""Picture of the coupling experiment: Fig. 7 of CCTA 2017, and the path."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Polygon

from omniman_ros.console.figure_style import (
    BLUE,
    CYAN,
    FAINT,
    GREEN,
    GREY,
    INK,
    RED,
    figure_style,
    save_figure,
)
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.coupling import OWN_CONTROLLER, PAPER_CONTROLLER, Run
from omniman_ros.motion.figure7 import Figure7, waypoints

OUTLINE_SPACING = 1.0  # distance along the path between two outlines of the robot [m]


def draw(
    robot: Robot, course: Figure7, runs: Sequence[Run], result: Mapping[str, Any], path: Path
) -> None:
    """Draw the coupling errors over time and the path as a PNG file."""
    with figure_style():
        figure = plt.figure(figsize=(11.5, 3.8), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(2.9, 1))
        _errors_over_time(figure.add_subplot(grid[0]), course, select_median(runs), result)
        _path(figure.add_subplot(grid[1]), robot, course)
        save_figure(figure, path)


def select_median(runs: Sequence[Run]) -> list[Run]:
    """Return the drives of group P with the wheels whose uncontrolled error is the median."""
    uncontrolled = sorted(
        (run for run in runs if run.case.group == "P" and run.case.gain == 0.0),
        key=lambda run: run.outcome.epsilon_max,
    )
    sample = uncontrolled[len(uncontrolled) // 2].case.sample
    return [run for run in runs if run.case.group == "P" and run.case.sample == sample]


def _errors_over_time(
    axes: Any, course: Figure7, runs: Sequence[Run], result: Mapping[str, Any]
) -> None:
    """Draw the coupling error by (24) over time; as in the paper, red is without control."""
    for leg in course.legs(0.0):
        axes.axvspan(leg.begin, leg.preview.end, color=FAINT, alpha=0.25, lw=0)
        style = {"ha": "center", "va": "bottom", "color": GREY, "fontsize": 8}
        middle = 0.5 * (leg.begin + leg.preview.end)
        axes.text(middle, 1.01, leg.name, transform=axes.get_xaxis_transform(), **style)
    own, paper, printed = (result[f"{name}_gain"] for name in ("chosen", "paper", "printed"))
    styles = {
        (OWN_CONTROLLER, 0.0): (RED, "off"),
        (PAPER_CONTROLLER, paper): (CYAN, f"the paper's, k = {paper:g}, $J_a$ corrected"),
        (PAPER_CONTROLLER, printed): (BLUE, f"the paper's, k = {paper:g}, as printed"),
        (OWN_CONTROLLER, own): (GREEN, f"this package's, k = {own:g}"),
    }
    for run in runs:
        if (run.case.controller, run.case.gain) in styles:
            colour, label = styles[run.case.controller, run.case.gain]
            epsilon = run.epsilon[:, 0]
            if run.epsilon.shape[1] > 1:
                epsilon = np.linalg.norm(run.epsilon, axis=1)
            axes.plot(run.time, epsilon, color=colour, label=label)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)
    axes.set_xlim(0.0, course.duration)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("coupling error ε, never reset [rad]")
    axes.set_title("Coupling error over time, P velocity loops", pad=16)
    axes.legend(loc="best")


def _path(axes: Any, robot: Robot, course: Figure7) -> None:
    """Draw the path from above: x (forward) points up, y (left) to the left."""
    poses = waypoints(0.02, course.length)
    axes.plot(-poses[:, 1], poses[:, 0], color=INK, lw=1.2, zorder=3)
    corners = 0.5 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    box = corners * [robot.body.length, robot.body.width]
    front_mark = np.array([[0.5, 0.0], [0.38, 0.08], [0.38, -0.08]]) * robot.body.length
    for pose in waypoints(OUTLINE_SPACING, course.length):
        for shape, fill in ((box, "none"), (front_mark, FAINT)):
            outline = _to_page(shape, pose)
            axes.add_patch(Polygon(outline, closed=True, fc=fill, ec=FAINT, lw=0.7, zorder=1))
    axes.plot(0.0, 0.0, "o", color=GREEN, zorder=4)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"The path, lines of {course.length:g} m")


def _to_page(shape: Array, pose: Array) -> Array:
    """Transform points (k, 2) of base_link at a pose (3,) to the page, on which x points up."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + shape @ [c, -s], pose[1] + shape @ [s, c]
    return np.column_stack([-y, x])
