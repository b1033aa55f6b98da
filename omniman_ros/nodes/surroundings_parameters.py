"""Parameters of nodes that plan among obstacles and in a map."""

from dataclasses import dataclass

from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.obstacles import ObstacleParameters


@dataclass(frozen=True)
class MapReading(Validated):
    """How all nodes read the cells of a map, so that none moves where another one stops.

    By default a map tells where something stands, and nothing else: like what lies outside of it,
    cells of unknown occupancy are free. Below and behind a robot, no scanner sees: one that took
    such cells for walls could not begin to move.
    """

    map_threshold: int = parameter(
        50,
        "Occupancy from which on a cell of the map counts as occupied.",
        unit="%",
        low=1,
        high=100,
    )
    map_unknown_is_free: bool = parameter(
        True,
        "Whether cells of unknown occupancy are free, as what lies outside of the map; if not, "
        "they count as occupied.",
    )

    @property
    def rule(self) -> tuple[int, bool]:
        """Occupancy from which on a cell counts as occupied, and whether unknown ones are free."""
        return self.map_threshold, self.map_unknown_is_free


@dataclass(frozen=True, kw_only=True)
class SurroundingsParameters(Validated):
    """Tracking of obstacles, and how maps are read."""

    obstacles: ObstacleParameters
    map_reading: MapReading = inline()
