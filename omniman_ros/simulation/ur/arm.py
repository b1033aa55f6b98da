"""Simulated arm: joints that follow their target within the limits of their drives."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.simulation.ur import kinematics

JOINTS = 6
"""Number of joints."""
CYCLE = 0.008
"""Cycle time of a CB3 controller [s]."""

REST_SPEED = 1e-3
"""Joint speed below which the arm counts as at rest [rad/s]."""

TORQUE_CONSTANTS = np.array([12.5, 12.5, 12.5, 9.2, 9.2, 9.2])
"""Torque at each joint per motor current [N m/A]; similar to a UR5's."""
INERTIAS = np.array([3.0, 3.0, 1.0, 0.1, 0.1, 0.05])
"""Moment of inertia at each joint [kg m^2]; similar to a UR5's."""
FRICTION = np.array([8.0, 8.0, 5.0, 2.0, 2.0, 2.0])
"""Viscous friction of each joint [N m s/rad]; similar to a UR5's."""


@dataclass(frozen=True, kw_only=True)
class UrArmParameters:
    """Limits of the simulated arm, and of its safety system.

    Position, speed and acceleration limits are those that a controller reports as its own
    configuration (Universal_Robots_Client_Library, test_primary_parser.cpp, CONFIGURATION_DATA):
    363 deg, 191.5 deg/s, 40 rad/s^2; a little more than the data sheet's pi rad/s and 360 deg.
    """

    initial: tuple[float, ...] = parameter(
        (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031),
        "Initial joint angles.",
        unit="rad",
        low=-6.3,
        high=6.3,
        read_only=True,
    )
    range: float = parameter(
        6.3355,
        "Magnitude of a joint angle above which there is a protective stop.",
        unit="rad",
        low=0.1,
        high=6.3355,
        read_only=True,
    )
    speed: float = parameter(
        3.3415,
        "Joint speed above which there is a protective stop.",
        unit="rad/s",
        low=0.1,
        high=3.3415,
        read_only=True,
    )
    acceleration: float = parameter(
        40.0, "Largest joint acceleration.", unit="rad/s^2", low=1, high=100, read_only=True
    )
    lag: float = parameter(
        0.01,
        "Lag of a joint behind its target.",
        unit="s",
        low=0.001,
        high=0.1,
        read_only=True,
    )
    deviation: float = parameter(
        0.1,
        "Distance of a joint from its target above which there is a protective stop.",
        unit="rad",
        low=0.01,
        high=1,
        read_only=True,
    )
    protective_deceleration: float = parameter(
        15.0,
        "Deceleration of the fastest joint in protective and emergency stops.",
        unit="rad/s^2",
        low=1,
        high=40,
        read_only=True,
    )

    def __post_init__(self) -> None:
        """Compare the parameters with each other.

        Raises:
            ParameterError: There are not six angles, one is out of range, or the deceleration of
                stops is above the largest acceleration.
        """
        if len(self.initial) != JOINTS or any(abs(q) > self.range for q in self.initial):
            reason = f"must be {JOINTS} angles within +-{self.range} rad"
            raise ParameterError("simulated_arm.initial", self.initial, reason)
        if self.protective_deceleration > self.acceleration:
            raise ParameterError(
                "simulated_arm.protective_deceleration",
                self.protective_deceleration,
                f"must be at most simulated_arm.acceleration = {self.acceleration} rad/s^2",
            )


class SimulatedArm:
    """Six independent joints, each of second order with limited acceleration.

    Attributes:
        q: Angles [rad].
        qd: Speeds [rad/s].
        qdd: Accelerations in the last cycle [rad/s^2].
    """

    def __init__(self, parameters: UrArmParameters) -> None:
        self.parameters = parameters
        self.q: Array = np.array(parameters.initial)
        self.qd: Array = np.zeros(JOINTS)
        self.qdd: Array = np.zeros(JOINTS)

    def follow(self, target: Array, dt: float) -> None:
        """Follow target angles (6,) [rad] for a time dt [s].

        A joint is critically damped, and lags by `lag` in steady motion. The step is implicit,
        and therefore stable for any cycle time.
        """
        lag = self.parameters.lag
        stiffness = 4.0 / lag**2
        unlimited_qd = (self.qd + dt * stiffness * (target - self.q)) / (
            1.0 + dt * stiffness * (dt + lag)
        )
        limit = self.parameters.acceleration
        self._move(np.clip((unlimited_qd - self.qd) / dt, -limit, limit), dt)

    def brake(self, dt: float) -> None:
        """Decelerate for a time [s], all joints in proportion: the arm keeps its path."""
        fastest = float(np.max(np.abs(self.qd)))
        if fastest == 0.0:
            self.qdd = np.zeros(JOINTS)
            return
        remaining_fraction = max(0.0, 1.0 - self.parameters.protective_deceleration * dt / fastest)
        self._move(self.qd * (remaining_fraction - 1.0) / dt, dt)
        if remaining_fraction == 0.0:
            self.qd = np.zeros(JOINTS)

    def _move(self, acceleration: Array, dt: float) -> None:
        self.qdd = acceleration
        self.qd = self.qd + acceleration * dt
        self.q = self.q + self.qd * dt

    @property
    def still(self) -> bool:
        """Whether the arm counts as at rest."""
        return bool(np.max(np.abs(self.qd)) < REST_SPEED)

    def violation(self, target: Array) -> str:
        """Return which limit is exceeded, with the values; an empty string if none is."""
        p = self.parameters
        # A joint beyond its range may move back.
        outward = np.where(self.q * self.qd > 0.0, np.abs(self.q), 0.0)
        checks = (
            ("position", "rad", outward, p.range),
            ("speed", "rad/s", np.abs(self.qd), p.speed),
            ("deviation", "rad", np.abs(target - self.q), p.deviation),
        )
        for name, unit, values, limit in checks:
            # Negated, so that NaN violates the limit.
            bad = np.flatnonzero(~(values <= limit))
            if bad.size:
                k = int(bad[0])
                return f"{name} of joint {k}: {values[k]:.3f} above {limit:.3f} {unit}"
        return ""

    def currents(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the motor currents (6,) for a motion [A]: gravity, inertia and friction."""
        torque = kinematics.gravity_torque(q) + INERTIAS * qdd + FRICTION * qd
        return np.asarray(torque / TORQUE_CONSTANTS)
