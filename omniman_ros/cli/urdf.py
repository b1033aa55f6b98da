"""Command `omniman urdf`: the URDF of a robot as it is configured."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import resolved
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build, specs
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.robots import load_robot


def run(args: argparse.Namespace) -> int:
    """Print the URDF, or write it to a file."""
    text = described(args.robot, args.param, args.params_file)
    if args.output is None:
        print(text, end="")
        return 0
    try:
        Path(args.output).write_text(text, encoding="utf-8")
    except OSError as error:
        raise CommandError(f"--output {args.output}: {error.strerror}") from error
    return 0


def described(robot: str, params: Sequence[str] = (), file: str | None = None) -> str:
    """The URDF of a robot.

    Args:
        robot: A name, or the path of a file.
        params: NAME:=VALUE each; of parameters that a URDF is made from.
        file: A ROS parameter file for all nodes; parameters of others are left alone.

    Raises:
        CommandError: No such robot, file or parameter, or a value is refused.
    """
    values = dict(load_robot(resolved(robot)))
    if file is not None and not Path(file).is_file():
        raise CommandError(f"no parameter file '{file}'", 2)
    try:
        values |= load_robot(file) if file is not None else {}
        return build(DescriptionParameters, values | given(params)).urdf
    except ParameterError as error:
        raise CommandError(str(error), 2) from error


def given(params: Sequence[str]) -> dict[str, Any]:
    """Names and values of NAME:=VALUE; values are YAML.

    Raises:
        CommandError: One is something else, or not a parameter that a URDF is made from.
    """
    known = {spec.name for spec in specs(DescriptionParameters)}
    values: dict[str, Any] = {}
    for text in params:
        name, found, value = text.partition(":=")
        if not found or not re.fullmatch(r"[^\s:=]+", name) or not value:
            raise CommandError(f"parameter '{text}' is not NAME:=VALUE", 2)
        if name not in known:
            raise CommandError(f"parameter '{name}' changes nothing in a URDF", 2)
        try:
            values[name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise CommandError(f"parameter '{text}': {value} is not YAML", 2) from error
    return values
