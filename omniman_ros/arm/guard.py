"""What no joint setpoint gets past: an independent veto right before the wire.

A UR controller lets 0.16 rad through in 8 ms. Whatever is wrong above, the arm does not get more
than this allows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError, ParameterError

Array = NDArray[np.float64]

TOLERANCE = 1e-6
"""Share by which a limit may be passed: rounding."""


class GuardError(InputError):
    """A setpoint is refused; the message names the joint, the value and the limit."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of each joint, arrays (n,), read-only.

    Attributes:
        names: Of the joints.
        lower, upper: Positions, rad.
        velocity, acceleration: rad/s and rad/s^2.
        distance: Largest difference of a setpoint and the measured angle, rad.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    distance: Array

    def __post_init__(self) -> None:
        n = len(self.names)
        for label in ("lower", "upper", "velocity", "acceleration", "distance"):
            array = np.array(getattr(self, label), dtype=float)
            if array.shape != (n,) or not np.isfinite(array).all():
                raise ParameterError(label, array.tolist(), f"expected {n} finite numbers")
            array.flags.writeable = False
            object.__setattr__(self, label, array)
        for label in ("velocity", "acceleration", "distance"):
            if not (getattr(self, label) > 0.0).all():
                raise ParameterError(label, getattr(self, label).tolist(), "must be positive")
        if not (self.lower < self.upper).all():
            raise ParameterError("lower", self.lower.tolist(), "must be below the upper limit")


class JointGuard:
    """Compares each setpoint with the last ones and with what is measured.

    Args:
        limits: Of the joints.
        period: Between two setpoints, s.

    Raises:
        ParameterError: The period is not positive.
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        if not period > 0.0:
            raise ParameterError("period", period, "must be positive")
        self.limits = limits
        self._period = period
        self._last: Array | None = None
        self._velocity: Array = np.zeros(len(limits.names))

    def begin(self, measured: Array) -> Array:
        """Start from where the arm is, at rest; return the first setpoint: that very place.

        Args:
            measured: Joint angles (n,), rad.

        Raises:
            GuardError: They are not finite, or not within the limits.
        """
        self._last = None
        self._within(measured)
        self._last = np.array(measured, dtype=float)
        self._velocity = np.zeros_like(self._last)
        return self._last.copy()

    def check(self, setpoint: Array, measured: Array) -> Array:
        """Return the setpoint if it may be sent; it is then the one that the next follows.

        A refused one changes nothing: the next is compared with the last good one.

        Args:
            setpoint: Joint angles (n,), rad, one period after the last ones.
            measured: Joint angles (n,), rad.

        Raises:
            GuardError: It may not; or :meth:`begin` was not called.
        """
        if self._last is None:
            raise GuardError("no setpoint before the measured joints are known")
        limits = self.limits
        self._within(setpoint)
        velocity = (setpoint - self._last) / self._period
        change = (velocity - self._velocity) / self._period
        self._demand(np.abs(velocity), limits.velocity, "velocity", "rad/s")
        self._demand(np.abs(change), limits.acceleration, "acceleration", "rad/s^2")
        self._demand(np.abs(setpoint - measured), limits.distance, "distance to measured", "rad")
        self._last, self._velocity = np.array(setpoint, dtype=float), velocity
        return self._last.copy()

    def _within(self, joints: Array) -> None:
        limits = self.limits
        if joints.shape != limits.lower.shape:
            raise GuardError(f"{joints.size} joint angles, expected {limits.lower.size}")
        self._demand(joints, limits.upper, "position", "rad")
        self._demand(-joints, -limits.lower, "position", "rad", -1.0)

    def _demand(
        self, values: Array, bounds: Array, what: str, unit: str, sign: float = 1.0
    ) -> None:
        """Refuse values above their bounds; what cannot be compared is refused, too."""
        good = values <= bounds + TOLERANCE * np.abs(bounds)  # false for NaN
        if good.all():
            return
        k = int(np.argmin(good))
        raise GuardError(
            f"{self.limits.names[k]}: {what} {sign * values[k]:.4g} {unit}, "
            f"the limit is {sign * bounds[k]:.4g} {unit}"
        )
