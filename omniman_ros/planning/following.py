"""Targets along a route: as far ahead as the robot can be by then, to rest at its end."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.route import Route

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Along:
    """The goal of one cycle: where to be on a route when. See `goals.Goal`.

    The pace is that at which the route's own seconds pass, 1 at its speeds. It rises and falls at
    one rate, to a most, so that the targets come to rest at the end of the route; the same
    comes out again from any place and pace on the way.

    Attributes:
        route: The route.
        since: Time of the cycle [s].
        place: Position along the route then [s].
        pace: Pace then.
        rate: Change of pace, up and down [1/s], above zero.
        most: Largest pace, 1 or less.
    """

    route: Route
    since: float
    place: float
    pace: float
    rate: float
    most: float = 1.0

    def targets(self, times: Array) -> tuple[Array, Array]:
        """Poses (N, 3) on the route at times (N,) [s]; no velocities are wanted."""
        poses = self.route.at(self.place + self.passed(times - self.since))
        return poses, np.zeros((len(times), 3))

    def passed(self, after: Array) -> Array:
        """How much of the route (N,) [s] is passed times (N,) [s] after the cycle."""
        left, rate = self.route.duration - self.place, self.rate
        pace = min(max(self.pace, 0.0), 1.0)
        top = min(math.sqrt(rate * left + 0.5 * pace * pace), self.most)
        change = math.copysign(rate, top - pace)
        up, down = (top - pace) / change, top / rate
        ramps = 0.5 * (top + pace) * up + 0.5 * top * down
        level = max(left - ramps, 0.0) / max(top, 1e-9)
        rising, holding = np.clip(after, 0.0, up), np.clip(after - up, 0.0, level)
        falling = np.clip(after - up - level, 0.0, down)
        result: Array = (
            (pace + 0.5 * change * rising) * rising
            + top * holding
            + (top - 0.5 * rate * falling) * falling
        )
        return np.minimum(result, left)

    @property
    def moves(self) -> bool:
        """The robot is not held to the velocity of the targets."""
        return False

    @property
    def until(self) -> float:
        """It comes to no end in time."""
        return -math.inf

    def near(self, heading: float) -> "Along":
        """The same: a route begins on the branch of the motion."""
        return self
