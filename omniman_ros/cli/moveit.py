"""`omniman moveit`: write the configuration of MoveIt for a robot."""

import argparse
from pathlib import Path

import yaml

from omniman_ros.cli.robot_values import existing_file, parse_parameters
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import output_errors
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import OmnimanError
from omniman_ros.processes.moveit_setup import PARAMETERS, moveit_configuration
from omniman_ros.processes.robot_setup import resolve_robot


def run(args: argparse.Namespace) -> int:
    """Run `omniman moveit`; return 0 or raise CommandError."""
    folder = Path(args.output)
    robot, file = resolve_robot(args.robot), existing_file(args.params_file)
    try:
        values = parse_parameters(args.param, PARAMETERS, "MoveIt")
        configuration = moveit_configuration(robot, file, values)
    except OmnimanError as error:
        raise CommandError(str(error), 2) from error
    texts = {"omniman.urdf": configuration.description.urdf, "omniman.srdf": configuration.srdf}
    tables = {
        "kinematics.yaml": configuration.kinematics,
        "joint_limits.yaml": configuration.joint_limits,
        "moveit_controllers.yaml": configuration.controllers,
        "ompl_planning.yaml": configuration.planning["ompl"],
    }
    texts |= {name: yaml.safe_dump(table, sort_keys=False) for name, table in tables.items()}
    with output_errors(args.output):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    say(f"{', '.join(texts)} written to {folder}")
    return 0
