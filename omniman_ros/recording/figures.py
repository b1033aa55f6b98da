"""Standard figures of a recorded drive; each is drawn if the recording contains its data.

Importing this module raises ImportError where matplotlib is not installed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot

from omniman_ros.console.figure_style import (
    BLUE,
    GREEN,
    GREY,
    GRID,
    INK,
    MAGENTA,
    ORANGE,
    PINK,
    PURPLE,
    SERIES,
    figure_style,
    save_figure,
)
from omniman_ros.core.arrays import Array
from omniman_ros.recording.robot_log import RobotLog, reference_errors

ODOMETRY = BLUE
PATH = ORANGE
TRUTH = GREEN
GOAL = MAGENTA
PLAN = PINK
BODY = PURPLE
SOURCE_BANDS = {
    "cmd_vel": "#e3edfd",
    "mpc": "#fbe3f3",
    "body": "#ede3fb",
    "path": "#fdeadd",
    "station": "#e0f2f1",
    "stop": "#ffd9d9",
}  #: Colour behind the lines while a source drives the platform, by source
DASHED = (0, (4, 4))  #: Line style of the ground truth
ARROWS = 12  #: Number of arrows along the path that show the heading
MAX_GAP = 0.5  #: Time without data over which no line is drawn [s]


@dataclass(frozen=True)
class StandardFigure:
    """A standard figure."""

    name: str  #: Name of the figure, which is part of the name of its file
    is_available: Callable[[RobotLog], bool]  #: Whether the log contains what the figure shows
    draw: Callable[[RobotLog], Any]  #: Draws the figure from the log


def draw_figures(log: RobotLog, folder: Path, prefix: str) -> dict[str, Path]:
    """Draw all figures for which the log contains data; return their PNG files by name.

    The folder is created where it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {}
    style = figure_style(
        lines_linewidth=1.2,
        axes_grid=True,
        grid_color=GRID,
        grid_linewidth=0.5,
        axes_axisbelow=True,
        agg_path_chunksize=10000,
    )
    with style:
        for figure in FIGURES:
            if figure.is_available(log):
                path = folder / f"{prefix}_{figure.name}.png"
                drawn[figure.name] = save_figure(figure.draw(log), path)
    return drawn


def draw_path(log: RobotLog) -> Any:
    """Draw the path of the platform from above: x points up, y to the left."""
    figure, axes = pyplot.subplots(figsize=(7, 6.5), layout="constrained")
    for poses in log.paths:
        axes.plot(-poses[:, 1], poses[:, 0], color=PATH, lw=5.0, alpha=0.25)
    if log.paths:
        axes.plot([], [], color=PATH, lw=5.0, alpha=0.25, label="path")
    if len(log.plan_ends):
        axes.plot(
            -log.plan_ends[:, 2],
            log.plan_ends[:, 1],
            ".",
            color=PLAN,
            ms=3.0,
            label="ends of the plans",
        )
    if len(log.goals):
        axes.plot(-log.goals[:, 2], log.goals[:, 1], "*", color=GOAL, ms=12, label="goal")
    if len(log.odom):
        axes.plot(-log.odom[:, 2], log.odom[:, 1], color=ODOMETRY, lw=1.8, label="odometry")
        _draw_headings(axes, log.odom)
    if len(log.truth):
        axes.plot(
            -log.truth[:, 2],
            log.truth[:, 1],
            color=TRUTH,
            lw=1.0,
            ls=DASHED,
            label="ground truth",
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("Way of the platform")
    axes.set_xlabel("← y [m]")
    axes.set_ylabel("x [m] →")
    axes.xaxis.set_major_formatter(lambda value, _: f"{-value + 0.0:g}")
    axes.legend(loc="best")
    return figure


def _draw_headings(axes: Any, odom: Array) -> None:
    axes.plot(-odom[0, 2], odom[0, 1], "o", color=ODOMETRY, ms=5, mfc="white", zorder=4)
    travel = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(odom[:, 1:3], axis=0).T))])
    rows = np.unique(np.searchsorted(travel, np.linspace(0.0, travel[-1], ARROWS)))
    poses = odom[np.minimum(rows, len(odom) - 1), 1:4]
    axes.quiver(
        -poses[:, 1],
        poses[:, 0],
        -np.sin(poses[:, 2]),
        np.cos(poses[:, 2]),
        color=INK,
        width=0.003,
        scale=22,
        zorder=5,
    )


