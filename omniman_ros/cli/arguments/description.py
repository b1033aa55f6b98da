"""Arguments of the commands that print the description of a robot and the nodes' parameters."""

import argparse

from omniman_ros.cli.arguments.common import add_parameters, add_robot
from omniman_ros.nodes.registry import NODES


def add_urdf(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman urdf`."""
    _add_description(parser)
    parser.add_argument("--output", metavar="FILE", help="file to write; default: stdout")


def add_moveit(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman moveit`."""
    _add_description(parser)
    parser.add_argument(
        "--output", metavar="FOLDER", default="moveit", help="folder to write to; default: moveit"
    )


def add_nav2(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman nav2`."""
    _add_description(parser)
    parser.add_argument(
        "--namespace", default="", help="namespace of the robot and of Nav2's nodes; default: none"
    )
    parser.add_argument(
        "--keepout", action="store_true", help="have zones in the costmaps to keep out of"
    )
    parser.add_argument("--output", metavar="FILE", help="file to write; default: stdout")


def add_map(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman map`."""
    parser.add_argument(
        "scene", metavar="SCENE", help="a scene of the package (workshop), or the path of a file"
    )
    parser.add_argument(
        "--resolution", type=float, default=0.05, metavar="M", help="edge of a cell; default: 0.05"
    )
    parser.add_argument(
        "--height",
        type=float,
        default=0.5,
        metavar="M",
        help="height of what shall pass; default: 0.5",
    )
    parser.add_argument(
        "--output",
        metavar="STEM",
        help="files to write, without suffix; default: the scene's name",
    )


def _add_description(parser: argparse.ArgumentParser) -> None:
    add_robot(parser)
    add_parameters(parser, "a parameter of the robot, its arm or the mount; may be repeated")
    parser.add_argument(
        "--params-file",
        metavar="FILE",
        help="a ROS parameter file, such as that of the arm's controller",
    )


def add_node_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman parameters`."""
    parser.add_argument(
        "node",
        nargs="?",
        choices=sorted(NODES),
        help="node to list; default: all nodes, each in a section of its own",
    )
