"""`omniman reproduce free | corridor | moving | workshop`: drives of the planner through a scene.

The first three are the test cases of MPC 2021, section 4; the workshop is a scene with a map.
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
from omniman_ros.lab.reproduce.energies import energy_lines, format_quantity, measure_energies
from omniman_ros.lab.reproduce.experiments import result_name
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.mpc_cases import PAPER_HORIZON, SCENES, Scene, Variant, variants
from omniman_ros.lab.studies.planned_drives import PlannedDrive, drive_with_planner
from omniman_ros.lab.studies.recorded_drive import SETTLING_TIME, Drive
from omniman_ros.lab.studies.roller_diagonals import NEAR_DIAGONAL, diagonal_figures
from omniman_ros.lab.studies.workshop import workshop
from omniman_ros.lab.verdicts import verdict
from omniman_ros.robots import load_robot

PAPER_VARIANT = Variant("the paper's horizon", planner=PAPER_HORIZON)
"""Variant with the horizon of MPC 2021, and no running cost."""
DEFAULTS = Variant("defaults")
"""Variant with the default parameters, whose reference the controller follows."""
VOLTAGES = Variant("voltages put out", voltages=True)
"""Variant in which the planner's motor voltages are applied, as in MPC 2021, (20)."""


@dataclass(frozen=True)
class MpcCase:
    """A scene with the settings in which the planner drives through it.

    Attributes:
        about: Description for the headline.
        scene: Function that creates the scene.
        variants: Function that returns the settings (variants) to drive with, given the robot's
            parameters by full name.
        quick: Number of variants in a quick run.
        layout: Number of snapshots and number of columns of the picture.
    """

    about: str
    scene: Callable[[], Scene]
    variants: Callable[[Mapping[str, Any]], Sequence[Variant]]
    quick: int = 2
    layout: tuple[int, int] = (5, 3)


