"""Arguments that several commands share."""

import argparse
import textwrap
from collections.abc import Iterable, Sequence

from omniman_ros.processes.arm_options import ARMS
from omniman_ros.processes.drive_options import DRIVES

#: Help text of `--robot`, to which each command adds its default
ROBOT_HELP = "a robot of the package (omniman, ig42) or the path of its .yaml file"
HELP_WIDTH = 79  #: Longest line of a description in help
#: Help text of `--param` of commands that start nodes
PARAMETER_HELP = "a parameter, set on every node; may be repeated"


def add_examples(parser: argparse.ArgumentParser, examples: Iterable[str]) -> None:
    """End a parser's help with examples, each the arguments of a complete command line."""
    lines = [f"  omniman {example}\n" for example in examples]
    parser.formatter_class = argparse.RawDescriptionHelpFormatter  # which fills no lines
    parser.description = textwrap.fill(parser.description or "", HELP_WIDTH)
    parser.epilog = "examples:\n" + "".join(lines)


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add `--robot`, with omniman as the default."""
    parser.add_argument("--robot", default="omniman", help=f"{ROBOT_HELP}; default: omniman")


def add_namespace(parser: argparse.ArgumentParser, text: str) -> None:
    """Add `--namespace`."""
    parser.add_argument("--namespace", default="", metavar="NS", help=text)


def add_parameters(parser: argparse._ActionsContainer, text: str = PARAMETER_HELP) -> None:
    """Add `--param`, which may be repeated."""
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME:=VALUE", help=text
    )


def add_results(parser: argparse.ArgumentParser, content: str = "JSON file") -> None:
    """Add `--results`, the folder of the results, with its content in the help text."""
    parser.add_argument(
        "--results",
        default="results",
        metavar="FOLDER",
        help=f"folder of the {content}; default: %(default)s",
    )


def add_arm(parser: argparse.ArgumentParser, arms: Sequence[str]) -> None:
    """Add `--arm`."""
    kinds = "; ".join(f"{name}: {ARMS[name]}" for name in arms)
    parser.add_argument(
        "--arm",
        choices=arms,
        help=f"hardware or simulation of the arm; {kinds}; default: simulated, or none with real "
        "drives and "
        "in simulated time",
    )


def add_drive(parser: argparse.ArgumentParser, drives: Sequence[str]) -> None:
    """Add `--drive` and `--installation`."""
    kinds = "; ".join(f"{name}: {DRIVES[name]}" for name in drives)
    parser.add_argument(
        "--drive",
        choices=drives,
        default="simulated",
        help=f"drives of the wheels; {kinds}; default: %(default)s",
    )
    parser.add_argument(
        "--installation",
        default="cia402",
        metavar="NAME",
        help="drives on the bus: cia402, vesc, odrive or the path of a .yaml file; "
        "default: %(default)s",
    )
