"""The picture of the coupling study: Fig. 7 of CCTA 2017, and what decides the gain."""

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
from omniman_ros.lab.studies.coupling import Run
from omniman_ros.lab.studies.coupling_sweep import AIM, PAPER_GAIN
from omniman_ros.motion.figure7 import Figure7, waypoints

OFF = RED
"""Colour of drives without coupling control."""
PAPER = BLUE
"""Colour of drives with the paper's gain."""
CHOSEN = GREEN
"""Colour of drives with the robot's own gain."""
GROUP_STYLES = {
    "P": ("P loops", INK, "o"),
    "PI": ("PI loops", AMBER, "s"),
    "radii": ("P loops, radii off", PURPLE, "^"),
    "ice": ("torque mode, ice", CYAN, "D"),
}
"""Label, colour and marker of each group of the study."""
OUTLINES = 1.0
"""Distance along the path between two outlines of the robot [m]."""


def draw(
    robot: Robot, figure: Figure7, runs: Sequence[Run], result: dict[str, Any], path: Path
) -> None:
    """Draw the study into a PNG file.

    Args:
        robot: The robot, for its outline.
        figure: The path in time.
        runs: Every drive.
        result: The published result: its table, the steps on blocks, the robot's own gain.
        path: Path of the file.
    """
    chosen = result["chosen_gain"]
    with figure_style():
        sheet = plt.figure(figsize=(11.5, 6.8), layout="constrained")
        rows = sheet.add_gridspec(2, 1, height_ratios=(1.15, 1))
        top = rows[0].subgridspec(1, 2, width_ratios=(2.9, 1))
        _courses(sheet.add_subplot(top[0]), figure, shown(runs), chosen)
        _path(sheet.add_subplot(top[1]), robot, figure)
        bottom = rows[1].subgridspec(1, 4)
        panels = [sheet.add_subplot(bottom[i]) for i in range(4)]
        _ratios(panels[0], result)
        _losses(panels[1], result)
        _odometry(panels[2], result)
        _limits(panels[3], result)
        gains = sorted({row["k"] for row in result["table"]})
        for axes in panels:
            _gain_axis(axes, gains, chosen)
        save_figure(sheet, path)


def shown(runs: Sequence[Run]) -> list[Run]:
    """Return the P-loop drives on the wheels with the median of max |epsilon| without control."""
    off = sorted(
        (run for run in runs if run.case.group == "P" and run.case.gain == 0.0),
        key=lambda run: run.outcome.epsilon_max,
    )
    sample = off[len(off) // 2].case.sample
    return [run for run in runs if run.case.group == "P" and run.case.sample == sample]


def _courses(axes: Any, figure: Figure7, runs: Sequence[Run], chosen: float) -> None:
    """Draw the coupling error over time as in the paper: red without control, blue with k = 2."""
    for leg in figure.legs(0.0):
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
    colours = {0.0: (OFF, "off"), PAPER_GAIN: (PAPER, f"k = {PAPER_GAIN:g}, the paper's")}
    colours[chosen] = (CHOSEN, f"k = {chosen:g}, the default")
    for run in runs:
        if run.case.gain in colours:
            colour, label = colours[run.case.gain]
            epsilon = run.epsilon[:, 0]
            if run.epsilon.shape[1] > 1:
                epsilon = np.linalg.norm(run.epsilon, axis=1)
            axes.plot(run.time, epsilon, color=colour, label=label)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)
    axes.set_xlim(0.0, figure.duration)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("coupling error ε [rad]")
    axes.set_title("Coupling error over time, P velocity loops", pad=16)
    axes.legend(loc="best")


def _path(axes: Any, robot: Robot, figure: Figure7) -> None:
    """Draw the path from above: x (forward) points up, y (left) to the left."""
    poses = waypoints(0.02, figure.length)
    axes.plot(-poses[:, 1], poses[:, 0], color=INK, lw=1.2, zorder=3)
    corners = 0.5 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    box = corners * [robot.body.length, robot.body.width]
    nose = np.array([[0.5, 0.0], [0.38, 0.08], [0.38, -0.08]]) * robot.body.length
    for pose in waypoints(OUTLINES, figure.length):
        for shape, fill in ((box, "none"), (nose, FAINT)):
            axes.add_patch(
                Polygon(_placed(shape, pose), closed=True, fc=fill, ec=FAINT, lw=0.7, zorder=1)
            )
    axes.plot(0.0, 0.0, "o", color=CHOSEN, zorder=4)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"The path, lines of {figure.length:g} m")


