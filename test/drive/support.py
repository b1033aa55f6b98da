"""Robots and parameters for the tests of the drives."""

from typing import Any

import robots

from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.drive.parameters import SimulationParameters


def robot(name: str = "ig42", **changes: Any) -> Robot:
    """One of the shared robots; changes by name with `__` for the dot."""
    return robots.robot(name, _dotted(changes))


def parameters(**changes: Any) -> SimulationParameters:
    """Parameters of the simulation; changes by name with `__` for the dot."""
    return build(SimulationParameters, _dotted(changes))


def _dotted(changes: dict[str, Any]) -> dict[str, Any]:
    return {key.replace("__", "."): value for key, value in changes.items()}
