"""The result of a friction identification: a table, a parameter file, and the JSON result."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from omniman_ros.console.terminal import table
from omniman_ros.identification.friction.friction_fit import (
    MIN_SPEED,
    ConfidenceInterval,
    WheelFriction,
)
from omniman_ros.identification.friction.record import FrictionRecord, Truth

BACK_EMF_TOLERANCE = 0.03  #: Relative deviation of N K above which a warning is given

Wheels = Sequence[WheelFriction]  #: Identified friction of each wheel, in the robot's order


def calibrated(wheels: Wheels) -> dict[str, list[float]]:
    """Return the parameters to set, by their names below `friction.`.

    A value that noise made negative becomes 0.
    """
    return {
        "viscous": [round(max(wheel.viscous.value, 0.0), 6) for wheel in wheels],
        "coulomb": [round(max(wheel.coulomb.value, 0.0), 5) for wheel in wheels],
    }


def parameter_file(wheels: Wheels) -> str:
    """Return the text of a ROS parameter file that applies to all nodes."""
    today = datetime.now(UTC).isoformat(timespec="seconds")
    lines = [
        f"# Friction of the wheels by `omniman identify friction`, {today}.",
        "# Use: omniman up --params-file FILE, or ros2 run ... --ros-args --params-file FILE",
        "# Wheel: value +- half width of the 95 % interval.",
        "/**:",
        "  ros__parameters:",
        "    friction:",
    ]
    for name, unit in (("viscous", "N m s/rad"), ("coulomb", "N m")):
        lines.append(f"      # {name} [{unit}]")
        for wheel in wheels:
            estimate: ConfidenceInterval = getattr(wheel, name)
            lines.append(
                f"      #   {wheel.name}: {estimate.value:.6f} +- {estimate.half_width:.6f}"
            )
        lines.append(f"      {name}: {calibrated(wheels)[name]}")
    return "\n".join(lines) + "\n"


def result(record: FrictionRecord, wheels: Wheels) -> dict[str, Any]:
    """Return the whole result, for the JSON file."""
    entries = []
    for k, wheel in enumerate(wheels):
        values = asdict(wheel)
        del values["covariance"]
        values |= {"directions_differ": wheel.differs, "back_emf_off": wheel.back_emf_off}
        if record.truth is not None:
            values["truth"] = {
                "viscous": record.truth.viscous[k],
                "coulomb": record.truth.coulomb[k],
            }
        entries.append(values)
    return {
        "ok": True,
        "parameters": {f"friction.{name}": values for name, values in calibrated(wheels).items()},
        "wheels": entries,
        "runs": len(record.runs),
        "spikes": int(sum(run.spikes.sum() for run in record.runs)),
        "warnings": warnings(wheels),
    }


def report(record: FrictionRecord, wheels: Wheels) -> list[str]:
    """Return the lines that are shown to the user."""
    friction = record.robot.friction
    head = ("wheel", "a [N m s/rad]", "95 %", "before", "b [N m]", "95 %", "before", "noise")
    rows: list[tuple[str, ...]] = [(*head, "outliers", "N K error")]
    for k, wheel in enumerate(wheels):
        a, b = wheel.viscous, wheel.coulomb
        rows.append(
            (
                wheel.name,
                f"{a.value:.5f}",
                f"+-{a.half_width:.5f}",
                f"{friction.viscous[k]:.5f}",
                f"{b.value:.4f}",
                f"+-{b.half_width:.4f}",
                f"{friction.coulomb[k]:.4f}",
                f"{1e3 * wheel.noise:.1f} mN m",
                f"{len(wheel.outliers)}",
                f"{100 * wheel.back_emf_off:+.1f} %",
            )
        )
    lines = ["", *table(rows), ""]
    if record.truth is not None:
        lines += [*_truth_lines(record.truth, wheels), ""]
    left_out = sum(len(wheel.left_out) for wheel in wheels)
    if left_out:
        lines.append(
            f"{left_out} of {len(record.runs) * len(wheels)} wheel runs were left out: not "
            f"steady, or slower than {MIN_SPEED:.2g} rad/s."
        )
    return lines + warnings(wheels)


def _truth_lines(truth: Truth, wheels: Wheels) -> list[str]:
    rows: list[tuple[str, ...]] = [("in the simulation", "a", "error", "b", "error")]
    for k, wheel in enumerate(wheels):
        cells = []
        for true, estimate in (
            (truth.viscous[k], wheel.viscous),
            (truth.coulomb[k], wheel.coulomb),
        ):
            error = f"{100 * (estimate.value / true - 1):+.1f} %" if true else "-"
            cells += [f"{true:.5f}", error]
        rows.append((wheel.name, *cells))
    return table(rows)


def warnings(wheels: Wheels) -> list[str]:
    """Return warnings about the result, one line each."""
    return [line for wheel in wheels for line in _wheel_warnings(wheel)]


def _wheel_warnings(wheel: WheelFriction) -> list[str]:
    lines = []
    (a1, b1), (a2, b2) = wheel.forward, wheel.backward
    if wheel.differs:
        lines.append(
            f"{wheel.name}: the directions differ (p = {wheel.difference:.1g}): a {a1:.5f} "
            f"and {a2:.5f}, b {b1:.4f} and {b2:.4f} forwards and backwards. An offset of the "
            "current sensor has the same effect."
        )
    half_width = wheel.back_emf.half_width / wheel.nominal_back_emf
    if abs(wheel.back_emf_off) > BACK_EMF_TOLERANCE + half_width:
        lines.append(
            f"WARNING {wheel.name}: N K is {wheel.back_emf.value:.4f} V s/rad by voltage, "
            f"current and speed, {100 * wheel.back_emf_off:+.1f} % off the configured "
            f"{wheel.nominal_back_emf:.4f}: correct motor.torque_constant (or the encoder's "
            "counts), then fit again: a and b have the same relative error."
        )
    for name, estimate in (("a", wheel.viscous), ("b", wheel.coulomb)):
        if estimate.value < estimate.half_width:
            lines.append(
                f"{wheel.name}: {name} does not differ significantly from 0"
                + (", and is set to 0." if estimate.value < 0.0 else ".")
            )
    return lines
