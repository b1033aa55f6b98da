"""`omniman urdf`: print the URDF of a robot as it is configured."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import write_output
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build, specs
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot


def run(args: argparse.Namespace) -> int:
    """Run `omniman urdf`.

    Args:
        args: Command line.

    Returns:
        The exit code, 0.

    Raises:
        CommandError: The options cannot be used, or the file cannot be written.
    """
    text = make_urdf(args.robot, args.param, args.params_file)
    if args.output is None:
        write_output(text)
        return 0
    try:
        Path(args.output).write_text(text, encoding="utf-8")
    except OSError as error:
        raise CommandError(f"--output {args.output}: {error.strerror}") from error
    return 0


def make_urdf(robot: str, params: Sequence[str] = (), file: str | None = None) -> str:
    """Return the URDF of a robot.

    Args:
        robot: Name of a robot of the package, or path of a robot's file.
        params: Parameters, each NAME:=VALUE, that the URDF depends on. They take precedence over
            the file.
        file: Path of a ROS parameter file for all nodes; parameters that the URDF does not depend
            on are ignored.

    Raises:
        CommandError: The robot, the file or a parameter does not exist, or a value is refused.
    """
    values, file = dict(load_robot(resolve_robot(robot))), existing_file(file)
    try:
        values |= load_robot(file) if file is not None else {}
        return build(DescriptionParameters, values | parse_parameters(params)).urdf
    except ParameterError as error:
        raise CommandError(str(error), 2) from error


def existing_file(file: str | None) -> str | None:
    """Return the path of a parameter file, if one is given.

    Raises:
        CommandError: The file does not exist.
    """
    if file is not None and not Path(file).is_file():
        raise CommandError(f"there is no parameter file '{file}'", 2)
    return file


def parse_parameters(params: Sequence[str]) -> dict[str, Any]:
    """Return the values of parameters by name.

    Args:
        params: Parameters, each NAME:=VALUE, where VALUE is YAML.

    Raises:
        CommandError: A text is not of this form, or not a parameter that the URDF depends on.
    """
    known = {spec.name for spec in specs(DescriptionParameters)}
    values: dict[str, Any] = {}
    for text in params:
        name, separator, value = text.partition(":=")
        if not separator or not re.fullmatch(r"[^\s:=]+", name) or not value:
            raise CommandError(f"parameter '{text}' is not NAME:=VALUE", 2)
        if name not in known:
            raise CommandError(f"parameter '{name}' does not affect the URDF", 2)
        try:
            values[name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise CommandError(f"parameter '{text}': {value} is not YAML", 2) from error
    return values
