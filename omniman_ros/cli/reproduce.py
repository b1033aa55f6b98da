"""`omniman reproduce`: the papers' experiments on the simulated robot.

`coupling` is CCTA 2017, Fig. 7; `free`, `corridor` and `moving` are the cases of MPC 2021;
`workshop` has a map, `scenes` are random ones that the planner's node is driven through;
`tool_path` has platform and arm in step, CCTA 2017 V.A; `all` is all of them, and a report.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.cli import reproduce_all, reproduce_tool_path, results
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.core.parameters import build
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.robot import Robot
from omniman_ros.robots import load_robot
from omniman_ros.studies.coupling import SMOOTHING, SPREAD, Run, Setup
from omniman_ros.studies.coupling_sweep import (
    AIM,
    FULL,
    PAPER_GAIN,
    QUICK,
    STANDARD,
    Plan,
    cases,
    responses,
    summary,
    sweep,
)
from omniman_ros.studies.figure7 import Figure7, movements
from omniman_ros.studies.mpc_cases import (
    NEAR_DIAGONAL,
    PAPER,
    SCENES,
    SETTLE,
    Comparison,
    Drive,
    Planned,
    Scene,
    StudyError,
    Variant,
    compare,
    goals,
    planned,
    slant_figures,
    variants,
)
from omniman_ros.studies.workshop import workshop

NAME = "reproduce_coupling"
ROBOTS = {
    "coupling": "omniman", "free": "ig42", "corridor": "ig42", "moving": "ig42",
    "workshop": "ig42", "scenes": "ig42", "tool_path": "omniman",
}  # fmt: skip
"""The robot of each experiment, where none is named."""
OF_SCENES = ("count", "seeds", "jobs", "solve_time")
"""Options that only the scenes have."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce`.

    Returns:
        0; of an MPC case 1 if a drive did not reach its goal or touched an obstacle, of the scenes
        and the tool's paths if an aim was missed, of all if any of them did not return 0.
    """
    if args.seed < 0:
        raise CommandError(f"--seed must be 0 or more, got {args.seed}", code=2)
    if args.name == "all":
        return reproduce_all.run(args)
    if getattr(args, "reuse", False):
        raise CommandError("--reuse is of all only", code=2)
    args.robot = args.robot or ROBOTS[args.name]
    if args.name == "scenes":
        from omniman_ros.cli import scenes  # it imports rclpy

        return scenes.run(args)
    given = [name for name in OF_SCENES if getattr(args, name, None) is not None]
    if given:
        raise CommandError(f"--{given[0].replace('_', '-')} is of scenes only", code=2)
    if args.name == "tool_path":
        return reproduce_tool_path.run(args)
    return _coupling(args) if args.name == "coupling" else _case(args)


# ---- CCTA 2017 ----------------------------------------------------------------------------------


def _coupling(args: argparse.Namespace) -> int:
    plan = QUICK if args.quick else FULL if args.full else STANDARD
    robot = load_robot(args.robot)
    chosen = build(PlatformParameters, robot).coupling.k_epsilon
    setup = Setup(robot, plan.figure)
    todo = cases(plan, robot, chosen, args.seed)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"Coupling control along the path of CCTA 2017, Fig. 7: {len(todo)} drives of "
        f"{plan.figure.duration:.0f} s each, robot '{args.robot}'"
    )
    progress.begin("drives")
    runs: list[Run] = []
    for driven in sweep(setup, todo, os.cpu_count() or 1):
        runs.append(driven)
        progress.update(len(runs) / len(todo), f"{len(runs)} of {len(todo)}")
    progress.end(f"{len(runs)} drives")
    progress.begin("late commands")
    steps = responses(plan, robot, chosen)
    progress.end(f"{len(steps)} steps on blocks")
    rows = summary(runs)
    result = {
        "robot": args.robot, "quick": args.quick, "full": args.full, "seed": args.seed,
        "paper_gain": PAPER_GAIN, "chosen_gain": chosen, "samples": plan.samples,
        "spread": SPREAD, "noise_window_s": SMOOTHING, "path": path_of(plan), "table": rows,
        "uncontrolled_rad": movement_peaks(plan.figure, runs),
        "late_commands": [
            {"k": step.gain, "delay_s": step.delay, "overshoot": step.overshoot,
             "swing": step.swing, "settled": step.settled}
            for step in steps
        ],
        "aim": {"ratio": AIM, "reached": reached(rows, chosen),
                "met": reached(rows, chosen) <= AIM},
    }  # fmt: skip
    picture = draw(build(Robot, robot), plan, runs, result, Path(args.results))
    result["picture"] = picture and str(picture)
    result["took_s"] = time.monotonic() - started
    say("\n".join(report(result)))
    results.publish(NAME, result, args.results)
    return 0


def path_of(plan: Plan) -> dict[str, Any]:
    """The path, which is the same for all drives."""
    figure = plan.figure
    return {
        "line_m": figure.length,
        "speed_m_s": figure.law.speed,
        "duration_s": figure.duration,
        "travel_m": sum(movement.length for movement in movements(figure.length)),
        "movements": [movement.name for movement in movements(figure.length)],
    }


def movement_peaks(figure: Figure7, runs: Sequence[Run]) -> dict[str, float]:
    """Largest change of epsilon [rad] within each movement, control off.

    From the begin of the movement on; mean over the wheels of group P. Empty without such drives.
    """
    off = [run for run in runs if run.case.group == "P" and run.case.gain == 0.0]
    if not off:
        return {}
    peaks = {}
    for leg, movement in zip(figure.legs(0.0), movements(figure.length), strict=True):
        first, last = leg.begin, leg.begin + figure.law.duration(movement.length)
        changes = []
        for run in off:
            inside = (run.time >= first) & (run.time <= last)
            epsilon = run.epsilon[inside]
            changes.append(float(np.abs(epsilon - epsilon[:1]).max(initial=0.0)))
        peaks[leg.name] = float(np.mean(changes))
    return peaks


def row_of(rows: Sequence[dict[str, Any]], group: str, gain: float) -> dict[str, Any]:
    """The row of a group and a gain."""
    return next(row for row in rows if (row["group"], row["k"]) == (group, gain))


def reached(rows: Sequence[dict[str, Any]], gain: float) -> float:
    """Mean over the wheels of max |epsilon| over that without control, P loops."""
    ratio: float = row_of(rows, "P", gain)["epsilon_ratio"]["mean"]
    return ratio


def draw(
    robot: Robot, plan: Plan, runs: Sequence[Run], result: dict[str, Any], folder: Path
) -> Path | None:
    """Draw the figure into a PNG file, where there is matplotlib."""
    try:
        from omniman_ros.cli import coupling_picture
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    coupling_picture.draw(robot, plan.figure, runs, result, path)
    return path


def report(result: dict[str, Any]) -> list[str]:
    """The tables at the end, means over the random wheels."""
    lines = []
    groups = dict.fromkeys((row["group"], row["about"]) for row in result["table"])
    for group, about in groups:
        rows: list[tuple[str, ...]] = [
            ("k [1/s]", "max |eps|", "RMS", "of off", "worst", "slip", "energy", "noise", "asked",
             "odom end", "max")
        ]  # fmt: skip
        for row in result["table"]:
            if row["group"] == group:
                rows.append(_cells(row))
        lines += ["", f"{about}, mean of {result['samples']}:", *table(rows)]
    lines += ["", "Step of epsilon with wheels off the floor, commands late by:"]
    delays = sorted({step["delay_s"] for step in result["late_commands"]})
    gains = sorted({step["k"] for step in result["late_commands"]})
    rows = [("k [1/s]", *(f"{1e3 * delay:g} ms" for delay in delays))]
    for gain in gains:
        rows.append((f"{gain:g}", *(_overshoot(result, gain, delay) for delay in delays)))
    lines += table(rows)
    aim = result["aim"]
    met = paint("met", GREEN, sys.stdout) if aim["met"] else paint("MISSED", RED, sys.stdout)
    lines += [
        "",
        f"max |eps| at k = {result['chosen_gain']:g} over that without control: "
        f"{aim['reached']:.3f}, aim {aim['ratio']:g}: {met}",
    ]
    if result["picture"]:
        lines += [f"Picture: {result['picture']}"]
    return lines


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    mean = {name: value["mean"] for name, value in row.items() if isinstance(value, dict)}
    return (
        "off" if row["k"] == 0.0 else f"{row['k']:g}",
        f"{mean['epsilon_max']:.3f} rad",
        f"{mean['epsilon_rms']:.3f}",
        f"{mean['epsilon_ratio']:.3f}",
        f"{row['epsilon_ratio']['worst']:.3f}",
        f"{mean['slip']:.2f} J",
        f"{mean['energy']:.0f} J",
        f"{1e3 * mean['speed_noise']:.1f}",
        f"{1e3 * mean['command_noise']:.1f} mrad/s",
        f"{1e3 * mean['odometry_end']:.2f}",
        f"{1e3 * mean['odometry_max']:.2f} mm",
    )


def _overshoot(result: dict[str, Any], gain: float, delay: float) -> str:
    (step,) = (
        step for step in result["late_commands"] if (step["k"], step["delay_s"]) == (gain, delay)
    )
    return f"{100 * step['overshoot']:.0f} %" if step["settled"] else "oscillates"


# ---- MPC 2021 -----------------------------------------------------------------------------------

CASES = {
    "free": "a straight way with nothing on it, MPC 2021, 4.1",
    "corridor": "circles closer together than the robot is long, MPC 2021, 4.2",
    "moving": "circles that cross the way, one of them changes its velocity, MPC 2021, 4.3",
    "workshop": "a dead end and three doors, with a map",
}
SITES = {**SCENES, "workshop": workshop}
SHOWN = {"corridor": (5, 3), "moving": (7, 4)}
"""Snapshots and columns of a picture."""


def _case(args: argparse.Namespace) -> int:
    robot, scene = load_robot(args.robot), SITES[args.name]()
    started = time.monotonic()
    progress = Progress()
    progress.headline(f"{CASES[args.name]}, robot '{args.robot}'")
    ways = _ways(args, robot)
    rides: list[Planned] = []
    progress.begin("drives")
    for way in ways:
        rides.append(_drive(robot, scene, way, args.seed))
        progress.update(len(rides) / len(ways), f"{len(rides)} of {len(ways)}")
    progress.end(f"{len(rides)} drives")
    drives = [drive_row(way, ride, robot) for way, ride in zip(ways, rides, strict=True)]
    # The paper's own setting is shown for what it is: it may fail.
    passed = all(row["reached"] and not row["collided"] for row in drives if row["counts"])
    result: dict[str, Any] = {
        "case": args.name, "robot": args.robot, "quick": args.quick, "full": args.full,
        "seed": args.seed, "passed": passed, "defaults": dict(scene.changes),
        "observation_noise_m": scene.noise, "drives": drives,
    }  # fmt: skip
    if args.name == "free":
        result["energy"] = _energies(args, robot, progress)
        result["energy_until"] = f"{SETTLE:g} s after the arrival"
    progress.begin("picture")
    result |= draw_case(build(Robot, robot), scene, rides[0], result, Path(args.results))
    progress.end("done" if result["picture"] else "no matplotlib")
    result["took_s"] = time.monotonic() - started
    say("\n".join(case_report(result)))
    results.publish(f"reproduce_{args.name}", result, args.results)
    return 0 if passed else 1


def _ways(args: argparse.Namespace, robot: Mapping[str, Any]) -> list[Variant]:
    if args.name == "free":
        ways = variants(robot)
        return ways[:2] if args.quick else ways
    ways = [Variant("defaults"), Variant("voltages put out", voltages=True)]
    if args.name == "workshop":
        return ways[:1] if args.quick else ways
    return ways if args.quick else [*ways, Variant("the paper's horizon and cost", planner=PAPER)]


def _drive(robot: Mapping[str, Any], scene: Scene, way: Variant, seed: int) -> Planned:
    changed = replace(scene, changes={**scene.changes, **way.planner})
    timer = time.process_time
    return planned({**robot, **way.robot}, changed, way.voltages, seed, timer)


def drive_row(way: Variant, ride: Planned, robot: Mapping[str, Any]) -> dict[str, Any]:
    """What is published of a drive; it counts where no parameter was changed for the show."""
    changes = {**way.robot, **way.planner}
    return {
        "about": way.about,
        "changes": changes,
        "counts": not changes,
        "voltages": way.voltages,
        **ride.figures(),
        **slant_figures(ride.drive, build(Robot, robot)),
        "backwards_share": backwards(ride.drive),
    }


def backwards(drive: Drive) -> float:
    """Share of the time in motion in which the direction of travel is behind the robot's side."""
    _, angles = drive.slant()
    return float(np.mean(np.abs(angles) > 0.5 * math.pi)) if len(angles) else 0.0


