"""Arguments of the commands that start a robot or tell of it."""

import argparse
from typing import Any

from omniman_ros.cli.arguments.common import (
    add_arm,
    add_drive,
    add_namespace,
    add_parameters,
    add_results,
    add_robot,
)
from omniman_ros.processes.arm_options import ARMS
from omniman_ros.processes.drive_options import DRIVES


def add_up(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman up`."""
    add_robot(parser)
    add_namespace(parser, "namespace of all nodes and topics")
    parser.add_argument(
        "--only", nargs="+", metavar="NODE", help="start only these nodes; default: all"
    )
    parser.add_argument(
        "--sim-time",
        action=argparse.BooleanOptionalAction,
        help="run on /clock, which the simulated drive then publishes, and which waits for nodes "
        "that a busy machine holds up; default: if all of the robot is simulated, without a bus "
        "and without a namespace",
    )
    parser.add_argument(
        "--collision-monitor",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="limit the speed before contact, and stop where the monitor is silent; default: yes, "
        "and with --only if the node is among them",
    )
    parser.add_argument(
        "--obstacle-tracker",
        action="store_true",
        help="turn the scans on `scan` into obstacles and a map, as with --world; with --only if "
        "the node is among them; default: no",
    )
    parser.add_argument(
        "--whole-body-planner",
        action="store_true",
        help="let platform and arm dodge what is around them on paths of the tool; with --only if "
        "the node is among them; default: no",
    )
    add_parameters(parser)
    parser.add_argument("--params-file", metavar="FILE", help="a ROS parameter file for all nodes")
    add_drive(parser, tuple(DRIVES))
    add_world(
        parser,
        "simulate the robot in a physics world, with contacts and laser scans: workshop, hall, "
        "corridor, shop_floor, clutter, empty or the path of a .yaml file; default: no world",
    )
    add_arm(parser, tuple(ARMS))
    parser.add_argument(
        "--controller",
        default="ur5",
        metavar="NAME",
        help="with --arm ur: ur5 or the path of a .yaml file; default: %(default)s",
    )


def add_world(parser: argparse.ArgumentParser, text: str, **options: Any) -> None:
    """Add `--world`, with a help text."""
    parser.add_argument("--world", metavar="SCENE", help=text, **options)


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman demo`."""
    add_robot(parser)
    parser.add_argument(
        "--keep",
        action="store_true",
        help="keep the robot running after the show, in your own ROS domain, for example for "
        "omniman teleop; Ctrl-C ends it",
    )
    parser.add_argument("--verbose", action="store_true", help="show the output of the nodes")
    add_drive(parser, ("simulated", "can"))
    add_world(
        parser,
        "drive in a physics world, where the robot may touch nothing and sees by its scanner: the "
        "name of a scene with room for the show or the path of a .yaml file; with no name, hall; "
        "none: no world; default: hall with the robot omniman and simulated drives, where MuJoCo "
        "and scipy are installed",
        nargs="?",
        const="hall",
    )
    add_arm(parser, ("simulated", "none"))
    add_parameters(parser)
    add_results(parser)


def add_info(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman info`."""
    add_robot(parser)


def add_status(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman status`."""
    add_namespace(parser, "namespace of the robot")
    parser.add_argument(
        "--watch", action="store_true", help="go on, and print what changes, until Ctrl-C"
    )
