"""Parameters of nodes that plan among obstacles and in a map."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.planning.obstacles.obstacles import ObstacleParameters


@dataclass(frozen=True, kw_only=True)
class SurroundingsParameters:
    """Tracking of obstacles, and how maps are read."""

    obstacles: ObstacleParameters
    map_threshold: int = parameter(
        50,
        "Occupancy from which on a cell of the map counts as occupied.",
        unit="%",
        low=1,
        high=100,
    )
    map_unknown_is_free: bool = parameter(
        False, "Whether the robot may move through cells of unknown occupancy."
    )

    @property
    def rule(self) -> tuple[int, bool]:
        """Occupancy from which on a cell counts as occupied, and whether unknown ones are free."""
        return self.map_threshold, self.map_unknown_is_free
