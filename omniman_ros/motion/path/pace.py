"""Pace of motion time: slows motions down on their paths, and back up again.

A motion x(s) within limits is executed as x(s(t)): its velocity is x' p and its acceleration
x'' p^2 + x' p', with the pace p = ds/dt from 0 to 1. With p <= 1 and p' = 0 each limit holds. The
unused part of the acceleration limits bounds how fast the pace may change. The jerk limits bound
how fast p' changes, but the jerk of the resulting motion may exceed them, as in a stop; where the
pace has to fall at once, the acceleration limits alone hold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.axis_group import AxisGroup

#: Ticks from a decision to the first changed tick, so that the receiver gets the tick in time
LEAD = 3
#: Largest first derivative of the pace, whatever the limits would allow [1/s]
MAX_PACE_RATE = 10.0
#: Largest second derivative of the pace, whatever the limits would allow [1/s^2]
MAX_PACE_ACCELERATION = 200.0
#: Fraction of an acceleration limit that a change of pace may use, as between ticks the
#: acceleration is slightly larger.
MARGIN = 0.95
#: The same fraction for a change without regard to the jerk, which is larger between two ticks
MARGIN_AT_ONCE = 0.92
CHUNK = 50  #: Number of ticks that are computed together
#: Difference between two paces, or two times [s], up to which they count as equal
PACE_TOLERANCE = 1e-12
MAX_SETTLING_TIME = 600.0  #: Upper bound of the time in which the pace reaches its target [s]


@dataclass(frozen=True)
class LimitUsage(Validated):
    """Use of the limits by motions at k times, in g groups of axes; arrays (k, g)."""

    #: x' . x' over the square of the acceleration limit [s^2]
    speed: Annotated[Array, Shape("k", "g")]
    #: x' . x'' over the square of the acceleration limit [s]
    mixed: Annotated[Array, Shape("k", "g")]
    bend: Annotated[Array, Shape("k", "g")]  #: x'' . x'' over the square of the acceleration limit
    jerk: Annotated[Array, Shape("k", "g")]  #: `|x'|` over the jerk limit [s^2]

    @classmethod
    def of(
        cls, groups: tuple[AxisGroup, ...], velocities: Array, accelerations: Array
    ) -> "LimitUsage":
        """Compute the demand of velocities and accelerations (k, d) on the limits of groups."""
        parts = []
        for group in groups:
            v, a = velocities[:, group.columns], accelerations[:, group.columns]
            square, limit = (v * v).sum(1), group.acceleration**2
            mixed, bend = (v * a).sum(1) / limit, (a * a).sum(1) / limit
            parts.append((square / limit, mixed, bend, np.sqrt(square) / group.jerk))
        return cls(*(np.column_stack(columns) for columns in zip(*parts, strict=True)))

    @classmethod
    def none(cls, count: int) -> "LimitUsage":
        """Create the demand of rest at a number of times."""
        return cls(*(np.zeros((count, 1)) for _ in range(4)))

    def beside(self, other: "LimitUsage") -> "LimitUsage":
        """Return the demand of this motion and another one together."""
        names = self.__dataclass_fields__
        return LimitUsage(*(np.hstack([getattr(self, n), getattr(other, n)]) for n in names))


@dataclass(frozen=True)
class Paced(Validated):
    """Motion time at k times."""

    motion: Annotated[Array, Shape("k")]  #: (k,) motion time s [s]
    rate: Annotated[Array, Shape("k")]  #: (k,) pace p = ds/dt
    slope: Annotated[Array, Shape("k")]  #: (k,) derivative p' of the pace [1/s]

    def apply(
        self, positions: Array, velocities: Array, accelerations: Array
    ) -> tuple[Array, Array, Array]:
        """Convert x, x', x'' (k, d) with derivatives by motion time to derivatives by time."""
        p, slope = self.rate[:, None], self.slope[:, None]
        return positions, velocities * p, accelerations * p * p + velocities * slope


