"""The commands of `omniman`: module, help text and arguments of each."""

import argparse
from collections.abc import Callable
from typing import NamedTuple

from omniman_ros.cli.arguments.description import (
    add_map,
    add_moveit,
    add_nav2,
    add_node_parameters,
    add_urdf,
)
from omniman_ros.cli.arguments.identification import add_identify
from omniman_ros.cli.arguments.lab import add_bench, add_reproduce
from omniman_ros.cli.arguments.motion import add_goal, add_stop, add_teleop, add_tool
from omniman_ros.cli.arguments.recording import add_film, add_plot, add_record
from omniman_ros.cli.arguments.robot import add_demo, add_up


class Subcommand(NamedTuple):
    """A command of `omniman`."""

    #: Module with the function `run(args) -> int` that returns the exit code; it is imported only
    #: when the command runs.
    module: str
    help: str  #: Help text, without a capital and a full stop
    #: Adds the command's arguments to its parser
    add_arguments: Callable[[argparse.ArgumentParser], None]


COMMANDS = {
    "up": Subcommand(
        "omniman_ros.cli.up", "start the nodes; Ctrl-C stops the robot and ends them", add_up
    ),
    "teleop": Subcommand(
        "omniman_ros.cli.teleop",
        "drive with the keyboard: hold a key to drive, release it to stop",
        add_teleop,
    ),
    "goal": Subcommand(
        "omniman_ros.cli.motion",
        "send the robot to a goal among obstacles; Ctrl-C cancels",
        add_goal,
    ),
    "tool": Subcommand(
        "omniman_ros.cli.motion",
        "move the tool along a straight line to a position; Ctrl-C cancels",
        add_tool,
    ),
    "stop": Subcommand(
        "omniman_ros.cli.stop_reset",
        "stop every node that moves something, until it is reset",
        add_stop,
    ),
    "reset": Subcommand(
        "omniman_ros.cli.stop_reset", "release stopped nodes; moves nothing by itself", add_stop
    ),
    "record": Subcommand(
        "omniman_ros.cli.record", "record the robot's topics as a rosbag2 recording", add_record
    ),
    "plot": Subcommand(
        "omniman_ros.cli.plot", "draw the standard figures from a recording", add_plot
    ),
    "film": Subcommand(
        "omniman_ros.cli.film", "draw a film of a drive from a recording", add_film
    ),
    "demo": Subcommand(
        "omniman_ros.demo.command",
        "drive a simulated robot and measure it, in a minute and a half",
        add_demo,
    ),
    "identify": Subcommand(
        "omniman_ros.cli.identify", "measure properties of the robot by driving it", add_identify
    ),
    "parameters": Subcommand(
        "omniman_ros.cli.parameters", "list the parameters of the nodes", add_node_parameters
    ),
    "urdf": Subcommand(
        "omniman_ros.cli.urdf", "print the robot's description for RViz and MoveIt", add_urdf
    ),
    "moveit": Subcommand(
        "omniman_ros.cli.moveit", "write the configuration of MoveIt for the robot", add_moveit
    ),
    "nav2": Subcommand(
        "omniman_ros.cli.nav2", "write the parameters of Nav2 for the robot", add_nav2
    ),
    "map": Subcommand("omniman_ros.cli.scene_map", "write a scene as a map for Nav2", add_map),
    "reproduce": Subcommand(
        "omniman_ros.lab.command",
        "repeat a paper's experiment in simulation",
        add_reproduce,
    ),
    "bench": Subcommand(
        "omniman_ros.lab.command", "measure the performance of the control", add_bench
    ),
}  #: Commands by name, in the order in which the help lists them
