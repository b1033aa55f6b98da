"""Arguments of the commands that record a drive and plot it."""

import argparse

from omniman_ros.cli.arguments.common import add_namespace, add_results


def add_record(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman record`."""
    parser.add_argument(
        "topics",
        nargs="*",
        metavar="TOPIC",
        help="topics to record, named in the robot's namespace; default: all topics of the robot",
    )
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        help="folder of the recording; default: recording_DATE_TIME",
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="SECONDS",
        help="length of the recording; default: until Ctrl-C",
    )
    add_namespace(parser, "namespace of the robot; default: all robots")


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman plot`."""
    parser.add_argument("bag", help="folder of a recording of `omniman record` or `ros2 bag`")
    add_results(parser, "figures")
    parser.add_argument("--show", action="store_true", help="also open the figures")
    add_namespace(parser, "namespace of the robot, if the recording contains several robots")