def _energies(
    args: argparse.Namespace, robot: Mapping[str, Any], progress: Progress
) -> list[dict[str, Any]]:
    """The table of energies; one row failing is told in it and ends nothing."""
    todo = [goal for goal in goals(args.full) if not args.quick or goal == (1.0, 0.0)]
    rows: list[dict[str, Any]] = []
    progress.begin("energy")
    with ProcessPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        for row in pool.map(partial(energy_row, dict(robot), args.full), todo):
            rows.append(row)
            progress.update(len(rows) / len(todo), f"{len(rows)} of {len(todo)}")
    progress.end(f"{len(rows)} goals, each at the arrival time of the planner")
    return rows


def energy_row(robot: Mapping[str, Any], both: bool, goal: tuple[float, float]) -> dict[str, Any]:
    """Energies to a goal at a distance [m] and bearing [rad], by planner and straight lines."""
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


def draw_case(
    robot: Robot, scene: Scene, ride: Planned, result: dict[str, Any], folder: Path
) -> dict[str, str | None]:
    """Draw a case into a PNG file, and a GIF where something moves, if there is matplotlib."""
    try:
        from omniman_ros.cli import mpc_picture
    except ImportError:
        return {"picture": None, "film": None}
    name = scene.name
    path, film = folder / f"reproduce_{name}.png", folder / f"reproduce_{name}.gif"
    if name == "free":
        mpc_picture.draw_free(robot, scene, ride, result, path)
    elif name == "workshop":
        mpc_picture.draw_trail(robot, scene, ride, path)
    else:
        mpc_picture.draw_case(robot, scene, ride, path, *SHOWN[name])
    if name == "moving":
        mpc_picture.animate(robot, scene, ride, film)
    return {"picture": str(path), "film": str(film) if name == "moving" else None}


