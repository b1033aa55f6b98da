"""Standard figures of a recorded drive, each drawn where the recording has what it shows."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from omniman_ros.bag.robot_log import RobotLog, off_reference

matplotlib.use("Agg")
from matplotlib import pyplot as plt

Array = NDArray[np.float64]

INK, FAINT, GREY = "#1f2933", "#c3cad2", "#5f6b7a"
ODOM, PATH, TRUTH, GOAL, PLAN = "#2f6fde", "#d9480f", "#0b8043", "#b5179e", "#d6009a"
LINES = ("#2f6fde", "#d9480f", "#0b8043", "#8a4fbf", "#b8860b", "#0891b2", "#d62828", "#5f6b7a")
BANDS = {"cmd_vel": "#e3edfd", "mpc": "#fbe3f3", "path": "#fdeadd", "stop": "#ffd9d9"}
"""Behind the lines: who drove."""
STYLE: Any = {
    "font.size": 9, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": GREY, "ytick.color": GREY, "axes.spines.top": False,
    "axes.spines.right": False, "axes.titlesize": 9.5, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "figure.dpi": 130, "lines.linewidth": 1.2,
    "lines.markersize": 4, "legend.frameon": False, "legend.fontsize": 8,
    "axes.grid": True, "grid.color": "#e4e7eb", "grid.linewidth": 0.5,
    "axes.axisbelow": True, "agg.path.chunksize": 10000,
}  # fmt: skip
ARROWS = 12
"""Headings along the way."""
BROKEN = 0.5
"""Time without data over which no line is drawn [s]."""


def draw(log: RobotLog, folder: Path, prefix: str) -> dict[str, Path]:
    """Draw all figures that can be drawn, as PNG files.

    Args:
        log: What was recorded of a robot.
        folder: Where they go; made if need be.
        prefix: Of the files' names.

    Returns:
        The files, by the figures' names.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {}
    with plt.rc_context(STYLE):
        for name, has, figure in FIGURES:
            if not has(log):
                continue
            sheet = figure(log)
            drawn[name] = folder / f"{prefix}_{name}.png"
            sheet.savefig(drawn[name])
            plt.close(sheet)
    return drawn


# ---- in the plane ---------------------------------------------------------------------------


def _way(log: RobotLog) -> Any:
    """Top view: x forward is up, y left is left, as the robot sees it at the start."""
    sheet, axes = plt.subplots(figsize=(7, 6.5), layout="constrained")
    for poses in log.paths:
        axes.plot(-poses[:, 1], poses[:, 0], color=PATH, lw=5.0, alpha=0.25)
    if log.paths:
        axes.plot([], [], color=PATH, lw=5.0, alpha=0.25, label="path")
    if len(log.plan_ends):
        axes.plot(-log.plan_ends[:, 2], log.plan_ends[:, 1], ".", color=PLAN, ms=3.0,
                  label="ends of the plans")  # fmt: skip
    if len(log.goals):
        axes.plot(-log.goals[:, 2], log.goals[:, 1], "*", color=GOAL, ms=12, label="goal")
    if len(log.odom):
        axes.plot(-log.odom[:, 2], log.odom[:, 1], color=ODOM, lw=1.8, label="odometry")
        _headings(axes, log.odom)
    if len(log.truth):
        axes.plot(-log.truth[:, 2], log.truth[:, 1], color=TRUTH, lw=1.0, ls=(0, (4, 4)),
                  label="ground truth")  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("Way of the platform")
    axes.set_xlabel("← y [m]")
    axes.set_ylabel("x [m] →")
    axes.xaxis.set_major_formatter(lambda value, _: f"{-value + 0.0:g}")
    axes.legend(loc="best")
    return sheet


def _headings(axes: Any, odom: Array) -> None:
    """Where it started, and where it looked along the way, evenly by distance."""
    axes.plot(-odom[0, 2], odom[0, 1], "o", color=ODOM, ms=5, mfc="white", zorder=4)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(odom[:, 1:3], axis=0).T))])
    rows = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], ARROWS)))
    poses = odom[np.minimum(rows, len(odom) - 1), 1:4]
    axes.quiver(
        -poses[:, 1], poses[:, 0], -np.sin(poses[:, 2]), np.cos(poses[:, 2]), color=INK,
        width=0.003, scale=22, zorder=5,
    )  # fmt: skip


