"""`omniman reproduce coupling`: the experiment of CCTA 2017, Fig. 7, on the simulated robot."""

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omniman_ros.cli import results
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
from omniman_ros.studies.figure7 import movements

NAME = "reproduce_coupling"


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce`; returns 0 if it could be measured, whatever the figures."""
    if args.seed < 0:
        raise CommandError(f"--seed must be 0 or more, got {args.seed}", code=2)
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