def case_report(result: Mapping[str, Any]) -> list[str]:
    """The tables at the end."""
    rows: list[tuple[str, ...]] = [
        ("", "reached", "time", "energy", "least gap", "plans used", "braked", "CPU median",
         "p99", "off path")
    ]  # fmt: skip
    rows += [_drive_cells(row) for row in result["drives"]]
    lines = ["", *table(rows)]
    if result["case"] == "free":
        lines += ["", *_slant_lines(result["drives"])]
        lines += ["", *_energy_lines(result)]
    failed = [row["about"] for row in result["drives"] if not row["reached"] or row["collided"]]
    passed = (
        paint("passed", GREEN, sys.stdout)
        if result["passed"]
        else paint("FAILED", RED, sys.stdout)
    )
    told = f" (not reached or touched: {', '.join(failed)})" if failed else ""
    lines += ["", f"Goal reached without contact, with the defaults: {passed}{told}"]
    for label, path in (("Picture", result["picture"]), ("Film", result["film"])):
        if path:
            lines.append(f"{label}: {path}")
    return lines


def _number(value: float, unit: str, digits: int) -> str:
    return f"{value:.{digits}f} {unit}" if math.isfinite(value) else "-"


def _drive_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        row["about"],
        "CONTACT" if row["collided"] else "yes" if row["reached"] else row["state"],
        _number(row["time_s"], "s", 2),
        _number(row["energy_j"], "J", 0),
        _number(1e3 * row["clearance_m"], "mm", 0),
        f"{row['plans_used']} of {row['cycles']}",
        f"{row['brakings']}",
        _number(row["cpu_median_ms"], "ms", 1),
        _number(row["cpu_p99_ms"], "ms", 1),
        _number(1e3 * row["tracking_m"], "mm", 0),
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
                _number(math.degrees(row["nearest_rad"]), "deg", 0),
                _number(row["nearest_s"], "s", 1),
                _number(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    limit = math.degrees(NEAR_DIAGONAL)
    return [f"Direction of travel within {limit:.0f} deg of a roller diagonal:", *table(rows)]


def _energy_lines(result: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ("goal", "arrival", "planner", "line, slower", "slower, softer", "ratio", "turned")
    ]  # fmt: skip
    for row in result["energy"]:
        rows.append(
            (
                f"{row['distance_m']:g} m at {row['bearing_deg']:g} deg",
                _number(row["arrival_s"], "s", 2),
                _number(row["energy_j"], "J", 1),
                _number(row["speed_only_j"], "J", 1),
                _number(row["all_limits_j"], "J", 1),
                _number(row["ratio"], "", 2).rstrip(),
                _number(math.degrees(row["peak_turn_rad"]), "deg", 0),
            )
        )
    faults = [row["fault"] for row in result["energy"] if row["fault"]]
    head = "Energy until rest at equal arrival times, planner and straight line:"
    return [head, *table(rows), *(f"  {fault}" for fault in faults)]
