"""The arm: joints that follow their target, within what their drives can do."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.simulated_ur import kinematics

Array = NDArray[np.float64]
JOINTS = 6

TORQUE_CONSTANTS = np.array([12.5, 12.5, 12.5, 9.2, 9.2, 9.2])
"""Torque at the joint per current of its motor, N m/A; of the size of a UR5's."""
INERTIAS = np.array([3.0, 3.0, 1.0, 0.1, 0.1, 0.05])
"""At the joint, kg m^2; of the size of a UR5's."""
FRICTION = np.array([8.0, 8.0, 5.0, 2.0, 2.0, 2.0])
"""Viscous, N m s/rad; of the size of a UR5's."""


@dataclass(frozen=True, kw_only=True)
class UrArmParameters:
    """What the simulated arm can do, and what its safety system lets it do.

    Position, speed and acceleration limits are those that a controller reports as its own
    configuration (Universal_Robots_Client_Library, test_primary_parser.cpp, CONFIGURATION_DATA):
    363 deg, 191.5 deg/s, 40 rad/s^2; a little more than the data sheet's pi rad/s and 360 deg.
    """

    initial: tuple[float, ...] = parameter(
        (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031),
        "Joint angles in the beginning.", unit="rad", low=-6.3, high=6.3, read_only=True,
    )  # fmt: skip
    range: float = parameter(
        6.3355, "Joint angle to both sides beyond which there is a protective stop.", unit="rad",
        low=0.1, high=6.3355, read_only=True,
    )  # fmt: skip
    speed: float = parameter(
        3.3415, "Joint speed above which there is a protective stop.", unit="rad/s", low=0.1,
        high=3.3415, read_only=True,
    )  # fmt: skip
    acceleration: float = parameter(
        40.0, "Largest joint acceleration.", unit="rad/s^2", low=1, high=100, read_only=True
    )
    lag: float = parameter(
        0.01, "By how much a joint lags behind its target.", unit="s", low=0.001, high=0.1,
        read_only=True,
    )  # fmt: skip
    deviation: float = parameter(
        0.1, "Distance of a joint to its target above which there is a protective stop.",
        unit="rad", low=0.01, high=1, read_only=True,
    )  # fmt: skip
    protective_deceleration: float = parameter(
        15.0, "Deceleration of the fastest joint in protective and emergency stops.",
        unit="rad/s^2", low=1, high=40, read_only=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Compare the parameters with each other.

        Raises:
            ParameterError: Not six angles, one is out of range, or stops are harder than possible.
        """
        if len(self.initial) != JOINTS or any(abs(q) > self.range for q in self.initial):
            reason = f"6 angles up to {self.range} rad"
            raise ParameterError("simulated_arm.initial", self.initial, reason)
        if self.protective_deceleration > self.acceleration:
            raise ParameterError(
                "simulated_arm.protective_deceleration", self.protective_deceleration,
                f"more than ur.acceleration = {self.acceleration} rad/s^2",
            )  # fmt: skip


class Arm:
    """Six independent joints, each of second order with a limit of its acceleration.

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
        """Follow target angles [rad] for a cycle [s].

        A joint is critically damped: in steady motion it lags by `lag`. The step is implicit, so
        that it is stable whatever the cycle.
        """
        lag = self.parameters.lag
        stiffness = 4.0 / lag**2
        wanted = (self.qd + dt * stiffness * (target - self.q)) / (
            1.0 + dt * stiffness * (dt + lag)
        )
        limit = self.parameters.acceleration
        self._move(np.clip((wanted - self.qd) / dt, -limit, limit), dt)

    def brake(self, dt: float) -> None:
        """Decelerate for a cycle [s], all joints in proportion, so that the path stays."""
        fastest = float(np.max(np.abs(self.qd)))
        if fastest == 0.0:
            self.qdd = np.zeros(JOINTS)
            return
        left = max(0.0, 1.0 - self.parameters.protective_deceleration * dt / fastest)
        self._move(self.qd * (left - 1.0) / dt, dt)
        if left == 0.0:
            self.qd = np.zeros(JOINTS)

    def _move(self, acceleration: Array, dt: float) -> None:
        self.qdd = acceleration
        self.qd = self.qd + acceleration * dt
        self.q = self.q + self.qd * dt

    @property
    def still(self) -> bool:
        """Whether no joint moves: less than 1 mrad/s."""
        return bool(np.max(np.abs(self.qd)) < 1e-3)

    def violation(self, target: Array) -> str:
        """What of the limits is exceeded, in words; empty if nothing is."""
        p = self.parameters
        # Beyond its range a joint may be moved back.
        outward = np.where(self.q * self.qd > 0.0, np.abs(self.q), 0.0)
        checks = (
            ("position", "rad", outward, p.range),
            ("speed", "rad/s", np.abs(self.qd), p.speed),
            ("deviation", "rad", np.abs(target - self.q), p.deviation),
        )
        for name, unit, values, limit in checks:
            # Not "greater": NaN is no angle to go to.
            bad = np.flatnonzero(~(values <= limit))
            if bad.size:
                k = int(bad[0])
                return f"{name} of joint {k}: {values[k]:.3f} above {limit:.3f} {unit}"
        return ""

    def currents(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Currents of the motors for a motion [A]: gravity, inertia and friction."""
        torque = kinematics.gravity_torque(q) + INERTIAS * qdd + FRICTION * qd
        return np.asarray(torque / TORQUE_CONSTANTS)
