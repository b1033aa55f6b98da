"""What the friction of the wheels comes to: figures, a table, a parameter file."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from omniman_ros.cli.identify_friction_record import FrictionRecord
from omniman_ros.cli.terminal import table
from omniman_ros.core.friction_identification import LEAST_SPEED, Estimate, WheelFriction

BACK_EMF_OFF = 0.03
"""Difference of N K to the configured one that is worth a warning."""

Found = Sequence[WheelFriction]


def calibrated(found: Found) -> dict[str, list[float]]:
    """The parameters to set, below `friction.`; what is below 0 by noise is 0."""
    return {
        "viscous": [round(max(wheel.viscous.value, 0.0), 6) for wheel in found],
        "coulomb": [round(max(wheel.coulomb.value, 0.0), 5) for wheel in found],
    }


def parameter_file(found: Found) -> str:
    """A ROS parameter file for all nodes."""
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
        for wheel in found:
            estimate: Estimate = getattr(wheel, name)
            lines.append(
                f"      #   {wheel.name}: {estimate.value:.6f} +- {estimate.half_width:.6f}"
            )
        lines.append(f"      {name}: {calibrated(found)[name]}")
    return "\n".join(lines) + "\n"


def result(record: FrictionRecord, found: Found) -> dict[str, Any]:
    """All of it, for the JSON file."""
    wheels = []
    for k, wheel in enumerate(found):
        values = asdict(wheel)
        del values["covariance"]
        values |= {"directions_differ": wheel.differs, "back_emf_off": wheel.back_emf_off}
        if record.truth is not None:
            values["truth"] = {
                "viscous": record.truth.viscous[k],
                "coulomb": record.truth.coulomb[k],
            }
        wheels.append(values)
    return {
        "ok": True,
        "parameters": {f"friction.{name}": values for name, values in calibrated(found).items()},
        "wheels": wheels,
        "runs": len(record.runs),
        "spikes": int(sum(run.spikes.sum() for run in record.runs)),
        "warnings": warnings(found),
    }


def report(record: FrictionRecord, found: Found) -> list[str]:
    """For people."""
    friction = record.robot.friction
    head = ("wheel", "a [N m s/rad]", "95 %", "before", "b [N m]", "95 %", "before", "noise")
    rows: list[tuple[str, ...]] = [(*head, "outliers", "N K off")]
    for k, wheel in enumerate(found):
        a, b = wheel.viscous, wheel.coulomb
        rows.append(
            (wheel.name, f"{a.value:.5f}", f"+-{a.half_width:.5f}", f"{friction.viscous[k]:.5f}",
             f"{b.value:.4f}", f"+-{b.half_width:.4f}", f"{friction.coulomb[k]:.4f}",
             f"{1e3 * wheel.noise:.1f} mN m", f"{len(wheel.outliers)}",
             f"{100 * wheel.back_emf_off:+.1f} %")
        )  # fmt: skip
    lines = ["", *table(rows), ""]
    if record.truth is not None:
        lines += [*_truth_lines(record, found), ""]
    used = len(record.runs)
    left = sum(len(wheel.left_out) for wheel in found)
    if left:
        lines.append(
            f"{left} of {used * len(found)} wheel runs were left out: not steady, or slower than "
            f"{LEAST_SPEED:.2g} rad/s."
        )
    return lines + warnings(found)


def _truth_lines(record: FrictionRecord, found: Found) -> list[str]:
    assert record.truth is not None
    rows: list[tuple[str, ...]] = [("in the simulation", "a", "found off", "b", "found off")]
    for k, wheel in enumerate(found):
        cells = []
        for true, estimate in (
            (record.truth.viscous[k], wheel.viscous), (record.truth.coulomb[k], wheel.coulomb)
        ):  # fmt: skip
            off = f"{100 * (estimate.value / true - 1):+.1f} %" if true else "-"
            cells += [f"{true:.5f}", off]
        rows.append((wheel.name, *cells))
    return table(rows)


def warnings(found: Found) -> list[str]:
    """What is worth a word."""
    lines = []
    for wheel in found:
        (a1, b1), (a2, b2) = wheel.forward, wheel.backward
        if wheel.differs:
            lines.append(
                f"{wheel.name}: the directions differ (p = {wheel.difference:.1g}): a {a1:.5f} "
                f"and {a2:.5f}, b {b1:.4f} and {b2:.4f} forwards and backwards. The current "
                "sensor's offset does this too."
            )
        half = wheel.back_emf.half_width / wheel.nominal_back_emf
        if abs(wheel.back_emf_off) > BACK_EMF_OFF + half:
            lines.append(
                f"WARNING {wheel.name}: N K is {wheel.back_emf.value:.4f} V s/rad by voltage, "
                f"current and speed, {100 * wheel.back_emf_off:+.1f} % off the configured "
                f"{wheel.nominal_back_emf:.4f}: correct motor.torque_constant (or the encoder's "
                "counts), then fit again: a and b are off as much."
            )
        for name, estimate in (("a", wheel.viscous), ("b", wheel.coulomb)):
            if estimate.value < estimate.half_width:
                lines.append(
                    f"{wheel.name}: {name} is not told from 0"
                    + (", and is set to 0." if estimate.value < 0.0 else ".")
                )
    return lines
