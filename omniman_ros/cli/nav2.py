"""`omniman nav2`: write the parameters of Nav2 for a robot."""

import argparse

import yaml

from omniman_ros.cli.robot_values import existing_file, parse_parameters
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_file_or_stdout
from omniman_ros.core.errors import OmnimanError
from omniman_ros.processes.nav2_setup import PARAMETERS, nav2_parameters
from omniman_ros.processes.robot_setup import resolve_robot


def run(args: argparse.Namespace) -> int:
    """Run `omniman nav2`; return 0 or raise CommandError."""
    robot, file = resolve_robot(args.robot), existing_file(args.params_file)
    try:
        parameters = nav2_parameters(
            robot,
            file,
            parse_parameters(args.param, PARAMETERS, "Nav2"),
            namespace=args.namespace,
            keeps_out=args.keepout,
        )
    except OmnimanError as error:
        raise CommandError(str(error), 2) from error
    text = yaml.safe_dump(parameters, sort_keys=False)
    write_file_or_stdout(args.output, text)
    return 0
