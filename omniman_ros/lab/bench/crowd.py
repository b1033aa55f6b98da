"""`omniman bench crowd`: the planner among discs that cross a square, giving way or not.

The drives are in simulated time on the plant; times are CPU times of the planner's cycles.
"""

import argparse
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.bench.planning_sweep import cycle_figures, sweep
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot

if TYPE_CHECKING:  # The command line must do without the planner.
    from omniman_ros.lab.studies.crowd import CrowdRun

CROWDS, QUICK_CROWDS = 6, 1  # number of crowds of each kind, and with `--quick`
SECONDS, QUICK_SECONDS = 60.0, 10.0  # simulated duration of a drive, and with `--quick` [s]
DISCS = 20  # number of discs
P99_AIM = 40.0  # aim: largest 99th percentile of the CPU time of a cycle [ms]
KINDS = {"crossing": False, "giving way": True}  # kinds of crowds, and whether they give way


def figures(runs: Sequence["CrowdRun"]) -> dict[str, Any]:
    """Return the figures of drives."""
    minutes = sum(run.seconds for run in runs) / 60.0
    goals = sum(run.goals for run in runs)
    return {
        "crowds": len(runs),
        "minutes": minutes,
        "goals": goals,
        "goals_per_minute": goals / minutes,
        "contacts": sum(run.contacts for run in runs),
        "contacts_at_rest": sum(run.contacts_at_rest for run in runs),
        "cycle_ms": cycle_figures([run.cycle_times for run in runs]),
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench crowd`; return 0, the exit code of a successful measurement."""
    # The command line must do without the planner.
    from omniman_ros.lab.studies.crowd import HALF, RADIUS, SPEEDS, drive_in_crowd

    crowds = args.worlds or (QUICK_CROWDS if args.quick else CROWDS)
    seconds = QUICK_SECONDS if args.quick else SECONDS
    jobs = args.jobs or os.cpu_count() or 1
    robot = dict(load_robot(resolve_robot("ig42")))
    result: dict[str, Any] = {
        "quick": args.quick,
        "conditions": {
            "robot": "ig42",
            "discs": DISCS,
            "edge_m": 2.0 * HALF,
            "disc_radius_m": RADIUS,
            "disc_speeds_m_s": SPEEDS,
            "seconds": seconds,
            "first_seed": args.seed,
            "jobs": jobs,
        },
        "crowds": {},
    }
    for name, gives_way in KINDS.items():
        say(f"{name}, {crowds} crowds of {DISCS} ...")
        seeds = range(args.seed, args.seed + crowds)
        tasks = [(robot, seed, gives_way, seconds, DISCS) for seed in seeds]
        result["crowds"][name] = figures(sweep(drive_in_crowd, tasks, jobs))
    return conclude("crowd", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    found = result["crowds"].values()
    return {
        "contacts": not any(each["contacts"] for each in found),
        "cpu": all(each["cycle_ms"]["p99"] <= P99_AIM for each in found),
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [
        ("", "goals per minute", "contacts", "at rest", "CPU of a cycle: median, p99, max")
    ]
    for name, found in result["crowds"].items():
        cpu = found["cycle_ms"]
        rows.append(
            (
                name,
                f"{found['goals_per_minute']:.1f}",
                f"{found['contacts']}",
                f"{found['contacts_at_rest']}",
                f"{cpu['median']:.0f}, {cpu['p99']:.0f}, {cpu['max']:.0f} ms",
            )
        )
    met = result["aims"]
    aimed: Rows = [
        ("aim", ""),
        ("no contact while the robot moves", verdict(met["contacts"])),
        (f"p99 of {P99_AIM:g} ms", verdict(met["cpu"])),
    ]
    return tables(rows, aimed)