def _panels(log: RobotLog, titles: Sequence[str]) -> tuple[Any, list[Any]]:
    count = len(titles)
    figure, grid = pyplot.subplots(
        count, 1, figsize=(9, 1.0 + 1.75 * count), sharex=True, layout="constrained", squeeze=False
    )
    panels = list(grid[:, 0])
    for axes, title in zip(panels, titles, strict=True):
        # The names of the sources need room above the first panel.
        axes.set_title(title, pad=16 if axes is panels[0] else None)
    begin, end = log.span
    changes = [*log.sources, (end, "")]
    for (start, name), (stop, _) in pairwise(changes):
        if name not in SOURCE_BANDS:
            continue
        left, right = max(start, begin) - begin, min(stop, end) - begin
        for axes in panels:
            axes.axvspan(left, right, color=SOURCE_BANDS[name], zorder=0, lw=0)
        panels[0].annotate(
            name,
            (0.5 * (left + right), 1.0),
            xycoords=("data", "axes fraction"),
            fontsize=7.5,
            ha="center",
            va="bottom",
            color=GREY,
        )
    panels[0].set_xlim(0.0, end - begin)
    panels[-1].set_xlabel("time [s]")
    return figure, panels


def _draw_line(log: RobotLog, axes: Any, times: Array, values: Array, **options: Any) -> None:
    gaps = np.flatnonzero(np.diff(times) > MAX_GAP) + 1
    seconds = np.insert(times - log.span[0], gaps, np.nan)
    axes.plot(seconds, np.insert(values, gaps, np.nan), **options)


def _draw_legend(axes: Any) -> None:
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_twist(log: RobotLog) -> Any:
    """Draw the commanded, the measured and the true twist."""
    names = ("x' [m/s]", "y' [m/s]", "θ' [rad/s]")
    figure, panels = _panels(log, [f"Twist in base_link: {name}" for name in names])
    for k, axes in enumerate(panels):
        for table, column, options in (
            (log.twist, 1 + k, {"color": PATH, "lw": 2.4, "alpha": 0.45, "label": "cmd_vel"}),
            (log.odom, 4 + k, {"color": ODOMETRY, "label": "odometry"}),
            (log.truth, 4 + k, {"color": TRUTH, "lw": 0.9, "ls": DASHED, "label": "ground truth"}),
        ):
            if len(table):
                _draw_line(log, axes, table[:, 0], table[:, column], **options)
    _draw_legend(panels[0])
    return figure


def draw_wheels(log: RobotLog) -> Any:
    """Draw the commanded and the measured speed of each wheel, which should coincide."""
    figure, panels = _panels(log, [f"Wheel {name}: speed [rad/s]" for name in log.wheel_names])
    for k, axes in enumerate(panels):
        for table, options in (
            (log.commanded, {"color": PATH, "lw": 2.4, "alpha": 0.45, "label": "commanded"}),
            (log.measured, {"color": ODOMETRY, "lw": 0.9, "label": "measured"}),
        ):
            if len(table):
                _draw_line(log, axes, table[:, 0], table[:, 1 + k], **options)
    _draw_legend(panels[0])
    return figure


def draw_power(log: RobotLog) -> Any:
    """Draw voltage, current and energy of each wheel, and the energy of all."""
    figure, panels = _panels(log, ["Voltage [V]", "Current [A]", "Energy [J]"])
    count = (log.electrical.shape[1] - 1) // 3
    names = list(log.wheel_names)
    if len(names) != count:
        names = [f"wheel {k + 1}" for k in range(count)]
    times = log.electrical[:, 0]
    for k, name in enumerate(names):
        for column, axes in enumerate(panels):
            values = log.electrical[:, 1 + 3 * k + column]
            colour = SERIES[k % len(SERIES)]
            _draw_line(log, axes, times, values, color=colour, lw=1.0, label=name)
    total = log.electrical[:, 3::3].sum(axis=1)
    _draw_line(log, panels[2], times, total, color=INK, lw=1.6, label="all together")
    _draw_legend(panels[2])
    return figure


