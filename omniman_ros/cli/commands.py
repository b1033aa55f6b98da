"""The commands of `omniman`: module, help text, arguments and examples of each."""

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
from omniman_ros.cli.arguments.lab import add_bench, add_fault, add_reproduce
from omniman_ros.cli.arguments.motion import add_goal, add_stop, add_teleop, add_tool
from omniman_ros.cli.arguments.recording import add_film, add_plot, add_record, add_replay
from omniman_ros.cli.arguments.robot import add_demo, add_info, add_status, add_up


class Subcommand(NamedTuple):
    """A command of `omniman`."""

    #: Module with the function `run(args) -> int` that returns the exit code; it is imported only
    #: when the command runs.
    module: str
    help: str  #: Help text, without a capital and a full stop
    #: Adds the command's arguments to its parser
    add_arguments: Callable[[argparse.ArgumentParser], None]
    examples: tuple[str, ...]  #: Arguments of complete command lines, shown at the end of the help


COMMANDS = {
    "up": Subcommand(
        "omniman_ros.cli.up",
        "start the nodes; Ctrl-C stops the robot and ends them",
        add_up,
        ("up --world hall --obstacle-tracker", "up --robot mine.yaml -p drive.mode:=torque"),
    ),
    "teleop": Subcommand(
        "omniman_ros.cli.teleop",
        "drive with the keyboard: hold a key to drive, release it to stop",
        add_teleop,
        ("teleop", "teleop --linear 0.5 --angular 1.0"),
    ),
    "goal": Subcommand(
        "omniman_ros.cli.motion",
        "send the robot to a goal among obstacles; Ctrl-C cancels",
        add_goal,
        ("goal 2 1 90", "goal 0.5 0 --relative"),
    ),
    "tool": Subcommand(
        "omniman_ros.cli.motion",
        "move the tool straight, or around obstacles, to a position; Ctrl-C cancels",
        add_tool,
        ("tool 2 0 0.1 --relative", "tool 5 0.3 0.9 --around"),
    ),
    "stop": Subcommand(
        "omniman_ros.cli.stop_reset",
        "stop every node that moves something, until it is reset",
        add_stop,
        ("stop", "stop --namespace robot_1"),
    ),
    "reset": Subcommand(
        "omniman_ros.cli.stop_reset",
        "release stopped nodes; moves nothing by itself",
        add_stop,
        ("reset", "reset --namespace robot_1"),
    ),
    "status": Subcommand(
        "omniman_ros.cli.status",
        "tell who drives, what is stopped and why, and what would release it",
        add_status,
        ("status", "status --watch --namespace robot_1"),
    ),
    "record": Subcommand(
        "omniman_ros.cli.record",
        "record the robot's topics as a rosbag2 recording",
        add_record,
        ("record", "record odom wheel_states --duration 20 --output drive"),
    ),
    "plot": Subcommand(
        "omniman_ros.cli.plot",
        "draw the standard figures from a recording",
        add_plot,
        ("plot recording", "plot recording --show"),
    ),
    "film": Subcommand(
        "omniman_ros.cli.film",
        "draw a film of a drive from a recording",
        add_film,
        ("film recording", "film recording --output drive.webp --size 3"),
    ),
    "replay": Subcommand(
        "omniman_ros.cli.replay",
        "repeat the recorded platform controller, and compare its commands bit for bit",
        add_replay,
        ("replay recording", "replay recording --namespace robot_1"),
    ),
    "demo": Subcommand(
        "omniman_ros.demo.command",
        "drive a simulated robot and measure it, in a minute and a half",
        add_demo,
        ("demo --keep", "demo --robot mine.yaml --world none"),
    ),
    "identify": Subcommand(
        "omniman_ros.cli.identify",
        "measure properties of the robot by driving it",
        add_identify,
        ("identify odometry --simulate", "identify friction --help"),
    ),
    "info": Subcommand(
        "omniman_ros.cli.info",
        "print versions, settings and the robot, for a report of a bug",
        add_info,
        ("info", "info --robot mine.yaml"),
    ),
    "parameters": Subcommand(
        "omniman_ros.cli.parameters",
        "list the parameters of the nodes",
        add_node_parameters,
        ("parameters mpc_planner", "parameters"),
    ),
    "urdf": Subcommand(
        "omniman_ros.cli.urdf",
        "print the robot's description for RViz and MoveIt",
        add_urdf,
        ("urdf --output omniman.urdf", "urdf --robot mine.yaml"),
    ),
    "moveit": Subcommand(
        "omniman_ros.cli.moveit",
        "write the configuration of MoveIt for the robot",
        add_moveit,
        ("moveit", "moveit --robot mine.yaml --output src/mine_moveit_config"),
    ),
    "nav2": Subcommand(
        "omniman_ros.cli.nav2",
        "write the parameters of Nav2 for the robot",
        add_nav2,
        ("nav2 --output nav2.yaml", "nav2 --robot mine.yaml --keepout"),
    ),
    "map": Subcommand(
        "omniman_ros.cli.scene_map",
        "write a scene as a map for Nav2",
        add_map,
        ("map workshop", "map workshop --resolution 0.02 --output maps/workshop"),
    ),
    "reproduce": Subcommand(
        "omniman_ros.lab.command",
        "repeat a paper's experiment in simulation",
        add_reproduce,
        ("reproduce coupling --quick", "reproduce scenes --help"),
    ),
    "bench": Subcommand(
        "omniman_ros.lab.command",
        "measure the performance of the control",
        add_bench,
        ("bench control --quick", "bench clutter --help"),
    ),
    "fault": Subcommand(
        "omniman_ros.lab.faults.command",
        "inject a fault into a running simulation",
        add_fault,
        ("fault --list", "fault cmd_vel-nan --duration 3"),
    ),
}  #: Commands by name, in the order in which the help lists them
