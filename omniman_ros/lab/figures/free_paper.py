"""Picture of the free case with the problem of MPC 2021 itself: two weights, and all variants."""

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
    INK,
    ORANGE,
    SERIES,
    figure_style,
    save_figure,
)
from omniman_ros.core.robot import Robot
from omniman_ros.lab.figures.top_view import (
    GOAL_COLOUR,
    ROBOT_COLOUR,
    START_COLOUR,
    draw_robot,
    frame_axes,
)
from omniman_ros.lab.studies.paper_drive import SNAPSHOTS, PaperDrive
from omniman_ros.lab.studies.roller_diagonals import diagonal_figures, roller_diagonals

COLOURS = (ORANGE, BLUE)
"""Colours of the two drives that are shown over time."""
MARGIN = 0.75
"""Margin around the drives from above [m]."""


def draw(robot: Robot, driven: Sequence[PaperDrive], path: Path) -> None:
    """Draw the study as a PNG file.

    Args:
        robot: The robot.
        driven: The drives; the first two are shown in detail, all in the bars.
        path: Path of the PNG file.
    """
    shown = driven[: len(COLOURS)]
    with figure_style():
        figure = plt.figure(figsize=(12.0, 9.4), layout="constrained")
        grid = figure.add_gridspec(4, 2, width_ratios=(1.15, 1), height_ratios=(1, 1, 1, 1.5))
        for row, drive in enumerate(shown):
            axes = figure.add_subplot(grid[row, 0])
            _from_above(axes, robot, drive)
        _voltages(figure.add_subplot(grid[2, 0]), robot, shown[-1])
        _over_time(figure.add_subplot(grid[0, 1]), shown, "speed")
        directions = figure.add_subplot(grid[1, 1])
        for diagonal in np.degrees(roller_diagonals(robot)):
            directions.axhline(diagonal, color=GREY, ls="--", lw=0.8)
        _over_time(directions, shown, "direction")
        _over_time(figure.add_subplot(grid[2, 1]), shown, "heading")
        _bars(figure.add_subplot(grid[3, :]), robot, driven)
        save_figure(figure, path)


def _name(drive: PaperDrive) -> str:
    weights = drive.variant.weights
    return f"W_pos {weights.position:g}, W_ang {weights.heading:g}"


def _from_above(axes: Any, robot: Robot, drive: PaperDrive) -> None:
    """Draw a drive with the robot at the times of the snapshots of Fig. 4, and at rest."""
    record = drive.drive
    draw_robot(axes, robot, record.poses[0], START_COLOUR, filled=False)
    draw_robot(axes, robot, np.array(record.goal), GOAL_COLOUR, filled=False)
    end = record.times[drive.last]
    times = [share * end for share in SNAPSHOTS] + [end]
    for time in times:
        draw_robot(
            axes, robot, record.poses[int(np.searchsorted(record.times, time))], ROBOT_COLOUR
        )
    axes.plot(*record.poses[: drive.last + 1, :2].T, color=INK, lw=1.0, zorder=5)
    frame_axes(axes, (-MARGIN, record.goal[0] + MARGIN, -MARGIN, MARGIN), labels=False)
    moments = ", ".join(f"{time:.1f}" for time in times)
    axes.set_title(f"{_name(drive)}: the robot at {moments} s")


def _over_time(axes: Any, drives: Sequence[PaperDrive], quantity: str) -> None:
    """Draw the speed, the direction of travel or the turn of drives over time."""
    for drive, colour in zip(drives, COLOURS, strict=False):
        record, rows = drive.drive, slice(drive.last + 1)
        times = record.times[rows]
        if quantity == "speed":
            values = drive.speeds[rows]
        elif quantity == "direction":
            times, values = record.travel_directions()
            values = np.degrees(np.unwrap(values))
        else:
            values = np.degrees(record.poses[rows, 2] - record.poses[0, 2])
        axes.plot(times, values, color=colour, label=_name(drive))
    titles = {
        "speed": ("Fast, then slow", "speed [m/s]"),
        "direction": ("Direction of travel in base_link; dashed: roller diagonals", "[°]"),
        "heading": ("Turn since the start", "[°]"),
    }
    title, label = titles[quantity]
    axes.set_title(title)
    axes.set_ylabel(label)
    axes.set_xlabel("time [s]")
    axes.set_xlim(left=0.0)
    if quantity == "direction":
        axes.set_ylim(30.0, 110.0)
    if quantity == "speed":
        axes.set_ylim(bottom=0.0)
        axes.legend()
    axes.grid(color=FAINT, lw=0.4)


def _voltages(axes: Any, robot: Robot, drive: PaperDrive) -> None:
    """Draw the motor voltages of a drive over time."""
    rows = slice(drive.last + 1)
    names = robot.wheels.names
    for voltages, name, colour in zip(drive.voltages[rows].T, names, SERIES, strict=False):
        axes.plot(drive.drive.times[rows], voltages, color=colour, lw=1.1, label=name)
    for limit in (-drive.max_voltage, drive.max_voltage):
        axes.axhline(limit, color=GREY, ls="--", lw=0.8)
    axes.set_xlim(left=0.0)
    axes.set_ylabel("[V]")
    axes.set_xlabel("time [s]")
    axes.set_title(f"Voltages, {_name(drive)}; dashed: their limits")
    axes.legend(loc="lower right", ncols=2, borderpad=0.8)
    axes.grid(color=FAINT, lw=0.4)


def _bars(axes: Any, robot: Robot, driven: Sequence[PaperDrive]) -> None:
    """Draw, for all drives, the share of time near a diagonal and with saturated motors."""
    places = np.arange(len(driven), dtype=float)
    near = [diagonal_figures(drive.drive, robot)["share"] for drive in driven]
    saturated = [drive.saturated_share() for drive in driven]
    for shift, shares, colour, label in (
        (-0.2, near, BLUE, "time near a roller diagonal"),
        (0.2, saturated, ORANGE, "time with a motor at its largest voltage"),
    ):
        axes.bar(places + shift, 100.0 * np.array(shares), width=0.36, color=colour, label=label)
    for place, drive in zip(places, driven, strict=True):
        error = drive.drive.goal - drive.drive.poses[drive.last]
        text = f"{math.hypot(error[0], error[1]):.2f} m\n{math.degrees(abs(error[2])):.0f}°"
        axes.text(place, 104.0, text, ha="center", va="bottom", fontsize=7.0, color=GREY)
    names = [f"{drive.variant.about}, {_pair(drive)}" for drive in driven]
    axes.set_xticks(places, names, rotation=35, ha="right", fontsize=7.0)
    axes.set_ylim(0.0, 150.0)
    axes.set_yticks([0, 50, 100])
    axes.set_ylabel("[%]")
    axes.set_title("All drives, with W_pos/W_ang; above: distance and angle to the goal at rest")
    axes.legend(loc="upper right", ncols=2)


def _pair(drive: PaperDrive) -> str:
    return f"{drive.variant.weights.position:g}/{drive.variant.weights.heading:g}"
