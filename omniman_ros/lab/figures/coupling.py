"""Picture of the coupling study: Fig. 7 of CCTA 2017, and the effects of the gain."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Polygon
from matplotlib.ticker import LogLocator, NullFormatter

from omniman_ros.console.figure_style import (
    AMBER,
    BLUE,
    CYAN,
    FAINT,
    GREEN,
    GREY,
    INK,
    PURPLE,
    RED,
    figure_style,
    save_figure,
)
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.coupling import OWN_CONTROLLER, PAPER_CONTROLLER, Run
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN
from omniman_ros.motion.figure7 import Figure7, waypoints

OFF_COLOUR = RED
"""Colour of drives without coupling control."""
PAPER_COLOUR = BLUE
"""Colour of drives with the paper's gain."""
CORRECTED_COLOUR = CYAN
"""Colour of drives with the paper's gain and controller, but J_a corrected."""
OWN_COLOUR = GREEN
"""Colour of drives with the robot's own gain."""
GROUP_STYLES = {
    "P": ("P loops", INK, "o"),
    "PI": ("PI loops", AMBER, "s"),
    "radii": ("P loops, radius errors", PURPLE, "^"),
    "ice": ("torque mode, ice", CYAN, "D"),
    "late": ("P loops, 50 ms late", GREEN, "v"),
}
"""Label, colour and marker of each group of drives in the study."""
OUTLINE_SPACING = 1.0
"""Distance along the path between two outlines of the robot [m]."""


def draw(
    robot: Robot, course: Figure7, runs: Sequence[Run], result: dict[str, Any], path: Path
) -> None:
    """Draw the study as a PNG file.

    Args:
        robot: The robot, for its outline.
        course: The path in time.
        runs: All drives.
        result: The result of the experiment, for its table, step responses and the robot's gain.
        path: Path of the PNG file.
    """
    own_gain = result["chosen_gain"]
    with figure_style():
        figure = plt.figure(figsize=(11.5, 6.8), layout="constrained")
        rows = figure.add_gridspec(2, 1, height_ratios=(1.15, 1))
        top = rows[0].subgridspec(1, 2, width_ratios=(2.9, 1))
        _errors_over_time(figure.add_subplot(top[0]), course, select_median(runs), result)
        _path(figure.add_subplot(top[1]), robot, course)
        bottom = rows[1].subgridspec(1, 4)
        panels = [figure.add_subplot(bottom[i]) for i in range(4)]
        _ratios(panels[0], result)
        _losses(panels[1], result)
        _odometry(panels[2], result)
        _stability(panels[3], result)
        gains = sorted({row["k"] for row in _own_rows(result)})
        for axes in panels[:3]:
            _gain_axis(axes, gains, own_gain)
        save_figure(figure, path)


def select_median(runs: Sequence[Run]) -> list[Run]:
    """Return the drives of group P with the set of wheels whose uncontrolled error is the median.

    The error is max |epsilon| without coupling control.
    """
    uncontrolled = sorted(
        (run for run in runs if run.case.group == "P" and run.case.gain == 0.0),
        key=lambda run: run.outcome.epsilon_max,
    )
    sample = uncontrolled[len(uncontrolled) // 2].case.sample
    return [run for run in runs if run.case.group == "P" and run.case.sample == sample]


def _errors_over_time(
    axes: Any, course: Figure7, runs: Sequence[Run], result: dict[str, Any]
) -> None:
    """Draw the coupling error by (24) over time; as in the paper, red is without control.

    With several motion constraints, the norm of the errors is drawn.
    """
    for leg in course.legs(0.0):
        axes.axvspan(leg.begin, leg.preview.end, color=FAINT, alpha=0.25, lw=0)
        middle = 0.5 * (leg.begin + leg.preview.end)
        axes.text(
            middle,
            1.01,
            leg.name,
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="bottom",
            color=GREY,
            fontsize=8,
        )
    own, printed = result["chosen_gain"], result["printed_gain"]
    styles = {
        (OWN_CONTROLLER, 0.0): (OFF_COLOUR, "off"),
        (PAPER_CONTROLLER, PAPER_GAIN): (
            CORRECTED_COLOUR,
            f"the paper's, k = {PAPER_GAIN:g}, $J_a$ corrected",
        ),
        (OWN_CONTROLLER, own): (OWN_COLOUR, f"this package's, k = {own:g}"),
    }
    if printed is not None:
        label = f"the paper's as printed, k = {PAPER_GAIN:g}, acts like {printed:.0f}"
        styles[PAPER_CONTROLLER, printed] = (PAPER_COLOUR, label)
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
            axes.add_patch(
                Polygon(_to_page(shape, pose), closed=True, fc=fill, ec=FAINT, lw=0.7, zorder=1)
            )
    axes.plot(0.0, 0.0, "o", color=OWN_COLOUR, zorder=4)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"The path, lines of {course.length:g} m")


def _to_page(shape: Array, pose: Array) -> Array:
    """Transform points (k, 2) of base_link at a pose (3,) to the page, on which x points up."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + shape @ [c, -s], pose[1] + shape @ [s, c]
    return np.column_stack([-y, x])


def _own_rows(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of this package's controller."""
    return [row for row in result["table"] if row["controller"] == OWN_CONTROLLER]


