"""Configuration of MoveIt for a robot by its name and parameter files."""

from collections.abc import Mapping
from typing import Any

from omniman_ros.core.parameters import build, specs
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.moveit.configuration import MoveItConfiguration
from omniman_ros.processes.checked_parameters import robot_values

PARAMETERS = frozenset(
    spec.name for kind in (DescriptionParameters, PathParameters) for spec in specs(kind)
)  #: Names of the parameters that the configuration depends on


def moveit_configuration(
    robot: str, file: str | None = None, values: Mapping[str, Any] | None = None
) -> MoveItConfiguration:
    """Return the configuration of MoveIt for a robot; see :func:`robot_values`.

    Raises:
        OmnimanError: A file cannot be read, a value is refused, or the robot has no arm.
    """
    found = robot_values(robot, file, values)
    return MoveItConfiguration(build(DescriptionParameters, found), build(PathParameters, found))
