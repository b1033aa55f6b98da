"""Arguments of the commands that record a drive and plot it."""

import argparse

from omniman_ros.cli.arguments.common import add_namespace, add_parameters, add_results, add_robot


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


def add_replay(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman replay`."""
    parser.add_argument("bag", help="folder of a recording of `omniman record` or `ros2 bag`")
    add_namespace(parser, "namespace of the robot, if the recording contains several robots")


def add_film(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman film`."""
    parser.add_argument("bag", help="folder of a recording of `omniman record` or `ros2 bag`")
    parser.add_argument(
        "--output", metavar="FILE", help="animated WebP file; default: RECORDING.webp"
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=25.0,
        metavar="SECONDS",
        help="longest length of the film; a longer drive is shown faster; default: %(default)g",
    )
    parser.add_argument(
        "--size",
        type=float,
        default=4.0,
        metavar="MB",
        help="largest size of the file; the quality is chosen so; default: %(default)g",
    )
    parser.add_argument(
        "--width", type=int, default=800, metavar="PX", help="width, at 16:9; default: %(default)s"
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=12.0,
        metavar="HZ",
        help="frames per second; default: %(default)g",
    )
    add_robot(parser)
    add_parameters(parser)
    parser.add_argument("--params-file", metavar="FILE", help="a ROS parameter file for all nodes")
    add_namespace(parser, "namespace of the robot, if the recording contains several robots")
