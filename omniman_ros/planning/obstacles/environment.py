"""Obstacles, workspace and map, from which the robot must keep its clearance."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import Workspace, box_gap, outside_by
from omniman_ros.planning.obstacles.walls import MAX_COMPUTED_GAP, Walls
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap, Mask


@dataclass(frozen=True)
class Environment:
    """Obstacles, workspace and map, and the outline of the robot among them."""

    footprint: Footprint  #: Outline of the robot
    ellipses: Ellipses  #: Obstacles with their centres at the time of the set
    workspace: Workspace  #: (x_min, y_min, x_max, y_max) in odom [m]
    grid: GridMap | None  #: Map, or None
    walls: Walls  #: Discs that cover the occupied cells of the map

    def gaps(self, poses: Array, reach: float) -> Array:
        """Return the gaps (K,) to obstacles, workspace and map at poses (K, 3) in odom [m].

        Those above `reach` [m] need not be distinguished.

        Args:
            poses: (K, 3) poses of base_link in odom [m, m, rad].
        """
        clearance = Clearance(self.footprint, self.ellipses, self.workspace, reach)
        result: Array = np.minimum(
            clearance.gaps(poses), self.walls.gaps(poses, self.footprint.whole)
        )
        return result

    def is_inside(self, poses: Array) -> Mask:
        """Return whether the middle of a part of the robot is in an occupied cell, (K,)."""
        result = np.zeros(len(poses), dtype=bool)
        if self.grid is not None:
            for part in self.footprint.whole.each():
                result |= self.grid.occupied_at(part.poses(poses)[:, :2])
        return result

    def touches(self, pose: Array) -> bool:
        """Return whether the robot at a pose (3,) touches or overlaps something."""
        poses = pose[None]
        return bool(self.gaps(poses, MAX_COMPUTED_GAP)[0] <= 0.0 or self.is_inside(poses)[0])

    def touched(self, poses: Array) -> Mask:
        """Return (M + N + 1,) flags of what is touched at poses (K, 3): discs, pairs and edge."""
        walls, pairs, outside = self._each(poses)
        result: Mask = np.concatenate([walls, pairs, outside]) <= 0.0
        return result

    def nearest(self, pose: Array) -> str:
        """Return what is nearest to the robot at a pose (3,), with its place in odom."""
        x, y = self._walls_near(pose).centers.T
        walls, pairs, outside = self._each(pose[None], self._walls_near(pose))
        if self.is_inside(pose[None])[0] and not (walls <= 0.0).any():
            return _at("the map", pose[:2])
        k = int(np.concatenate([walls, pairs, outside]).argmin())
        if k < len(walls):
            return _at("the map", np.array([x[k], y[k]]))
        if k < len(walls) + len(pairs):
            known = Pairs.of(self.footprint, self.ellipses).ellipses
            return _at("the obstacle", known.centers[k - len(walls)])
        return "the workspace's edge"

    def _walls_near(self, pose: Array) -> Walls:
        return self.walls.near(pose, self.footprint.radius + self.walls.radius + MAX_COMPUTED_GAP)

    def _each(self, poses: Array, walls: Walls | None = None) -> tuple[Array, Array, Array]:
        """Return the least gaps of each disc (M,), pair (N,) and the edge (1,) at poses [m]."""
        walls = self.walls if walls is None else walls
        pairs = Pairs.of(self.footprint, self.ellipses)
        known, times = pairs.ellipses, np.full(len(poses), self.ellipses.time)
        axes = known.axes_at(times)
        gaps = box_gap(poses, pairs.boxes, known.centers_at(times), axes, known.angles)
        outside = -outside_by(poses, self.footprint.whole, self.workspace)
        return (
            walls.gaps_of_each(poses, self.footprint.whole),
            gaps.min(axis=0),
            outside.min(keepdims=True),
        )


def _at(name: str, place: Array) -> str:
    return f"{name} at ({place[0]:.2f}, {place[1]:.2f}) m"
