"""Minimum time of the whole body along a path of the tool, within all limits.

The time-optimal profile of u (:mod:`~omniman_ros.motion.path.time_profile`) keeps speeds and
accelerations; u(t) is then averaged over a window, which bounds the jerk without leaving the path.
Slow sections are extended slightly, so that the average does not raise the speed in them. Any
limit that is still exceeded is met by stretching the whole motion in time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import AXES
from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.curve import Curve
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.planner import MAX_DURATION
from omniman_ros.motion.path.smoothing import Smoother, window_ticks
from omniman_ros.motion.path.time_profile import CELL, SpeedCap, TimeProfile, TimeProfiler
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.whole_body_path import WholeBodyPath

MAX_STRETCHES = 20  #: Number of attempts to meet all limits by stretching the motion


class PathProgress:
    """Path parameter u(t): cubic polynomials over equal intervals, at rest before and after.

    Args:
        u, rate, acceleration: (n,) u [m], u' and u'' at the ends of the polynomials.
    """

    def __init__(self, span: float, u: Array, rate: Array, acceleration: Array) -> None:
        self._span, self._u, self._rate, self._acceleration = span, u, rate, acceleration
        self._jerk: Array = np.append(np.diff(acceleration), 0.0) / span

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return self._span * (len(self._u) - 1)

    def stretched(self, factor: float) -> "PathProgress":
        """Return the same course, slower by a factor."""
        return PathProgress(
            self._span * factor,
            self._u,
            self._rate / factor,
            self._acceleration / (factor * factor),
        )

    def at(self, times: Array) -> Array:
        """Return u (m,) at times (m,) [s]."""
        return self.motion(times, 0)[0]

    def motion(self, times: Array, order: int = 2) -> list[Array]:
        """Return u and its derivatives up to an order of at most 2, each (m,), at times [s]."""
        clipped = np.clip(times, 0.0, self.duration)
        i = np.minimum((clipped / self._span).astype(np.intp), len(self._u) - 2)
        s = clipped - i * self._span
        u, rate, a, jerk = self._u[i], self._rate[i], self._acceleration[i], self._jerk[i]
        result = [u + s * (rate + s * (0.5 * a + s * jerk / 6.0))]
        if order > 0:
            result.append(rate + s * (a + 0.5 * s * jerk))
        if order > 1:
            result.append(a + s * jerk)
        return result


class ToolTimer:
    """Computes the timing of paths of the whole body.

    Args:
        options: Limits of the tool, and the reserve of the axes.

    Attributes:
        window: Length of the averaging window [ticks].
    """

    def __init__(self, limits: WholeBodyLimits, options: ToolPathOptions) -> None:
        self._limits, self._options = limits, options
        scale = 1.0 - options.reserve
        axes = limits.groups(scale, options.tolerance)
        self._groups = (
            *axes,
            AxisGroup(
                (AXES, AXES + 1, AXES + 2),
                options.linear_velocity,
                options.linear_acceleration,
                math.inf,
                options.tolerance,
            ),
            AxisGroup(
                (AXES + 3, AXES + 4, AXES + 5),
                options.angular_velocity,
                options.angular_acceleration,
                math.inf,
                options.angular_tolerance,
            ),
        )
        self._wheels = limits.speed_cap(scale)
        self.window = window_ticks(axes, TICK)

    def timed(self, path: WholeBodyPath) -> tuple[PathProgress, TimedCurve]:
        """Return the motion from rest to rest: u(t), and all axes at ticks.

        Raises:
            InputError: The motion would take too long.
        """
        samples = _Samples(path, self._groups, self._wheels)
        return self._kept(path, self._progress(samples))

    def _progress(self, samples: "_Samples") -> PathProgress:
        profile, scale = samples.profile(self._spread(samples.u, samples.tops()))
        duration = profile.duration + (self.window + 2) * TICK
        if not duration <= MAX_DURATION:
            raise InputError(
                f"the path takes over {duration:.0f} s, at most {MAX_DURATION:.0f} s are allowed"
            )
        smoother = Smoother(self.window, TICK)
        count = math.ceil(profile.duration / TICK - 1e-9) + 1 + smoother.memory
        u, _ = profile.at(TICK * np.arange(count, dtype=float))
        u = np.concatenate([np.zeros(smoother.memory), scale * u])[:, None]
        u, rate, acceleration = (column[:, 0] for column in smoother.smooth(u))
        end = float(samples.u[-1])
        u[-1], rate[-1], acceleration[-1] = end, 0.0, 0.0
        return PathProgress(TICK, np.clip(u, 0.0, end), rate, acceleration)

    def _spread(self, u: Array, top: Array) -> Array:
        """Return bounds (n,) of u' that are extended by half of the window around each sample.

        So the average does not raise the speed in a short slow section.
        """
        half = 0.5 * (self.window + 2) * TICK
        result = top.copy()
        for offset in range(1, len(u)):
            # Up to the next sample, so that everything between two samples is covered.
            ahead = u[offset:] - u[1 : len(u) - offset + 1] <= half * top[offset:]
            behind = u[offset - 1 : -1] - u[:-offset] <= half * top[:-offset]
            if not (ahead.any() or behind.any()):
                break
            np.minimum(result[:-offset], top[offset:], out=result[:-offset], where=ahead)
            np.minimum(result[offset:], top[:-offset], out=result[offset:], where=behind)
        return result

    def _kept(
        self, path: WholeBodyPath, progress: PathProgress
    ) -> tuple[PathProgress, TimedCurve]:
        for _ in range(MAX_STRETCHES):
            curve = self._curve(path, progress)
            excess = self._excess(curve)
            if excess <= 1.0:
                return progress, curve
            # Stretch to a whole number of ticks.
            ticks = math.ceil(progress.duration / TICK * excess * 1.0005)
            if not ticks * TICK <= MAX_DURATION:
                break
            progress = progress.stretched(ticks * TICK / progress.duration)
        raise InputError(f"the path takes over {MAX_DURATION:.0f} s")

    def _curve(self, path: WholeBodyPath, progress: PathProgress) -> TimedCurve:
        count = round(progress.duration / TICK)
        times: Array = TICK * np.arange(count + 1.0)
        u, rate, acceleration = (column[:, None] for column in progress.motion(times))
        q, first, second, _, _ = path.motion(u[:, 0])
        return TimedCurve(times, q, first * rate, second * rate * rate + first * acceleration)

    def _excess(self, curve: TimedCurve) -> float:
        """Return the factor by which a motion must be slowed down to keep all limits.

        It is at most 1 if the motion keeps all limits already.
        """
        limits, worst = self._limits, 0.0
        bounds = limits.velocity, limits.acceleration, limits.jerk
        for order, (_, values) in enumerate(curve.extremes()):
            if order > 0:
                fraction = float((np.abs(values) / bounds[order - 1]).max())
                worst = max(worst, fraction ** (1.0 / order))
        velocities, accelerations = curve.velocities[:, :2], curve.accelerations[:, :2]
        jerks = np.diff(accelerations, axis=0) / TICK
        for order, values in enumerate((velocities, accelerations, jerks), start=1):
            fraction = float(np.hypot(*values.T).max() / bounds[order - 1][0])
            worst = max(worst, fraction ** (1.0 / order))
        cap = limits.speed_cap(1.0)(curve.positions, curve.velocities)
        return max(worst, float(1.0 / cap.min()))


class _Samples:
    """A path at samples of u, for the time profile.

    The columns are the nine axes and the six components of the tool's twist.
    """

    def __init__(self, path: WholeBodyPath, groups: Sequence[AxisGroup], wheels: SpeedCap) -> None:
        self.u: Array = path.samples()
        self._groups, self._wheels = groups, wheels
        self._q, first, second, twist, change = path.motion(self.u)
        self._first, self._second = np.hstack([first, twist]), np.hstack([second, change])
        self._third: Array = np.diff(self._second, axis=0) / np.diff(self.u)[:, None]

    def tops(self) -> Array:
        """Return the largest u' (n,) that the first three derivatives by u allow."""
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
        """Return the fastest profile with bounds (n,) on u', and the scale of its parameter."""
        # The scale is large enough for a cell of the profile to reach from sample to sample.
        scale = max(float(top.max()), 5.0 * float(np.diff(self.u).max()) / CELL)
        groups = [replace(group, velocity=1.0) for group in self._groups]

        def cap(values: Array, _: Array) -> Array:
            bound: Array = np.interp(values[:, 0], self.u, top) / scale
            return bound

        bends = np.diff(self._first, axis=0) / np.diff(self.u)[:, None]
        sampled = _SampledCurve(
            self.u / scale, self.u[:, None], scale * self._first, scale * scale * bends
        )
        profile = TimeProfiler(groups, cap).fastest(cast(Curve, sampled))
        assert profile is not None  # a profile from rest always exists
        return profile, scale


@dataclass(frozen=True)
class _SampledCurve:
    """Samples with the interface of a :class:`Curve`: q' continuous, q'' constant between them."""

    knots: Array
    values: Array
    slopes: Array
    bends: Array

    @property
    def end(self) -> float:
        return float(self.knots[-1])

    def piece(self, u: Array) -> NDArray[np.intp]:
        index = np.searchsorted(self.knots, u, side="right") - 1
        return np.clip(index, 0, len(self.bends) - 1)

    def at(self, u: Array) -> Array:
        return np.interp(u, self.knots, self.values[:, 0])[:, None]

    def slope(self, u: Array) -> Array:
        i = self.piece(u)
        value: Array = self.slopes[i] + (u - self.knots[i])[:, None] * self.bends[i]
        return value
