"""`omniman bench NAME`: the benchmarks, by name."""

import argparse
import importlib

BENCHMARKS = {
    "control": "omniman_ros.lab.bench.control",
    "path": "omniman_ros.lab.bench.path",
    "mpc": "omniman_ros.lab.bench.mpc",
    "can": "omniman_ros.lab.bench.can_bus",
    "arm": "omniman_ros.lab.bench.arm",
    "whole_body": "omniman_ros.lab.bench.whole_body",
}
"""Module of each benchmark, which is imported when it runs; its `run(args)` is the benchmark."""


def run(args: argparse.Namespace) -> int:
    """Run a benchmark.

    Args:
        args: Command line, with the benchmark's name.

    Returns:
        0 if it could be measured, whatever the figures.

    Raises:
        CommandError: It could not be measured.
    """
    code: int = importlib.import_module(BENCHMARKS[args.name]).run(args)
    return code
