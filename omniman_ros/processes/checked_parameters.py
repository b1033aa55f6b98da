"""Parameters of nodes, checked before any process is started."""

import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.errors import FileError, OmnimanError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.nodes.registry import parameter_class, unknown_names
from omniman_ros.robots import robot_parameters
from omniman_ros.yaml_files import FOR_ALL_NODES, PARAMETERS, parse_value, read_parameters


def robot_values(
    robot: str, file: str | None = None, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the parameters of a robot, of which the platform can be driven.

    Args:
        file: Path of a ROS parameter file, whose values for all nodes go before those of the
            robot.
        values: Values of single parameters by name, which go before both.

    Raises:
        OmnimanError: A file cannot be read, the robot's file names a parameter that no node has,
            or the wheels do not make a platform.
    """
    found = _robot(robot)
    if file is not None:
        sections = [s for s in read_parameters(Path(file)) if s.nodes == FOR_ALL_NODES]
        if not sections:
            raise FileError(file, None, f"has no '{FOR_ALL_NODES}: {PARAMETERS}:' with values")
        for section in sections:
            found |= section.values
            for sentence in unknown_names(section.values):
                say(f"warning: {file}: {sentence}", sys.stderr)
    found |= values or {}
    PlatformKinematics(build(Platform, found).wheels)
    return found


def check_node(node: str, namespace: str, arguments: Sequence[str]) -> None:
    """Raise CommandError for parameters that a node would refuse when it starts."""
    given, sources = _given("/".join(("", *namespace.strip("/").split("/"), node)), arguments)
    robot = str(given.get("robot", "omniman"))
    try:
        values = {} if "wheels.names" in given else _robot(robot)
        values |= given
        build(parameter_class(node), values)
        PlatformKinematics(build(Platform, values).wheels)
    except ParameterError as error:
        source = "" if error.name == "robot" else sources.get(error.name, f"robot '{robot}': ")
        raise CommandError(f"{source}{error}", 2) from error
    except OmnimanError as error:
        raise CommandError(f"robot '{robot}': {error}", 2) from error


def _robot(robot: str) -> dict[str, Any]:
    """Return the parameters in a robot's file, all of which a node of the package has."""
    values = dict(robot_parameters(robot))
    for sentence in unknown_names(values):
        raise ParameterError("robot", robot, sentence)
    return values


def _given(node: str, arguments: Sequence[str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the parameters of ROS arguments, later ones first, and where each is from."""
    given: dict[str, Any] = {}
    sources: dict[str, str] = {}
    for option, argument in pairwise(arguments):
        found: dict[str, Any] = {}
        source = ""
        try:
            if option == "-p":
                name, _, text = argument.partition(":=")
                found[name] = parse_value(text)
            elif option == "--params-file":
                source = f"{argument}: "
                for section in read_parameters(Path(argument)):
                    found |= section.values if section.is_for(node) else {}
        except FileError as error:
            raise CommandError(
                f"{argument}: {error.reason}" if not source else str(error), 2
            ) from error
        for name, value in found.items():
            given[name] = [] if value == [""] else value  # how ROS writes an array without items
            sources[name] = source
    return given, sources
