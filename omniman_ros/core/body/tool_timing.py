"""When the whole body is where along a path of the tool: the least time within all limits.

The time-optimal profile of u (:mod:`~omniman_ros.core.path.time_profile`) keeps speeds and
accelerations; u(t) is then averaged over a window, so that it has a jerk and yet the path is not
left. So that the average takes no speed from beside into a short slow place, slow places are made
a little longer; what is still over a limit is taken out by stretching all of the motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.body.body_way import BodyWay
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import AXES
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.axes import AxisGroup
from omniman_ros.core.path.curve import Curve
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.path.planner import LONGEST
from omniman_ros.core.path.smoothing import Smoother, window_ticks
from omniman_ros.core.path.time_profile import CELL, SpeedCap, TimeProfile, TimeProfiler
from omniman_ros.core.path.timed_curve import TimedCurve

Array = NDArray[np.float64]

STRETCHES = 20


class Clock:
    """u(t): cubic polynomials between equal spans of time, at rest before and after.

    Args:
        span: Of the polynomials [s].
        u, rate, rise: (n,) u, u' and u'' at their ends.
    """

    def __init__(self, span: float, u: Array, rate: Array, rise: Array) -> None:
        self._span, self._u, self._rate, self._rise = span, u, rate, rise
        self._jerk: Array = np.append(np.diff(rise), 0.0) / span

    @property
    def duration(self) -> float:
        """From rest to rest [s]."""
        return self._span * (len(self._u) - 1)

    def stretched(self, factor: float) -> "Clock":
        """The same, slower by a factor."""
        return Clock(
            self._span * factor, self._u, self._rate / factor, self._rise / (factor * factor)
        )

    def at(self, times: Array) -> Array:
        """Give u (m,) at times (m,) [s]."""
        return self.motion(times, 0)[0]

    def motion(self, times: Array, order: int = 2) -> list[Array]:
        """Give u and its rates up to an order of at most 2, each (m,), at times (m,) [s]."""
        held = np.clip(times, 0.0, self.duration)
        i = np.minimum((held / self._span).astype(np.intp), len(self._u) - 2)
        s = held - i * self._span
        u, rate, rise, jerk = self._u[i], self._rate[i], self._rise[i], self._jerk[i]
        result = [u + s * (rate + s * (0.5 * rise + s * jerk / 6.0))]
        if order > 0:
            result.append(rate + s * (rise + 0.5 * s * jerk))
        if order > 1:
            result.append(rise + s * jerk)
        return result


class ToolTimer:
    """Times ways of the whole body.

    Args:
        limits: Of the nine axes.
        options: Limits of the tool, and the axes' reserve.
    """

    def __init__(self, limits: BodyLimits, options: ToolPathOptions) -> None:
        self._limits, self._options = limits, options
        share = 1.0 - options.reserve
        axes = limits.groups(share, options.tolerance)
        self._groups = (
            *axes,
            AxisGroup(
                (AXES, AXES + 1, AXES + 2), options.linear_velocity, options.linear_acceleration,
                math.inf, options.tolerance,
            ),
            AxisGroup(
                (AXES + 3, AXES + 4, AXES + 5), options.angular_velocity,
                options.angular_acceleration, math.inf, options.angular_tolerance,
            ),
        )  # fmt: skip
        self._wheels = limits.cap(share)
        self.window = window_ticks(axes, TICK)

    def timed(self, way: BodyWay) -> tuple[Clock, TimedCurve]:
        """The motion from rest to rest: u(t), and all axes at ticks.

        Raises:
            InputError: It would take too long.
        """
        samples = _Samples(way, self._groups, self._wheels)
        return self._kept(way, self._clock(samples))

    # ---- parts ------------------------------------------------------------------------------

    def _clock(self, samples: "_Samples") -> Clock:
        """The fastest u(t) below the bounds of u' at the samples, averaged."""
        profile, scale = samples.profile(self._spread(samples.u, samples.tops()))
        lasts = profile.duration + (self.window + 2) * TICK
        if not lasts <= LONGEST:
            raise InputError(f"the path takes over {lasts:.0f} s, at most {LONGEST:.0f} s")
        smoother = Smoother(self.window, TICK)
        count = math.ceil(profile.duration / TICK - 1e-9) + 1 + smoother.memory
        u, _ = profile.at(TICK * np.arange(count, dtype=float))
        u = np.concatenate([np.zeros(smoother.memory), scale * u])[:, None]
        u, rate, rise = (column[:, 0] for column in smoother.smooth(u))
        end = float(samples.u[-1])
        u[-1], rate[-1], rise[-1] = end, 0.0, 0.0
        return Clock(TICK, np.clip(u, 0.0, end), rate, rise)

    def _spread(self, u: Array, top: Array) -> Array:
        """Bounds (n,) of u' that last for half of the window before and after each sample.

        So the average cannot take speed from beside into a short slow place.
        """
        half = 0.5 * (self.window + 2) * TICK
        result = top.copy()
        for offset in range(1, len(u)):
            # To the sample before, so that all between two samples is in.
            ahead = u[offset:] - u[1 : len(u) - offset + 1] <= half * top[offset:]
            behind = u[offset - 1 : -1] - u[:-offset] <= half * top[:-offset]
            if not (ahead.any() or behind.any()):
                break
            np.minimum(result[:-offset], top[offset:], out=result[:-offset], where=ahead)
            np.minimum(result[offset:], top[:-offset], out=result[offset:], where=behind)
        return result

    def _kept(self, way: BodyWay, clock: Clock) -> tuple[Clock, TimedCurve]:
        """The motion, stretched until it keeps all limits."""
        for _ in range(STRETCHES):
            curve = self._curve(way, clock)
            excess = self._excess(curve)
            if excess <= 1.0:
                return clock, curve
            # A whole number of ticks.
            ticks = math.ceil(clock.duration / TICK * excess * 1.0005)
            if not ticks * TICK <= LONGEST:
                break
            clock = clock.stretched(ticks * TICK / clock.duration)
        raise InputError(f"the path takes over {LONGEST:.0f} s")

    def _curve(self, way: BodyWay, clock: Clock) -> TimedCurve:
        count = round(clock.duration / TICK)
        times: Array = TICK * np.arange(count + 1.0)
        u, rate, rise = (column[:, None] for column in clock.motion(times))
        q, first, second, _, _ = way.motion(u[:, 0])
        return TimedCurve(times, q, first * rate, second * rate * rate + first * rise)

    def _excess(self, curve: TimedCurve) -> float:
        """By what factor a motion has to be slower to keep all limits; at most 1 for none."""
        limits, worst = self._limits, 0.0
        bounds = limits.velocity, limits.acceleration, limits.jerk
        for order, (_, values) in enumerate(curve.extremes()):
            if order > 0:
                share = float((np.abs(values) / bounds[order - 1]).max())
                worst = max(worst, share ** (1.0 / order))
        speeds, rises = curve.velocities[:, :2], curve.accelerations[:, :2]
        jerks = np.diff(rises, axis=0) / TICK
        for order, values in enumerate((speeds, rises, jerks), start=1):
            share = float(np.hypot(*values.T).max() / bounds[order - 1][0])
            worst = max(worst, share ** (1.0 / order))
        cap = limits.cap(1.0)(curve.positions, curve.velocities)
        return max(worst, float(1.0 / cap.min()))


