"""The result of an identification on the floor: tables, a parameter file, and the JSON result."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from omniman_ros.console.terminal import table
from omniman_ros.identification.floor.feed_forward import feed_forward_residual
from omniman_ros.identification.floor.floor_fit import FloorFit, configured_quantities
from omniman_ros.identification.floor.record import FloorRecord

UNITS = {
    "mass": "kg",
    "com_x": "m",
    "com_y": "m",
    "inertia": "kg m^2",
    "wheel_inertia": "of configured",
    "gear_efficiency": "",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "drag": "N",
    "friction": "N",
    "slope_x": "rad",
    "slope_y": "rad",
    "back_emf": "V s/rad",
}  #: Units of the quantities, by their names or the first part of them


def unit(name: str) -> str:
    """Return the unit of a quantity."""
    if name.endswith("turning"):
        return "N m"
    return UNITS[name.replace(" ", ".").partition(".")[0]]


def parameters(fit: FloorFit) -> dict[str, Any]:
    """Return the parameters to set, by their full names."""
    robot = fit.robot
    body, motor, friction = robot.body, robot.motor, robot.friction

    def rounded(values: tuple[float, ...]) -> list[float]:
        return [float(f"{value:.5g}") for value in values]

    return {
        "body.mass": round(body.mass, 3),
        "body.inertia": round(body.inertia, 4),
        "body.com_x": round(body.com_x, 4),
        "body.com_y": round(body.com_y, 4),
        "wheels.inertia": rounded(robot.wheels.inertia),
        "motor.gear_efficiency": round(motor.gear_efficiency, 4),
        "motor.torque_constant": float(f"{motor.torque_constant:.5g}"),
        "friction.viscous": rounded(friction.viscous),
        "friction.coulomb": rounded(friction.coulomb),
        "friction.roller": rounded(friction.roller),
    }


def parameter_file(fit: FloorFit) -> str:
    """Return the text of a ROS parameter file that applies to all nodes."""
    today = datetime.now(UTC).isoformat(timespec="seconds")
    lines = [
        f"# Masses, friction and gear by `omniman identify floor`, {today}.",
        "# Use: omniman up --params-file FILE, or ros2 run ... --ros-args --params-file FILE",
        "# The arm is taken to be as configured; what it is not shows up in the body.",
        *(f"# {line}" for line in undetermined_lines(fit)),
        "/**:",
        "  ros__parameters:",
    ]
    group = ""
    for name, value in parameters(fit).items():
        first, _, key = name.partition(".")
        if first != group:
            lines.append(f"    {first}:")
            group = first
        lines.append(f"      {key}: {value}")
    return "\n".join(lines) + "\n"


def undetermined_lines(fit: FloorFit) -> list[str]:
    """Return one line for each group of unknowns that the drive does not tell apart."""
    lines = []
    for group in fit.inseparable:
        if group == ("gear",):
            lines.append(
                "Not told apart: the gear's efficiency, and the common scale of masses, inertias "
                "and friction; the efficiency stays as configured."
                if not fit.is_efficiency_bounded
                else "The gear's efficiency is at its bound of 1: check the motor constants."
            )
        elif len(group) == 1:
            lines.append(f"Not determined: {group[0]}, which has too little effect.")
        else:
            lines.append(
                f"Not told apart: {', '.join(group)}; their common effect is determined, their "
                "difference stays as configured."
            )
    if not fit.is_back_emf_measured:
        lines.append(
            "Not told apart: the motor constant, and the common scale of masses, inertias and "
            "friction; the drives report no voltage, so it stays as configured."
        )
    return lines


def residuals(record: FloorRecord, fit: FloorFit) -> dict[str, float]:
    """Return the feed-forward's residuals on the drive that nothing was fitted to.

    Returns:
        RMS in the directions of motion `before` and `after` [A], the fraction `removed`, and what
        remains as `strain` between the wheels [A]; empty if there was no such drive.
    """
    if record.check is None:
        return {}
    before = feed_forward_residual(record.check, record.robot)
    after = feed_forward_residual(record.check, fit.robot)
    return {
        "before": before.motion,
        "after": after.motion,
        "removed": 1.0 - after.motion / before.motion,
        "strain": after.strain,
    }


def faults(checked: Mapping[str, float]) -> list[str]:
    """Return why the result is not to be used; empty if it is."""
    if checked and checked["after"] >= checked["before"]:
        return [
            f"the feed-forward's residual on the check grew from {checked['before']:.3f} A to "
            f"{checked['after']:.3f} A"
        ]
    return []


def result(record: FloorRecord, fit: FloorFit) -> dict[str, Any]:
    """Return the whole result, for the JSON file."""
    checked = residuals(record, fit)
    truth = {} if record.truth is None else configured_quantities(record.truth)
    return {
        "ok": not faults(checked),
        "parameters": parameters(fit),
        "estimates": {
            name: asdict(estimate) | {"unit": unit(name)} | _true(truth, name)
            for name, estimate in fit.estimates.items()
        },
        "inseparable": [list(group) for group in fit.inseparable],
        "back_emf_measured": fit.is_back_emf_measured,
        "unexplained": (fit.residual / fit.typical).tolist(),
        "feed_forward": checked,
    }


def report(record: FloorRecord, fit: FloorFit) -> list[str]:
    """Return the lines that are shown to the user."""
    truth = {} if record.truth is None else configured_quantities(record.truth)
    head = ("quantity", "unit", "found", "95 %", "before")
    rows: list[tuple[str, ...]] = [(*head, "in the simulation") if truth else head]
    for name, estimate in fit.estimates.items():
        interval = f"+-{estimate.half_width:.4f}"
        cells = (name, unit(name), f"{estimate.value:.4f}", interval, f"{estimate.before:.4f}")
        if not estimate.is_determined:
            cells = (*cells[:3], "not by itself", cells[4])
        rows.append((*cells, f"{truth[name]:.4f}") if truth else cells)
    fractions = 100.0 * fit.residual / fit.typical
    lines = ["", *table(rows), "", *undetermined_lines(fit)]
    lines.append(
        "Drag and friction by direction: at 1 m/s and 1 rad/s, CCTA 2017 (23). Of forward, "
        f"sideways and turning torque, {fractions[0]:.1f}, {fractions[1]:.1f} and "
        f"{fractions[2]:.1f} % are not explained."
    )
    checked = residuals(record, fit)
    if checked:
        lines.append(
            f"Feed-forward on a drive that nothing was fitted to: {checked['before']:.3f} A off "
            f"before, {checked['after']:.3f} A after (RMS): {100.0 * checked['removed']:.0f} % of "
            "the residual is removed. Besides, the wheels strain against one another by "
            f"{checked['strain']:.3f} A, which no feed-forward knows."
        )
    return lines


def _true(truth: Mapping[str, float], name: str) -> dict[str, float]:
    return {"truth": truth[name]} if truth else {}
