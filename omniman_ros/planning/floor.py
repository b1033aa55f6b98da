"""What stands on the floor, and what a route leads around."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route import Clearance
from omniman_ros.planning.separation import Workspace
from omniman_ros.planning.walls import Walls

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Floor:
    """Everything that stands.

    Attributes:
        ellipses: Obstacles, where they are at their time.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        grid: A map, if there is one.
        walls: What is occupied on it.
    """

    ellipses: Ellipses
    workspace: Workspace
    grid: GridMap | None
    walls: Walls

    def gaps(self, poses: Array, half: Array, reach: float) -> Array:
        """How far (K,) the box, half (2,), keeps from all of it at poses (K, 3) [m].

        What is further away than `reach` need not be told apart.
        """
        result: Array = np.minimum(
            Clearance(half, self.ellipses, self.workspace, reach).gaps(poses),
            self.walls.gaps(poses, half),
        )
        return result
