"""What a calibration of the odometry comes to: figures, a table, a parameter file."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli.identify_record import Check, Record
from omniman_ros.cli.terminal import table
from omniman_ros.core.calibration import CROSS_TERMS, SCALES, forward_matrix, integrate
from omniman_ros.core.identification import Calibration
from omniman_ros.core.odometry import OdometryParameters

Array = NDArray[np.float64]

PARAMETERS = (*SCALES, *CROSS_TERMS, "wheel_scale")
"""Names below `odometry.` that a calibration sets."""
SCATTER = 3.0
"""Scatter of the measured poses over the stated one that is worth a word."""


def errors_on(check: Check, record: Record, parameters: OdometryParameters) -> dict[str, float]:
    """Errors of the odometry with some parameters along the check path [mm, degrees].

    Along the path where poses were measured on the way, and at its end where one was.
    """
    forward = forward_matrix(record.wheels, parameters)
    poses = integrate(forward, check.positions, check.start)
    found: dict[str, float] = {}
    if check.end is not None:
        off = poses[-1] - np.array(check.end)
        found["end_mm"] = 1e3 * math.hypot(off[0], off[1])
        found["end_heading_deg"] = math.degrees(abs(math.remainder(off[2], math.tau)))
    inside = (check.times >= check.truth[:1, 0].min(initial=math.inf)) & (
        check.times <= check.truth[-1:, 0].max(initial=-math.inf)
    )
    if inside.any():
        times, truth = check.times[inside], check.truth
        away = np.hypot(
            *(poses[inside, k] - np.interp(times, truth[:, 0], truth[:, k + 1]) for k in (0, 1))
        )
        found["rms_mm"] = 1e3 * float(np.sqrt(np.mean(away**2)))
        found["max_mm"] = 1e3 * float(away.max())
    return found


def judge(record: Record, calibration: Calibration) -> dict[str, Any]:
    """Errors on the check path before and after, and what of them is gone.

    Returns:
        Empty if there was no check, or nothing was measured on it.
    """
    if record.check is None:
        return {}
    before = errors_on(record.check, record, record.odometry)
    after = errors_on(record.check, record, calibration.parameters)
    if not before:
        return {}
    key = "rms_mm" if "rms_mm" in before else "end_mm"
    return {
        "before": before, "after": after,
        "removed": 1.0 - after[key] / before[key] if before[key] > 0.0 else 0.0,
        "removed_of": key,
    }  # fmt: skip


def faults(record: Record, check: Mapping[str, Any]) -> list[str]:
    """What speaks against the calibration."""
    if not check:
        return []
    key = check["removed_of"]
    before, after = check["before"][key], check["after"][key]
    if after > before and after > 2e3 * record.accuracy.position:
        return [f"the error on the check path grew from {before:.1f} to {after:.1f} mm"]
    return []


def result(record: Record, calibration: Calibration) -> dict[str, Any]:
    """All of it, for the JSON file."""
    check = judge(record, calibration)
    return {
        "ok": not faults(record, check),
        "model": calibration.model,
        "parameters": {f"odometry.{k}": v for k, v in calibrated(calibration).items()},
        "factors": [asdict(factor) for factor in calibration.factors],
        "not_told_apart": [asdict(untold) for untold in calibration.untold],
        "outliers": [asdict(outlier) for outlier in calibration.outliers],
        "fit": {
            "runs": len(record.runs),
            "poses": len(record.campaign.stations),
            "chi_square": calibration.chi_square,
            "freedom": calibration.freedom,
            "scatter": math.sqrt(calibration.chi_square / max(calibration.freedom, 1)),
            "condition": calibration.condition,
            "wheels_chi_square": calibration.wheels_chi_square,
            "wheels_limit": calibration.wheels_limit,
        },
        "accuracy": {
            "position_mm": 1e3 * record.accuracy.position,
            "heading_deg": math.degrees(record.accuracy.heading),
        },
        "check": check or None,
        "faults": faults(record, check),
    }


def calibrated(calibration: Calibration) -> dict[str, Any]:
    """The parameters to set, below `odometry.`; numbers of six decimals."""
    values: dict[str, Any] = {}
    for name in PARAMETERS:
        value = getattr(calibration.parameters, name)
        if isinstance(value, tuple):
            values[name] = [round(float(item), 6) for item in value]
        else:
            values[name] = round(float(value), 6)
    return values


def parameter_file(calibration: Calibration) -> str:
    """A ROS parameter file for all nodes."""
    today = datetime.now(UTC).isoformat(timespec="seconds")
    lines = [
        f"# Calibration of the odometry by `omniman identify odometry`, {today}.",
        "# Use: omniman up --params-file FILE, or ros2 run ... --ros-args --params-file FILE",
        "/**:",
        "  ros__parameters:",
        "    odometry:",
    ]
    for name, value in calibrated(calibration).items():
        lines.append(f"      {name}: {value}")
    return "\n".join(lines) + "\n"


def report(record: Record, calibration: Calibration) -> list[str]:
    """For people."""
    rows: list[tuple[str, ...]] = [("factor", "before", "fitted", "95 %")]
    for factor in calibration.factors:
        width = factor.half_width
        rows.append(
            (factor.name, f"{factor.before:.4f}", f"{factor.value:.4f}",
             "left" if width is None else f"+-{width:.4f}")
        )  # fmt: skip
    return ["", *table(rows), "", *_remarks(calibration), *_check_lines(record, calibration)]


def _remarks(calibration: Calibration) -> list[str]:
    lines = []
    if calibration.model == "wheels":
        lines.append("Factors per wheel explain the runs; no wheel seems to be mounted askew.")
    elif calibration.wheels_chi_square is not None:
        lines.append(
            "Radii alone do not explain the runs (a wheel mounted askew, or poses measured at "
            "another point than base_link): the wheels' own factors are left as they are."
        )
    for untold in calibration.untold:
        lines.append(
            f"Not told apart by these runs: {', '.join(untold.together)}; left as they are: "
            f"{', '.join(untold.left)}."
        )
    for outlier in calibration.outliers:
        x, y, heading = outlier.off
        lines.append(
            f"Left out: the pose {outlier.name} is off by {1e3 * x:+.0f} mm, {1e3 * y:+.0f} mm, "
            f"{math.degrees(heading):+.1f} deg."
        )
    scatter = math.sqrt(calibration.inflation)
    if scatter > SCATTER:
        lines.append(f"The poses scatter {scatter:.1f} times as much as their stated accuracy.")
    return lines


def _check_lines(record: Record, calibration: Calibration) -> list[str]:
    check = judge(record, calibration)
    if not check:
        return ["No check: it was not driven, or its end was not measured."]
    names = {
        "rms_mm": ("along the path, RMS", "mm"), "max_mm": ("along the path, max", "mm"),
        "end_mm": ("at its end", "mm"), "end_heading_deg": ("heading at its end", "deg"),
    }  # fmt: skip
    rows: list[tuple[str, ...]] = [("odometry's error on a path not fitted to", "before", "after")]
    for key, (name, unit) in names.items():
        if key in check["before"]:
            rows.append(
                (name, f"{check['before'][key]:.2f} {unit}", f"{check['after'][key]:.2f} {unit}")
            )
    of = names[check["removed_of"]][0]
    return ["", *table(rows), f"  {100 * check['removed']:.0f} % is gone ({of})", ""]
