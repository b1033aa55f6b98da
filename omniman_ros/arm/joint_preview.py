"""A preview of the arm's motion: timed joint angles, speeds and accelerations."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.hermite import Hermite

Array = NDArray[np.float64]

MAX_POINTS = 5000
"""Longest accepted preview."""
ANGLE, SPEED, ACCELERATION = 100.0, 1e3, 1e5
"""What is beyond them is no joint angle [rad], speed [rad/s], acceleration [rad/s^2]."""
CLOSEST = 1e-6
"""Least time between two points [s]."""


class JointPreview:
    """Points in time, joined by quintic (with accelerations) or cubic polynomials.

    Before its first point it waits there, at rest; beyond its last it goes on straight with the
    last point's velocity: where to brake when nothing else is known.

    Args:
        times: (k,) [s] on the receiver's clock, strictly increasing.
        positions: (k, n) joint angles [rad].
        velocities: (k, n) [rad/s].
        accelerations: (k, n) [rad/s^2], or None.

    Raises:
        InputError: Empty, too long, wrong shapes, not finite, huge, or times that do not
            increase.
    """

    def __init__(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array | None = None
    ) -> None:
        k = len(times)
        if not 1 <= k <= MAX_POINTS:
            raise InputError(f"a preview has 1 to {MAX_POINTS} points, got {k}")
        n = positions.shape[1] if positions.ndim == 2 else 0
        for label, array, bound in (
            ("positions", positions, ANGLE), ("velocities", velocities, SPEED),
            ("accelerations", accelerations, ACCELERATION),
        ):  # fmt: skip
            if array is None:
                continue
            if n == 0 or array.shape != (k, n):
                raise InputError(f"preview: {label} of shape {array.shape}, expected ({k}, {n})")
            plausible.demand(array, bound, f"preview: {label}")
        plausible.demand(times, np.finfo(float).max, "preview: times")
        if k > 1 and not (np.diff(times) > CLOSEST).all():
            raise InputError("preview: the points' times do not increase")
        self._curve = Hermite(times, positions, velocities, accelerations)
        self._last, self._slope = positions[-1], velocities[-1]

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return self._curve.start

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return self._curve.end

    def sample(self, now: float) -> tuple[Array, Array, Array]:
        """Angles (n,) [rad], their rates and second derivatives at a time [s]."""
        over = now - self._curve.end
        if over < 0.0:
            return self._curve.sample(now)
        return self._last + over * self._slope, self._slope, np.zeros_like(self._slope)

    def positions_at(self, times: Array) -> Array:
        """Angles (m, n) [rad] at times (m,) [s]."""
        over = np.maximum(times - self._curve.end, 0.0)
        beyond: Array = over[:, None] * self._slope
        return self._curve.positions_at(times) + beyond
