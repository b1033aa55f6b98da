"""The obstacles that a source reports: tracked, forgotten in time, and given out as ellipses."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.tracking import PATIENCE, ObstacleTrack, TrackingParameters

Array = NDArray[np.float64]
Key = tuple[str, int]
"""Namespace and number of an obstacle, as those of a marker."""

LEAST_AXIS = 1e-3
"""A semi-axis is longer than this [m] ..."""
LARGEST_AXIS = 100.0
"""... and shorter than this [m]."""
AHEAD = 0.1
"""An observation may be so much [s] ahead of the caller's clock; a clock that goes back by more
starts the tracks anew."""
COAST = 1.0
"""An obstacle is predicted at its velocity until its observation is so old [s], if there is no
time-out that says it."""
LARGEST_DOUBT = 0.3
"""At most so much of an uncertain velocity counts for the growth [m/s]: what an obstacle seen for
the first time may do at worst would close the whole floor."""


@dataclass(frozen=True)
class ObstacleParameters:
    """How obstacles are followed, and when their source is not trusted."""

    tracking: TrackingParameters = inline()
    timeout: float = parameter(
        1.0, "Age of the source's last message at which it counts as silent; 0: never.",
        unit="s", low=0.0, high=3600.0,
    )  # fmt: skip
    required: bool = parameter(
        False, "Whether the robot waits for a source of obstacles before it moves."
    )
    most: int = parameter(
        1000, "Obstacles kept; more are refused.", low=1, high=100_000, read_only=True
    )


@dataclass(frozen=True, slots=True)
class Observation:
    """One obstacle as it was observed.

    Attributes:
        key: Its namespace and number.
        time: When, on the caller's clock [s].
        x, y: Centre in odom [m].
        angle: Of its own x axis in odom [rad].
        semi_axes: (a, b) along its own x and y [m].
        lifetime: How long it stays without being observed again [s]; 0: for ever.

    Raises:
        InputError: A value is not finite or implausible, a semi-axis is not above 1 mm and below
            100 m, or the lifetime is negative.
    """

    key: Key
    time: float
    x: float
    y: float
    angle: float
    semi_axes: tuple[float, float]
    lifetime: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.time):
            raise InputError(f"time {self.time} is not finite")
        place = (self.x, self.y)
        if not (abs(self.x) <= plausible.LENGTH and abs(self.y) <= plausible.LENGTH):
            plausible.demand(np.array(place), plausible.LENGTH, "position")
        if not abs(self.angle) <= plausible.ANGLE:
            plausible.demand(np.array([self.angle]), plausible.ANGLE, "angle")
        a, b = self.semi_axes
        if not (LEAST_AXIS < a < LARGEST_AXIS and LEAST_AXIS < b < LARGEST_AXIS):
            raise InputError(
                f"semi-axes ({a}, {b}) m, expected above {LEAST_AXIS:g} and below {LARGEST_AXIS:g}"
            )
        if not 0.0 <= self.lifetime < math.inf:
            raise InputError(f"lifetime {self.lifetime} s, expected finite and not negative")


@dataclass(slots=True)
class _Obstacle:
    track: ObstacleTrack
    seen: Observation
    expiry: float


@dataclass(frozen=True)
class _Table:
    """All obstacles as arrays, as long as nothing new is heard."""

    times: Array
    centers: Array
    velocities: Array
    observed: Array
    semi_axes: Array
    angles: Array
    growth: Array
    first_expiry: float
    first_doubted: float


class ObstacleSet:
    """Obstacles by their key, each followed by a track.

    A marker stays until it is changed, deleted or its lifetime is over (counted from its arrival).
    While its observation is younger than the time-out it is predicted at constant velocity
    (MPC 2021, 4.3); an older one, of a source that is not silent, counts as standing where it was
    last observed.

    Args:
        parameters: Of tracking, and of the source.
    """

    def __init__(self, parameters: ObstacleParameters) -> None:
        self._parameters = parameters
        self._obstacles: dict[Key, _Obstacle] = {}
        self._heard = -math.inf
        self._table: _Table | None = None

    def configure(self, parameters: ObstacleParameters) -> None:
        """Take other parameters; tracks that are known keep those they began with."""
        self._parameters = parameters
        self._table = None

    def __len__(self) -> int:
        return len(self._obstacles)

    def heard(self, now: float) -> None:
        """Note that the source sent something, if only that there is nothing, at now [s]."""
        self._notice(now)
        self._heard = now

    def add(self, observation: Observation, now: float) -> None:
        """Take an observation in at now [s]; one older than the obstacle's last is ignored.

        Raises:
            InputError: It is ahead of now by more than 0.1 s, or there are too many obstacles.
        """
        self._notice(now)
        key, time = observation.key, observation.time
        if time > now + AHEAD:
            raise InputError(f"obstacle {key}: observed {time - now:.3f} s ahead of now")
        known = self._obstacles.get(key)
        expiry = now + observation.lifetime if observation.lifetime > 0.0 else math.inf
        if known is None or known.expiry <= now:
            if known is None and len(self._obstacles) >= self._parameters.most:
                self._drop_expired(now)
                if len(self._obstacles) >= self._parameters.most:
                    raise InputError(
                        f"obstacle {key}: there are {len(self._obstacles)} already, "
                        f"at most {self._parameters.most} are kept"
                    )
            track = ObstacleTrack(self._parameters.tracking, time, observation.x, observation.y)
            self._obstacles[key] = _Obstacle(track, observation, expiry)
        elif time < known.seen.time:
            return
        else:
            # The same observation again keeps it alive, and may change its shape.
            known.track.observe(time, observation.x, observation.y)
            known.seen, known.expiry = observation, expiry
        self._heard = now  # what was refused is no sign of life
        self._table = None

    def delete(self, key: Key) -> None:
        """Forget an obstacle; one that is not known is no fault."""
        if self._obstacles.pop(key, None) is not None:
            self._table = None

    def delete_all(self, namespace: str = "") -> None:
        """Forget all obstacles, or those of a namespace."""
        self._obstacles = {
            key: known
            for key, known in self._obstacles.items()
            if namespace and key[0] != namespace
        }
        self._table = None

    def dismiss(self) -> None:
        """Expect no source any more; what it has said stays known."""
        self._heard = -math.inf

    def silent(self, now: float) -> str:
        """Why the source cannot be trusted at now [s], or an empty string."""
        self._notice(now)
        p = self._parameters
        if self._heard == -math.inf:
            return "no obstacle source yet" if p.required else ""
        age = now - self._heard
        return f"no obstacles heard for {age:.1f} s" if 0.0 < p.timeout < age else ""

    def ellipses(self, now: float) -> Ellipses:
        """What is there at now [s], in the order in which the obstacles were first seen.

        The growth of each is the parameter's share of its speed and the standard deviation of its
        velocity (that at most 0.3 m/s).
        """
        self._notice(now)
        table = self._table
        if table is None or table.first_expiry <= now or table.first_doubted <= now:
            self._drop_expired(now)
            table = self._table = self._tabulate(now)
        if not len(table.times):
            return Ellipses.none(now)
        ages = now - table.times
        moving = ages <= (self._parameters.timeout or COAST)
        velocities = np.where(moving[:, None], table.velocities, 0.0)
        centers = np.where(
            moving[:, None], table.centers + ages[:, None] * velocities, table.observed
        )
        growth = np.where(moving, table.growth, 0.0)
        return Ellipses(now, centers, velocities, table.semi_axes, table.angles, growth)

    def _drop_expired(self, now: float) -> None:
        expired = [key for key, known in self._obstacles.items() if known.expiry <= now]
        for key in expired:
            self.delete(key)

    def _notice(self, now: float) -> None:
        """Start the tracks anew where they are, if the clock went back."""
        if now >= self._heard - AHEAD:
            return
        self._heard = now
        for known in self._obstacles.values():
            known.track.restart(now, *known.track.observed)
            known.seen = replace(known.seen, time=now)
            known.expiry = now + known.seen.lifetime if known.seen.lifetime > 0.0 else math.inf
        self._table = None

    def _tabulate(self, now: float) -> _Table:
        rows, doubted, expiry = [], math.inf, math.inf
        share = self._parameters.tracking.growth
        for known in self._obstacles.values():
            track, seen = known.track, known.seen
            track.settle(now)
            vx, vy = track.velocity
            growth = share * math.hypot(vx, vy) + min(track.velocity_deviation, LARGEST_DOUBT)
            rows.append(
                (track.time, *track.position, vx, vy, *track.observed, *seen.semi_axes,
                 seen.angle, growth)
            )  # fmt: skip
            doubted = min(doubted, track.doubted)
            expiry = min(expiry, known.expiry)
        array = np.array(rows, dtype=float).reshape(-1, 11)
        array.flags.writeable = False
        return _Table(
            times=array[:, 0], centers=array[:, 1:3], velocities=array[:, 3:5],
            observed=array[:, 5:7], semi_axes=array[:, 7:9], angles=array[:, 9],
            growth=array[:, 10], first_expiry=expiry, first_doubted=doubted + PATIENCE,
        )  # fmt: skip
