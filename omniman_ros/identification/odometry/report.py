"""The result of an odometry calibration: a table, a parameter file, and the JSON result."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np

from omniman_ros.console.terminal import table
from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.identification.odometry.factor_selection import Calibration
from omniman_ros.identification.odometry.least_squares import CROSS_TERMS, SCALES
from omniman_ros.identification.odometry.record import CheckDrive, OdometryRecord
from omniman_ros.identification.odometry.wheel_integration import forward_matrix, integrate

PARAMETERS = (*SCALES, *CROSS_TERMS, "wheel_scale")  #: Names below `odometry.` that are set
MAX_SCATTER = 3.0  #: Scatter over the stated one above which the user is told
CHECK_ERRORS = {
    "rms_mm": ("along the path, RMS", "mm"),
    "max_mm": ("along the path, max", "mm"),
    "end_mm": ("at its end", "mm"),
    "end_heading_deg": ("heading at its end", "deg"),
}  #: Errors on the check path by their key: description and unit


def errors_on(
    check: CheckDrive, record: OdometryRecord, parameters: OdometryParameters
) -> dict[str, float]:
    """Evaluate the errors of the odometry along the check path.

    Returns:
        Errors by the keys of `CHECK_ERRORS`: those along the path where poses were measured on the
        way, and those at its end where the pose was measured there.
    """
    forward = forward_matrix(record.wheels, parameters)
    poses = integrate(forward, check.positions, check.start)
    errors: dict[str, float] = {}
    if check.end is not None:
        deviation = poses[-1] - np.array(check.end)
        errors["end_mm"] = 1e3 * math.hypot(deviation[0], deviation[1])
        errors["end_heading_deg"] = math.degrees(abs(math.remainder(deviation[2], math.tau)))
    is_inside = (check.times >= check.truth[:1, 0].min(initial=math.inf)) & (
        check.times <= check.truth[-1:, 0].max(initial=-math.inf)
    )
    if is_inside.any():
        times, truth = check.times[is_inside], check.truth
        distance = np.hypot(
            *(poses[is_inside, k] - np.interp(times, truth[:, 0], truth[:, k + 1]) for k in (0, 1))
        )
        errors["rms_mm"] = 1e3 * float(np.sqrt(np.mean(distance**2)))
        errors["max_mm"] = 1e3 * float(distance.max())
    return errors


def judge(record: OdometryRecord, calibration: Calibration) -> dict[str, Any]:
    """Compare the errors on the check path before and after the calibration.

    Returns:
        The errors `before` and `after`, the fraction `removed`, and the key `removed_of` of the
        error that it refers to; empty if there was no check, or nothing was measured on it.
    """
    if record.check is None:
        return {}
    before = errors_on(record.check, record, record.odometry)
    after = errors_on(record.check, record, calibration.parameters)
    if not before:
        return {}
    key = "rms_mm" if "rms_mm" in before else "end_mm"
    return {
        "before": before,
        "after": after,
        "removed": 1.0 - after[key] / before[key] if before[key] > 0.0 else 0.0,
        "removed_of": key,
    }


def faults(record: OdometryRecord, check: Mapping[str, Any]) -> list[str]:
    """Return the reasons not to use the calibration."""
    if not check:
        return []
    key = check["removed_of"]
    before, after = check["before"][key], check["after"][key]
    if after > before and after > 2e3 * record.accuracy.position:
        return [f"the error on the check path grew from {before:.1f} to {after:.1f} mm"]
    return []


def result(record: OdometryRecord, calibration: Calibration) -> dict[str, Any]:
    """Return the whole result, for the JSON file."""
    check = judge(record, calibration)
    return {
        "ok": not faults(record, check),
        "model": calibration.model,
        "parameters": {f"odometry.{k}": v for k, v in calibrated(calibration).items()},
        "factors": [asdict(factor) for factor in calibration.factors],
        "not_told_apart": [asdict(factors) for factors in calibration.undetermined],
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
    """Return the parameters to set, by their names below `odometry.`, with six decimals."""
    values: dict[str, Any] = {}
    for name in PARAMETERS:
        value = getattr(calibration.parameters, name)
        if isinstance(value, tuple):
            values[name] = [round(float(item), 6) for item in value]
        else:
            values[name] = round(float(value), 6)
    return values


def parameter_file(calibration: Calibration) -> str:
    """Return the text of a ROS parameter file that applies to all nodes."""
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


def report(record: OdometryRecord, calibration: Calibration) -> list[str]:
    """Return the lines that are shown to the user."""
    rows: list[tuple[str, ...]] = [("factor", "before", "fitted", "95 %")]
    for factor in calibration.factors:
        width = factor.half_width
        rows.append(
            (
                factor.name,
                f"{factor.before:.4f}",
                f"{factor.value:.4f}",
                "not fitted" if width is None else f"+-{width:.4f}",
            )
        )
    return ["", *table(rows), "", *_remarks(calibration), *_check_lines(record, calibration)]


def _remarks(calibration: Calibration) -> list[str]:
    lines = []
    if calibration.model == "wheels":
        lines.append("Factors per wheel explain the runs; no wheel seems to be misaligned.")
    elif calibration.wheels_chi_square is not None:
        lines.append(
            "Radii alone do not explain the runs (a misaligned wheel, or poses measured at "
            "another point than base_link): the wheels' own factors are not changed."
        )
    for factors in calibration.undetermined:
        lines.append(
            f"These runs cannot distinguish {', '.join(factors.together)}; not changed: "
            f"{', '.join(factors.left)}."
        )
    for outlier in calibration.outliers:
        x, y, heading = outlier.off
        lines.append(
            f"Left out: the pose {outlier.name} is off by {1e3 * x:+.0f} mm, {1e3 * y:+.0f} mm, "
            f"{math.degrees(heading):+.1f} deg."
        )
    scatter = math.sqrt(calibration.inflation)
    if scatter > MAX_SCATTER:
        lines.append(f"The poses scatter {scatter:.1f} times as much as their stated accuracy.")
    return lines


def _check_lines(record: OdometryRecord, calibration: Calibration) -> list[str]:
    check = judge(record, calibration)
    if not check:
        return ["No check: it was not driven, or its end was not measured."]
    rows: list[tuple[str, ...]] = [
        ("error of the odometry on a path that was not fitted", "before", "after")
    ]
    for key, (name, unit) in CHECK_ERRORS.items():
        if key in check["before"]:
            rows.append(
                (name, f"{check['before'][key]:.2f} {unit}", f"{check['after'][key]:.2f} {unit}")
            )
    description = CHECK_ERRORS[check["removed_of"]][0]
    removed = f"  {100 * check['removed']:.0f} % of the error is removed ({description})"
    return ["", *table(rows), removed, ""]
