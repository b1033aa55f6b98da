"""`omniman bench NAME` and `omniman reproduce NAME`: run what the registry names."""

import argparse
import importlib

from omniman_ros.console.errors import CommandError
from omniman_ros.extras import WORLD
from omniman_ros.lab.registry import BENCHMARKS, EXPERIMENTS


def run(args: argparse.Namespace) -> int:
    """Run a benchmark or an experiment.

    Returns:
        0 if the measurement succeeded, independent of the figures; 1 if a row of `faults` failed,
        an aim of `soak` was missed, or an experiment with a verdict of its own did not pass.
    """
    study = (BENCHMARKS if args.command == "bench" else EXPERIMENTS)[args.name]
    if getattr(args, "seed", 0) < 0:
        raise CommandError(f"--seed must be 0 or more, got {args.seed}", code=2)
    if getattr(args, "world", None) and not WORLD.is_available:
        raise CommandError(WORLD.hint)
    if study.robot is not None:
        args.robot = args.robot or study.robot
    code: int = importlib.import_module(f"omniman_ros.lab.{study.module}").run(args)
    return code
