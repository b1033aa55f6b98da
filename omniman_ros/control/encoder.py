"""Wheel encoders: unwrap counters, and estimate speeds from coarse positions."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError


class Unwrapper:
    """Unwraps the readings of counters, in both directions, into continuous positions.

    Args:
        span: Length of the counter's range, in the readings' own unit (2 pi rad, 2**32 counts).
            A step of half of it or more cannot be distinguished from one in the other direction.

    Raises:
        InputError: The span is not positive.
    """

    def __init__(self, span: float) -> None:
        if not span > 0.0:
            raise InputError(f"the span of a counter must be above 0, got {span}")
        self._span = span
        self._reading: Array | None = None
        self._position: Array | None = None

    def update(self, reading: Array) -> Array:
        """Return the unwrapped positions (n,) for readings (n,); the first reading is kept."""
        reading = np.array(reading, dtype=float)
        if self._reading is None or self._position is None:
            self._position = reading
        else:
            step = reading - self._reading
            self._position = self._position + (step - self._span * np.round(step / self._span))
        self._reading = reading
        return self._position


class VelocityObserver:
    """Estimates speeds from positions: a critically damped tracking observer of second order.

    One count of a coarse encoder in one tick is a large speed (0.27 m/s for an IG42 at 200 Hz):
    a difference quotient is useless. The observer integrates its own speed and corrects it by
    the position's error; steps of the encoder are smoothed over about 2 / bandwidth.

    Args:
        bandwidth: Natural frequency of the error [rad/s]; a ramp in position is followed without
            a steady-state error.

    Raises:
        InputError: The bandwidth is not positive.
    """

    def __init__(self, bandwidth: float) -> None:
        if not bandwidth > 0.0:
            raise InputError(f"the observer's bandwidth must be above 0, got {bandwidth} rad/s")
        self._bandwidth = bandwidth
        self._position: Array | None = None
        self._velocity: Array | None = None

    def reset(self) -> None:
        """Discard the state; the next position starts anew at rest."""
        self._position = self._velocity = None

    def update(self, position: Array, dt: float) -> Array:
        """Return speeds (n,) [rad/s] from positions (n,) [rad], dt [s] after the last ones.

        The gains are those of a discrete double pole at exp(-bandwidth dt): stable for any dt.
        """
        if self._position is None or self._velocity is None:
            self._position = np.array(position, dtype=float)
            self._velocity = np.zeros_like(self._position)
        elif dt > 0.0:
            pole = float(np.exp(-self._bandwidth * dt))
            predicted = self._position + dt * self._velocity
            error = position - predicted
            self._position = predicted + (1.0 - pole * pole) * error
            self._velocity = self._velocity + ((1.0 - pole) ** 2 / dt) * error
        return self._velocity
