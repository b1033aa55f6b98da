"""Motion of the whole body along a path of the tool: all nine axes, and their minimum time.

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
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.redundancy_resolver import RobotConfigurations
from omniman_ros.motion.whole_body.tool_curve import ToolCurve

SAMPLE_SPACING = 0.005  #: Largest distance between samples [m of u]
MIN_INTERVALS = 20  #: Smallest number of intervals between samples
SAME_SAMPLE = 1e-6  #: Distance up to which two samples count as one [m of u]
DIFFERENCE_STEP = 1e-5  #: Step of the numerical derivative of the Jacobian [m of u]


class PlatformSpline:
    """Uniform cubic B-spline with poses of the platform as control points, mirrored at its ends.

    It smooths its control points slightly, but starts and ends exactly at the first and last.

    Args:
        points: (n + 1, 3) poses at equally spaced parameters, n >= 1.
        end: Parameter of the last pose; that of the first is 0.
    """

    def __init__(self, points: Array, end: float) -> None:
        first, last = 2.0 * points[0] - points[1], 2.0 * points[-1] - points[-2]
        self._points = np.vstack([first, points, last])
        self._space = end / (len(points) - 1)

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Return poses (m, 3) at u (m,), and two derivatives."""
        i = np.clip((u / self._space).astype(np.intp), 0, len(self._points) - 4)
        s = (u / self._space - i)[:, None]
        a, b, c, d = (self._points[i + k] for k in range(4))
        # Computed from differences, so that no precision is lost far from the origin.
        ab, bc, cd = b - a, c - b, d - c
        bend, jerk = bc - ab, cd - 2.0 * bc + ab
        slope = 0.5 * (ab + bc)
        pose = b + bend / 6.0 + s * (slope + s * (0.5 * bend + s * jerk / 6.0))
        h = self._space
        return pose, (slope + s * (bend + 0.5 * s * jerk)) / h, (bend + s * jerk) / (h * h)


class WholeBodyPath:
    """Nine axes as functions of u, with the tool exactly on its path.

    Args:
        branch: Branch of the arm's inverse kinematics, :meth:`ArmModel.inverse`.
    """

    def __init__(
        self,
        model: WholeBodyModel,
        tool: ToolCurve,
        configurations: RobotConfigurations,
        branch: int,
    ) -> None:
        self._model, self._branch = model, branch
        self.tool = tool
        self._nodes, self._arm = configurations.at, configurations.arm
        self._platform = PlatformSpline(configurations.platform, tool.end)

    @property
    def end(self) -> float:
        """Parameter u at the end of the path [m]."""
        return self.tool.end

    def samples(self) -> Array:
        """Return values (n,) of u between which the second derivative is approximately linear."""
        even = np.linspace(
            0.0, self.end, 1 + max(MIN_INTERVALS, math.ceil(self.end / SAMPLE_SPACING))
        )
        u: Array = np.unique(np.concatenate([even, self.tool.knots]))
        u = u[np.concatenate([[True], np.diff(u) > SAME_SAMPLE])]
        u[-1] = self.end
        return u

    def axes(self, u: Array) -> Array:
        """Return all axes (m, 9) at u (m,)."""
        return self._axes(u, self._platform.motion(u)[0], self.tool.pose(u))

    def motion(self, u: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return axes (m, 9), two derivatives, and the tool's twist (m, 6) and its derivative.

        All derivatives are by u. The second one solves J q'' = a - J' q' for the arm's part.
        """
        pose, twist, change = self.tool.motion(u)
        platform, rate, bend = self._platform.motion(u)
        q = self._axes(u, platform, pose)
        jacobian = self._model.jacobian(q)
        arm, base = jacobian[:, :, 3:], jacobian[:, :, :3]
        first = np.hstack([rate, _solved(arm, twist - _times(base, rate))])
        difference = self._model.jacobian(q + DIFFERENCE_STEP * first)
        difference -= self._model.jacobian(q - DIFFERENCE_STEP * first)
        drift = _times(difference, first) / (2.0 * DIFFERENCE_STEP)  # J' q'
        second = np.hstack([bend, _solved(arm, change - drift - _times(base, bend))])
        return q, first, second, twist, change

    def _axes(self, u: Array, platform: Array, pose: Array) -> Array:
        """Return all axes (m, 9) for poses of the platform (m, 3) and of the tool (m, 4, 4)."""
        near = np.column_stack([np.interp(u, self._nodes, joint) for joint in self._arm.T])
        return np.hstack([platform, self._model.arm_angles(platform, pose, self._branch, near)])


def _times(matrix: Array, vectors: Array) -> Array:
    result: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return result


def _solved(matrix: Array, vectors: Array) -> Array:
    solution = np.linalg.solve(matrix, vectors[:, :, None])[:, :, 0]
    return np.asarray(solution, dtype=float)


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
