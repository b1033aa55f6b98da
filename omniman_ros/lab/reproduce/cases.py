"""`omniman reproduce free | corridor | moving | workshop`: the planner's drives through a scene.

The first three are the cases of MPC 2021, section 4; the workshop has a map.
"""

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce.energies import energy_lines, measure_energies, number
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.mpc_cases import PAPER, SCENES, Scene, Variant, variants
from omniman_ros.lab.studies.planned_drives import PlannedDrive, drive_with_planner
from omniman_ros.lab.studies.recorded_drive import SETTLE, Drive
from omniman_ros.lab.studies.roller_diagonals import NEAR_DIAGONAL, diagonal_figures
from omniman_ros.lab.studies.workshop import workshop
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

PAPER_VARIANT = Variant("the paper's horizon and cost", planner=PAPER)
DEFAULTS = Variant("defaults")
VOLTAGES = Variant("voltages put out", voltages=True)


@dataclass(frozen=True)
class MpcCase:
    """A case that the planner drives.

    Attributes:
        about: Headline.
        scene: Makes its scene.
        variants: Makes the variants in which it is driven, from the robot's parameters.
        quick: Number of variants of a quick run.
        layout: Number of snapshots and columns of its picture.
    """

    about: str
    scene: Callable[[], Scene]
    variants: Callable[[Mapping[str, Any]], Sequence[Variant]]
    quick: int = 2
    layout: tuple[int, int] = (5, 3)


