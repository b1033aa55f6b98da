"""Arguments of the commands that move or stop a running robot."""

import argparse

from omniman_ros.cli.arguments.common import add_namespace


def add_teleop(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman teleop`."""
    parser.add_argument(
        "--linear", type=float, default=0.3, help="speed [m/s]; default: %(default)s"
    )
    parser.add_argument(
        "--angular", type=float, default=0.6, help="yaw rate [rad/s]; default: %(default)s"
    )
    add_namespace(parser, "namespace of the robot")


def add_goal(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman goal`."""
    parser.add_argument("x", type=float, help="position in odom [m]")
    parser.add_argument("y", type=float, help="position in odom [m]")
    parser.add_argument(
        "heading", type=float, nargs="?", default=0.0, help="heading [degrees]; default: 0"
    )
    parser.add_argument(
        "--relative", action="store_true", help="interpret the goal relative to the robot's pose"
    )
    parser.add_argument(
        "--joints",
        type=float,
        nargs="+",
        metavar="ANGLE",
        help="move the arm to these angles meanwhile, from base to tool [degrees]; needs the "
        "whole-body planner (`omniman up --whole-body-planner`)",
    )
    _add_timeout(parser, 120.0)
    add_namespace(parser, "namespace of the robot")


def add_tool(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman tool`."""
    for name in ("x", "y", "z"):
        parser.add_argument(name, type=float, help="position in odom [m]")
    parser.add_argument(
        "--relative",
        action="store_true",
        help="interpret the position relative to the tool's, with x ahead of the robot and y to "
        "its left",
    )
    parser.add_argument(
        "--around",
        action="store_true",
        help="drive around what is in the way; needs the whole-body planner "
        "(`omniman up --whole-body-planner`)",
    )
    _add_timeout(parser, 300.0)
    add_namespace(parser, "namespace of the robot")


def add_stop(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman stop` and `omniman reset`."""
    add_namespace(parser, "call only the nodes in this namespace; default: all nodes found")


def _add_timeout(parser: argparse.ArgumentParser, default: float) -> None:
    parser.add_argument(
        "--timeout",
        type=float,
        default=default,
        help="time after which the motion is cancelled [s]; default: %(default)s",
    )
