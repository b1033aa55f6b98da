"""Shapes of the tool, of what it holds, and of people."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class ToolShape(Validated):
    """Cylinder at the arm's flange, along z of `tool0`."""

    length: float = parameter(
        0.0, "Length of the tool; 0: none.", unit="m", low=0.0, high=2.0, read_only=True
    )
    radius: float = parameter(
        0.05, "Radius of the tool.", unit="m", low=0.001, high=1.0, read_only=True
    )


@dataclass(frozen=True, kw_only=True)
class LoadShape(Validated):
    """Box that the tool holds, along the axes of `tool0`."""

    length: float = parameter(
        0.0, "Length of the load along x of tool0; 0: none.", unit="m", low=0.0, high=5.0
    )
    width: float = parameter(
        0.0, "Width of the load along y of tool0.", unit="m", low=0.0, high=5.0
    )
    height: float = parameter(
        0.0, "Height of the load along z of tool0.", unit="m", low=0.0, high=5.0
    )
    distance: float = parameter(
        0.0,
        "Distance of the load's near side from the flange, along z of tool0.",
        unit="m",
        low=0.0,
        high=3.0,
    )

    @property
    def is_carried(self) -> bool:
        """Whether there is a load."""
        return self.length > 0.0 and self.width > 0.0 and self.height > 0.0


@dataclass(frozen=True, kw_only=True)
class PersonShape(Validated):
    """Disc on the floor that stands for the smallest person that counts."""

    radius: float = parameter(
        0.2,
        "Radius of the smallest person that counts, the same in obstacle_tracker and in "
        "collision_monitor: where less room is, nobody stands or goes.",
        unit="m",
        low=0.1,
        high=1.0,
    )
