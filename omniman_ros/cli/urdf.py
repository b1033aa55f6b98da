"""`omniman urdf`: print the URDF of a robot as it is configured."""

import argparse
from collections.abc import Sequence

from omniman_ros.cli.robot_values import existing_file, parse_parameters
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_file_or_stdout
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build, specs
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.processes.checked_parameters import robot_values
from omniman_ros.processes.robot_setup import resolve_robot


def run(args: argparse.Namespace) -> int:
    """Run `omniman urdf`; return 0 or raise CommandError."""
    text = make_urdf(args.robot, args.param, args.params_file)
    write_file_or_stdout(args.output, text)
    return 0


def make_urdf(robot: str, params: Sequence[str] = (), file: str | None = None) -> str:
    """Return the URDF of a robot; arguments and errors are those of `robot_description`."""
    return robot_description(robot, params, file).urdf


def robot_description(
    robot: str, params: Sequence[str] = (), file: str | None = None
) -> DescriptionParameters:
    """Return what the description of a robot is made from.

    Args:
        robot: Name of a robot of the package, or path of a robot's file.
        params: Parameters, each NAME:=VALUE, that the URDF depends on. They take precedence over
            the file.
        file: Path of a ROS parameter file for all nodes; parameters that the URDF does not depend
            on are ignored.

    Raises:
        CommandError: The robot, the file or a parameter does not exist, or a value is refused.
    """
    robot, file = resolve_robot(robot), existing_file(file)
    known = {spec.name for spec in specs(DescriptionParameters)}
    values = parse_parameters(params, known, "the URDF")
    try:
        return build(DescriptionParameters, robot_values(robot, file, values))
    except OmnimanError as error:
        raise CommandError(str(error), 2) from error
