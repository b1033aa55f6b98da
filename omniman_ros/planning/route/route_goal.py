"""Goal of a plan that follows a route, at the positions that the robot can reach in time."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.route.route import Route


@dataclass(frozen=True)
class RouteGoal:
    """Positions on a route over time, until rest at its end; a goal as in `goals.Goal`.

    The pace is the speed along the route in seconds of the route per second, 1 at its speeds. It
    rises and falls at one rate, up to a maximum, so that the targets come to rest at the end of
    the route. The same targets result from any position and pace along the route.
    """

    route: Route  #: Route to follow
    since: float  #: Time of the cycle [s]
    position: float  #: Position along the route at that time [s]
    pace: float  #: Pace at that time [-]
    rate: float  #: Change of pace, up and down [1/s], above zero
    max_pace: float = 1.0  #: Largest pace, 1 or less [-]

    def targets(self, times: Array) -> tuple[Array, Array]:
        """Return poses (N, 3) on the route at times (N,) [s], and zero velocities (N, 3)."""
        poses = self.route.at(self.position + self.passed(times - self.since))
        return poses, np.zeros((len(times), 3))

    def passed(self, elapsed: Array) -> Array:
        """Return the parts of the route (N,) [s] passed at times (N,) [s] after the cycle."""
        remaining, rate = self.route.duration - self.position, self.rate
        pace = min(max(self.pace, 0.0), 1.0)
        top = min(math.sqrt(rate * remaining + 0.5 * pace * pace), self.max_pace)
        change = math.copysign(rate, top - pace)
        up, down = (top - pace) / change, top / rate
        ramps = 0.5 * (top + pace) * up + 0.5 * top * down
        level = max(remaining - ramps, 0.0) / max(top, 1e-9)
        rising, holding = np.clip(elapsed, 0.0, up), np.clip(elapsed - up, 0.0, level)
        falling = np.clip(elapsed - up - level, 0.0, down)
        result: Array = (
            (pace + 0.5 * change * rising) * rising
            + top * holding
            + (top - 0.5 * rate * falling) * falling
        )
        return np.minimum(result, remaining)

    @property
    def moves(self) -> bool:
        """Whether the velocity of the targets counts: it does not."""
        return False

    @property
    def until(self) -> float:
        """Time at which the goal ends [s]: minus infinity, as it does not move."""
        return -math.inf
