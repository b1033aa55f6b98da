"""From points to a trajectory: route, profile, ticks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.core.path import polyline
from omniman_ros.core.path.axes import AxisGroup, largest
from omniman_ros.core.path.curve import STRAIGHT, Curve
from omniman_ros.core.path.smoothing import Smoother, deviation, window_ticks
from omniman_ros.core.path.time_profile import SpeedCap, TimeProfile, TimeProfiler
from omniman_ros.core.path.trajectory import Ticks, joined

Array = NDArray[np.float64]

FINE, COARSE = 0.04, 0.5
"""Shares of the tolerance that leaving out points may take: always, and where it pays."""
PAYS = 0.95
"""Coarse is chosen where it takes less than this of the time."""
LONGEST = 3600.0
"""Longest trajectory [s]."""
FINEST = 1e-4
"""Least scale on which points are compared [m, rad]."""
STANDING = 1e-9
"""Below this u' is rest, and a way to go in u [s] is none."""
OVERRUN = 1.1
"""Way out of a motion over the shortest way to rest."""


class Route:
    """Curves one after the other, with a rest at the end of each."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.curves = tuple(curves)
        self._before = np.concatenate([[0.0], np.cumsum([curve.end for curve in curves])])

    def progress(self, section: int, u: Array) -> Array:
        """How much is behind at u (k,) of a section, 0 to 1."""
        share: Array = (self._before[section] + u) / self._before[-1]
        return share


@dataclass(frozen=True)
class Plan:
    """A route and its drive.

    Attributes:
        route: Where.
        ticks: When; at rest at the end for as long as the smoothing lasts.
        bound: The least time in which the same curves can be driven without jerk limits [s].
        duration: How long the drive takes [s].
    """

    route: Route
    ticks: Ticks
    bound: float
    duration: float


class PathPlanner:
    """Plans the motion of d coordinates through points.

    Args:
        groups: The coordinates' limits; together they have each of the d coordinates once.
        dt: Tick of the time base [s].
        cap: Largest u' at points of a curve, besides 1; None for no such limit.
        share: Of all speeds and accelerations that is used.

    Attributes:
        smoother: The filter that its ticks are meant for; the same for each share.
        share: As above.
    """

    def __init__(
        self,
        groups: Sequence[AxisGroup],
        dt: float,
        cap: SpeedCap | None = None,
        share: float = 1.0,
    ) -> None:
        self.dt, self.share = dt, share
        self._full = (groups, dt, cap)
        if share < 1.0:
            cap = _shared(cap, share)
        self._speeds = [group.velocity for group in groups]
        window = window_ticks(groups, dt)
        self.smoother = Smoother(window, dt)
        self._smear = [deviation(group.acceleration, window, dt) for group in groups]
        groups = [replace(group, acceleration=share * group.acceleration) for group in groups]
        self._groups = groups
        self._accelerations = [group.acceleration for group in groups]
        self._profiler = TimeProfiler(groups, cap)
        self._scale = np.ones(sum(len(group.columns) for group in groups))
        for group in groups:
            self._scale[list(group.columns)] = max(group.tolerance, FINEST)

    @property
    def groups(self) -> tuple[AxisGroup, ...]:
        """The limits that it plans within, with its share of the accelerations."""
        return tuple(self._groups)

    def slower(self, share: float) -> "PathPlanner":
        """One for the same routes that uses a share of all speeds and accelerations."""
        return PathPlanner(*self._full, share)

    def plan(self, points: Array) -> Plan:
        """Plan from rest at the first of the points (k, d) to rest at the last, k >= 1.

        Raises:
            InputError: It would last too long, or all points are one.
        """
        return self._chosen(points, None)

    def plan_on(self, position: Array, velocity: Array, points: Array) -> Plan:
        """Plan from motion: out of it the straight way that a stop takes, then to the points.

        Args:
            position: (d,) q.
            velocity: (d,) its rate, not zero.
            points: (k, d) where to go from there, to rest at the last.

        Raises:
            InputError: It would last too long.
        """
        tip = self.stop_point(position, velocity)
        return self._chosen(np.vstack([position, tip, points]), velocity)

    def stop_point(self, position: Array, velocity: Array) -> Array:
        """Where (d,) the straight way out of a motion ends."""
        rate = float(largest(self._groups, velocity, self._speeds))
        slope = velocity / rate
        hardest = 1.0 / float(largest(self._groups, slope, self._accelerations))
        point: Array = position + slope * (OVERRUN * rate * rate / (2.0 * hardest))
        return point

    def drive(self, route: Route, section: int, u: float, rate: float) -> Ticks:
        """Ticks from a place of a route to its end, the first there.

        The place and its u' are from ticks of this planner, so that it can stop in time.

        Raises:
            InputError: It would last too long.
        """
        ticks, _ = self._driven(route, section, u, rate)
        if ticks is None:
            raise AssertionError(f"no way to stop from u = {u}, u' = {rate} of section {section}")
        return ticks

    def stop(self, route: Route, section: int, u: float, rate: float) -> Ticks:
        """Ticks from a place of a route to rest, as soon as the limits allow."""
        if rate <= STANDING:
            return self._resting(route, section, np.array([u]))
        profile = self._profiler.quickest_stop(route.curves[section], u, rate)
        return self._sampled(route, section, profile)

    # ---- parts ------------------------------------------------------------------------------

    def _chosen(self, points: Array, velocity: Array | None) -> Plan:
        """The plan with as little left out as pays."""
        fine, coarse = (self._reduced(points, share, velocity) for share in (FINE, COARSE))
        plan = self._planned(fine, FINE, velocity)
        if 1 < len(coarse) < len(fine):
            quick = self._planned(coarse, COARSE, velocity)
            if quick.duration < PAYS * plan.duration:
                return quick
        return plan

    def _reduced(self, points: Array, share: float, velocity: Array | None) -> Array:
        kept = points[:0] if velocity is None else points[:1]
        rest = polyline.distinct(points[len(kept) :], self._scale)
        rest = polyline.simplified(rest, share * self._scale)
        # What is left may be the way there and back to one point.
        return np.vstack([kept, polyline.distinct(rest, self._scale)])

    def _planned(self, points: Array, share: float, velocity: Array | None) -> Plan:
        rate = 0.0
        if velocity is not None:
            rate = float(largest(self._groups, velocity, self._speeds))
        route = self._route(points, share, moving=velocity is not None)
        ticks, bound = self._driven(route, 0, 0.0, rate)
        if ticks is None:
            # The way ahead bends too soon: stop first.
            first = Curve(points[:2], self._groups, self._room(share))
            route = Route([first, *self._route(points[1:], share, moving=False).curves])
            brake = TimeProfiler(self._groups).fastest(first, 0.0, rate)
            assert brake is not None
            rest, later = self._driven(route, 1, 0.0, 0.0)
            assert rest is not None
            ticks, bound = joined([self._sampled(route, 0, brake), rest]), brake.duration + later
        return Plan(route, ticks, bound, (len(ticks) - 1) * self.dt)

    def _room(self, share: float) -> list[float]:
        """How far parabolas may cut corners, by groups; what others take is taken off."""
        return [
            (1.0 - share) * group.tolerance - smear
            for group, smear in zip(self._groups, self._smear, strict=True)
        ]

    def _route(self, points: Array, share: float, moving: bool) -> Route:
        """Curves between those points at which the path must stop."""
        if len(points) < 2:
            raise InputError("nothing to drive: the robot is there already")
        room = self._room(share)
        steps = np.diff(points, axis=0)
        slopes = steps / largest(self._groups, steps, self._speeds)[:, None]
        turns = np.diff(slopes, axis=0)
        stops = np.zeros(len(turns), dtype=bool)
        for group, allowed in zip(self._groups, room, strict=True):
            if allowed <= 0.0:
                stops |= group.norm(turns) > STRAIGHT * group.velocity
        if moving:
            stops[:1] = False
        ends = np.concatenate([[0], np.flatnonzero(stops) + 1, [len(points) - 1]])
        return Route(
            [
                Curve(points[a : b + 1], self._groups, room, head=moving and a == 0)
                for a, b in zip(ends[:-1], ends[1:], strict=True)
            ]
        )

    def _driven(
        self, route: Route, section: int, u: float, rate: float
    ) -> tuple[Ticks | None, float]:
        """Ticks from a place to the route's end, and the time without smoothing."""
        bound, lasts, parts = 0.0, 0.0, []
        for i in range(section, len(route.curves)):
            if route.curves[i].end - u < STANDING:
                parts.append(self._resting(route, i, np.array([u])))
                u = rate = 0.0
                continue
            profile = self._profiler.fastest(route.curves[i], u, rate)
            if profile is None:
                return None, bound
            bound += profile.duration
            # With little jerk the smoothing of each stop lasts longer than the rest.
            lasts += profile.duration + self.smoother.memory * self.dt
            if not lasts <= LONGEST:
                raise InputError(f"the path takes over {lasts:.0f} s, at most {LONGEST:.0f} s")
            parts.append(self._sampled(route, i, profile))
            u = rate = 0.0
        return joined(parts), bound

    def _sampled(self, route: Route, section: int, profile: TimeProfile) -> Ticks:
        """Ticks of a profile, and of the rest after it for as long as the smoothing lasts."""
        count = int(np.ceil(profile.duration / self.dt - 1e-9)) + 1 + self.smoother.memory
        u, rate = profile.at(self.dt * np.arange(count, dtype=float))
        return Ticks(
            route.curves[section].at(u), np.full(count, section), u, rate,
            route.progress(section, u),
        )  # fmt: skip

    def _resting(self, route: Route, section: int, u: Array) -> Ticks:
        u = np.repeat(u, 1 + self.smoother.memory)
        return Ticks(
            route.curves[section].at(u), np.full(len(u), section), u, np.zeros(len(u)),
            route.progress(section, u),
        )  # fmt: skip


def _shared(cap: SpeedCap | None, share: float) -> SpeedCap:
    """A cap at a share of u' = 1 and of another cap."""

    def lower(q: Array, slope: Array) -> Array:
        most = np.ones(len(q)) if cap is None else np.minimum(cap(q, slope), 1.0)
        return share * most

    return lower