def _by_gain(result: dict[str, Any], group: str, name: str, statistic: str = "mean") -> Array:
    """Return an array (r, 2) of the gain k and a measured value, for the rows of a group."""
    rows = [row for row in _own_rows(result) if row["group"] == group]
    return np.array([(row["k"], row[name][statistic]) for row in rows])


def _groups(result: dict[str, Any]) -> list[str]:
    """Return the groups that the result contains."""
    return [name for name in GROUP_STYLES if any(r["group"] == name for r in result["table"])]


def _ratios(axes: Any, result: dict[str, Any]) -> None:
    """Draw max |epsilon| relative to that without control over the gain, mean and each sample."""
    for group in (name for name in _groups(result) if name in ("P", "PI")):
        label, colour, marker = GROUP_STYLES[group]
        samples = np.array(
            [row["epsilon_max_samples"] for row in _own_rows(result) if row["group"] == group]
        )
        mean = _by_gain(result, group, "epsilon_ratio")
        axes.plot(mean[:, 0], samples / samples[0], color=colour, lw=0.5, alpha=0.3)
        axes.plot(*mean.T, color=colour, marker=marker, label=label)
    axes.axhline(AIM, color=GREY, lw=0.8, ls="--")
    _log_scale(axes)
    axes.set_title("max |ε|, relative to off")
    axes.legend(loc="lower left")


def _losses(axes: Any, result: dict[str, Any]) -> None:
    """Draw slip losses and energy relative to those without control over the gain."""
    for group in (name for name in _groups(result) if name in ("P", "PI")):
        _, colour, marker = GROUP_STYLES[group]
        for name, text, dashes in (("slip", "slip losses", "-"), ("energy", "energy", "--")):
            mean = _by_gain(result, group, name)
            axes.plot(
                mean[:, 0],
                mean[:, 1] / mean[0, 1],
                color=colour,
                marker=marker,
                ls=dashes,
                label=f"{text}, {group}",
            )
    axes.set_ylim(bottom=0.0)
    axes.set_title("Slip losses and energy, relative to off")
    axes.legend(loc="lower left")


def _odometry(axes: Any, result: dict[str, Any]) -> None:
    """Draw the largest error of odometry over the gain."""
    for group in _groups(result):
        label, colour, marker = GROUP_STYLES[group]
        mean = _by_gain(result, group, "odometry_max")
        axes.plot(mean[:, 0], 1e3 * mean[:, 1], color=colour, marker=marker, label=label)
    _log_scale(axes)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, 40.0 * top)  # room for the legend
    axes.set_title("Largest error of odometry [mm]")
    axes.legend(loc="upper left")


def _stability(axes: Any, result: dict[str, Any]) -> None:
    """Draw where the loop oscillates over gain and delay: measured points, computed boundary."""
    points = {
        (step["k"], step["delay_s"], step["lifted"]): step for step in result["late_commands"]
    }
    kinds: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for (gain, delay, lifted), step in points.items():
        if not lifted:
            continue
        floor = points.get((gain, delay, False))
        if step["settled"]:
            kind = ("settles", OWN_COLOUR, "o")
        elif floor is None or floor["settled"]:
            kind = ("oscillates off the floor", AMBER, "x")
        else:
            kind = ("on the floor, too", OFF_COLOUR, "x")
        kinds.setdefault(kind, []).append((gain, 1e3 * delay))
    for (label, colour, marker), found in kinds.items():
        axes.plot(*np.array(found).T, marker, color=colour, ms=4, mew=1.5, label=label)
    computed = [
        (row["k"], 1e3 * row["delay_s"]) for row in result["stability"]["boundary"] if row["k"]
    ]
    axes.plot(
        *np.array(computed).reshape(-1, 2).T, color=INK, lw=1.2, label="computed, off the floor"
    )
    marked = {result["chosen_gain"]: OWN_COLOUR, result["printed_gain"]: PAPER_COLOUR}
    for gain, colour in marked.items():
        if gain is not None:
            axes.axvline(gain, color=colour, lw=5, alpha=0.15, zorder=0)
    ticks = [
        gain for gain in (2.0, 5.0, 15.0, 63.0, 400.0) if gain <= max(key[0] for key in points)
    ]
    axes.set_xscale("log")
    axes.set_xticks(ticks, [f"{gain:g}" for gain in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("gain k [1/s]")
    axes.set_ylim(-4.0, 1.55e3 * max(key[1] for key in points) + 5.0)  # room for the legend
    axes.set_title("Late commands [ms], step of ε")
    axes.legend(loc="upper right")


def _log_scale(axes: Any) -> None:
    """Make the y axis logarithmic, with plain numbers."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _gain_axis(axes: Any, gains: Sequence[float], own_gain: float) -> None:
    """Make the x axis logarithmic in the gain, with a separate position for a gain of zero.

    Args:
        axes: The axes.
        gains: Gains of the study, in ascending order [1/s].
        own_gain: The robot's own gain, which is highlighted [1/s].
    """
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.4)
    axes.set_xlim(-0.15, 1.15 * gains[-1])
    labelled = [gain for gain in gains if gain in (0.0, 1.0, 2.0, 5.0, 30.0, own_gain)]
    axes.set_xticks(labelled, ["off" if not gain else f"{gain:g}" for gain in labelled])
    axes.set_xticks([], minor=True)
    axes.axvline(own_gain, color=OWN_COLOUR, lw=5, alpha=0.15, zorder=0)
    axes.set_xlabel("gain k [1/s]")
    axes.grid(color=FAINT, lw=0.4)
