"""Independent check of each joint setpoint right before it is sent.

A UR controller accepts steps of 0.16 rad in 8 ms. Whatever fails in the layers above, the arm does
not get a setpoint that this guard refuses.
"""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, ParameterError

#: Fraction of a limit by which it may be exceeded because of rounding errors
RELATIVE_TOLERANCE = 1e-6
#: Angle by which a position limit, and the stopping distance before it, may be exceeded [rad]
POSITION_TOLERANCE = 1e-6


class GuardError(InputError):
    """A setpoint was refused; the message names the joint, the value and the limit."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of n joints, as read-only arrays (n,).

    Raises:
        ParameterError: An array does not contain n finite numbers, a limit is not positive, or a
            lower position limit is not below the upper one.
    """

    names: tuple[str, ...]  #: Names of the joints
    lower: Array  #: Lower position limits [rad]
    upper: Array  #: Upper position limits [rad]
    velocity: Array  #: Largest velocities [rad/s]
    acceleration: Array  #: Largest accelerations [rad/s^2]
    distance: Array  #: Largest distances between setpoints and measured angles [rad]

    def __post_init__(self) -> None:
        n = len(self.names)
        for label in ("lower", "upper", "velocity", "acceleration", "distance"):
            array = np.array(getattr(self, label), dtype=float)
            if array.shape != (n,) or not np.isfinite(array).all():
                raise ParameterError(label, array.tolist(), f"must be {n} finite numbers")
            array.flags.writeable = False
            object.__setattr__(self, label, array)
        for label in ("velocity", "acceleration", "distance"):
            if not (getattr(self, label) > 0.0).all():
                raise ParameterError(label, getattr(self, label).tolist(), "must be positive")
        if not (self.lower < self.upper).all():
            raise ParameterError("lower", self.lower.tolist(), "must be below the upper limit")


class JointGuard:
    """Checks each setpoint against the last ones and against the measured angles.

    A setpoint passes if it is finite, within the limits of position, velocity and acceleration,
    slow enough to stop before the position limits, and near enough to the measured angles. The
    steps of a stop only have to be finite, keep the acceleration limit, and not become faster:
    limits may have been lowered meanwhile, and the arm may have been pushed away.

    Args:
        period: Time between two setpoints [s].

    Attributes:
        last: Last setpoint (n,) [rad].
        velocity: Velocity (n,) of the last step [rad/s].

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
        """Begin at rest at measured angles (n,) [rad], and return them as the first setpoint.

        A joint that is beyond a position limit may stay there or move back.

        Raises:
            GuardError: The angles are not finite, or not of n joints.
        """
        self._begun = False
        self._check_size(measured)
        if not np.isfinite(measured).all():
            raise GuardError(f"joint angles {measured.tolist()} must be finite")
        self._begun = True
        self.last = np.array(measured, dtype=float)
        self.velocity = np.zeros_like(self.last)
        return self.last.copy()

    def check(self, setpoint: Array, measured: Array | None) -> Array:
        """Return the setpoint if it may be sent; the next one is then compared with it.

        A refused setpoint changes nothing: the next one is compared with the last accepted one.

        Args:
            measured: Joint angles (n,) [rad]; None for the step of a stop.

        Raises:
            GuardError: The setpoint is refused, or :meth:`begin` has not been called.
        """
        self._check_size(setpoint)
        if measured is None:
            velocity = self._check_stop_step(setpoint)
        else:
            velocity = self.examine(setpoint[None])[0]
            distance = np.abs(setpoint - measured)[None]
            self._check_bounds(distance, self.limits.distance, "distance to measured", "rad")
        self.last, self.velocity = np.array(setpoint, dtype=float), velocity
        return self.last.copy()

    def _check_stop_step(self, setpoint: Array) -> Array:
        self._check_begun()
        limits = self.limits
        velocity: Array = (setpoint - self.last) / self._period
        rate = (velocity - self.velocity) / self._period
        fastest = np.maximum(limits.velocity, np.abs(self.velocity))
        self._check_bounds(np.abs(velocity)[None], fastest, "velocity", "rad/s")
        self._check_bounds(np.abs(rate)[None], limits.acceleration, "acceleration", "rad/s^2")
        return velocity

    def _check_begun(self) -> None:
        if not self._begun:
            raise GuardError("the measured joint angles must be known before a setpoint")

    def examine(self, setpoints: Array) -> Array:
        """Check a sequence of setpoints that would follow the last one, and change nothing.

        Args:
            setpoints: Joint angles (k, n), one period apart [rad].

        Returns:
            Velocities (k, n) of their steps [rad/s].

        Raises:
            GuardError: One of them is refused, or :meth:`begin` has not been called.
        """
        self._check_begun()
        limits, dt = self.limits, self._period
        self._check_positions(setpoints)
        velocities = np.diff(setpoints, axis=0, prepend=self.last[None]) / dt
        rates = np.diff(velocities, axis=0, prepend=self.velocity[None]) / dt
        self._check_bounds(np.abs(velocities), limits.velocity, "velocity", "rad/s")
        self._check_bounds(np.abs(rates), limits.acceleration, "acceleration", "rad/s^2")
        # The stop consists of steps of dt, each shorter than the previous one by a dt^2.
        speeds = np.abs(velocities)
        stopping_distance = np.maximum(0.5 * speeds * (speeds / limits.acceleration - dt), 0.0)
        stopping_distance -= POSITION_TOLERANCE
        lower, upper = self._range()
        remaining = np.where(velocities > 0.0, upper - setpoints, setpoints - lower)
        is_safe = stopping_distance <= remaining + RELATIVE_TOLERANCE
        if not is_safe.all():
            i, k = np.argwhere(~is_safe)[0]
            raise GuardError(
                f"{limits.names[k]}: velocity {velocities[i, k]:.4g} rad/s at "
                f"{setpoints[i, k]:.4g} rad is too fast to stop before the position limit"
            )
        return velocities

    def _check_size(self, joints: Array) -> None:
        if joints.shape != self.limits.lower.shape:
            raise GuardError(f"must be {self.limits.lower.size} joint angles, got {joints.size}")

    def _range(self) -> tuple[Array, Array]:
        """Return lower and upper bounds (n,) [rad], widened to include the last setpoint."""
        limits = self.limits
        return np.minimum(limits.lower, self.last), np.maximum(limits.upper, self.last)

    def _check_positions(self, joints: Array) -> None:
        lower, upper = self._range()
        self._check_bounds(joints, upper, "position", "rad", tolerance=POSITION_TOLERANCE)
        self._check_bounds(-joints, -lower, "position", "rad", -1.0, POSITION_TOLERANCE)

    def _check_bounds(
        self,
        values: Array,
        bounds: Array,
        quantity: str,
        unit: str,
        sign: float = 1.0,
        tolerance: float = 0.0,
    ) -> None:
        """Check that values (k, n) are at most bounds (n,); NaN is refused."""
        upper = bounds + RELATIVE_TOLERANCE * np.abs(bounds) + tolerance
        is_within = values <= upper  # False for NaN
        if is_within.all():
            return
        i, k = np.argwhere(~is_within)[0]
        raise GuardError(
            f"{self.limits.names[k]}: {quantity} {sign * values[i, k]:.4g} {unit}, "
            f"the limit is {sign * bounds[k]:.4g} {unit}"
        )