class Pace:
    """Motion time as a function of time.

    Args:
        demand: Returns the demand of the motions at motion times (k,) [s].
        tick: Step in which the pace changes [s].

    Attributes:
        target: Pace that is aimed for, 0 to 1.
    """

    def __init__(self, demand: Callable[[Array], LimitUsage], tick: float) -> None:
        self._demand, self._tick = demand, tick
        self.target, self._at_once = 1.0, False
        self._times: list[float] = []  # times of the knots; without knots, motion time is time
        self._motion: list[float] = []
        self._rates: list[float] = []
        self._slopes: list[float] = []  # p' from a knot to the next

    @property
    def plain(self) -> bool:
        """Whether motion time is the time itself."""
        return not self._times

    def reset(self, now: float, target: float) -> None:
        """Set motion time to `now` [s], and the pace to `target` at once, as nothing moves."""
        self.target, self._at_once = target, False
        if target == 1.0:
            self._knots([])
        else:
            self._knots([(now, now, target, 0.0)])

    def aim(
        self, target: float, now: float, since: float = -math.inf, *, at_once: bool = False
    ) -> None:
        """Set the pace to aim for.

        Args:
            since: Earliest time of a change [s]; :data:`LEAD` ticks from now are kept anyway.
            at_once: Whether a pace that falls does so without regard to the jerk limits.
        """
        if target != self.target or at_once != self._at_once:
            self._at_once = at_once
            self._replan(target, now, since)

    def refresh(self, now: float, since: float = -math.inf) -> None:
        """Plan the change to the target anew, as the motions have changed."""
        if not self._settled:
            self._replan(self.target, now, since)

    def sample(self, times: Array) -> Paced:
        """Return motion time and its rates at increasing times (k,) [s]."""
        if self.plain:
            return Paced(times, np.ones(len(times)), np.zeros(len(times)))
        self._extend(float(times[-1]))
        knots = np.array(self._times)
        i = np.maximum(np.searchsorted(knots, times, side="right") - 1, 0)
        dt = times - knots[i]
        rate, slope = np.array(self._rates)[i], np.array(self._slopes)[i]
        motion = np.array(self._motion)[i] + dt * (rate + 0.5 * dt * slope)
        return Paced(motion, rate + dt * slope, slope)

    def motion(self, now: float) -> float:
        """Return the motion time at a time [s]."""
        return now if self.plain else float(self.sample(np.array([now])).motion[0])

    def rate(self, now: float) -> float:
        """Return the pace at a time [s]."""
        return 1.0 if self.plain else float(self.sample(np.array([now])).rate[0])

    def stands(self, now: float) -> bool:
        """Return whether motion time stands still at a time [s] and from then on."""
        return self.target == 0.0 and self.rate(now) == 0.0

    def settling(self, now: float) -> float:
        """Return the time at which the target is reached [s], not before `now`."""
        end = now
        while not self._settled and end - now < MAX_SETTLING_TIME:
            end = max(self._times[-1], now) + CHUNK * self._tick
            self._extend(end)
        return max(self._times[-1], now) if self._times else now

    def copy(self) -> "Pace":
        """Return an independent pace with the same course."""
        other = Pace(self._demand, self._tick)
        other.target, other._at_once = self.target, self._at_once
        knots = zip(self._times, self._motion, self._rates, self._slopes, strict=True)
        other._knots(list(knots))
        return other

    @property
    def _settled(self) -> bool:
        return not self._times or (self._rates[-1] == self.target and self._slopes[-1] == 0.0)

    def _knots(self, rows: list[tuple[float, float, float, float]]) -> None:
        """Set the knots: time [s], motion time [s], pace, and its derivative [1/s]."""
        columns = [list(column) for column in zip(*rows, strict=True)] or [[], [], [], []]
        self._times, self._motion, self._rates, self._slopes = columns

    def _replan(self, target: float, now: float, since: float) -> None:
        begin = max(now + LEAD * self._tick, since)
        if self.plain:
            self._knots([(now, now, 1.0, 0.0)])
        here = self.sample(np.array([begin]))  # in the change to the previous target
        self.target = target
        rows = list(zip(self._times, self._motion, self._rates, self._slopes, strict=True))
        past = [row for row in rows if row[0] < begin - PACE_TOLERANCE]
        old = sum(row[0] <= now for row in past)
        motion, rate = float(here.motion[0]), float(here.rate[0])
        slope = self._next_slope(self._demand_at(motion, 0), 0, rate, past[-1][3] if past else 0.0)
        self._knots([*past[max(old - 1, 0) :], (begin, motion, rate, slope)])

    def _demand_at(self, motion: float, steps: int) -> LimitUsage:
        """Return the demand at the ticks from a motion time [s] on, two more than `steps` + 1."""
        return self._demand(motion + self._tick * np.arange(steps + 3, dtype=float))

    def _extend(self, until: float) -> None:
        dt = self._tick
        while not self._settled and self._times[-1] <= until:
            base = self._motion[-1]
            demand = self._demand_at(base, CHUNK)
            for _ in range(CHUNK):
                time, motion = self._times[-1], self._motion[-1]
                rate, slope = self._rates[-1], self._slopes[-1]
                motion += dt * (rate + 0.5 * dt * slope)
                rate = min(max(rate + dt * slope, 0.0), 1.0)
                if abs(rate - self.target) < PACE_TOLERANCE:
                    rate = self.target
                i = int((motion - base) / dt)
                self._times.append(time + dt)
                self._motion.append(motion)
                self._rates.append(rate)
                self._slopes.append(self._next_slope(demand, i, rate, slope))
                if self._settled:
                    return

    def _next_slope(self, demand: LimitUsage, i: int, rate: float, slope: float) -> float:
        dt, gap = self._tick, self.target - rate
        if gap == 0.0:
            return 0.0
        # The largest p'', and the change of p' in a tick.
        at_once = self._at_once and gap < 0.0
        jerk = 0.0 if at_once else float(demand.jerk[i : i + 3].max())
        second = 1.0 / max(jerk, 1.0 / MAX_PACE_ACCELERATION)
        change = second * dt
        # The largest p' that can return to 0 in steps of `change` at the target.
        largest = math.sqrt(0.25 * change * change + 2.0 * second * abs(gap)) - 0.5 * change
        desired = math.copysign(min(MAX_PACE_RATE, largest, abs(gap) / dt), gap)
        desired = min(max(desired, slope - change), slope + change)
        margin = MARGIN_AT_ONCE if at_once else MARGIN
        low, high = self._allowed(demand, i, min(rate + max(desired, 0.0) * dt, 1.0), margin)
        desired = min(max(desired, low), high)
        desired = min(desired, gap / dt) if gap > 0.0 else max(desired, gap / dt)
        return min(max(desired, -rate / dt), (1.0 - rate) / dt)

    def _allowed(
        self, demand: LimitUsage, i: int, rate: float, margin: float
    ) -> tuple[float, float]:
        """Return the range of p' with |x'' p^2 + x' p'| within the limits around a tick."""
        speed = np.maximum(demand.speed[i : i + 3], 1e-18)
        square = rate * rate
        middle = demand.mixed[i : i + 3] * square
        room = margin**2 - demand.bend[i : i + 3] * square * square
        root = np.sqrt(np.maximum(middle * middle + speed * room, 0.0))
        low, high = float(((-middle - root) / speed).max()), float(((root - middle) / speed).min())
        return min(low, 0.0), max(high, 0.0)


