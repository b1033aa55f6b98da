"""Robots and parameters for the tests of the drives."""

from typing import Any

from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots


def robot(name: str = "ig42", **changes: Any) -> Platform:
    """Return a shared robot with changes by name, `__` standing for the dot."""
    return robots.robot(name, _dotted(changes))


def parameters(**changes: Any) -> SimulationParameters:
    """Return simulation parameters with changes by name, `__` standing for the dot."""
    return build(SimulationParameters, _dotted(changes))


def _dotted(changes: dict[str, Any]) -> dict[str, Any]:
    return {key.replace("__", "."): value for key, value in changes.items()}
