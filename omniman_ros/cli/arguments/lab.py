"""Arguments of the laboratory's commands: `omniman bench`, `reproduce` and `fault`."""

import argparse
from collections.abc import Mapping

from omniman_ros.cli.arguments.common import (
    ROBOT_HELP,
    add_examples,
    add_namespace,
    add_parameters,
    add_results,
)
from omniman_ros.lab.registry import BENCHMARKS, EXPERIMENTS, Study

EFFORTS = {"quick": "take a few samples only, to see that it runs", "full": "measure more"}


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks of `omniman bench`, each with its options."""
    _add(parser, "bench", BENCHMARKS)


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Add the experiments of `omniman reproduce`, each with its options."""
    _add(parser, "reproduce", EXPERIMENTS)


def add_fault(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman fault`."""
    chosen = parser.add_mutually_exclusive_group(required=True)
    chosen.add_argument("name", nargs="?", metavar="NAME", help="name of the fault")
    chosen.add_argument("--list", action="store_true", help="list the faults, and inject none")
    parser.add_argument(
        "--duration",
        type=float,
        metavar="SECONDS",
        help="time after which the fault is removed; default: until Ctrl-C",
    )
    add_namespace(parser, "namespace of the robot")


def _add(parser: argparse.ArgumentParser, command: str, studies: Mapping[str, Study]) -> None:
    names = parser.add_subparsers(dest="name", metavar="NAME", required=True)
    for name, study in studies.items():
        text = study.about[0].upper() + study.about[1:] + "."
        own = names.add_parser(name, help=study.about, description=text, allow_abbrev=False)
        own.set_defaults(quick=False, full=False)
        effort = own.add_mutually_exclusive_group()
        for word in study.efforts:
            effort.add_argument(f"--{word}", action="store_true", help=EFFORTS[word])
        if study.robot is not None:
            own.add_argument("--robot", help=f"{ROBOT_HELP}; default: {study.robot}")
        add_results(own)
        for flag, settings in study.options:
            own.add_argument(flag, **settings)
        if study.parameters:
            add_parameters(own)
        run = f"{command} {name}"
        add_examples(own, (f"{run} --{study.efforts[0]}", f"{run} --results {name}_today"))
