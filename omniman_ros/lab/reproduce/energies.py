"""Energies of the free case of MPC 2021: the planner against straight lines, by goal."""

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
    """Measure the table of energies, a row for each goal; a row that fails contains its fault.

    Args:
        args: Command line.
        robot: Parameters of the robot, full names to values.
        progress: Progress bar.
    """
    todo = [goal for goal in goals(args.full) if not args.quick or goal == (1.0, 0.0)]
    with ProcessPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        rows = pool.map(partial(energy_row, dict(robot), args.full), todo)
        unit = "goals, each at the arrival time of the planner"
        return collect(progress, "energy", rows, len(todo), unit)


def energy_row(robot: Mapping[str, Any], both: bool, goal: tuple[float, float]) -> dict[str, Any]:
    """Measure the energies to one goal, with the planner and on straight lines.

    Args:
        robot: Parameters of the robot, full names to values.
        both: Whether the line is also driven with all limits lowered, besides the speed alone.
        goal: Distance [m] and bearing [rad] of the goal.
    """
    distance, bearing = goal
    row: dict[str, Any] = {"distance_m": distance, "bearing_deg": math.degrees(bearing)}
    try:
        found: Comparison | None = compare(robot, distance, bearing, {}, both)
        row["fault"] = ""
    except StudyError as error:
        found, row["fault"] = None, str(error)
    nan = math.nan
    return row | {
        "arrival_s": found.arrival if found else nan,
        "lateness_s": found.lateness if found else nan,
        "peak_turn_rad": found.peak if found else nan,
        "energy_j": found.energy if found else nan,
        "speed_only_j": found.speed_only if found else nan,
        "all_limits_j": found.all_limits if found else nan,
        "ratio": found.ratio if found else nan,
    }


def number(value: float, unit: str, digits: int) -> str:
    """Format a value with its unit; a dash if it is not finite."""
    return f"{value:.{digits}f} {unit}" if math.isfinite(value) else "-"


def energy_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the table of energies."""
    rows: list[tuple[str, ...]] = [
        ("goal", "arrival", "planner", "line, slower", "slower, softer", "ratio", "turned")
    ]
    for row in result["energy"]:
        rows.append(
            (
                f"{row['distance_m']:g} m at {row['bearing_deg']:g} deg",
                number(row["arrival_s"], "s", 2),
                number(row["energy_j"], "J", 1),
                number(row["speed_only_j"], "J", 1),
                number(row["all_limits_j"], "J", 1),
                number(row["ratio"], "", 2).rstrip(),
                number(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    faults = [row["fault"] for row in result["energy"] if row["fault"]]
    head = "Energy until rest at equal arrival times, planner and straight line:"
    return [head, *table(rows), *(f"  {fault}" for fault in faults)]
