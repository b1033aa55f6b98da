"""`omniman bench NAME`: runs the benchmark of that name."""

import argparse
import importlib

BENCHMARKS = {
    "control": "omniman_ros.lab.bench.control",
    "nodes": "omniman_ros.lab.bench.nodes",
    "participants": "omniman_ros.lab.bench.participants",
    "path": "omniman_ros.lab.bench.path",
    "mpc": "omniman_ros.lab.bench.mpc",
    "can": "omniman_ros.lab.bench.can_bus",
    "arm": "omniman_ros.lab.bench.arm",
    "whole_body": "omniman_ros.lab.bench.whole_body",
    "whole_body_obstacles": "omniman_ros.lab.bench.whole_body_obstacles",
    "world": "omniman_ros.lab.bench.world",
    "stability": "omniman_ros.lab.bench.stability",
    "collision": "omniman_ros.lab.bench.collision",
    "tracker": "omniman_ros.lab.bench.tracker",
    "clutter": "omniman_ros.lab.bench.clutter",
    "crowd": "omniman_ros.lab.bench.crowd",
    "faults": "omniman_ros.lab.bench.faults",
    "soak": "omniman_ros.lab.bench.soak",
}
"""Module of each benchmark, by name; it has a function `run(args)` and is imported on demand."""


def run(args: argparse.Namespace) -> int:
    """Run a benchmark.

    Args:
        args: Parsed command line; `name` is the name of the benchmark.

    Returns:
        0 if the measurement succeeded, independent of the figures; `faults` returns 1 if a row
        failed, `soak` if an aim was missed.

    Raises:
        CommandError: The measurement failed.
    """
    code: int = importlib.import_module(BENCHMARKS[args.name]).run(args)
    return code
