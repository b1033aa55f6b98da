"""Read robots from files: config/NAME.yaml, which is a ROS parameter file as well."""

from collections.abc import Mapping
from copy import copy
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import flatten_mapping
from omniman_ros.share import share_path

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Loader of libyaml, where PyYAML has it: nine times faster, and every node reads a robot."""


def robot_file(robot: str) -> Path:
    """Return the path of a robot's file.

    Args:
        robot: Name of a file in config/ without its suffix, or the path of a YAML file.

    Raises:
        ParameterError: There is no such file; the message lists the names in config/.
    """
    path = Path(robot).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return path
        raise ParameterError("robot", robot, "there is no such file")
    folder = share_path("config")
    named = folder / f"{robot}.yaml"
    if robot and named.parent == folder and named.is_file():
        return named
    known = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
    raise ParameterError("robot", robot, f"must be one of {known}, or the path of a .yaml file")


def load_robot(robot: str) -> Mapping[str, Any]:
    """Read a robot's parameters.

    Args:
        robot: As for :func:`robot_file`.

    Returns:
        Full parameter names to values.

    Raises:
        ParameterError: There is no such robot, or the file is not a ROS parameter file for all
            nodes.
    """
    path = robot_file(robot)
    try:
        values = _parse(path.read_text(encoding="utf-8"))
        return MappingProxyType({name: copy(value) for name, value in values.items()})
    except (yaml.YAMLError, TypeError, KeyError, AttributeError, OSError) as error:
        raise ParameterError(
            "robot", robot, f"{path.name} has no '/**: ros__parameters:' with values ({error!r})"
        ) from error


@lru_cache(maxsize=8)
def _parse(text: str) -> Mapping[str, Any]:
    """Return the parameters in the text of a file."""
    return flatten_mapping(yaml.load(text, Loader=_LOADER)["/**"]["ros__parameters"])