class _Samples:
    """A way at samples of u, for the profile.

    Columns are the nine axes and the tool's six coordinates of motion.
    """

    def __init__(self, way: BodyWay, groups: Sequence[AxisGroup], wheels: SpeedCap) -> None:
        self.u: Array = way.samples()
        self._groups, self._wheels = groups, wheels
        self._q, first, second, twist, change = way.motion(self.u)
        self._first, self._second = np.hstack([first, twist]), np.hstack([second, change])
        self._third: Array = np.diff(self._second, axis=0) / np.diff(self.u)[:, None]

    def tops(self) -> Array:
        """Largest u' (n,) that speeds, the way's bend and its change allow."""
        result: Array = self._wheels(self._q, self._first[:, :AXES])
        before, after = np.vstack([self._third[:1], self._third]), self._third
        after = np.vstack([after, after[-1:]])
        with np.errstate(divide="ignore"):
            for group in self._groups:
                result = np.minimum(result, group.velocity / group.norm(self._first))
                result = np.minimum(result, np.sqrt(group.acceleration / group.norm(self._second)))
                third = np.maximum(group.norm(before), group.norm(after))
                result = np.minimum(result, np.cbrt(group.jerk / third))
        return result

    def profile(self, top: Array) -> tuple[TimeProfile, float]:
        """The fastest from rest to rest with bounds (n,) on u', and u over its u."""
        # So large that a cell of the profile is from sample to sample.
        scale = max(float(top.max()), 5.0 * float(np.diff(self.u).max()) / CELL)
        groups = [replace(group, velocity=1.0) for group in self._groups]

        def cap(values: Array, _: Array) -> Array:
            bound: Array = np.interp(values[:, 0], self.u, top) / scale
            return bound

        bends = np.diff(self._first, axis=0) / np.diff(self.u)[:, None]
        sampled = _Sampled(
            self.u / scale, self.u[:, None], scale * self._first, scale * scale * bends
        )
        profile = TimeProfiler(groups, cap).fastest(cast(Curve, sampled))
        assert profile is not None  # from rest there is always a way
        return profile, scale


@dataclass(frozen=True)
class _Sampled:
    """Samples in the shape of a :class:`Curve`: q' is continuous, q'' constant between them."""

    knots: Array
    values: Array
    slopes: Array
    bends: Array

    @property
    def end(self) -> float:
        return float(self.knots[-1])

    def piece(self, u: Array) -> NDArray[np.intp]:
        found = np.searchsorted(self.knots, u, side="right") - 1
        return np.clip(found, 0, len(self.bends) - 1)

    def at(self, u: Array) -> Array:
        return np.interp(u, self.knots, self.values[:, 0])[:, None]

    def slope(self, u: Array) -> Array:
        i = self.piece(u)
        value: Array = self.slopes[i] + (u - self.knots[i])[:, None] * self.bends[i]
        return value
