"""What is around the robot: upright obstacles, some of which move."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from omniman_ros.collision.upright_obstacles import Mask, UprightObstacles
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated

SLOWEST = 0.02  #: Speed up to which an obstacle counts as standing [m/s]


@dataclass(frozen=True)
class MovingObstacles(Validated):
    """Obstacles that stand or move at constant velocity."""

    obstacles: UprightObstacles  #: M obstacles where they are now
    #: Velocities (2, M) in the frame of the obstacles [m/s]
    velocity: Annotated[Array, Shape(2, "M")]

    @staticmethod
    def standing(obstacles: UprightObstacles) -> "MovingObstacles":
        """Return obstacles that do not move."""
        return MovingObstacles(obstacles, np.zeros((2, len(obstacles))))

    @staticmethod
    def join(parts: Sequence["MovingObstacles"]) -> "MovingObstacles":
        """Return the obstacles of several surroundings, in their order."""
        obstacles = UprightObstacles.join([part.obstacles for part in parts])
        velocity = [part.velocity for part in parts] or [np.zeros((2, 0))]
        return MovingObstacles(obstacles, np.concatenate(velocity, axis=1))

    def __len__(self) -> int:
        return len(self.obstacles)

    @property
    def is_moving(self) -> Mask:
        """Whether each solid (M,) moves."""
        moving: Mask = np.hypot(*self.velocity) > SLOWEST
        return moving

    def within(self, place: Array, distance: float, time: float) -> Mask:
        """Return which obstacles (M,) may come within a distance [m] of a place in a time [s]."""
        m = len(self)
        points = np.stack((np.full(m, place[0]), np.full(m, place[1]), self.obstacles.lower))
        cutoff = distance + time * np.hypot(*self.velocity)
        near: Mask = self.obstacles.point_distances(points) <= cutoff
        return near

    def select(self, chosen: Mask) -> "MovingObstacles":
        """Return the obstacles with a flag."""
        return MovingObstacles(
            self.obstacles.select(np.flatnonzero(chosen)), self.velocity[:, chosen]
        )

    def after(self, time: float) -> UprightObstacles:
        """Return the obstacles a time from now [s]."""
        return replace(self.obstacles, centre=self.obstacles.centre + time * self.velocity)
