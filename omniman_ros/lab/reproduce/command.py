"""`omniman reproduce NAME`: runs one or all of the papers' experiments in simulation."""

import argparse
import importlib

from omniman_ros.console.errors import CommandError
from omniman_ros.extras import WORLD
from omniman_ros.lab.reproduce.experiments import ARM_ROBOT, EXPERIMENTS, SCENES_OPTIONS


def run(args: argparse.Namespace) -> int:
    """Run `omniman reproduce`.

    Args:
        args: Parsed command line.

    Returns:
        0 if the experiment passed, else 1. A case of MPC 2021 or the workshop fails if a drive
        with default parameters misses its goal or touches an obstacle; `scenes` and `tool_path`
        fail if an aim is missed; `coupling` never fails; `all` fails if an experiment fails.

    Raises:
        CommandError: An option is invalid, or the experiment cannot run.
    """
    if args.seed < 0:
        raise CommandError(f"--seed must be 0 or more, got {args.seed}", code=2)
    has_arm = bool(getattr(args, "arm", None))
    if has_arm and args.name != "scenes":
        raise CommandError("--arm is an option of scenes only", code=2)
    if (args.world or has_arm) and not WORLD.is_available:
        raise CommandError(WORLD.hint)
    if args.name == "all":
        return _run("omniman_ros.lab.reproduce.all_experiments", args)
    if getattr(args, "reuse", False):
        raise CommandError("--reuse is an option of all only", code=2)
    given = [name for name in SCENES_OPTIONS if getattr(args, name, None) is not None]
    if given and args.name != "scenes":
        option = given[0].replace("_", "-")
        raise CommandError(f"--{option} is an option of scenes only", code=2)
    experiment = EXPERIMENTS[args.name]
    if args.world and not experiment.in_world:
        names = ", ".join(name for name, entry in EXPERIMENTS.items() if entry.in_world)
        raise CommandError(f"--world is an option of {names} and all only", code=2)
    args.robot = args.robot or (ARM_ROBOT if has_arm else experiment.robot)
    return _run(experiment.module, args)


def _run(module: str, args: argparse.Namespace) -> int:
    code: int = importlib.import_module(module).run(args)
    return code
