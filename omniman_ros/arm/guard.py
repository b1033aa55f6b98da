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
SLACK = 1e-6
"""By which a position limit may be passed, and a stop before it [rad]: rounding."""


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

    A setpoint passes if it is finite, within the limits on position, velocity and acceleration,
    slow enough to stop before the position limits, and near enough to the measured angles. The
    steps of a stop only have to be finite, to keep the acceleration, and not to become faster:
    limits may have been lowered since, the arm may have been pushed away.

    Args:
        limits: Of the joints.
        period: Between two setpoints, s.

    Attributes:
        limits: As above, live.
        last: (n,) the last setpoint, rad.
        velocity: (n,) of the last step, rad/s.

    Raises:
        ParameterError: The period is not positive.
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        if not period > 0.0:
            raise ParameterError("period", period, "must be positive")
        self.limits = limits
        self._period = period
        self._begun = False
        self.last: Array = np.zeros(len(limits.names))
        self.velocity: Array = np.zeros(len(limits.names))

    def begin(self, measured: Array) -> Array:
        """Start from where the arm is, at rest; return the first setpoint: that very place.

        A joint beyond a limit may stay, and move back only.

        Args:
            measured: Joint angles (n,), rad.

        Raises:
            GuardError: They are not finite.
        """
        self._begun = False
        self._demand_size(measured)
        if not np.isfinite(measured).all():
            raise GuardError(f"joint angles {measured.tolist()} are not finite")
        self._begun = True
        self.last = np.array(measured, dtype=float)
        self.velocity = np.zeros_like(self.last)
        return self.last.copy()

    def check(self, setpoint: Array, measured: Array | None) -> Array:
        """Return the setpoint if it may be sent; it is then the one that the next follows.

        A refused one changes nothing: the next is compared with the last good one.

        Args:
            setpoint: Joint angles (n,), rad, one period after the last ones.
            measured: Joint angles (n,), rad; None: it is the step of a stop.

        Raises:
            GuardError: It may not; or :meth:`begin` was not called.
        """
        self._demand_size(setpoint)
        if measured is None:
            velocity = self._stop_step(setpoint)
        else:
            velocity = self.examine(setpoint[None])[0]
            away = np.abs(setpoint - measured)[None]
            self._demand(away, self.limits.distance, "distance to measured", "rad")
        self.last, self.velocity = np.array(setpoint, dtype=float), velocity
        return self.last.copy()

    def _stop_step(self, setpoint: Array) -> Array:
        self._demand_begun()
        limits = self.limits
        velocity: Array = (setpoint - self.last) / self._period
        rate = (velocity - self.velocity) / self._period
        fastest = np.maximum(limits.velocity, np.abs(self.velocity))
        self._demand(np.abs(velocity)[None], fastest, "velocity", "rad/s")
        self._demand(np.abs(rate)[None], limits.acceleration, "acceleration", "rad/s^2")
        return velocity

    def _demand_begun(self) -> None:
        if not self._begun:
            raise GuardError("no setpoint before the measured joints are known")

    def examine(self, setpoints: Array) -> Array:
        """Check a sequence that would follow the last setpoint; nothing is changed.

        Args:
            setpoints: (k, n) joint angles, rad, one period after the other.

        Returns:
            (k, n) velocities of their steps, rad/s.

        Raises:
            GuardError: One of them may not be sent; or :meth:`begin` was not called.
        """
        self._demand_begun()
        limits, dt = self.limits, self._period
        self._demand_within(setpoints)
        velocities = np.diff(setpoints, axis=0, prepend=self.last[None]) / dt
        rates = np.diff(velocities, axis=0, prepend=self.velocity[None]) / dt
        self._demand(np.abs(velocities), limits.velocity, "velocity", "rad/s")
        self._demand(np.abs(rates), limits.acceleration, "acceleration", "rad/s^2")
        # The way of a stop from here, in steps: they are shorter by a * dt^2 each.
        speeds = np.abs(velocities)
        way = np.maximum(0.5 * speeds * (speeds / limits.acceleration - dt), 0.0) - SLACK
        lower, upper = self._range()
        left = np.where(velocities > 0.0, upper - setpoints, setpoints - lower)
        good = way <= left + TOLERANCE
        if not good.all():
            i, k = np.argwhere(~good)[0]
            raise GuardError(
                f"{limits.names[k]}: velocity {velocities[i, k]:.4g} rad/s at "
                f"{setpoints[i, k]:.4g} rad is too fast to stop before the position limit"
            )
        return velocities

    def _demand_size(self, joints: Array) -> None:
        if joints.shape != self.limits.lower.shape:
            raise GuardError(f"{joints.size} joint angles, expected {self.limits.lower.size}")

    def _range(self) -> tuple[Array, Array]:
        """Lower and upper bounds (n,), rad; a joint beyond one is bounded by where it is."""
        limits = self.limits
        return np.minimum(limits.lower, self.last), np.maximum(limits.upper, self.last)

    def _demand_within(self, joints: Array) -> None:
        lower, upper = self._range()
        self._demand(joints, upper, "position", "rad", slack=SLACK)
        self._demand(-joints, -lower, "position", "rad", -1.0, SLACK)

    def _demand(
        self, values: Array, bounds: Array, what: str, unit: str, sign: float = 1.0,
        slack: float = 0.0,
    ) -> None:  # fmt: skip
        """Refuse values (k, n) above bounds (n,); what cannot be compared is refused, too."""
        good = values <= bounds + TOLERANCE * np.abs(bounds) + slack  # false for NaN
        if good.all():
            return
        i, k = np.argwhere(~good)[0]
        raise GuardError(
            f"{self.limits.names[k]}: {what} {sign * values[i, k]:.4g} {unit}, "
            f"the limit is {sign * bounds[k]:.4g} {unit}"
        )
