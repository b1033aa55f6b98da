"""`omniman reproduce free_paper`: the free case, MPC 2021, 4.1, with the paper's own problem.

Weights, mass, friction and bearing, which the paper does not give, are varied.
"""

import argparse
import math
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce.energies import format_quantity
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.paper_drive import (
    COMPARED_WAY,
    SNAPSHOTS,
    PaperDrive,
    drive_paper,
    paper_variants,
)
from omniman_ros.lab.studies.paper_problem import STAGE, STAGES
from omniman_ros.lab.studies.recorded_drive import REST_SPEED
from omniman_ros.robots import load_robot

NAME = "reproduce_free_paper"
"""Name of the results, without a suffix."""
QUICK = 2
"""Number of variants in a quick run: those that the picture shows."""


def run(args: argparse.Namespace) -> int:
    """Run the study.

    Args:
        args: Parsed command line.

    Returns:
        1 if the solver did not converge in some stage, else 0.
    """
    robot = load_robot(args.robot)
    variants = paper_variants(robot)
    variants = variants[:QUICK] if args.quick else variants
    started = time.monotonic()
    progress = Progress()
    progress.headline(f"the paper's own problem, MPC 2021, 4.1, robot '{args.robot}'")
    with ProcessPoolExecutor(min(len(variants), os.cpu_count() or 1)) as pool:
        mapped = pool.map(partial(drive_paper, dict(robot)), variants)
        driven = collect(progress, "drives", mapped, len(variants), "drives")
    built = build(Robot, robot)
    rows = [drive.figures(built) for drive in driven]
    unsolved = sum(row["unsolved"] for row in rows)
    result: dict[str, Any] = {
        "robot": args.robot,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "passed": unsolved == 0,
        "horizon": {"stages": STAGES, "stage_s": STAGE},
        "rest_speed": REST_SPEED,
        "snapshot_shares": SNAPSHOTS,
        "compared_way_m": COMPARED_WAY,
        "drives": rows,
    }
    progress.begin("picture")
    path = draw_picture(built, driven, Path(args.results))
    result["picture"] = path and str(path)
    progress.end("done" if path else "no matplotlib")
    publish(NAME, result, report, started, args.results)
    return 0 if result["passed"] else 1


def draw_picture(robot: Robot, driven: Sequence[PaperDrive], folder: Path) -> Path | None:
    """Draw the picture, and return its path; None if matplotlib is not installed.

    Args:
        robot: The robot.
        driven: The drives, in the order of the variants.
        folder: Folder of the file.
    """
    try:
        from omniman_ros.lab.figures import free_paper
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    free_paper.draw(robot, driven, path)
    return path


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    rows: list[tuple[str, ...]] = [
        (
            "",
            "W_pos/W_ang",
            "peak speed",
            "at",
            "rest",
            "short by",
            "heading off",
            "turn to diagonal",
            "near one",
            "saturated",
            "energy",
        )
    ]
    rows += [_cells(row) for row in result["drives"]]
    stages = sum(row["stages"] for row in result["drives"])
    unsolved = sum(row["unsolved"] for row in result["drives"])
    lines = ["", *table(rows), "", f"Stages that were not solved: {unsolved} of {stages}"]
    if result["picture"]:
        lines.append(f"Picture: {result['picture']}")
    return lines


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        row["about"],
        f"{row['w_pos']:g}/{row['w_ang']:g}",
        format_quantity(row["peak_speed_m_s"], "m/s", 2),
        format_quantity(row["peak_speed_s"], "s", 1),
        format_quantity(row["rest_s"], "s", 1),
        format_quantity(row["rest_m"], "m", 2),
        format_quantity(math.degrees(row["rest_rad"]), "deg", 0),
        format_quantity(math.degrees(row["turn_to_diagonal_rad"]), "deg", 0),
        f"{100 * row['share']:.0f} %",
        f"{100 * row['saturated_share']:.0f} %",
        format_quantity(row["energy_j"], "J", 0),
    )
