"""Reference of the arm: a preview, joined smoothly from the present motion."""

from collections.abc import Callable

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.hermite import Hermite
from omniman_ros.ur.joint_preview import JointPreview

#: Fraction of the acceleration limits for joining a preview gently.
#: It suits instants at which planned motions leave the least acceleration free.
GENTLE_FRACTION = 0.08
#: Fraction of the acceleration limits for joining a preview quickly.
#: Planned motions leave a tenth of the limits free, and more for most of the time.
FIRM_FRACTION = 0.4
#: Distance [rad] and velocity [rad/s] up to which a preview need not be joined smoothly
NEGLIGIBLE = 1e-9

#: Returns angles (n,) [rad], velocities [rad/s] and accelerations [rad/s^2] at a time [s]
Motion = Callable[[float], tuple[Array, Array, Array]]


class BlendedPreview:
    """A preview plus an offset that decays to zero, so that it continues the present motion.

    Args:
        begin: Time at which joining begins [s].
        previous: Motion until that time.
        acceleration: Accelerations (n,) that the decay of the offset may use [rad/s^2].
        period: Time between two setpoints [s].

    Attributes:
        preview: Preview that is joined.
        joined: Time from which on the offset is zero [s].
    """

    def __init__(
        self,
        preview: JointPreview,
        begin: float,
        previous: Motion,
        acceleration: Array,
        period: float,
    ) -> None:
        self.preview = preview
        self._begin, self._previous = begin, previous
        position, velocity, _ = previous(begin)
        target, target_velocity, _ = preview.sample(begin)
        offset, drift = position - target, velocity - target_velocity
        self._offset: Hermite | None = None
        self.joined = begin
        if float(np.abs(offset).max()) > NEGLIGIBLE or float(np.abs(drift).max()) > NEGLIGIBLE:
            duration = joining_time(offset, drift, acceleration, period)
            self.joined = begin + duration
            zero = np.zeros_like(offset)
            self._offset = Hermite(
                np.array([begin, begin + duration]),
                np.stack([offset, zero]),
                np.stack([drift, zero]),
                None,
            )

    @property
    def end(self) -> float:
        """Time of the preview's last point [s]."""
        return self.preview.end

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Return angles (n,) [rad], velocities and accelerations at a time [s]."""
        if now < self._begin:
            return self._previous(now)
        position, velocity, acceleration = self.preview.sample(now)
        if self._offset is None or now >= self._offset.end:
            return position, velocity, acceleration
        offset = self._offset.sample(now)
        return position + offset[0], velocity + offset[1], acceleration + offset[2]

    def positions_at(self, times: Array) -> Array:
        """Return angles (m, n) [rad] at times (m,) [s]."""
        positions = self.preview.positions_at(times)
        if self._offset is not None:
            positions = positions + self._offset.positions_at(times)
        for i in np.flatnonzero(times < self._begin):
            positions[i] = self._previous(float(times[i]))[0]
        return positions

    def discard_past(self, now: float) -> None:
        """Release the previous motion once its end has passed at the time `now` [s].

        Otherwise each reference would keep all earlier references in memory.
        """
        if now >= self._begin:
            position, velocity, acceleration = self.sample(self._begin)
            self._previous = lambda time: (position, velocity, acceleration)


def joining_time(offset: Array, drift: Array, acceleration: Array, period: float) -> float:
    """Return the duration of a cubic polynomial that brings an offset and its rate to zero.

    Its second derivative is largest at an end: -(6 offset + 4 T drift) / T^2 at the beginning,
    (6 offset + 2 T drift) / T^2 at the end.

    Args:
        offset: Offsets (n,) [rad].
        drift: Rates (n,) of the offsets [rad/s].
        acceleration: Bounds of the second derivative (n,) [rad/s^2].
        period: Shortest duration [s].

    Returns:
        The duration T, with which all bounds are kept [s].
    """
    drift_times = 2.0 * np.abs(drift) / acceleration
    times = drift_times + np.sqrt(drift_times**2 + 6.0 * np.abs(offset) / acceleration)
    return max(float(times.max()), period)


def straight_preview(position: Array, velocity: Array, now: float) -> JointPreview:
    """Return a preview that starts at a position (n,) [rad] and keeps a velocity (n,) [rad/s]."""
    return JointPreview(np.array([now]), position[None].copy(), velocity[None].copy())


def braked_rate(
    velocity: Array, acceleration: Array, rate: float, limits: Array, period: float
) -> float:
    """Return the rate of progress along a reference after one period of the hardest braking.

    With the rate s', the acceleration of a joint is q'' s'^2 + q' s''.

    Args:
        velocity: Velocities q' (n,) of the reference [rad/s].
        acceleration: Accelerations q'' (n,) of the reference [rad/s^2].
        rate: Present rate s', 1 at full speed.
        limits: Accelerations (n,) that braking may use [rad/s^2].
        period: Time between two setpoints [s].
    """
    speed = np.abs(velocity)
    is_moving = speed * rate > limits * period  # slower joints stop within the period
    if not is_moving.any():
        return 0.0
    path_acceleration = np.sign(velocity[is_moving]) * acceleration[is_moving] * rate * rate
    available = np.maximum(limits[is_moving] + path_acceleration, 0.0)
    return max(rate - period * float((available / speed[is_moving]).min()), 0.0)


def stopping_time(velocity: Array, limits: Array) -> float:
    """Return the time [s] to rest from velocities (n,) [rad/s] within limits (n,) [rad/s^2]."""
    return float((np.abs(velocity) / limits).max())
