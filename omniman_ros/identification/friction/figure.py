"""A figure of the wheels' friction over their speed: runs, fit, interval, outliers."""

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
    LIGHT_BLUE,
    ORANGE,
    figure_style,
    save_figure,
)
from omniman_ros.identification.friction.friction_fit import WheelFriction, friction_torque
from omniman_ros.identification.friction.record import FrictionRecord

FIT_COLOUR = BLUE
INTERVAL_COLOUR = LIGHT_BLUE
OUTLIER_COLOUR = ORANGE
COLUMNS = 2  #: Number of panels side by side


def draw(record: FrictionRecord, wheels: Sequence[WheelFriction], path: Path) -> None:
    """Draw a panel for each wheel, and save the figure; a failure raises an OSError."""
    rows = math.ceil(len(wheels) / COLUMNS)
    with figure_style(axes_titlesize=10):
        figure, panels = plt.subplots(
            rows, COLUMNS, figsize=(10, 3.2 * rows), layout="constrained", squeeze=False
        )
        for k, axes in enumerate(panels.flat):
            if k < len(wheels):
                _draw_wheel(axes, record, wheels[k], k)
                axes.set_xlabel("speed of the wheel [rad/s]")
                axes.set_ylabel("friction [N m]")
            else:
                axes.set_axis_off()
        save_figure(figure, path)


def _draw_wheel(axes: Any, record: FrictionRecord, wheel: WheelFriction, k: int) -> None:
    speeds = np.array([run.speed[k] for run in record.runs])
    torques = np.array([friction_torque(run, record.robot)[k] for run in record.runs])
    outliers, left_out = list(wheel.outliers), list(wheel.left_out)
    is_used = np.ones(len(speeds), dtype=bool)
    is_used[outliers + left_out] = False
    top = 1.05 * float(np.abs(speeds).max())
    axes.axhline(0.0, color=FAINT, lw=0.6)
    axes.axvline(0.0, color=FAINT, lw=0.6)
    friction = record.robot.friction
    for sign in (1.0, -1.0):
        at = sign * np.linspace(1e-3, top, 50)
        torque, half = wheel.torque(at), wheel.band(at)
        configured = friction.viscous[k] * at + sign * friction.coulomb[k]

        def label(text: str, sign: float = sign) -> str | None:
            return text if sign > 0 else None

        axes.plot(at, configured, color=GREY, lw=1.0, ls=":", label=label("as configured"))
        axes.fill_between(
            at, torque - half, torque + half, color=INTERVAL_COLOUR, lw=0, label=label("95 %")
        )
        axes.plot(at, torque, color=FIT_COLOUR, lw=1.3, label=label("fit"))
    axes.plot(speeds[is_used], torques[is_used], "o", ms=3.5, color=INK, mew=0, label="steady run")
    if outliers:
        axes.plot(
            speeds[outliers], torques[outliers], "x", ms=6, color=OUTLIER_COLOUR, label="outlier"
        )
    if left_out:
        axes.plot(
            speeds[left_out],
            torques[left_out],
            "o",
            ms=4,
            mfc="none",
            color=GREY,
            label="left out",
        )
    a, b = wheel.viscous, wheel.coulomb
    axes.set_title(wheel.name)
    axes.text(
        0.98,
        0.04,
        f"a = {a.value:.5f} ± {a.half_width:.5f} N m s/rad\n"
        f"b = {b.value:.4f} ± {b.half_width:.4f} N m",
        transform=axes.transAxes,
        ha="right",
        va="bottom",
    )
    axes.legend(loc="upper left")