@dataclass(frozen=True)
class Window(Validated):
    """A stretch of a stream of d axes: the motion (k, d) at its times, in SI units."""

    times: Annotated[Array, Shape("k")]  #: Times (k,) [s]
    positions: Annotated[Array, Shape("k", "d")]
    velocities: Annotated[Array, Shape("k", "d")]
    accelerations: Annotated[Array, Shape("k", "d")]

    def columns(self, columns: slice) -> "Window":
        """Return the same stretch for some of the axes."""
        arrays = (self.positions, self.velocities, self.accelerations)
        return Window(self.times, *(array[:, columns] for array in arrays))

    def slowed(self, start: float, rate: float) -> "Window":
        """Return the same path, driven from `start` [s] on at a constant rate above 0."""
        times = start + (self.times - self.times[0]) / rate
        return Window(times, self.positions, self.velocities * rate, self.accelerations * rate**2)


def paced_window(
    pace: Pace, sample: Callable[[Array], tuple[Array, Array, Array]], times: Array
) -> Window:
    """Sample a motion that is driven at a pace.

    Args:
        sample: Returns x, x', x'' (k, d) of the motion at motion times (k,) [s].
        times: (k,) increasing [s].
    """
    paced = pace.sample(times)
    return Window(times, *paced.apply(*sample(paced.motion)))


HEADROOM = 0.95  #: Part of the allowed speed that the motion uses; the rest is left to feedback


@dataclass(frozen=True)
class SpeedBound(Validated):
    """Limits of speed to which the fractions of a motion limit refer."""

    linear: float  #: Linear speed of the platform [m/s]
    angular: float  #: Yaw rate [rad/s]
    #: Rate (6,) of each joint of the arm [rad/s]
    rates: Annotated[Array, Shape("j", low=0.0, unit="rad/s")]

    def pace(self, velocities: Array, platform: float, arm: float) -> float:
        """Return the largest pace, 0 to 1, at which platform and arm keep to their shares.

        The velocities (k, 9) of platform and joints are those at full pace [m/s, rad/s].

        Args:
            velocities: Velocities (k, 9) of platform and joints at full pace [m/s, m/s, rad/s,
                rad/s ...].
        """
        v = np.abs(velocities)
        linear = float(np.hypot(v[:, 0], v[:, 1]).max())
        platform_use = max(linear / self.linear, float(v[:, 2].max()) / self.angular)
        arm_use = float((v[:, 3:] / self.rates).max())
        pace = 1.0
        for use, fraction in ((platform_use, platform), (arm_use, arm)):
            if fraction < 1.0 and use > 0.0:
                pace = min(pace, HEADROOM * fraction / use)
        return pace