# ---- over time ------------------------------------------------------------------------------


def _rows(log: RobotLog, titles: Sequence[str]) -> tuple[Any, list[Any]]:
    """A sheet with panels one below the other over the same time, with who drove behind."""
    count = len(titles)
    sheet, grid = plt.subplots(
        count, 1, figsize=(9, 1.0 + 1.75 * count), sharex=True, layout="constrained", squeeze=False
    )
    panels = list(grid[:, 0])
    for axes, title in zip(panels, titles, strict=True):
        # Above the first it says who drove.
        axes.set_title(title, pad=16 if axes is panels[0] else None)
    begin, end = log.span
    changes = [*log.sources, (end, "")]
    for (start, name), (stop, _) in zip(changes[:-1], changes[1:], strict=True):
        if name not in BANDS:
            continue
        left, right = max(start, begin) - begin, min(stop, end) - begin
        for axes in panels:
            axes.axvspan(left, right, color=BANDS[name], zorder=0, lw=0)
        panels[0].annotate(
            name, (0.5 * (left + right), 1.0), xycoords=("data", "axes fraction"), fontsize=7.5,
            ha="center", va="bottom", color=GREY,
        )  # fmt: skip
    panels[0].set_xlim(0.0, end - begin)
    panels[-1].set_xlabel("time [s]")
    return sheet, panels


def _line(log: RobotLog, axes: Any, times: Array, values: Array, **options: Any) -> None:
    """A line that is broken where nothing was heard."""
    holes = np.flatnonzero(np.diff(times) > BROKEN) + 1
    seconds = np.insert(times - log.span[0], holes, np.nan)
    axes.plot(seconds, np.insert(values, holes, np.nan), **options)


