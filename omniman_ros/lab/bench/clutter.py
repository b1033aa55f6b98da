"""`omniman bench clutter`: the planner in worlds of BARN's kind, map known or by scanner alone.

The physics world judges contact, and times are CPU times of the planner's cycles.
"""

import argparse
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.extras import TRACKING, WORLD
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.bench.planning_sweep import cycle_figures, sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot

if TYPE_CHECKING:  # The command line must do without the planner.
    from omniman_ros.lab.studies.clutter import ClutterRun

WORLDS, QUICK_WORLDS = 300, 2  # number of worlds, one drive each, and with `--quick`
SCORE_AIM = 0.49  # aim: least mean score by scanner alone, at the size of a Jackal
TIME_AIM = 6.5  # aim: largest mean time of those drives [s]
AIMED = "jackal_size scanner"  # name of the drives that the aims are about
SENSES = ("known", "scanner")  # what the robot knows: the map, or what its scanner has seen


def figures(runs: Sequence["ClutterRun"]) -> dict[str, Any]:
    """Return the figures of drives."""
    times = [run.seconds for run in runs if run.reached]
    return {
        "worlds": len(runs),
        "reached": len(times),
        "contacts": sum(bool(run.touched) for run in runs),
        "score": sum(run.score for run in runs) / len(runs),
        "mean_time_s": sum(times) / len(times) if times else None,
        "failed_seeds": [run.seed for run in runs if not run.reached],
        "cycle_ms": cycle_figures([run.cycle_times for run in runs]),
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench clutter`; return 0, the exit code of a successful measurement."""
    for extra in (WORLD, TRACKING):
        if not extra.is_available:
            raise CommandError(extra.hint)
    # The command line must do without the engine.
    from omniman_ros.lab.studies.clutter import (
        GOAL_RADIUS,
        JACKAL_SIZE,
        TIME_LIMIT,
        drive_clutter,
    )

    worlds = args.worlds or (QUICK_WORLDS if args.quick else WORLDS)
    jobs = args.jobs or os.cpu_count() or 1
    robot = dict(load_robot(resolve_robot("ig42")))
    robots = {"jackal_size": {**robot, **JACKAL_SIZE}, "ig42": robot}
    senses = [args.sense] if args.sense else SENSES
    result: dict[str, Any] = {
        "quick": args.quick,
        "conditions": {
            "first_seed": args.seed,
            "goal_radius_m": GOAL_RADIUS,
            "time_limit_s": TIME_LIMIT,
            "trials": 1,
            "jobs": jobs,
        },
        "drives": {},
    }
    for name, values in robots.items():
        for sense in senses:
            say(f"{name}, {sense}, {worlds} worlds ...")
            seeds = range(args.seed, args.seed + worlds)
            tasks = [(values, seed, sense == "scanner") for seed in seeds]
            result["drives"][f"{name} {sense}"] = figures(sweep(drive_clutter, tasks, jobs))
    return conclude("clutter", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool | None]:
    """Return whether each aim was met, None where those drives were left out."""
    found = result["drives"].get(AIMED)
    if found is None:
        return dict.fromkeys(("reached", "contacts", "score", "time"))
    return {
        "reached": found["reached"] == found["worlds"],
        "contacts": found["contacts"] == 0,
        "score": found["score"] >= SCORE_AIM,
        "time": found["mean_time_s"] is not None and found["mean_time_s"] <= TIME_AIM,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    head = ("", "reached", "contacts", "score", "mean time", "CPU of a cycle: median, p99, max")
    rows: Rows = [head]
    for name, found in result["drives"].items():
        cpu, mean = found["cycle_ms"], found["mean_time_s"]
        rows.append(
            (
                name,
                f"{found['reached']} of {found['worlds']}",
                f"{found['contacts']}",
                f"{found['score']:.3f}",
                "-" if mean is None else f"{mean:.2f} s",
                f"{cpu['median']:.0f}, {cpu['p99']:.0f}, {cpu['max']:.0f} ms",
            )
        )
    met = {key: verdict(good) for key, good in result["aims"].items() if good is not None}
    aimed: Rows = [
        (f"aim, {AIMED}", ""),
        *((f"{key}{_AIM_TEXTS[key]}", text) for key, text in met.items()),
    ]
    return tables(rows, aimed) if met else tables(rows)


_AIM_TEXTS = {
    "reached": ": all",
    "contacts": ": none",
    "score": f": {SCORE_AIM:g}",
    "time": f": {TIME_AIM:g} s",
}
"""What each aim asks for."""
