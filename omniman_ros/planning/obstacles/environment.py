"""Obstacles, workspace and map, from which the robot must keep its clearance."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.grid_map import GridMap
from omniman_ros.planning.obstacles.separation import Workspace
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.route.route import Clearance


@dataclass(frozen=True)
class Environment:
    """Obstacles, workspace and map.

    Attributes:
        ellipses: Obstacles with their centres at the time of the set.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        grid: Map, or None.
        walls: Discs that cover the occupied cells of the map.
    """

    ellipses: Ellipses
    workspace: Workspace
    grid: GridMap | None
    walls: Walls

    def gaps(self, poses: Array, half: Array, reach: float) -> Array:
        """Return the distance of a box to obstacles, workspace and map at each pose.

        Args:
            poses: (K, 3) poses of the box in odom [m, m, rad].
            half: (2,) half length and half width of the box [m].
            reach: Distance above which gaps need not be distinguished [m].

        Returns:
            (K,) gaps [m].
        """
        result: Array = np.minimum(
            Clearance(half, self.ellipses, self.workspace, reach).gaps(poses),
            self.walls.gaps(poses, half),
        )
        return result
