"""How fast time passes for what moves: slows motions on their paths, and brings them back.

A motion x(s) within limits is driven as x(s(t)): its velocity is x' p and its acceleration
x'' p^2 + x' p', with the pace p = ds/dt from 0 to 1. With p <= 1 and p' = 0 each limit holds; how
fast the pace may change is what is left of the accelerations. The jerk limits set how fast p'
changes, but do not hold for the sum: what slows down may be felt, as a stop may.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.axes import AxisGroup

Array = NDArray[np.float64]

LEAD = 3
"""Ticks from a decision to the first tick that it changes: the receiver must hear of it first."""
FASTEST = 10.0
"""Largest change of the pace, whatever the limits would allow [1/s] ..."""
SHARPEST = 200.0
"""... and of that [1/s^2]."""
MARGIN = 0.95
"""Share of an acceleration limit that a change of pace may use: between ticks there is more."""
CHUNK = 50
"""Ticks that are looked at together."""
STANDING = 1e-12
LONGEST = 600.0
"""A stop on the path takes no longer [s]."""


@dataclass(frozen=True)
class Demand:
    """What motions ask of their limits at k times, in g groups; arrays (k, g).

    Attributes:
        speed: x' . x' over the square of the largest acceleration [s^2].
        mixed: x' . x'' over the same [s].
        bend: x'' . x'' over the same.
        jerk: |x'| over the largest jerk [s^2].
    """

    speed: Array
    mixed: Array
    bend: Array
    jerk: Array

    @classmethod
    def of(
        cls, groups: tuple[AxisGroup, ...], velocities: Array, accelerations: Array
    ) -> "Demand":
        """Of velocities and accelerations (k, d)."""
        parts = []
        for group in groups:
            v, a = velocities[:, group.columns], accelerations[:, group.columns]
            square, limit = (v * v).sum(1), group.acceleration**2
            mixed, bend = (v * a).sum(1) / limit, (a * a).sum(1) / limit
            parts.append((square / limit, mixed, bend, np.sqrt(square) / group.jerk))
        return cls(*(np.column_stack(columns) for columns in zip(*parts, strict=True)))

    @classmethod
    def none(cls, count: int) -> "Demand":
        """Nothing moves at so many times."""
        return cls(*(np.zeros((count, 1)) for _ in range(4)))

    def beside(self, other: "Demand") -> "Demand":
        """Both together."""
        names = self.__dataclass_fields__
        return Demand(*(np.hstack([getattr(self, n), getattr(other, n)]) for n in names))


@dataclass(frozen=True)
class Paced:
    """Motion time (k,) [s], its rate p and p' [1/s], at k times."""

    motion: Array
    rate: Array
    slope: Array

    def apply(
        self, positions: Array, velocities: Array, accelerations: Array
    ) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) in time, from those in motion time."""
        p, slope = self.rate[:, None], self.slope[:, None]
        return positions, velocities * p, accelerations * p * p + velocities * slope


class Pace:
    """Motion time as a function of time.

    Args:
        demand: What the motions ask at motion times (k,) [s].
        tick: Step in which the pace changes [s].

    Attributes:
        target: Where the pace goes, 0 to 1.
    """

    def __init__(self, demand: Callable[[Array], Demand], tick: float) -> None:
        self._demand, self._tick = demand, tick
        self.target = 1.0
        self._times: list[float] = []  # of the knots; none: motion time is time
        self._motion: list[float] = []
        self._rates: list[float] = []
        self._slopes: list[float] = []  # from a knot to the next

    @property
    def plain(self) -> bool:
        """Whether motion time is time."""
        return not self._times

    def reset(self, now: float, target: float) -> None:
        """Nothing moves: motion time is time now, and passes at the target's rate."""
        self.target = target
        if target == 1.0:
            self._knots([])
        else:
            self._knots([(now, now, target, 0.0)])

    def aim(self, target: float, now: float, since: float = -math.inf) -> None:
        """Set where the pace goes.

        Args:
            target: 0 to 1.
            now: Time [s].
            since: No change before this time [s]; nor before the receiver can hear of it.
        """
        if target != self.target:
            self._begin_again(target, now, since)

    def refresh(self, now: float, since: float = -math.inf) -> None:
        """What moves has changed: the way to the target is found anew."""
        if not self._settled:
            self._begin_again(self.target, now, since)

    def sample(self, times: Array) -> Paced:
        """Motion time and its rates at times (k,) [s] that increase."""
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
        """Motion time at a time [s]."""
        return now if self.plain else float(self.sample(np.array([now])).motion[0])

    def rate(self, now: float) -> float:
        """The pace at a time [s]."""
        return 1.0 if self.plain else float(self.sample(np.array([now])).rate[0])

    def stands(self, now: float) -> bool:
        """Whether it stands still at a time [s], and stays so."""
        return self.target == 0.0 and self.rate(now) == 0.0

    def settling(self, now: float) -> float:
        """When the target is reached [s], a time not before now."""
        end = now
        while not self._settled and end - now < LONGEST:
            end = max(self._times[-1], now) + CHUNK * self._tick
            self._extend(end)
        return max(self._times[-1], now) if self._times else now

    def copy(self) -> "Pace":
        """Another that goes the same way."""
        other = Pace(self._demand, self._tick)
        other.target = self.target
        knots = zip(self._times, self._motion, self._rates, self._slopes, strict=True)
        other._knots(list(knots))
        return other

    # ---- parts ------------------------------------------------------------------------------

    @property
    def _settled(self) -> bool:
        return not self._times or (self._rates[-1] == self.target and self._slopes[-1] == 0.0)

    def _knots(self, rows: list[tuple[float, float, float, float]]) -> None:
        columns = [list(column) for column in zip(*rows, strict=True)] or [[], [], [], []]
        self._times, self._motion, self._rates, self._slopes = columns

    def _begin_again(self, target: float, now: float, since: float) -> None:
        """Forget what was to come, and what was long ago."""
        begin = max(now + LEAD * self._tick, since)
        if self.plain:
            self._knots([(now, now, 1.0, 0.0)])
        here = self.sample(np.array([begin]))  # on the way to the target there was
        self.target = target
        rows = list(zip(self._times, self._motion, self._rates, self._slopes, strict=True))
        past = [row for row in rows if row[0] < begin - STANDING]
        old = sum(row[0] <= now for row in past)
        motion, rate = float(here.motion[0]), float(here.rate[0])
        slope = self._next_slope(self._demand_at(motion, 0), 0, rate, past[-1][3] if past else 0.0)
        self._knots([*past[max(old - 1, 0) :], (begin, motion, rate, slope)])

    def _demand_at(self, motion: float, steps: int) -> Demand:
        return self._demand(motion + self._tick * np.arange(steps + 3, dtype=float))

    def _extend(self, until: float) -> None:
        """Knots up to a time, or to where nothing changes any more."""
        dt = self._tick
        while not self._settled and self._times[-1] <= until:
            base = self._motion[-1]
            demand = self._demand_at(base, CHUNK)
            for _ in range(CHUNK):
                time, motion = self._times[-1], self._motion[-1]
                rate, slope = self._rates[-1], self._slopes[-1]
                motion += dt * (rate + 0.5 * dt * slope)
                rate = min(max(rate + dt * slope, 0.0), 1.0)
                if abs(rate - self.target) < STANDING:
                    rate = self.target
                i = int((motion - base) / dt)
                self._times.append(time + dt)
                self._motion.append(motion)
                self._rates.append(rate)
                self._slopes.append(self._next_slope(demand, i, rate, slope))
                if self._settled:
                    return

    def _next_slope(self, demand: Demand, i: int, rate: float, slope: float) -> float:
        """Slope p' of the next tick: towards the target within what the limits leave."""
        dt, gap = self._tick, self.target - rate
        if gap == 0.0:
            return 0.0
        sharp = 1.0 / max(float(demand.jerk[i : i + 3].max()), 1.0 / SHARPEST)
        change = sharp * dt
        # The largest from which p' can come back to 0 in steps of `change` at the target.
        most = math.sqrt(0.25 * change * change + 2.0 * sharp * abs(gap)) - 0.5 * change
        wanted = math.copysign(min(FASTEST, most, abs(gap) / dt), gap)
        wanted = min(max(wanted, slope - change), slope + change)
        low, high = self._allowed(demand, i, min(rate + max(wanted, 0.0) * dt, 1.0))
        wanted = min(max(wanted, low), high)
        wanted = min(wanted, gap / dt) if gap > 0.0 else max(wanted, gap / dt)
        return min(max(wanted, -rate / dt), (1.0 - rate) / dt)

    def _allowed(self, demand: Demand, i: int, rate: float) -> tuple[float, float]:
        """Least and largest p' with |x'' p^2 + x' p'| within the limits around a tick."""
        speed = np.maximum(demand.speed[i : i + 3], 1e-18)
        square = rate * rate
        middle = demand.mixed[i : i + 3] * square
        room = MARGIN**2 - demand.bend[i : i + 3] * square * square
        root = np.sqrt(np.maximum(middle * middle + speed * room, 0.0))
        low, high = float(((-middle - root) / speed).max()), float(((root - middle) / speed).min())
        return min(low, 0.0), max(high, 0.0)
