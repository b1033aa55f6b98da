"""Entry point of the command `omniman`.

A command's own module, and rclpy and NumPy with it, is imported only when the command runs.
"""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from omniman_ros.cli.arguments.common import add_examples
from omniman_ros.cli.commands import COMMANDS
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say, write_output
from omniman_ros.core.errors import OmnimanError

DESCRIPTION = """\
Mobile manipulator on Mecanum or Omni wheels: start it, drive it, try it, measure it.
"""
EPILOG = """\
`omniman COMMAND --help` explains a command. Exit code 0: success; 1: failure, explained by the
last lines of output; 2: invalid command line; 130: ended by Ctrl-C.
"""


class VersionAction(argparse.Action):
    """Prints the version, which is looked up only if the option is given."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        """Print the version of the installed package and exit."""
        from importlib.metadata import PackageNotFoundError, version

        try:
            text = version("omniman_ros")
        except PackageNotFoundError:
            text = "(not installed, the version is in package.xml)"
        write_output(f"omniman {text}\n")
        parser.exit()


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        "omniman",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=VersionAction, nargs=0, help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        description = command.help[0].upper() + command.help[1:] + "."
        own = commands.add_parser(
            name, help=command.help, description=description, allow_abbrev=False
        )
        command.add_arguments(own)
        add_examples(own, command.examples)
    return parser


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer a shell that asks for the completions of a command line, and end then."""
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command of `omniman`, and return its exit code."""
    parser = make_parser()
    complete(parser)
    args = parser.parse_args(arguments)
    try:
        command = importlib.import_module(COMMANDS[args.command].module)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("omniman_ros"):
            raise
        say(
            f"error: Python module '{error.name}' is not installed.\n"
            "On a ROS 2 machine: source /opt/ros/jazzy/setup.bash first. Elsewhere: "
            "pip install 'omniman_ros[ros]', or use `make demo`.",
            sys.stderr,
        )
        return 1
    try:
        return int(command.run(args))
    except CommandError as error:
        say(f"error: {error}", sys.stderr)
        return error.code
    except OmnimanError as error:
        say(f"error: {error}", sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
