"""`omniman reproduce coupling`: the coupling error along the path of CCTA 2017, Fig. 7.

The path is driven with random wheels, with and without coupling control, over a range of gains.
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
from omniman_ros.lab.reproduce.pipeline import collect, publish
from omniman_ros.lab.studies.coupling import MISMATCH_SPREAD, SMOOTHING_WINDOW, Run, Setup
from omniman_ros.lab.studies.coupling_sweep import (
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
    generator = sweep(setup, selected, os.cpu_count() or 1)
    runs = collect(progress, "drives", generator, len(selected), "drives")
    progress.begin("delayed commands")
    steps = responses(plan, robot, own_gain)
    progress.end(f"{len(steps)} step responses with the wheels off the floor")
    rows = summary(runs)
    result = {
        "robot": args.robot,
        "quick": args.quick,
        "full": args.full,
        "seed": args.seed,
        "paper_gain": PAPER_GAIN,
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
                "overshoot": step.overshoot,
                "swing": step.swing,
                "settled": step.settled,
            }
            for step in steps
        ],
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


def find_row(rows: Sequence[dict[str, Any]], group: str, gain: float) -> dict[str, Any]:
    """Return the row of the table for a group and a gain [1/s]."""
    return next(row for row in rows if (row["group"], row["k"]) == (group, gain))


def remaining_ratio(rows: Sequence[dict[str, Any]], gain: float) -> float:
    """Return the mean ratio of max |epsilon| at a gain [1/s] to that without control, P loops."""
    ratio: float = find_row(rows, "P", gain)["epsilon_ratio"]["mean"]
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
                rows.append(_cells(row))
        lines += ["", f"{about}, mean of {result['samples']} sets of wheels:", *table(rows)]
    lines += [
        "",
        "Overshoot after a step of epsilon, wheels off the floor, by delay of the commands:",
    ]
    delays = sorted({step["delay_s"] for step in result["late_commands"]})
    gains = sorted({step["k"] for step in result["late_commands"]})
    rows = [("k [1/s]", *(f"{1e3 * delay:g} ms" for delay in delays))]
    for gain in gains:
        rows.append((f"{gain:g}", *(_overshoot(result, gain, delay) for delay in delays)))
    lines += table(rows)
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