def _legend(axes: Any, columns: int) -> None:
    """Beside the panel: a line may be anywhere in it."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=columns)


def _twist(log: RobotLog) -> Any:
    names = ("x' [m/s]", "y' [m/s]", "θ' [rad/s]")
    sheet, panels = _rows(log, [f"Twist in base_link: {name}" for name in names])
    for k, axes in enumerate(panels):
        if len(log.twist):
            _line(log, axes, log.twist[:, 0], log.twist[:, 1 + k], color=PATH, lw=2.4, alpha=0.45,
                  label="cmd_vel")  # fmt: skip
        if len(log.odom):
            _line(log, axes, log.odom[:, 0], log.odom[:, 4 + k], color=ODOM, label="odometry")
        if len(log.truth):
            _line(log, axes, log.truth[:, 0], log.truth[:, 4 + k], color=TRUTH, lw=0.9,
                  ls=(0, (4, 4)), label="ground truth")  # fmt: skip
    _legend(panels[0], 1)
    return sheet


def _wheels(log: RobotLog) -> Any:
    """Each wheel for itself: commanded and measured lie on each other where all is well."""
    names = log.wheels
    sheet, panels = _rows(log, [f"Wheel {name}: speed [rad/s]" for name in names])
    for k, axes in enumerate(panels):
        if len(log.commanded):
            _line(log, axes, log.commanded[:, 0], log.commanded[:, 1 + k], color=PATH, lw=2.4,
                  alpha=0.45, label="commanded")  # fmt: skip
        if len(log.measured):
            _line(log, axes, log.measured[:, 0], log.measured[:, 1 + k], color=ODOM, lw=0.9,
                  label="measured")  # fmt: skip
    _legend(panels[0], 1)
    return sheet


def _power(log: RobotLog) -> Any:
    sheet, panels = _rows(log, ["Voltage [V]", "Current [A]", "Energy [J]"])
    count = (log.electrical.shape[1] - 1) // 3
    names = log.wheels if len(log.wheels) == count else [f"wheel {k + 1}" for k in range(count)]
    times = log.electrical[:, 0]
    for k, name in enumerate(names):
        for column, axes in enumerate(panels):
            values = log.electrical[:, 1 + 3 * k + column]
            _line(log, axes, times, values, color=LINES[k % len(LINES)], lw=1.0, label=name)
    total = log.electrical[:, 3::3].sum(axis=1)
    _line(log, panels[2], times, total, color=INK, lw=1.6, label="all together")
    _legend(panels[2], 1)
    return sheet


def _errors(log: RobotLog) -> Any:
    """Coupling error and, where something was followed, how far the odometry was off it."""
    followed = {n: r for n, r in log.references.items() if len(r) > 1 and len(log.odom)}
    titles = ["Coupling error ε [rad]"] if len(log.coupling) else []
    if followed:
        titles += ["Off the reference: position [mm]", "Off the reference: heading [mrad]"]
    sheet, panels = _rows(log, titles)
    if len(log.coupling):
        for k in range(1, log.coupling.shape[1]):
            _line(log, panels[0], log.coupling[:, 0], log.coupling[:, k],
                  color=LINES[(k - 1) % len(LINES)], lw=1.0)  # fmt: skip
    for name, colour in (("path", PATH), ("mpc", PLAN)):
        if name not in followed:
            continue
        off = off_reference(log.odom, followed[name])
        for axes, values in zip(panels[-2:], (off[:, 1], off[:, 2]), strict=True):
            _line(log, axes, off[:, 0], 1e3 * values, color=colour, label=f"{name}/reference")
    if followed:
        panels[-2].set_ylim(bottom=0.0)
        _legend(panels[-2], 1)
    return sheet


def _planner(log: RobotLog) -> Any:
    titles = ("Solve time [ms]", "Slack: into an obstacle's clearance [mm]",
              "Distance to the goal [m]", "Energy that the plan takes [J]")  # fmt: skip
    sheet, panels = _rows(log, titles)
    for column, (axes, factor) in enumerate(zip(panels, (1.0, 1e3, 1.0, 1.0), strict=True)):
        values = factor * log.planner[:, 1 + column]
        _line(log, axes, log.planner[:, 0], values, color=PLAN)
        if np.isfinite(values).any() and np.nanmin(values) >= 0.0:
            axes.set_ylim(0.0, max(1.05 * float(np.nanmax(values)), 1.0))
    return sheet


def _arm(log: RobotLog) -> Any:
    titles = ["Arm: joint angles from the start, measured [rad]"]
    asked = log.arm_reference if log.arm_reference.shape[1:] == log.arm.shape[1:] else None
    if asked is not None and len(asked) > 1:
        titles.append("Arm: off its reference [mrad]")
    if len(log.intervals):
        titles.append("Arm: time between two setpoints [ms]")
    sheet, panels = _rows(log, titles)
    for k, name in enumerate(log.joints):
        colour = LINES[k % len(LINES)]
        angles = log.arm[:, 1 + k]
        _line(log, panels[0], log.arm[:, 0], angles - angles[0], color=colour, label=name)
        if asked is not None and len(asked) > 1:
            should = np.interp(log.arm[:, 0], asked[:, 0], asked[:, 1 + k], np.nan, np.nan)
            _line(log, panels[1], log.arm[:, 0], 1e3 * (angles - should), color=colour, lw=0.9)
    _legend(panels[0], 1)
    if len(log.intervals):
        # They come in groups: each group over the time since the one before.
        times = log.intervals[:, 0] - log.span[0]
        panels[-1].plot(times, 1e3 * log.intervals[:, 1], ".", ms=2.0, color=INK, alpha=0.4)
        panels[-1].set_ylim(bottom=0.0)
    return sheet


Has = Callable[[RobotLog], bool]
FIGURES: tuple[tuple[str, Has, Callable[[RobotLog], Any]], ...] = (
    ("way", lambda log: len(log.odom) + len(log.truth) > 0, _way),
    ("twist", lambda log: len(log.odom) + len(log.truth) + len(log.twist) > 0, _twist),
    ("wheels", lambda log: len(log.wheels) > 0 and len(log.measured) > 0, _wheels),
    ("power", lambda log: len(log.electrical) > 0, _power),
    ("errors", lambda log: len(log.coupling) > 0 or any(map(len, log.references.values())),
     _errors),
    ("planner", lambda log: len(log.planner) > 0, _planner),
    ("arm", lambda log: len(log.arm) > 0, _arm),
)  # fmt: skip
"""Name, whether it can be drawn, and how."""
