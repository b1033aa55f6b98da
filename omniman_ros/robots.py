"""Read robots from files: config/NAME.yaml, which is a ROS parameter file as well."""

from collections.abc import Mapping
from copy import copy
from pathlib import Path
from types import MappingProxyType
from typing import Any

from omniman_ros.core.errors import FileError, ParameterError
from omniman_ros.share import share_path
from omniman_ros.yaml_files import FOR_ALL_NODES, PARAMETERS, read_parameters


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


def robot_parameters(robot: str) -> Mapping[str, Any]:
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
        sections = read_parameters(path)
        others = [section for section in sections if section.nodes != FOR_ALL_NODES]
        if others or not sections:
            line = others[0].line if others else None
            reason = f"its only section must be '{FOR_ALL_NODES}: {PARAMETERS}:'"
            raise FileError(str(path), line, reason)
    except FileError as error:
        place = path.name if error.line is None else f"{path.name}:{error.line}"
        raise ParameterError("robot", robot, f"{place}: {error.reason}") from error
    # A reader may change an array: the sections are kept for the next one.
    return MappingProxyType(
        {name: copy(value) for section in sections for name, value in section.values.items()}
    )
