"""Energies of the free case of MPC 2021: planner and straight line compared for each goal.

Both arrive at the same time; see `studies.kinematic_comparison`.
"""

import argparse
import math
import os
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.lab.reproduce.pipeline import collect
from omniman_ros.lab.studies.kinematic_comparison import Comparison, compare
from omniman_ros.lab.studies.mpc_cases import goals
from omniman_ros.lab.studies.recorded_drive import StudyError


def measure_energies(
    args: argparse.Namespace, robot: Mapping[str, Any], progress: Progress
) -> list[dict[str, Any]]:
    """Measure the energies to all goals, in parallel.

    Args:
        args: Parsed command line.
        robot: Parameters of the robot, full names to values.
        progress: Progress bar.

    Returns:
        One row for each goal, as returned by :func:`energy_row`.
    """
    selected = [goal for goal in goals(args.full) if not args.quick or goal == (1.0, 0.0)]
    with ProcessPoolExecutor(min(len(selected), os.cpu_count() or 1)) as pool:
        row = partial(energy_row, dict(robot), args.full, wheels=args.world)
        rows = pool.map(row, selected)
        unit = "goals, with the arrival times of the planner"
        return collect(progress, "energy", rows, len(selected), unit)


def energy_row(
    robot: Mapping[str, Any],
    all_limits: bool,
    goal: tuple[float, float],
    wheels: str | None = None,
) -> dict[str, Any]:
    """Measure the energies to one goal, with the planner and along a straight line.

    Args:
        robot: Parameters of the robot, full names to values.
        all_limits: Whether the line is driven a second time with all limits lowered, in addition
            to the drive with only the speed lowered.
        goal: Distance [m] and bearing [rad] of the goal.
        wheels: Kind of wheels in the physics world; None for the plant.

    Returns:
        The row for the JSON. If the comparison fails, `fault` has the reason, and the measured
        values are NaN.
    """
    distance, bearing = goal
    row: dict[str, Any] = {"distance_m": distance, "bearing_deg": math.degrees(bearing)}
    try:
        comparison: Comparison | None = compare(robot, distance, bearing, {}, all_limits, wheels)
        row["fault"] = ""
    except StudyError as error:
        comparison, row["fault"] = None, str(error)
    nan = math.nan
    return row | {
        "arrival_s": comparison.arrival if comparison else nan,
        "lateness_s": comparison.lateness if comparison else nan,
        "peak_turn_rad": comparison.peak if comparison else nan,
        "energy_j": comparison.energy if comparison else nan,
        "speed_only_j": comparison.speed_only if comparison else nan,
        "all_limits_j": comparison.all_limits if comparison else nan,
        "ratio": comparison.ratio if comparison else nan,
    }


def format_quantity(value: float, unit: str, digits: int) -> str:
    """Format a value with its unit and a number of decimals; return a dash if it is not finite."""
    return f"{value:.{digits}f} {unit}" if math.isfinite(value) else "-"


def energy_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the table of energies, followed by the faults."""
    rows: list[tuple[str, ...]] = [
        ("goal", "arrival", "planner", "line, slower", "slower, softer", "ratio", "largest turn")
    ]
    for row in result["energy"]:
        rows.append(
            (
                f"{row['distance_m']:g} m at {row['bearing_deg']:g} deg",
                format_quantity(row["arrival_s"], "s", 2),
                format_quantity(row["energy_j"], "J", 1),
                format_quantity(row["speed_only_j"], "J", 1),
                format_quantity(row["all_limits_j"], "J", 1),
                format_quantity(row["ratio"], "", 2).rstrip(),
                format_quantity(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    faults = [row["fault"] for row in result["energy"] if row["fault"]]
    heading = "Energy until rest of the planner and of a straight line, at equal arrival times:"
    return [heading, *table(rows), *(f"  {fault}" for fault in faults)]