def _defaults_and_paper(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return (DEFAULTS, VOLTAGES, PAPER_VARIANT)


def _all_variants(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return variants(robot)


def _defaults_only(robot: Mapping[str, Any]) -> Sequence[Variant]:
    return (DEFAULTS, VOLTAGES)


CASES = {
    "free": MpcCase(
        "a straight line without obstacles, MPC 2021, 4.1", SCENES["free"], _all_variants
    ),
    "corridor": MpcCase(
        "gaps between circles narrower than the robot is long, MPC 2021, 4.2",
        SCENES["corridor"],
        _defaults_and_paper,
    ),
    "moving": MpcCase(
        "circles that cross the path, one of which changes its velocity, MPC 2021, 4.3",
        SCENES["moving"],
        _defaults_and_paper,
        layout=(7, 4),
    ),
    "workshop": MpcCase(
        "a dead end and three doors, with a map", workshop, _defaults_only, quick=1
    ),
}
"""Cases by the name of their experiment."""


def run(args: argparse.Namespace) -> int:
    """Run a case.

    Args:
        args: Parsed command line.

    Returns:
        1 if a drive with default parameters missed its goal or had a contact, else 0.
    """
    case = CASES[args.name]
    robot, scene = load_robot(args.robot), case.scene()
    started = time.monotonic()
    progress = Progress()
    where = f", in the physics world on wheels '{args.world}'" if args.world else ""
    progress.headline(f"{case.about}, robot '{args.robot}'{where}")
    selected = case.variants(robot)
    selected = selected[: case.quick] if args.quick else selected
    generator = (_drive(robot, scene, variant, args.seed, args.world) for variant in selected)
    driven = collect(progress, "drives", generator, len(selected), "drives")
    rows = [
        drive_row(variant, planned, robot)
        for variant, planned in zip(selected, driven, strict=True)
    ]
    # Variants with changed parameters, such as the paper's, are reported but may fail.
    passed = all(row["reached"] and not row["collided"] for row in rows if row["counts"])
    result: dict[str, Any] = {
        "case": args.name,
        "robot": args.robot,
        "world": args.world,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "passed": passed,
        "defaults": dict(scene.changes),
        "observation_noise_m": scene.noise,
        "drives": rows,
    }
    if args.name == "free":
        result["energy"] = measure_energies(args, robot, progress)
        result["energy_until"] = f"{SETTLING_TIME:g} s after the arrival"
    progress.begin("picture")
    stem = result_name(args.name, args.world)
    files = Path(args.results)
    result |= draw_case(build(Robot, robot), scene, driven[0], result, files, stem)
    progress.end("done" if result["picture"] else "no matplotlib")
    publish(stem, result, report, started, args.results)
    return 0 if passed else 1


def _drive(
    robot: Mapping[str, Any], scene: Scene, variant: Variant, seed: int, wheels: str | None
) -> PlannedDrive:
    """Drive one variant; the CPU time of the planner is measured."""
    changed_scene = replace(scene, changes={**scene.changes, **variant.planner})
    changed_robot = {**robot, **variant.robot}
    timer = time.process_time
    return drive_with_planner(changed_robot, changed_scene, variant.voltages, seed, timer, wheels)


def drive_row(variant: Variant, planned: PlannedDrive, robot: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a drive for the JSON.

    The drive `counts` for the verdict of the case if no parameter was changed.

    Args:
        variant: Setting in which the case was driven.
        planned: The drive.
        robot: Unchanged parameters of the robot, full names to values.
    """
    changes = {**variant.robot, **variant.planner}
    return {
        "about": variant.about,
        "changes": changes,
        "counts": not changes,
        "voltages": variant.voltages,
        **planned.figures(),
        **diagonal_figures(planned.drive, build(Robot, robot)),
        "backwards_share": backward_share(planned.drive),
    }


def backward_share(drive: Drive) -> float:
    """Return the fraction of the time in motion during which the robot travels backwards [-].

    Backwards means more than 90 degrees from its x axis.
    """
    _, angles = drive.travel_directions()
    return float(np.mean(np.abs(angles) > 0.5 * math.pi)) if len(angles) else 0.0


def draw_case(
    robot: Robot,
    scene: Scene,
    planned: PlannedDrive,
    result: dict[str, Any],
    folder: Path,
    stem: str,
) -> dict[str, str | None]:
    """Draw a case as a PNG file, and `moving` also as an animated GIF.

    Args:
        robot: The robot.
        scene: The scene of the case.
        planned: The drive to draw.
        result: The result, for its energies.
        folder: Folder of the files.
        stem: Name of the files without a suffix.

    Returns:
        Paths of the `picture` and the `film`; None for a file that was not written, and for both
        if matplotlib is not installed.
    """
    try:
        from omniman_ros.lab.figures import mpc as mpc_picture
    except ImportError:
        return {"picture": None, "film": None}
    name = scene.name
    path, film = folder / f"{stem}.png", folder / f"{stem}.gif"
    if name == "free":
        mpc_picture.draw_free(robot, scene, planned, result, path)
    elif name == "workshop":
        mpc_picture.draw_trail(robot, scene, planned, path)
    else:
        mpc_picture.draw_case(robot, scene, planned, path, *CASES[name].layout)
    if name == "moving":
        mpc_picture.animate(robot, scene, planned, film)
    return {"picture": str(path), "film": str(film) if name == "moving" else None}


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal."""
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
            "tracking error",
        )
    ]
    rows += [_drive_cells(row) for row in result["drives"]]
    lines = ["", *table(rows)]
    if result["case"] == "free":
        lines += ["", *_diagonal_lines(result["drives"])]
        lines += ["", *energy_lines(result)]
    failed = [row["about"] for row in result["drives"] if not row["reached"] or row["collided"]]
    passed = verdict(result["passed"], "passed", "FAILED")
    names = f" (goal missed or contact: {', '.join(failed)})" if failed else ""
    lines += ["", f"Goal reached without contact, with the defaults: {passed}{names}"]
    for label, path in (("Picture", result["picture"]), ("Film", result["film"])):
        if path:
            lines.append(f"{label}: {path}")
    return lines


def _drive_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        row["about"],
        "CONTACT" if row["collided"] else "yes" if row["reached"] else row["state"],
        format_quantity(row["time_s"], "s", 2),
        format_quantity(row["energy_j"], "J", 0),
        format_quantity(1e3 * row["clearance_m"], "mm", 0),
        f"{row['plans_used']} of {row['cycles']}",
        f"{row['brakings']}",
        format_quantity(row["cpu_median_ms"], "ms", 1),
        format_quantity(row["cpu_p99_ms"], "ms", 1),
        format_quantity(1e3 * row["tracking_m"], "mm", 0),
    )


def _diagonal_lines(drives: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the table that shows how closely each drive kept to a roller diagonal."""
    rows: list[tuple[str, ...]] = [
        ("", "along a diagonal", "of the time", "smallest angle", "at", "largest turn")
    ]
    for row in drives:
        rows.append(
            (
                row["about"],
                "yes" if row["along_diagonal"] else "no",
                f"{100 * row['share']:.0f} %",
                format_quantity(math.degrees(row["nearest_rad"]), "deg", 0),
                format_quantity(row["nearest_s"], "s", 1),
                format_quantity(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    limit = math.degrees(NEAR_DIAGONAL)
    return [f"Direction of travel within {limit:.0f} deg of a roller diagonal:", *table(rows)]
