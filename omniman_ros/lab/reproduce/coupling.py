"""`omniman reproduce coupling`: the coupling error along the path of CCTA 2017, Fig. 7.

The path is driven with random wheels, with and without coupling control, over a range of gains,
and with the paper's controller as its equations are printed. Step responses with late commands, on
blocks and on the floor, show what a high gain costs. With `--world`, see
:mod:`omniman_ros.lab.reproduce.coupling_world`.
"""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import table
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.reproduce import coupling_world
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.coupling import (
    MISMATCH_SPREAD,
    OWN_CONTROLLER,
    PAPER_CONTROLLER,
    SMOOTHING_WINDOW,
    Run,
    Setup,
)
from omniman_ros.lab.studies.coupling_sweep import (
    AIM,
    FULL,
    PAPER_GAIN,
    QUICK,
    STANDARD,
    Plan,
    cases,
    printed_gain,
    responses,
    stability,
    step_grid,
    summary,
    sweep,
)
from omniman_ros.lab.verdicts import verdict
from omniman_ros.motion.figure7 import Figure7, movements
from omniman_ros.robots import load_robot

NAME = "reproduce_coupling"
"""Name of the results, without a suffix."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce coupling`.

    Args:
        args: Parsed command line.

    Returns:
        0, whether or not the aim is met.
    """
    if args.world:
        return coupling_world.run(args)
    plan = QUICK if args.quick else FULL if args.full else STANDARD
    robot = load_robot(args.robot)
    own_gain = build(PlatformParameters, robot).coupling.k_epsilon
    setup = Setup(robot, plan.figure)
    selected = cases(plan, robot, own_gain, args.seed)
    started = time.monotonic()
    progress = Progress()
    progress.headline(
        f"Coupling control along the path of CCTA 2017, Fig. 7: {len(selected)} drives of "
        f"{plan.figure.duration:.0f} s each, robot '{args.robot}'"
    )
    workers = os.cpu_count() or 1
    generator = sweep(setup, selected, workers)
    runs = collect(progress, "drives", generator, len(selected), "drives")
    grid = step_grid(plan, robot, own_gain)
    measured = responses(robot, grid, workers)
    steps = collect(progress, "late commands", measured, len(grid), "step responses")
    rows = summary(runs)
    as_printed = printed_gain(robot)
    named = [gain for gain in (PAPER_GAIN, own_gain, as_printed) if gain]
    result = {
        "robot": args.robot,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "paper_gain": PAPER_GAIN,
        "printed_gain": as_printed,
        "chosen_gain": own_gain,
        "samples": plan.samples,
        "spread": MISMATCH_SPREAD,
        "noise_window_s": SMOOTHING_WINDOW,
        "path": describe_path(plan),
        "table": rows,
        "uncontrolled_rad": movement_peaks(plan.figure, runs),
        "late_commands": [
            {
                "k": step.gain,
                "delay_s": step.delay,
                "lifted": step.lifted,
                "overshoot": step.overshoot,
                "swing": step.swing,
                "settled": step.settled,
            }
            for step in steps
        ],
        "stability": stability(robot, steps, named),
        "aim": {
            "ratio": AIM,
            "reached": remaining_ratio(rows, own_gain),
            "met": remaining_ratio(rows, own_gain) <= AIM,
        },
    }
    picture = draw(build(Robot, robot), plan, runs, result, Path(args.results))
    result["picture"] = picture and str(picture)
    publish(NAME, result, report, started, args.results)
    return 0


def describe_path(plan: Plan) -> dict[str, Any]:
    """Return the properties of the path for the JSON; all drives follow the same path."""
    figure = plan.figure
    return {
        "line_m": figure.length,
        "speed_m_s": figure.law.speed,
        "duration_s": figure.duration,
        "travel_m": sum(movement.length for movement in movements(figure.length)),
        "movements": [movement.name for movement in movements(figure.length)],
    }


def movement_peaks(figure: Figure7, runs: Sequence[Run]) -> dict[str, float]:
    """Return the largest change of the coupling error in each movement without control [rad].

    The change is taken relative to the start of the movement, and averaged over the drives of
    group P without coupling control.

    Args:
        figure: The path in time.
        runs: The drives.

    Returns:
        The changes by the name of the movement; empty if there are no such drives.
    """
    uncontrolled = [run for run in runs if run.case.group == "P" and run.case.gain == 0.0]
    if not uncontrolled:
        return {}
    peaks = {}
    for leg, movement in zip(figure.legs(0.0), movements(figure.length), strict=True):
        first, last = leg.begin, leg.begin + figure.law.duration(movement.length)
        changes = []
        for run in uncontrolled:
            inside = (run.time >= first) & (run.time <= last)
            epsilon = run.epsilon[inside]
            changes.append(float(np.abs(epsilon - epsilon[:1]).max(initial=0.0)))
        peaks[leg.name] = float(np.mean(changes))
    return peaks