def _placed(shape: Array, pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = pose[0] + shape @ [c, -s], pose[1] + shape @ [s, c]
    return np.column_stack([-y, x])


def _column(result: dict[str, Any], group: str, name: str, which: str = "mean") -> Array:
    """Return pairs (k, figure) of a group."""
    rows = [row for row in result["table"] if row["group"] == group]
    return np.array([(row["k"], row[name][which]) for row in rows])


def _groups(result: dict[str, Any]) -> list[str]:
    return [name for name in GROUP_STYLES if any(r["group"] == name for r in result["table"])]


def _ratios(axes: Any, result: dict[str, Any]) -> None:
    for group in (name for name in _groups(result) if name in ("P", "PI")):
        label, colour, marker = GROUP_STYLES[group]
        samples = np.array(
            [row["epsilon_max_samples"] for row in result["table"] if row["group"] == group]
        )
        mean = _column(result, group, "epsilon_ratio")
        axes.plot(mean[:, 0], samples / samples[0], color=colour, lw=0.5, alpha=0.3)
        axes.plot(*mean.T, color=colour, marker=marker, label=label)
    axes.axhline(AIM, color=GREY, lw=0.8, ls="--")
    _log(axes)
    axes.set_title("max |ε| over that of off")
    axes.legend(loc="lower left")


def _losses(axes: Any, result: dict[str, Any]) -> None:
    for group in (name for name in _groups(result) if name in ("P", "PI")):
        _, colour, marker = GROUP_STYLES[group]
        for name, text, dashes in (("slip", "slip", "-"), ("energy", "energy", "--")):
            mean = _column(result, group, name)
            axes.plot(
                mean[:, 0],
                mean[:, 1] / mean[0, 1],
                color=colour,
                marker=marker,
                ls=dashes,
                label=f"{text}, {group}",
            )
    axes.set_ylim(bottom=0.0)
    axes.set_title("Loss by slip, and energy, over off")
    axes.legend(loc="lower left")


def _odometry(axes: Any, result: dict[str, Any]) -> None:
    for group in _groups(result):
        label, colour, marker = GROUP_STYLES[group]
        mean = _column(result, group, "odometry_max")
        axes.plot(mean[:, 0], 1e3 * mean[:, 1], color=colour, marker=marker, label=label)
    _log(axes)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, 8.0 * top)  # room for the legend
    axes.set_title("Odometry off the truth, max [mm]")
    axes.legend(loc="upper left")


def _limits(axes: Any, result: dict[str, Any]) -> None:
    steps = result["late_commands"]
    delays = sorted({step["delay_s"] for step in steps})
    for i, delay in enumerate(delays):
        share = (i + 1) / len(delays)
        late = [step for step in steps if step["delay_s"] == delay]
        calm = np.array([(step["k"], step["overshoot"]) for step in late if step["settled"]])
        axes.plot(
            *calm.reshape(-1, 2).T,
            color=OFF,
            alpha=0.25 + 0.75 * share,
            marker="o",
            label=f"overshoot, {1e3 * delay:g} ms late",
        )
        lost = [step["k"] for step in late if not step["settled"]]
        axes.plot(lost, np.ones(len(lost)), "x", color=OFF, ms=7, mew=2)
    noise = _column(result, "P", "command_noise")
    axes.plot(
        noise[:, 0],
        noise[:, 1] / noise[0, 1] - 1.0,
        color=GREY,
        ls="--",
        marker=".",
        label="noise asked of wheels, more",
    )
    axes.set_ylim(-0.05, 1.1)
    axes.set_title("What limits k (x: oscillates)")
    axes.legend(loc="upper left")


def _log(axes: Any) -> None:
    """Make the y axis logarithmic, with plain numbers."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _gain_axis(axes: Any, gains: Sequence[float], chosen: float) -> None:
    """Scale the x axis by ratios of gains, with a position of its own for a gain of zero."""
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.4)
    axes.set_xlim(-0.15, 1.15 * gains[-1])
    labelled = [gain for gain in gains if gain in (0.0, 1.0, 2.0, 5.0, 30.0, chosen)]
    axes.set_xticks(labelled, ["off" if not gain else f"{gain:g}" for gain in labelled])
    axes.set_xticks([], minor=True)
    axes.axvline(chosen, color=CHOSEN, lw=5, alpha=0.15, zorder=0)
    axes.set_xlabel("gain k [1/s]")
    axes.grid(color=FAINT, lw=0.4)
