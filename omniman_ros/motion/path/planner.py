"""Planning of a motion through points: route, time profile, ticks."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path import polyline
from omniman_ros.motion.path.axis_group import AxisGroup, max_utilisation
from omniman_ros.motion.path.curve import STRAIGHT, Curve
from omniman_ros.motion.path.smoothing import Smoother, deviation, window_ticks
from omniman_ros.motion.path.time_profile import SpeedCap, TimeProfile, TimeProfiler
from omniman_ros.motion.path.trajectory import Ticks, concatenate

FINE_SIMPLIFICATION = 0.04  #: Fraction of the tolerance by which points may always be omitted
#: Fraction of the tolerance by which points may be omitted where that makes the motion faster
COARSE_SIMPLIFICATION = 0.5
COARSE_GAIN = 0.95  #: Fraction of the duration below which the coarse simplification is chosen
MAX_DURATION = 3600.0  #: Longest trajectory [s]
MIN_SCALE = 1e-4  #: Smallest scale on which points are compared [m, rad]
#: Rate u' up to which a motion is at rest, and distance in u [s] that counts as none
AT_REST = 1e-9
#: Length of the straight line out of a motion, relative to its shortest stopping distance
EXIT_LENGTH = 1.1


class CurveSequence:
    """Sequence of curves, each from the end of the one before, with a rest at the end of each."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.curves = tuple(curves)
        self._before = np.concatenate([[0.0], np.cumsum([curve.end for curve in curves])])

    def progress(self, section: int, u: Array) -> Array:
        """Return the completed fraction (k,) of the route at u (k,) [s] of a section, 0 to 1."""
        fraction: Array = (self._before[section] + u) / self._before[-1]
        return fraction


@dataclass(frozen=True)
class Plan:
    """A route and a motion along it."""

    route: CurveSequence  #: Curves of the path
    ticks: Ticks  #: Motion at the ticks, with a final rest that lasts as long as the smoothing
    bound: float  #: Minimum time for the same curves without jerk limits [s]
    duration: float  #: Duration of the motion [s]