def _with_paper(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return (DEFAULTS, VOLTAGES, PAPER_VARIANT)


def _free(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return variants(robot)


def _own(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return (DEFAULTS, VOLTAGES)


CASES = {
    "free": MpcCase("a straight way with nothing on it, MPC 2021, 4.1", SCENES["free"], _free),
    "corridor": MpcCase(
        "circles closer together than the robot is long, MPC 2021, 4.2",
        SCENES["corridor"],
        _with_paper,
    ),
    "moving": MpcCase(
        "circles that cross the way, one of them changes its velocity, MPC 2021, 4.3",
        SCENES["moving"],
        _with_paper,
        layout=(7, 4),
    ),
    "workshop": MpcCase("a dead end and three doors, with a map", workshop, _own, quick=1),
}
"""The cases, by the names of their experiments."""


def run(args: argparse.Namespace) -> int:
    """Drive a case; return 1 if a drive with defaults missed its goal or touched something."""
    case = CASES[args.name]
    robot, scene = load_robot(args.robot), case.scene()
    started = time.monotonic()
    progress = Progress()
    progress.headline(f"{case.about}, robot '{args.robot}'")
    chosen = case.variants(robot)
    chosen = chosen[: case.quick] if args.quick else chosen
    made = (_drive(robot, scene, variant, args.seed) for variant in chosen)
    rides = collect(progress, "drives", made, len(chosen), "drives")
    drives = [drive_row(variant, ride, robot) for variant, ride in zip(chosen, rides, strict=True)]
    # The paper's own setting is shown as it is: it may fail.
    passed = all(row["reached"] and not row["collided"] for row in drives if row["counts"])
    result: dict[str, Any] = {
        "case": args.name,
        "robot": args.robot,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "passed": passed,
        "defaults": dict(scene.changes),
        "observation_noise_m": scene.noise,
        "drives": drives,
    }
    if args.name == "free":
        result["energy"] = measure_energies(args, robot, progress)
        result["energy_until"] = f"{SETTLE:g} s after the arrival"
    progress.begin("picture")
    result |= draw_case(build(Robot, robot), scene, rides[0], result, Path(args.results))
    progress.end("done" if result["picture"] else "no matplotlib")
    publish(f"reproduce_{args.name}", result, report, started, args.results)
    return 0 if passed else 1


def _drive(robot: Mapping[str, Any], scene: Scene, variant: Variant, seed: int) -> PlannedDrive:
    changed = replace(scene, changes={**scene.changes, **variant.planner})
    timer = time.process_time
    return drive_with_planner({**robot, **variant.robot}, changed, variant.voltages, seed, timer)


def drive_row(variant: Variant, ride: PlannedDrive, robot: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a drive; it counts for the result if no parameter was changed."""
    changes = {**variant.robot, **variant.planner}
    return {
        "about": variant.about,
        "changes": changes,
        "counts": not changes,
        "voltages": variant.voltages,
        **ride.figures(),
        **diagonal_figures(ride.drive, build(Robot, robot)),
        "backwards_share": backwards(ride.drive),
    }


def backwards(drive: Drive) -> float:
    """Return the share of the time in motion in which the robot travels backwards."""
    _, angles = drive.travel_directions()
    return float(np.mean(np.abs(angles) > 0.5 * math.pi)) if len(angles) else 0.0


def draw_case(
    robot: Robot, scene: Scene, ride: PlannedDrive, result: dict[str, Any], folder: Path
) -> dict[str, str | None]:
    """Draw a case into a PNG file, and `moving` also into a GIF, if matplotlib is installed.

    Returns:
        Paths of `picture` and `film`; None where there is none.
    """
    try:
        from omniman_ros.lab.figures import mpc as mpc_picture
    except ImportError:
        return {"picture": None, "film": None}
    name = scene.name
    path, film = folder / f"reproduce_{name}.png", folder / f"reproduce_{name}.gif"
    if name == "free":
        mpc_picture.draw_free(robot, scene, ride, result, path)
    elif name == "workshop":
        mpc_picture.draw_trail(robot, scene, ride, path)
    else:
        mpc_picture.draw_case(robot, scene, ride, path, *CASES[name].layout)
    if name == "moving":
        mpc_picture.animate(robot, scene, ride, film)
    return {"picture": str(path), "film": str(film) if name == "moving" else None}


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the tables."""
    rows: list[tuple[str, ...]] = [
        (
            "",
            "reached",
            "time",
            "energy",
            "least gap",
            "plans used",
            "braked",
            "CPU median",
            "p99",
            "off path",
        )
    ]
    rows += [_drive_cells(row) for row in result["drives"]]
    lines = ["", *table(rows)]
    if result["case"] == "free":
        lines += ["", *_slant_lines(result["drives"])]
        lines += ["", *energy_lines(result)]
    failed = [row["about"] for row in result["drives"] if not row["reached"] or row["collided"]]
    passed = verdict(result["passed"], "passed", "FAILED")
    named = f" (not reached or touched: {', '.join(failed)})" if failed else ""
    lines += ["", f"Goal reached without contact, with the defaults: {passed}{named}"]
    for label, path in (("Picture", result["picture"]), ("Film", result["film"])):
        if path:
            lines.append(f"{label}: {path}")
    return lines


def _drive_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        row["about"],
        "CONTACT" if row["collided"] else "yes" if row["reached"] else row["state"],
        number(row["time_s"], "s", 2),
        number(row["energy_j"], "J", 0),
        number(1e3 * row["clearance_m"], "mm", 0),
        f"{row['plans_used']} of {row['cycles']}",
        f"{row['brakings']}",
        number(row["cpu_median_ms"], "ms", 1),
        number(row["cpu_p99_ms"], "ms", 1),
        number(1e3 * row["tracking_m"], "mm", 0),
    )


def _slant_lines(drives: Sequence[Mapping[str, Any]]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ("", "along a diagonal", "of the way", "nearest", "at", "turned by")
    ]
    for row in drives:
        rows.append(
            (
                row["about"],
                "yes" if row["along_diagonal"] else "no",
                f"{100 * row['share']:.0f} %",
                number(math.degrees(row["nearest_rad"]), "deg", 0),
                number(row["nearest_s"], "s", 1),
                number(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    limit = math.degrees(NEAR_DIAGONAL)
    return [f"Direction of travel within {limit:.0f} deg of a roller diagonal:", *table(rows)]
