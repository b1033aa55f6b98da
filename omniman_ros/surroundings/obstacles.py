"""Set of the obstacles that are reported: tracked, expired in time, available as ellipses."""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.tracking import (
    CONFIRMATION_TIME,
    ObstacleTrack,
    ReportedMotion,
    TrackingParameters,
)

Key = tuple[str, int]  #: Namespace and number of an obstacle, as those of a marker

MIN_AXIS = 1e-3  #: Length that every semi-axis must exceed [m]
MAX_AXIS = 100.0  #: Length that no semi-axis may reach [m]
#: Largest lead of an observation on the caller's clock [s]; if the clock goes back by more, the
#: tracks restart.
MAX_LEAD = 0.1
#: Age of an observation up to which an obstacle is predicted at its velocity [s], if the timeout
#: is disabled.
PREDICTION_TIME = 1.0
#: Largest standard deviation of a velocity that counts for the growth [m/s]: that of an obstacle
#: observed for the first time would block the whole workspace.
MAX_VELOCITY_DOUBT = 0.3


@dataclass(frozen=True)
class ObstacleParameters(Validated):
    """Parameters of the tracking of obstacles, and what is expected of their source."""

    tracking: TrackingParameters = inline()
    timeout: float = parameter(
        1.0,
        "Age of the last usable message at which the source counts as silent, and time that who "
        "publishes has until the first one; 0: never.",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    required: bool = parameter(
        False,
        "Whether the robot waits for obstacles before it moves although nobody publishes them.",
    )
    most: int = parameter(
        1000,
        "Largest number of obstacles; more are refused.",
        low=1,
        high=100_000,
        read_only=True,
    )


@dataclass(frozen=True, slots=True)
class Observation:
    """Observation of one obstacle.

    Attributes:
        x, y: Centre in `frame` [m].

    Raises:
        InputError: A value is not finite or implausible, a semi-axis is not above 1 mm and below
            100 m, the lifetime or the deviation is negative, or the upper side is below the lower
            one.
    """

    key: Key  #: Namespace and number of the obstacle
    time: float  #: Time of the observation on the caller's clock [s]
    x: float
    y: float
    angle: float  #: Angle of the ellipse's x axis in `frame` [rad]
    semi_axes: tuple[float, float]  #: (a, b) semi-axes along the ellipse's x and y axes [m]
    #: Time for which it stays without being observed again [s]; 0 means for ever
    lifetime: float = 0.0
    #: Heights of its lower and its upper side above the floor [m]; by default it has no ends
    heights: tuple[float, float] = (-math.inf, math.inf)
    #: Frame of the observation, which does not move with the robot; empty for odom
    frame: str = ""
    #: (x, y) velocity in `frame` [m/s] if the source tracks the obstacle, None if not
    velocity: tuple[float, float] | None = None
    velocity_deviation: float = 0.0  #: Standard deviation of either component of it [m/s]

    def __post_init__(self) -> None:
        if not math.isfinite(self.time):
            raise InputError(f"time {self.time} is not finite")
        if not (abs(self.x) <= plausible.LENGTH and abs(self.y) <= plausible.LENGTH):
            plausible.demand(np.array([self.x, self.y]), plausible.LENGTH, "position")
        if not abs(self.angle) <= plausible.ANGLE:
            plausible.demand(np.array([self.angle]), plausible.ANGLE, "angle")
        a, b = self.semi_axes
        if not (MIN_AXIS < a < MAX_AXIS and MIN_AXIS < b < MAX_AXIS):
            raise InputError(
                f"semi-axes ({a}, {b}) m must be above {MIN_AXIS:g} and below {MAX_AXIS:g}"
            )
        if not 0.0 <= self.lifetime < math.inf:
            raise InputError(f"lifetime {self.lifetime} s must be finite and not negative")
        if not self.heights[0] <= self.heights[1]:
            raise InputError(f"heights {self.heights} m must be a lower and an upper one")
        if self.velocity is not None:
            plausible.demand(np.array(self.velocity), plausible.SPEED, "velocity")
            if not 0.0 <= self.velocity_deviation < math.inf:
                raise InputError(
                    f"the velocity's deviation {self.velocity_deviation} m/s must be finite and "
                    "not negative"
                )


@dataclass(slots=True)
class _Obstacle:
    """Track, last observation and expiry time [s] of an obstacle."""

    track: ObstacleTrack | ReportedMotion
    seen: Observation
    expiry: float


@dataclass(frozen=True)
class _Table:
    """All obstacles as arrays, valid until a message changes them."""

    times: Array
    centers: Array
    velocities: Array
    observed: Array
    semi_axes: Array
    angles: Array
    growth: Array
    lower: Array
    upper: Array
    first_expiry: float
    first_doubted: float


class ObstacleSet:
    """Obstacles by their keys. Those that come without a velocity are tracked.

    An obstacle stays until it is changed or deleted, or its lifetime is over (counted from its
    arrival). While its observation is younger than the timeout, it is predicted at constant
    velocity (MPC 2021, 4.3); after that, if the source is not silent, it counts as being at rest
    at its last observed position.
    """

    def __init__(self, parameters: ObstacleParameters) -> None:
        self._parameters = parameters
        self._obstacles: dict[Key, _Obstacle] = {}
        self._latest = -math.inf
        self._table: _Table | None = None

    def configure(self, parameters: ObstacleParameters) -> None:
        """Use other parameters; existing tracks keep those they began with."""
        self._parameters = parameters
        self._table = None

    def __len__(self) -> int:
        return len(self._obstacles)

    def add(self, observation: Observation, now: float) -> None:
        """Add an observation at a time [s]; one that is older than the obstacle's last is ignored.

        Raises:
            InputError: The observation is ahead of `now` by more than MAX_LEAD, or there are too
                many obstacles.
        """
        self._check_clock(now)
        key, time = observation.key, observation.time
        if time > now + MAX_LEAD:
            raise InputError(f"obstacle {key}: was observed {time - now:.3f} s ahead of now")
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
            self._obstacles[key] = _Obstacle(self._begun(observation), observation, expiry)
        elif time < known.seen.time:
            return
        else:
            # The same observation again keeps it alive, and may change its shape.
            if observation.velocity is None and type(known.track) is ObstacleTrack:
                known.track.observe(time, observation.x, observation.y)
            else:
                known.track = self._begun(observation)
            known.seen, known.expiry = observation, expiry
        self._latest = now
        self._table = None

    def _begun(self, seen: Observation) -> ObstacleTrack | ReportedMotion:
        """Return the motion of an obstacle after an observation with a velocity, or the first."""
        p = self._parameters.tracking
        if seen.velocity is None:
            return ObstacleTrack(p, seen.time, seen.x, seen.y)
        place = (seen.x, seen.y)
        return ReportedMotion(p, seen.time, place, seen.velocity, seen.velocity_deviation)

    def delete(self, key: Key) -> None:
        """Delete an obstacle if it is known."""
        if self._obstacles.pop(key, None) is not None:
            self._table = None

    def delete_all(self, namespace: str = "") -> None:
        """Delete all obstacles, or those of a namespace."""
        self._obstacles = {
            key: known
            for key, known in self._obstacles.items()
            if namespace and key[0] != namespace
        }
        self._table = None

    def ellipses(self, now: float) -> Ellipses:
        """Return the obstacles at a time [s], in the order in which they were first seen.

        The growth of each is its speed times the parameter `growth`, plus the standard deviation
        of its velocity, at most MAX_VELOCITY_DOUBT.
        """
        self._check_clock(now)
        table = self._table
        if table is None or table.first_expiry <= now or table.first_doubted <= now:
            self._drop_expired(now)
            table = self._table = self._tabulate(now)
        if not len(table.times):
            return Ellipses.none(now)
        ages = now - table.times
        moving = ages <= (self._parameters.timeout or PREDICTION_TIME)
        velocities = np.where(moving[:, None], table.velocities, 0.0)
        centers = np.where(
            moving[:, None], table.centers + ages[:, None] * velocities, table.observed
        )
        growth = np.where(moving, table.growth, 0.0)
        return Ellipses(
            now,
            centers,
            velocities,
            table.semi_axes,
            table.angles,
            growth,
            table.lower,
            table.upper,
        )

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the obstacles, in the order of `ellipses` at the same time."""
        return tuple(self._obstacles)

    def _drop_expired(self, now: float) -> None:
        expired = [key for key, known in self._obstacles.items() if known.expiry <= now]
        for key in expired:
            self.delete(key)

    def _check_clock(self, now: float) -> None:
        """Restart the tracks at their last observations if the clock went back."""
        if now >= self._latest - MAX_LEAD:
            return
        self._latest = now
        for known in self._obstacles.values():
            known.track.restart(now, *known.track.observed)
            known.seen = replace(known.seen, time=now)
            known.expiry = now + known.seen.lifetime if known.seen.lifetime > 0.0 else math.inf
        self._table = None

    def _tabulate(self, now: float) -> _Table:
        """Return all obstacles as arrays, in the order of their first observation."""
        rows, doubted, expiry = [], math.inf, math.inf
        fraction = self._parameters.tracking.growth
        for known in self._obstacles.values():
            track, seen = known.track, known.seen
            track.settle(now)
            vx, vy = track.velocity
            growth = fraction * math.hypot(vx, vy) + min(
                track.velocity_deviation, MAX_VELOCITY_DOUBT
            )
            rows.append(
                (
                    track.time,
                    *track.position,
                    vx,
                    vy,
                    *track.observed,
                    *seen.semi_axes,
                    seen.angle,
                    growth,
                    *seen.heights,
                )
            )
            doubted = min(doubted, track.doubted)
            expiry = min(expiry, known.expiry)
        array = np.array(rows, dtype=float).reshape(-1, 13)
        array.flags.writeable = False
        return _Table(
            times=array[:, 0],
            centers=array[:, 1:3],
            velocities=array[:, 3:5],
            observed=array[:, 5:7],
            semi_axes=array[:, 7:9],
            angles=array[:, 9],
            growth=array[:, 10],
            lower=array[:, 11],
            upper=array[:, 12],
            first_expiry=expiry,
            first_doubted=doubted + CONFIRMATION_TIME,
        )
