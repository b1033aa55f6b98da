"""What the whole body keeps clear of: standing obstacles, and those that move or may move."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.obstacle_shapes import ellipse_surroundings
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import Range
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.ellipses import Ellipses

#: Lowest pace at which what moves is predicted: below it, the robot all but stands
SLOWEST_PACE = 0.1
#: Speed from which on an obstacle moves, over the rate at which the margin around it grows: that
#: rate is the standard deviation of its velocity, and a small share of its speed
SIGNIFICANT = 1.5


def _nothing() -> MovingObstacles:
    return MovingObstacles.standing(UprightObstacles.join([]))


@dataclass(frozen=True)
class ObstacleSnapshot(Validated):
    """Obstacles around the robot at one time, in odom.

    Raises:
        InputError: There are not as many rates or names as obstacles, or a value is not finite.
    """

    time: float = 0.0  #: Time at which the moving ones are where they are said to be [s]
    #: Obstacles that stand
    standing: UprightObstacles = field(default_factory=lambda: UprightObstacles.join([]))
    #: Obstacles that move at constant velocity, and those that may walk on at once
    moving: MovingObstacles = field(default_factory=_nothing)
    #: Rates (M,) at which the margin around each of the moving ones grows [m/s]
    growth: Annotated[Array, Shape("M")] = field(default_factory=lambda: np.zeros(0))
    #: Rate at which the time of this snapshot passes, by the clock
    pace: Annotated[float, Range(low=0.0)] = 1.0
    #: Names of all obstacles, the standing ones first; none if they are numbered
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.standing) + len(self.moving)
        if len(self.names) not in (0, count):
            raise InputError(f"there are {len(self.names)} names for {count} solids")
        if len(self.growth) != len(self.moving):
            raise InputError(
                f"growth has shape {self.growth.shape}, expected ({len(self.moving)},)"
            )

    @staticmethod
    def of_ellipses(
        time: float,
        ellipses: Ellipses,
        names: Sequence[str],
        fixed: UprightObstacles | None = None,
        fixed_names: tuple[str, ...] = (),
    ) -> "ObstacleSnapshot":
        """Return obstacles at a time [s] with their names, and others that are fixed.

        A velocity that is within its uncertainty is noise: who evades a post as if it moved to and
        fro shakes the robot.
        """
        found = ellipse_surroundings(ellipses)
        moves = found.is_moving & (np.hypot(*found.velocity) > SIGNIFICANT * ellipses.growth)
        still, walking = (
            tuple(name for name, moved in zip(names, moves, strict=True) if moved == which)
            for which in (False, True)
        )
        standing = found.obstacles.select(np.flatnonzero(~moves))
        chosen = np.flatnonzero(moves)
        return ObstacleSnapshot(
            time,
            standing if fixed is None else UprightObstacles.join([standing, fixed]),
            MovingObstacles(found.obstacles.select(chosen), found.velocity[:, moves]),
            ellipses.growth[moves],
            names=(*still, *fixed_names, *walking),
        )

    @cached_property
    def velocities(self) -> Array:
        """Velocities (2, M) of all obstacles, the standing ones first [m/s]."""
        return np.hstack([np.zeros((2, len(self.standing))), self.moving.velocity])

    def placed(self, ages: Array, numbers: Indices) -> UprightObstacles:
        """Return obstacles with numbers (k, n), the standing ones first, at ages (k,) [s].

        All arrays of the result are (..., k, n).
        """
        chosen = self._everything.select(numbers)
        return chosen.placed(chosen.centre + ages[:, None] * self.velocities[:, numbers])

    @cached_property
    def _everything(self) -> UprightObstacles:
        """All obstacles at their time, the standing ones first."""
        return UprightObstacles.join([self.standing, self.moving.obstacles])

    def slowed(self, time: float, pace: float) -> "ObstacleSnapshot":
        """Return the same in the motion time of a robot at a pace, in which what moves is faster.

        A robot slower than `SLOWEST_PACE` all but stands.
        """
        pace = max(pace, SLOWEST_PACE)
        moving = MovingObstacles.unchecked(
            obstacles=self.moving.obstacles, velocity=self.moving.velocity / pace
        )
        return ObstacleSnapshot.unchecked(
            time=time,
            standing=self.standing,
            moving=moving,
            growth=self.growth / pace,
            pace=pace,
            names=self.names,
        )

    def standing_near(self, place: Array, reach: float) -> Indices:
        """Return the numbers of those that stand within a reach [m] of a place (2,), or more."""
        offset = self.standing.centre - place[:, None]
        extent = np.hypot(*self.standing.half) + self.standing.rounding
        return np.flatnonzero(np.hypot(*offset) - extent < reach)

    def selected(self, standing: Indices, moving: Indices) -> "ObstacleSnapshot":
        """Return some of the obstacles by their numbers among those that stand and that move."""
        labels, still = self.labels(), len(self.standing)
        return ObstacleSnapshot.unchecked(
            time=self.time,
            standing=self.standing.select(standing),
            moving=MovingObstacles.unchecked(
                obstacles=self.moving.obstacles.select(moving),
                velocity=self.moving.velocity[:, moving],
            ),
            growth=self.growth[moving],
            pace=self.pace,
            names=tuple(labels[k] for k in (*standing.tolist(), *(still + moving).tolist())),
        )

    def labels(self) -> tuple[str, ...]:
        """Return a name for each solid, the standing ones first."""
        if self.names:
            return self.names
        standing = tuple(f"standing solid {k}" for k in range(len(self.standing)))
        return standing + tuple(f"moving solid {k}" for k in range(len(self.moving)))
