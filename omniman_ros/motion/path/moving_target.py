"""Streams of single points: motions to a point that moves, soon there and then at rest."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from omniman_ros.core import round_off
from omniman_ros.core.arbiter import NEVER
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.joint_points import JointPoints, KinematicState
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.timed_curve import TimedCurve

#: Latest time at which a point of a stream is due [s]; later ones are those of a trajectory
STREAM_LEAD = 0.5
SHORTEST = 4.0 * TICK  #: Shortest time to the target that is tried [s]
LONGEST = 1.0  #: Longest time to the target [s]: what is farther away is no point of a stream
STOPS = 130  #: Number of times to rest that are tried, up to 17 s
GROWTH = 1.05  #: Ratio of two times to the target that are tried one after the other
#: Fraction of the limits that is used where less does not suffice; the grid misses up to 0.4 %
FULL_FRACTION = 0.99
#: Number of motions whose limits are checked exactly, of those that keep them on the grid
MOST_CHECKS = 4
#: Grid of a piece's elapsed fraction on which limits are checked
_U = np.linspace(0.0, 1.0, 25)[:, None]


@dataclass(frozen=True)
class MovingTarget(Validated):
    """Where some axes are to be at a time, and how fast."""

    columns: tuple[int, ...]  #: Indices of the axes
    position: Annotated[Array, Shape("m")]  #: (m,) positions [rad or m]
    #: (m,) velocities [rad/s or m/s]; zeros where the source gives none
    velocity: Annotated[Array, Shape("m")]
    due: float  #: Time from now [s]; negative if it has passed

    @classmethod
    def last_of(cls, points: JointPoints, delay: float) -> "MovingTarget":
        """Create the target from the last point of a message that starts after a delay [s].

        Raises:
            InputError: The point was due in the past.
        """
        assert points.times is not None
        due = float(points.times[-1]) + delay
        if due <= 0.0:
            raise InputError(f"the point was due {-due:.3f} s ago")
        velocity = np.zeros(len(points.columns))
        if points.velocities is not None:
            velocity = round_off.ended(points.velocities)[-1]
        return cls(points.columns, points.positions[-1], velocity, due)

    def after(self, elapsed: float) -> "MovingTarget":
        """Return the target as it is seen a time [s] later."""
        return replace(self, due=self.due - elapsed)


def curve_to(
    target: MovingTarget, state: KinematicState, limits: AxisLimits, reserve: float, hold: float
) -> TimedCurve:
    """Plan a motion that meets a target as soon as the limits allow, and then comes to rest.

    Each piece is a quintic polynomial. A target with a velocity is met in motion. Axes that the
    target does not name come to rest. Where the target cannot be reached from a motion, the axes
    brake first.

    Args:
        state: State of all d axes at time 0.
        reserve: Fraction of the limits that the motion leaves unused, if it can.
        hold: Time for which the target is taken to move on after it was due [s].

    Raises:
        InputError: The target is beyond a position limit, or too far away.
    """
    columns = list(target.columns)
    place = state.position.copy()
    place[columns] = target.position
    limits.require_within(place[None])
    velocity = np.zeros(len(place))
    velocity[columns] = np.clip(
        target.velocity, -limits.velocity[columns], limits.velocity[columns]
    )
    first = max(target.due, SHORTEST)
    count = max(int(np.log(LONGEST / first) / np.log(GROWTH)), 0) + 1
    spans: Array = first * GROWTH ** np.arange(count, dtype=float)
    moving = [velocity, 0.0 * velocity] if velocity.any() else [velocity]
    for fraction in (1.0 - reserve, FULL_FRACTION):
        for end_velocity in moving:
            ahead = np.clip(spans - target.due, 0.0, hold)[:, None]
            ends = place + ahead * end_velocity
            others = np.delete(np.arange(len(place)), columns)
            ends[:, others] = _rest_positions(state, spans)[:, others]
            found = _Meetings(spans, ends, end_velocity).kept(state, limits, fraction)
            curve = next(found, None)
            if curve is not None:
                return curve
    if not round_off.is_rest(state.velocity):
        return _braked(state, limits)
    distance = np.abs(place - state.position)
    k = int(distance.argmax())
    raise InputError(
        f"{limits.names[k]}: a point {distance[k]:.3g} {limits.units[k]} away cannot be reached "
        f"within {LONGEST:g} s: it is too far for a stream, and too soon for a trajectory"
    )


def _braked(state: KinematicState, limits: AxisLimits) -> TimedCurve:
    """Return the shortest motion to rest, from which the next point may be reached.

    Raises:
        InputError: None keeps the limits; the motion under way does, to its end.
    """
    spans: Array = SHORTEST * GROWTH ** np.arange(STOPS, dtype=float)
    stops = _Meetings(spans, _rest_positions(state, spans), np.zeros(len(state.position)))
    curve = next(stops.kept(state, limits, FULL_FRACTION), None)
    if curve is None:
        raise InputError("the point cannot be reached from the motion under way")
    return curve


def _rest_positions(state: KinematicState, spans: Array) -> Array:
    """Return the places (n, d) at which axes rest that have times (n,) [s] to stop."""
    t = spans[:, None]
    places: Array = state.position + t * (0.5 * state.velocity + t / 12.0 * state.acceleration)
    return places


@dataclass(frozen=True)
class _Meetings:
    """Motions to choose from: to places (n, d) in times (n,) [s], there with one velocity (d,)."""

    spans: Array
    ends: Array
    velocity: Array

    def kept(
        self, state: KinematicState, limits: AxisLimits, fraction: float
    ) -> Iterator[TimedCurve]:
        """Yield the motions that keep a fraction of the limits, the shortest first."""
        v, a, j = (
            fraction * limits.velocity,
            fraction * limits.acceleration,
            fraction * limits.jerk,
        )
        stop = max(
            float((1.5 * np.abs(self.velocity) / a).max()),
            float(np.sqrt(6.0 * np.abs(self.velocity) / j).max()),
            TICK,
        )
        rest = self.ends + 0.5 * stop * self.velocity
        within = ((rest >= limits.lower) & (rest <= limits.upper)).all(axis=1)
        # What is beyond its share already may stay there, but not rise.
        highest = (
            np.maximum(v, np.abs(state.velocity)),
            np.maximum(a, np.abs(state.acceleration)),
        )
        is_beyond = bool((highest[0] > v).any() or (highest[1] > a).any())
        for values, bound in zip(self._rates(state), (*highest, j), strict=True):
            within &= (np.abs(values) <= bound * (1.0 + 1e-9)).all(axis=(0, 2))
        for i in np.flatnonzero(within)[:MOST_CHECKS]:
            zero = np.zeros_like(self.velocity)
            rows = (
                [state.position, self.ends[i], rest[i]],
                [state.velocity, self.velocity, zero],
                [state.acceleration, zero, zero],
            )
            times = np.array([0.0, self.spans[i], self.spans[i] + stop])
            used = 3 if self.velocity.any() else 2
            curve = TimedCurve(times[:used], *(np.array(row[:used]) for row in rows))
            if is_beyond:  # near the limit itself a grid is too coarse
                try:
                    limits.require_kept(curve, 1.0)
                except InputError:
                    continue
            yield curve

    def _rates(self, state: KinematicState) -> tuple[Array, Array, Array]:
        """Return x', x'' and x''' (grid, n, d) of the pieces that lead to the target."""
        t, u = self.spans[:, None], _U[:, :, None]
        v0, v1, a0 = state.velocity * t, self.velocity * t, state.acceleration * t * t
        gap, lift = self.ends - state.position - v0 - 0.5 * a0, v1 - v0 - a0
        c3 = 10.0 * gap - 4.0 * lift - 0.5 * a0
        c4 = -15.0 * gap + 7.0 * lift + a0
        c5 = 6.0 * gap - 3.0 * lift - 0.5 * a0
        return (
            (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / t,
            (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / t**2,
            (6.0 * c3 + u * (24.0 * c4 + u * 60.0 * c5)) / t**3,
        )


class PointStream:
    """State of a stream of points; all times are on one clock.

    A stream that lost control, or whose point was refused as nothing may move, is used again only
    after a pause. One that only fell silent goes on with its next point.
    """

    def __init__(self) -> None:
        self.active = False
        self._lost = ""
        self._received = self._fresh_until = NEVER

    def offer(self, now: float, refusal: str, pause: float) -> str:
        """Register a point; return why it is not used, or an empty string.

        No point may move the arm for a `refusal`. After a `pause` [s] a stream that lost control
        is used again.
        """
        if now - self._received > pause:
            self._lost = ""
        self._received = now
        if refusal:
            self.active, self._lost = False, refusal
            return refusal
        return self._lost and f"{self._lost}; the stream must pause for {pause:g} s"

    def follow(self, fresh_until: float) -> None:
        """Note that a point is followed, until a time [s] without another one."""
        self.active, self._fresh_until = True, fresh_until

    def is_silent(self, now: float) -> bool:
        """Return whether the stream drives the motion under way, and fell silent."""
        return self.active and now > self._fresh_until

    def end(self) -> None:
        """Note that its motion ends by itself: the next point begins anew."""
        self.active = False

    def lose(self, reason: str) -> None:
        """Note that something else ended its motion, if it drives one."""
        if self.active:
            self.active, self._lost = False, reason
