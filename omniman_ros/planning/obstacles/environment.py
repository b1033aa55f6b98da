"""Obstacles, workspace and map, from which the robot must keep its clearance."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.grid_map import GridMap
from omniman_ros.planning.obstacles.separation import Workspace
from omniman_ros.planning.obstacles.walls import Walls


@dataclass(frozen=True)
class Environment:
    """Obstacles, workspace and map, and the outline of the robot among them.

    Attributes:
        footprint: Outline of the robot.
        ellipses: Obstacles with their centres at the time of the set.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        grid: Map, or None.
        walls: Discs that cover the occupied cells of the map.
    """

    footprint: Footprint
    ellipses: Ellipses
    workspace: Workspace
    grid: GridMap | None
    walls: Walls

    def gaps(self, poses: Array, reach: float) -> Array:
        """Return the distance of the robot to obstacles, workspace and map at each pose.

        Args:
            poses: (K, 3) poses of base_link in odom [m, m, rad].
            reach: Distance above which gaps need not be distinguished [m].

        Returns:
            (K,) gaps [m].
        """
        clearance = Clearance(self.footprint, self.ellipses, self.workspace, reach)
        result: Array = np.minimum(
            clearance.gaps(poses), self.walls.gaps(poses, self.footprint.whole)
        )
        return result
