"""A picture of the wheels' friction over their speed: runs, fit, interval, outliers."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from omniman_ros.cli.identify_friction_record import FrictionRecord
from omniman_ros.core.friction_identification import WheelFriction, friction_torque

matplotlib.use("Agg")
from matplotlib import pyplot as plt

INK, FAINT, FIT, BAND, OUTLIER, SOFT = (
    "#1f2933", "#c3cad2", "#2f6fde", "#bcd2f7", "#d9480f", "#5f6b7a",
)  # fmt: skip
COLUMNS = 2


def draw(record: FrictionRecord, found: Sequence[WheelFriction], path: Path) -> None:
    """Draw a panel for each wheel into a PNG file."""
    style: Any = {
        "font.size": 9, "axes.edgecolor": FAINT, "axes.labelcolor": INK, "text.color": INK,
        "xtick.color": SOFT, "ytick.color": SOFT, "axes.spines.top": False,
        "axes.spines.right": False, "axes.titlesize": 10, "axes.titleweight": "bold",
        "axes.titlelocation": "left", "figure.dpi": 130,
    }  # fmt: skip
    rows = math.ceil(len(found) / COLUMNS)
    with plt.rc_context(style):
        sheet, panels = plt.subplots(
            rows, COLUMNS, figsize=(10, 3.2 * rows), layout="constrained", squeeze=False
        )
        for k, axes in enumerate(panels.flat):
            if k < len(found):
                _panel(axes, record, found[k], k)
                axes.set_xlabel("speed of the wheel [rad/s]")
                axes.set_ylabel("friction [N m]")
            else:
                axes.set_axis_off()
        path.parent.mkdir(parents=True, exist_ok=True)
        sheet.savefig(path)
        plt.close(sheet)


def _panel(axes: Any, record: FrictionRecord, wheel: WheelFriction, k: int) -> None:
    speeds = np.array([run.speed[k] for run in record.runs])
    torques = np.array([friction_torque(run, record.robot)[k] for run in record.runs])
    odd, absent = list(wheel.outliers), list(wheel.left_out)
    good = np.ones(len(speeds), dtype=bool)
    good[odd + absent] = False
    top = 1.05 * float(np.abs(speeds).max())
    axes.axhline(0.0, color=FAINT, lw=0.6)
    axes.axvline(0.0, color=FAINT, lw=0.6)
    friction = record.robot.friction
    for sign in (1.0, -1.0):
        at = sign * np.linspace(1e-3, top, 50)
        torque, half = wheel.torque(at), wheel.band(at)
        first = sign > 0
        axes.plot(
            at, friction.viscous[k] * at + sign * friction.coulomb[k], color=SOFT, lw=1.0,
            ls=":", label="as configured" if first else None,
        )  # fmt: skip
        axes.fill_between(
            at, torque - half, torque + half, color=BAND, lw=0, label="95 %" if first else None
        )
        axes.plot(at, torque, color=FIT, lw=1.3, label="fit" if first else None)
    axes.plot(speeds[good], torques[good], "o", ms=3.5, color=INK, mew=0, label="steady run")
    if odd:
        axes.plot(speeds[odd], torques[odd], "x", ms=6, color=OUTLIER, label="outlier")
    if absent:
        axes.plot(
            speeds[absent], torques[absent], "o", ms=4, mfc="none", color=SOFT, label="left out"
        )
    a, b = wheel.viscous, wheel.coulomb
    axes.set_title(wheel.name)
    axes.text(
        0.98, 0.04,
        f"a = {a.value:.5f} ± {a.half_width:.5f} N m s/rad\n"
        f"b = {b.value:.4f} ± {b.half_width:.4f} N m",
        transform=axes.transAxes, ha="right", va="bottom",
    )  # fmt: skip
    axes.legend(frameon=False, loc="upper left", fontsize=8)