def draw_errors(log: RobotLog) -> Any:
    """Draw the coupling error, and the error of odometry relative to references."""
    references = {n: r for n, r in log.references.items() if len(r) > 1 and len(log.odom)}
    titles = ["Coupling error ε, not reset at rest [rad]"] if len(log.coupling) else []
    if references:
        titles += ["Off the reference: position [mm]", "Off the reference: heading [mrad]"]
    figure, panels = _panels(log, titles)
    if len(log.coupling):
        for k in range(1, log.coupling.shape[1]):
            colour = SERIES[(k - 1) % len(SERIES)]
            times, values = log.coupling[:, 0], log.coupling[:, k]
            _draw_line(log, panels[0], times, values, color=colour, lw=1.0)
    for name, colour in (("path", PATH), ("body", BODY), ("mpc", PLAN)):
        if name not in references:
            continue
        errors = reference_errors(log.odom, references[name])
        for axes, values in zip(panels[-2:], (errors[:, 1], errors[:, 2]), strict=True):
            label = f"{name}/reference"
            _draw_line(log, axes, errors[:, 0], 1e3 * values, color=colour, label=label)
    if references:
        panels[-2].set_ylim(bottom=0.0)
        _draw_legend(panels[-2])
    return figure


def draw_planner(log: RobotLog) -> Any:
    """Draw the figures of the planner."""
    titles = (
        "Solve time [ms]",
        "Slack: into an obstacle's clearance [mm]",
        "Distance to the goal [m]",
        "Energy of the plan [J]",
    )
    figure, panels = _panels(log, titles)
    for column, (axes, factor) in enumerate(zip(panels, (1.0, 1e3, 1.0, 1.0), strict=True)):
        values = factor * log.planner[:, 1 + column]
        _draw_line(log, axes, log.planner[:, 0], values, color=PLAN)
        if np.isfinite(values).any() and np.nanmin(values) >= 0.0:
            axes.set_ylim(0.0, max(1.05 * float(np.nanmax(values)), 1.0))
    return figure


def draw_arm(log: RobotLog) -> Any:
    """Draw the joint angles, their errors, and the intervals between setpoints."""
    titles = ["Arm: joint angles from the start, measured [rad]"]
    reference = log.arm_reference
    has_reference = reference.shape[1:] == log.arm.shape[1:] and len(reference) > 1
    if has_reference:
        titles.append("Arm: off its reference [mrad]")
    if len(log.arm_intervals):
        titles.append("Arm: time between two setpoints [ms]")
    figure, panels = _panels(log, titles)
    times = log.arm[:, 0]
    for k, name in enumerate(log.joint_names):
        colour = SERIES[k % len(SERIES)]
        angles = log.arm[:, 1 + k]
        _draw_line(log, panels[0], times, angles - angles[0], color=colour, label=name)
        if has_reference:
            column = reference[:, 1 + k]
            setpoints = np.interp(times, reference[:, 0], column, np.nan, np.nan)
            errors = 1e3 * (angles - setpoints)
            _draw_line(log, panels[1], times, errors, color=colour, lw=0.9)
    _draw_legend(panels[0])
    if len(log.arm_intervals):
        # Intervals arrive in groups: each group is drawn at the time of its arrival.
        arrivals = log.arm_intervals[:, 0] - log.span[0]
        intervals = 1e3 * log.arm_intervals[:, 1]
        panels[-1].plot(arrivals, intervals, ".", ms=2.0, color=INK, alpha=0.4)
        panels[-1].set_ylim(bottom=0.0)
    return figure


FIGURES = (
    StandardFigure("way", lambda log: len(log.odom) + len(log.truth) > 0, draw_path),
    StandardFigure(
        "twist", lambda log: len(log.odom) + len(log.truth) + len(log.twist) > 0, draw_twist
    ),
    StandardFigure(
        "wheels", lambda log: len(log.wheel_names) > 0 and len(log.measured) > 0, draw_wheels
    ),
    StandardFigure("power", lambda log: len(log.electrical) > 0, draw_power),
    StandardFigure(
        "errors",
        lambda log: len(log.coupling) > 0 or any(map(len, log.references.values())),
        draw_errors,
    ),
    StandardFigure("planner", lambda log: len(log.planner) > 0, draw_planner),
    StandardFigure("arm", lambda log: len(log.arm) > 0, draw_arm),
)  #: The standard figures, in the order in which they are drawn
