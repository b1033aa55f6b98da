"""Preview of the arm's motion: timed joint angles, velocities and accelerations."""

import numpy as np

from omniman_ros.core import plausible, round_off
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.hermite import Hermite

MAX_POINTS = 5000  #: Largest number of points of a preview
MAX_ANGLE = 100.0  #: Largest plausible joint angle [rad]
MAX_SPEED = 1e3  #: Largest plausible joint speed [rad/s]
MAX_ACCELERATION = 1e5  #: Largest plausible joint acceleration [rad/s^2]


class JointPreview:
    """Timed points, joined by quintic (with accelerations) or cubic polynomials.

    Before the first point the preview rests there. Beyond the last point it continues with the
    last velocity: a path to brake along when nothing else is known. Round-off of its source
    counts for nothing: see `round_off`.

    Args:
        times: Times (k,) on the receiver's clock, increasing [s].
        positions: Joint angles (k, n) [rad].
        velocities: Joint velocities (k, n) [rad/s].
        accelerations: Joint accelerations (k, n) [rad/s^2]; None if they are unknown.

    Raises:
        InputError: There are no points or too many, a shape is wrong, a value is not finite or
            not plausible, or the times do not increase.
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array | None = None
    ) -> None:
        k = len(times)
        if not 1 <= k <= MAX_POINTS:
            raise InputError(f"preview: must have 1 to {MAX_POINTS} points, got {k}")
        n = positions.shape[1] if positions.ndim == 2 else 0
        for label, array, bound in (
            ("positions", positions, MAX_ANGLE),
            ("velocities", velocities, MAX_SPEED),
            ("accelerations", accelerations, MAX_ACCELERATION),
        ):
            if array is None:
                continue
            if n == 0 or array.shape != (k, n):
                raise InputError(f"preview: {label} must have shape ({k}, {n}), got {array.shape}")
            plausible.demand(array, bound, f"preview: {label}")
        plausible.demand(times, np.finfo(float).max, "preview: times")
        times, rows = round_off.distinct(times, positions)
        positions, velocities = positions[rows], round_off.ended(velocities[rows])
        accelerations = None if accelerations is None else accelerations[rows]
        self._curve = Hermite(times, positions, velocities, accelerations)
        self._last_position, self._last_velocity = positions[-1], velocities[-1]

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return self._curve.start

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return self._curve.end

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Return angles (n,) [rad], velocities and accelerations at a time [s]."""
        excess_time = now - self._curve.end
        if excess_time < 0.0:
            return self._curve.sample(now)
        velocity = self._last_velocity
        return self._last_position + excess_time * velocity, velocity, np.zeros_like(velocity)

    def positions_at(self, times: Array) -> Array:
        """Return angles (m, n) [rad] at times (m,) [s]."""
        excess_times = np.maximum(times - self._curve.end, 0.0)
        extension: Array = excess_times[:, None] * self._last_velocity
        return self._curve.positions_at(times) + extension