def remaining_ratio(rows: Sequence[dict[str, Any]], gain: float) -> float:
    """Return the mean ratio of max |epsilon| at a gain [1/s] to that without control, P loops.

    The controller is this package's.
    """
    key = ("P", OWN_CONTROLLER, gain)
    row = next(row for row in rows if (row["group"], row["controller"], row["k"]) == key)
    ratio: float = row["epsilon_ratio"]["mean"]
    return ratio


def draw(
    robot: Robot, plan: Plan, runs: Sequence[Run], result: dict[str, Any], folder: Path
) -> Path | None:
    """Draw the study as a PNG file; return its path, or None if matplotlib is not installed."""
    try:
        from omniman_ros.lab.figures import coupling as coupling_picture
    except ImportError:
        return None
    path = folder / f"{NAME}.png"
    coupling_picture.draw(robot, plan.figure, runs, result, path)
    return path


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on the terminal.

    Unless noted otherwise, values are means over the sets of random wheels.
    """
    lines = []
    groups = dict.fromkeys((row["group"], row["about"]) for row in result["table"])
    for group, about in groups:
        rows: list[tuple[str, ...]] = [
            (
                "k [1/s]",
                "max |eps|",
                "RMS",
                "ratio to off",
                "worst",
                "slip loss",
                "energy",
                "speed noise",
                "command noise",
                "odom error, end",
                "max",
            )
        ]
        for row in result["table"]:
            if row["group"] == group:
                rows.append(_cells(row, result["printed_gain"]))
        lines += ["", f"{about}, mean of {result['samples']} sets of wheels:", *table(rows)]
    lines += [
        "(paper: its controller, which is never reset and has no bound, with J_a corrected; "
        "as printed: with (18) as it is printed)"
    ]
    for lifted, where in ((True, "off"), (False, "on")):
        lines += [
            "",
            f"Overshoot after a step of epsilon, wheels {where} the floor, by delay of commands:",
            *_step_table([step for step in result["late_commands"] if step["lifted"] is lifted]),
        ]
    lines += ["", *_stability_lines(result["stability"])]
    aim = result["aim"]
    outcome = verdict(aim["met"])
    lines += [
        "",
        f"max |eps| at k = {result['chosen_gain']:g} in relation to that without control: "
        f"{aim['reached']:.3f}, aim at most {aim['ratio']:g}: {outcome}",
    ]
    if result["picture"]:
        lines += [f"Picture: {result['picture']}"]
    return lines


def _step_table(steps: Sequence[dict[str, Any]]) -> list[str]:
    """Return the table of the overshoot by gain and delay."""
    cells = {
        (step["k"], step["delay_s"]): f"{100 * step['overshoot']:.0f} %"
        if step["settled"]
        else "oscillates"
        for step in steps
    }
    gains, delays = (sorted({key[i] for key in cells}) for i in range(2))
    rows = [("k [1/s]", *(f"{1e3 * delay:g} ms" for delay in delays))]
    rows += [(f"{gain:.3g}", *(cells[gain, delay] for delay in delays)) for gain in gains]
    return table(rows)


def _stability_lines(found: dict[str, Any]) -> list[str]:
    """Return the delay margins, computed and measured, wheels off the floor."""

    def cell(seconds: float | None) -> str:
        return "none" if seconds is None else f"{1e3 * seconds:.0f} ms"

    rows: list[tuple[str, ...]] = [("k [1/s]", "computed", "measured: settles", "oscillates")]
    rows += [
        (
            f"{row['k']:.3g}",
            cell(row["computed_s"]),
            cell(row["settles_s"]),
            cell(row["oscillates_s"]),
        )
        for row in found["margins"]
    ]
    return [
        "Longest delay of the commands without oscillation, wheels off the floor:",
        *table(rows),
        f"Computed and measured agree on {found['agree']} of {found['compared']} step responses.",
    ]


def _name(row: dict[str, Any], printed: float | None) -> str:
    """Return the name of a row: its gain, and whose controller it is if not this package's."""
    if row["controller"] == PAPER_CONTROLLER:
        as_printed = row["k"] == printed
        return f"{PAPER_GAIN:g}, as printed" if as_printed else f"{row['k']:g}, paper"
    return "off" if row["k"] == 0.0 else f"{row['k']:g}"


def _cells(row: dict[str, Any], printed: float | None) -> tuple[str, ...]:
    mean = {name: value["mean"] for name, value in row.items() if isinstance(value, dict)}
    return (
        _name(row, printed),
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
