"""What the arm is led along: a preview, and the way from where it is onto it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.core.hermite import Hermite

Array = NDArray[np.float64]

GENTLE, FIRM = 0.08, 0.4
"""Shares of the acceleration limits that joining a preview takes: planned motions leave a tenth to
it, and more for most of the time."""
NEAR = 1e-9
"""Distances and speeds that need no joining [rad, rad/s]."""


Motion = Callable[[float], tuple[Array, Array, Array]]


class Reference:
    """A preview plus an offset that fades: it begins with the arm's motion of that time.

    Args:
        preview: Where to go.
        begin: When it begins [s].
        before: The motion until then, of a time: angles (n,) [rad], rates, second derivatives.
        acceleration: (n,) that the offset may take to fade [rad/s^2].
        period: Of the setpoints [s].

    Attributes:
        joined: When the offset has faded [s].
    """

    def __init__(
        self, preview: JointPreview, begin: float, before: Motion, acceleration: Array,
        period: float,
    ) -> None:  # fmt: skip
        self.preview = preview
        self._begin, self._before = begin, before
        position, velocity, _ = before(begin)
        place, rate, _ = preview.sample(begin)
        away, drift = position - place, velocity - rate
        self._offset: Hermite | None = None
        self.joined = begin
        if float(np.abs(away).max()) > NEAR or float(np.abs(drift).max()) > NEAR:
            time = joining_time(away, drift, acceleration, period)
            self.joined = begin + time
            zero = np.zeros_like(away)
            self._offset = Hermite(
                np.array([begin, begin + time]),
                np.stack([away, zero]),
                np.stack([drift, zero]),
                None,
            )

    @property
    def end(self) -> float:
        """Time of the preview's last point [s]."""
        return self.preview.end

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Angles (n,) [rad], their rates and second derivatives at a time [s]."""
        if now < self._begin:
            return self._before(now)
        position, velocity, acceleration = self.preview.sample(now)
        if self._offset is None or now >= self._offset.end:
            return position, velocity, acceleration
        more = self._offset.sample(now)
        return position + more[0], velocity + more[1], acceleration + more[2]

    def positions_at(self, times: Array) -> Array:
        """Angles (m, n) [rad] at times (m,) [s]."""
        positions = self.preview.positions_at(times)
        if self._offset is not None:
            positions = positions + self._offset.positions_at(times)
        for i in np.flatnonzero(times < self._begin):
            positions[i] = self._before(float(times[i]))[0]
        return positions

    def forget(self, now: float) -> None:
        """Give up what was before, if that is over."""
        if now >= self._begin:
            position, velocity, acceleration = self.sample(self._begin)
            self._before = lambda time: (position, velocity, acceleration)


def joining_time(away: Array, drift: Array, acceleration: Array, period: float) -> float:
    """Time in which a cubic polynomial takes an offset (n,) and its rate to zero [s].

    Its second derivative is largest at an end: -(6 away + 4 T drift) / T^2 at the beginning,
    (6 away + 2 T drift) / T^2 at the end.
    """
    shares = 2.0 * np.abs(drift) / acceleration
    times = shares + np.sqrt(shares * shares + 6.0 * np.abs(away) / acceleration)
    return max(float(times.max()), period)


def straight(position: Array, velocity: Array, now: float) -> JointPreview:
    """A preview that is at its end already: straight on from a position with a velocity."""
    return JointPreview(np.array([now]), position[None].copy(), velocity[None].copy())


def braking(
    velocity: Array, acceleration: Array, rate: float, limits: Array, period: float
) -> float:
    """Rate of progress along a reference after one more period of the hardest braking.

    With s' the rate, a joint's acceleration is q'' s'^2 + q' s''.

    Args:
        velocity, acceleration: (n,) q' [rad/s] and q'' [rad/s^2] of the reference.
        rate: s' now, 1 at full speed.
        limits: (n,) accelerations to keep [rad/s^2].
        period: [s].
    """
    speed = np.abs(velocity)
    moving = speed * rate > limits * period  # what is slower stops within the period
    if not moving.any():
        return 0.0
    toward = np.sign(velocity[moving]) * acceleration[moving] * rate * rate
    spare = np.maximum(limits[moving] + toward, 0.0)
    return max(rate - period * float((spare / speed[moving]).min()), 0.0)


def stopping_time(velocity: Array, limits: Array) -> float:
    """Time to come to rest from velocities (n,) [rad/s] within accelerations [rad/s^2]; [s]."""
    return float((np.abs(velocity) / limits).max())
