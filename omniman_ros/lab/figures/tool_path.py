"""Picture of the study of tool paths: the paths, and the error of the tool over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from omniman_ros.console.figure_style import (
    FAINT,
    GREEN,
    GREY,
    INK,
    RED,
    figure_style,
    save_figure,
)
from omniman_ros.lab.studies.tool_path import Run

CORRECTED_COLOUR = GREEN  # colour of drives with the arm's correction
UNCORRECTED_COLOUR = RED  # colour of drives without the arm's correction


def draw(runs: Sequence[Run], rms_bound: float, max_bound: float, path: Path) -> None:
    """Draw the study as a PNG file: a row for each course, a column for each kind of wheels."""
    courses = list(dict.fromkeys(run.course for run in runs))
    wheels = list(dict.fromkeys(run.case.about for run in runs))
    with figure_style():
        figure, axes = plt.subplots(
            len(courses),
            1 + len(wheels),
            squeeze=False,
            layout="constrained",
            figsize=(3.2 + 3.6 * len(wheels), 0.6 + 2.4 * len(courses)),
            width_ratios=[1.0] + [1.3] * len(wheels),
        )
        for row, course in zip(axes, courses, strict=True):
            _path(row[0], next(run for run in runs if run.course == course))
            for cell, name in zip(row[1:], wheels, strict=True):
                driven = [run for run in runs if (run.course, run.case.about) == (course, name)]
                _errors(cell, driven, rms_bound, max_bound)
                if course == courses[0]:
                    cell.set_title(f"Tracking error of the tool [mm]: {name}")
                if course == courses[-1]:
                    cell.set_xlabel("time [s]")
        axes[0][1].legend(loc="center", frameon=False)
        save_figure(figure, path)


def _path(axes: Any, run: Run) -> None:
    """Draw the paths of tool and platform from above: x (forward) points up, y to the left."""
    for positions, colour, label in (
        (run.base, GREY, "base_link"),
        (run.reference, INK, "tool0"),
    ):
        axes.plot(-positions[:, 1], positions[:, 0], color=colour, lw=1.2, label=label)
    axes.plot(-run.reference[0, 1], run.reference[0, 0], "o", color=CORRECTED_COLOUR)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_axis_off()
    axes.set_title(f"{run.course}: tool0, and base_link in grey")


def _errors(axes: Any, runs: Sequence[Run], rms_bound: float, max_bound: float) -> None:
    """Draw the errors of the drives over time, their RMS (dotted) and the bounds [m] (dashed)."""
    for run in sorted(runs, key=lambda run: run.case.options.correction):
        has_correction = run.case.options.correction
        colour = CORRECTED_COLOUR if has_correction else UNCORRECTED_COLOUR
        rms = 1e3 * float(np.sqrt(np.mean(run.error**2)))
        label = f"{'with' if has_correction else 'without'} correction"
        axes.plot(run.times, 1e3 * run.error, color=colour, lw=1.0, label=label)
        axes.axhline(rms, color=colour, lw=0.6, ls=":")
    for bound, text in ((rms_bound, "RMS"), (max_bound, "max")):
        axes.axhline(1e3 * bound, color=GREY, lw=0.8, ls="--")
        axes.text(
            1.0,
            1e3 * bound,
            text,
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            color=GREY,
            fontsize=7,
        )
    axes.set_ylim(bottom=0.0)
    axes.grid(color=FAINT, lw=0.4)
