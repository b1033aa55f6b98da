"""`omniman reproduce free | corridor | moving | workshop`: drives of the planner through a scene.

The first three are the test cases of MPC 2021, section 4; the workshop is a scene with a map.
"""

import argparse
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce.pipeline import collect, publish, result_name
from omniman_ros.lab.studies.mpc_cases import PAPER_HORIZON, SCENES, Scene, Variant
from omniman_ros.lab.studies.planned_drives import PlannedDrive, drive_with_planner
from omniman_ros.lab.studies.workshop import workshop
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

VARIANTS = (
    Variant("defaults"),
    Variant("voltages put out", voltages=True),  # as in MPC 2021, (20)
    Variant("the paper's horizon", planner=PAPER_HORIZON),
)
CASES = {**SCENES, "workshop": workshop}
ABOUT = {
    "free": "a straight line without obstacles, MPC 2021, 4.1",
    "corridor": "gaps between circles narrower than the robot is long, MPC 2021, 4.2",
    "moving": "circles that cross the path, one of which changes its velocity, MPC 2021, 4.3",
    "workshop": "a dead end and three doors, with a map",
}


def run(args: argparse.Namespace) -> int:
    """Run a case.

    Returns:
        1 if a drive with default parameters missed its goal or had a contact, else 0.
    """
    robot, scene = load_robot(args.robot), CASES[args.name]()
    started = time.monotonic()
    progress = Progress()
    where = f", in the physics world on wheels '{args.world}'" if args.world else ""
    progress.headline(f"{ABOUT[args.name]}, robot '{args.robot}'{where}")
    # The paper's horizon is too short for a map.
    selected = VARIANTS[: 1 if args.quick else 2 if args.name == "workshop" else 3]

    def driven(variant: Variant) -> PlannedDrive:
        changed = replace(scene, changes={**scene.changes, **variant.planner})
        timer = time.process_time
        return drive_with_planner(robot, changed, variant.voltages, args.seed, timer, args.world)

    drives = collect(progress, "drives", map(driven, selected), len(selected), "drives")
    rows = [
        {
            "about": variant.about,
            "changes": dict(variant.planner),
            "counts": not variant.planner,
            "voltages": variant.voltages,
            **planned.figures(),
        }
        for variant, planned in zip(selected, drives, strict=True)
    ]
    # The paper's horizon is reported but may fail.
    passed = all(row["reached"] and not row["collided"] for row in rows if row["counts"])
    stem = result_name(args.name, args.world)
    result: dict[str, Any] = {
        "case": args.name,
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "seed": args.seed,
        "passed": passed,
        "observation_noise_m": scene.noise,
        "drives": rows,
        "picture": draw(build(Robot, robot), scene, drives[0], Path(args.results, f"{stem}.png")),
    }
    publish(stem, result, report, started, args.results)
    return 0 if passed else 1


def draw(robot: Robot, scene: Scene, planned: PlannedDrive, path: Path) -> str | None:
    """Draw a case as a PNG file; return its path, or None if matplotlib is not installed."""
    try:
        from omniman_ros.lab.figures import mpc as picture
    except ImportError:
        return None
    if scene.name == "workshop":
        picture.draw_trail(robot, scene, planned, path)
    else:
        picture.draw_snapshots(robot, scene, planned, path)
    return str(path)


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
    header = ("", "reached", "time", "energy", "least gap", "plans used", "braked")
    rows: list[tuple[str, ...]] = [(*header, "CPU median", "p99", "tracking error")]
    rows += [_cells(row) for row in result["drives"]]
    failed = [row["about"] for row in result["drives"] if not row["reached"] or row["collided"]]
    names = f" (goal missed or contact: {', '.join(failed)})" if failed else ""
    passed = verdict(result["passed"], "passed", "FAILED")
    return [
        "",
        *table(rows),
        "",
        f"Goal reached without contact, with the defaults: {passed}{names}",
        f"Picture: {result['picture'] or 'no matplotlib'}",
    ]


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    def quantity(value: float, unit: str, digits: int) -> str:
        return f"{value:.{digits}f} {unit}" if math.isfinite(value) else "-"

    return (
        row["about"],
        "CONTACT" if row["collided"] else "yes" if row["reached"] else row["state"],
        quantity(row["time_s"], "s", 2),
        quantity(row["energy_j"], "J", 0),
        quantity(1e3 * row["clearance_m"], "mm", 0),
        f"{row['plans_used']} of {row['cycles']}",
        f"{row['brakings']}",
        quantity(row["cpu_median_ms"], "ms", 1),
        quantity(row["cpu_p99_ms"], "ms", 1),
        quantity(1e3 * row["tracking_m"], "mm", 0),
    )