class PathPlanner:
    """Plans the motion of d coordinates through points.

    Args:
        groups: Limits of the coordinates; each of the d coordinates is in exactly one group.
        cap: Bound on u' at points of a curve besides 1; None if there is none.
        limit_scale: Fraction of all speed and acceleration limits that is used.

    Attributes:
        smoother: Filter that the ticks are meant for; the same for each limit scale.
    """

    def __init__(
        self,
        groups: Sequence[AxisGroup],
        dt: float,
        cap: SpeedCap | None = None,
        limit_scale: float = 1.0,
    ) -> None:
        self.dt, self.limit_scale = dt, limit_scale
        self._full = (groups, dt, cap)
        if limit_scale < 1.0:
            cap = _scaled(cap, limit_scale)
        self._speeds = [group.velocity for group in groups]
        window = window_ticks(groups, dt)
        self.smoother = Smoother(window, dt)
        self._smear = [deviation(group.acceleration, window, dt) for group in groups]
        groups = [
            replace(group, acceleration=limit_scale * group.acceleration) for group in groups
        ]
        self._groups = groups
        self._accelerations = [group.acceleration for group in groups]
        self._profiler = TimeProfiler(groups, cap)
        self._scale = np.ones(sum(len(group.columns) for group in groups))
        for group in groups:
            self._scale[list(group.columns)] = max(group.tolerance, MIN_SCALE)

    @property
    def groups(self) -> tuple[AxisGroup, ...]:
        """Limits that the planner uses, with scaled accelerations."""
        return tuple(self._groups)

    def slower(self, limit_scale: float) -> "PathPlanner":
        """Return a planner for the same routes with a fraction of all speeds and accelerations."""
        return PathPlanner(*self._full, limit_scale)

    def plan(self, points: Array) -> Plan:
        """Plan from rest at the first of the points (k, d) to rest at the last, k >= 1.

        Raises:
            InputError: The motion would take too long, or all points are the same.
        """
        return self._chosen(points, None)

    def plan_on(self, position: Array, velocity: Array, points: Array) -> Plan:
        """Plan from a motion: straight out of it, as far as a stop takes, then to the points.

        Args:
            velocity: (d,) present velocity, not zero.
            points: (k, d) points to drive to, with rest at the last.

        Raises:
            InputError: The motion would take too long.
        """
        tip = self.stop_point(position, velocity)
        return self._chosen(np.vstack([position, tip, points]), velocity)

    def stop_point(self, position: Array, velocity: Array) -> Array:
        """Return the point (d,) at which the straight line out of a motion ends."""
        rate = float(max_utilisation(self._groups, velocity, self._speeds))
        slope = velocity / rate
        deceleration = 1.0 / float(max_utilisation(self._groups, slope, self._accelerations))
        point: Array = position + slope * (EXIT_LENGTH * rate * rate / (2.0 * deceleration))
        return point

    def drive(self, route: CurveSequence, section: int, u: float, rate: float) -> Ticks:
        """Plan the ticks from a point of a route to its end; the first tick is at that point.

        The point and its u' must be from ticks of this planner, so that a stop in time is
        possible.

        Raises:
            InputError: The motion would take too long.
        """
        ticks, _ = self._driven(route, section, u, rate)
        if ticks is None:
            raise AssertionError(f"cannot stop from u = {u}, u' = {rate} of section {section}")
        return ticks

    def stop(self, route: CurveSequence, section: int, u: float, rate: float) -> Ticks:
        """Plan the ticks from a point of a route to rest, as soon as the limits allow."""
        if rate <= AT_REST:
            return self._resting(route, section, np.array([u]))
        profile = self._profiler.quickest_stop(route.curves[section], u, rate)
        return self._sampled(route, section, profile)

    def _chosen(self, points: Array, velocity: Array | None) -> Plan:
        fine, coarse = (
            self._reduced(points, fraction, velocity)
            for fraction in (FINE_SIMPLIFICATION, COARSE_SIMPLIFICATION)
        )
        plan = self._planned(fine, FINE_SIMPLIFICATION, velocity)
        if 1 < len(coarse) < len(fine):
            quick = self._planned(coarse, COARSE_SIMPLIFICATION, velocity)
            if quick.duration < COARSE_GAIN * plan.duration:
                return quick
        return plan

    def _reduced(self, points: Array, fraction: float, velocity: Array | None) -> Array:
        kept = points[:0] if velocity is None else points[:1]
        rest = polyline.remove_repeats(points[len(kept) :], self._scale)
        rest = polyline.simplify(rest, fraction * self._scale)
        # The remaining points may lead away and back to the same point.
        return np.vstack([kept, polyline.remove_repeats(rest, self._scale)])

    def _planned(self, points: Array, fraction: float, velocity: Array | None) -> Plan:
        """Plan through points, whose simplification used a fraction of the tolerance.

        The motion starts from rest if `velocity` is None.
        """
        rate = 0.0
        if velocity is not None:
            rate = float(max_utilisation(self._groups, velocity, self._speeds))
        route = self._route(points, fraction, moving=velocity is not None)
        ticks, bound = self._driven(route, 0, 0.0, rate)
        if ticks is None:
            # The path bends too soon for the present speed: stop first.
            first = Curve(points[:2], self._groups, self._room(fraction))
            route = CurveSequence([first, *self._route(points[1:], fraction, moving=False).curves])
            brake = TimeProfiler(self._groups).fastest(first, 0.0, rate)
            assert brake is not None
            rest, later = self._driven(route, 1, 0.0, 0.0)
            assert rest is not None
            ticks, bound = (
                concatenate([self._sampled(route, 0, brake), rest]),
                brake.duration + later,
            )
        return Plan(route, ticks, bound, (len(ticks) - 1) * self.dt)

    def _room(self, fraction: float) -> list[float]:
        return [
            (1.0 - fraction) * group.tolerance - smear
            for group, smear in zip(self._groups, self._smear, strict=True)
        ]

    def _route(self, points: Array, fraction: float, moving: bool) -> CurveSequence:
        if len(points) < 2:
            raise InputError("there is nothing to drive: the robot is already there")
        room = self._room(fraction)
        steps = np.diff(points, axis=0)
        slopes = steps / max_utilisation(self._groups, steps, self._speeds)[:, None]
        changes = np.diff(slopes, axis=0)
        stops = np.zeros(len(changes), dtype=bool)
        for group, allowed in zip(self._groups, room, strict=True):
            if allowed <= 0.0:
                stops |= group.norm(changes) > STRAIGHT * group.velocity
        if moving:
            stops[:1] = False
        ends = np.concatenate([[0], np.flatnonzero(stops) + 1, [len(points) - 1]])
        return CurveSequence(
            [
                Curve(points[a : b + 1], self._groups, room, free_first_corner=moving and a == 0)
                for a, b in itertools.pairwise(ends)
            ]
        )

    def _driven(
        self, route: CurveSequence, section: int, u: float, rate: float
    ) -> tuple[Ticks | None, float]:
        """Return the ticks from a point to the route's end, and the time without smoothing [s]."""
        bound, total, parts = 0.0, 0.0, []
        for i in range(section, len(route.curves)):
            if route.curves[i].end - u < AT_REST:
                parts.append(self._resting(route, i, np.array([u])))
                u = rate = 0.0
                continue
            profile = self._profiler.fastest(route.curves[i], u, rate)
            if profile is None:
                return None, bound
            bound += profile.duration
            # With a low jerk limit the smoothing of each stop takes longer than the motion itself.
            total += profile.duration + self.smoother.memory * self.dt
            if not total <= MAX_DURATION:
                raise InputError(
                    f"the path takes over {total:.0f} s, at most {MAX_DURATION:.0f} s are allowed"
                )
            parts.append(self._sampled(route, i, profile))
            u = rate = 0.0
        return concatenate(parts), bound

    def _sampled(self, route: CurveSequence, section: int, profile: TimeProfile) -> Ticks:
        count = int(np.ceil(profile.duration / self.dt - 1e-9)) + 1 + self.smoother.memory
        u, rate = profile.at(self.dt * np.arange(count, dtype=float))
        return Ticks(
            route.curves[section].at(u),
            np.full(count, section),
            u,
            rate,
            route.progress(section, u),
        )

    def _resting(self, route: CurveSequence, section: int, u: Array) -> Ticks:
        u = np.repeat(u, 1 + self.smoother.memory)
        return Ticks(
            route.curves[section].at(u),
            np.full(len(u), section),
            u,
            np.zeros(len(u)),
            route.progress(section, u),
        )


def _scaled(cap: SpeedCap | None, scale: float) -> SpeedCap:
    def lower(q: Array, slope: Array) -> Array:
        largest = np.ones(len(q)) if cap is None else np.minimum(cap(q, slope), 1.0)
        return scale * largest

    return lower
