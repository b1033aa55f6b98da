"""From a twist to a command for the drives: the right-hand half of CCTA 2017 Fig. 6."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.coupling_controller import CouplingController
from omniman_ros.core.dynamics import PlatformDynamics
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.limits import saturation
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.robot import Robot
from omniman_ros.core.wheel_controller import WheelController

Array = NDArray[np.float64]

REST_SPEED = 0.02
"""Wheel speed below which a platform that is asked for nothing is said to stand [rad/s]."""


class DriveMode(Enum):
    """What the wheels' drives are asked to follow."""

    VELOCITY = "velocity"
    TORQUE = "torque"
    VOLTAGE = "voltage"


@dataclass(frozen=True)
class WheelCommand:
    """One command to the drives, wheels in the robot's order, arrays (n,).

    VELOCITY: `velocity` [rad/s] with `effort` [N m] as feed-forward; TORQUE: `effort` alone;
    VOLTAGE: `effort` holds volts.
    """

    mode: DriveMode
    effort: Array
    velocity: Array | None = None


class FollowingWatch:
    """Finds a wheel whose speed error lasts."""

    def __init__(self, count: int) -> None:
        self._lasted = np.zeros(count)

    def update(self, error: Array, limit: float, patience: float, dt: float) -> int | None:
        """Return the index of a wheel that was off by more than `limit` for `patience` s."""
        self._lasted = np.where(np.abs(error) > limit, self._lasted + dt, 0.0)
        worst = int(self._lasted.argmax())
        if self._lasted[worst] <= patience:
            return None
        self._lasted[:] = 0.0
        return worst


class WheelCascade:
    """Inverse kinematics, saturation, coupling controller, computed torque, wheel controllers.

    Attributes:
        kinematics, dynamics: Models with calibrated wheel radii.
        coupling: The coupling error epsilon.
        reference: (n,) wheel speeds asked for in the last command [rad/s].
        saturated: Whether the last twist was scaled down to the wheels' speed.
    """

    def __init__(self, parameters: PlatformParameters) -> None:
        n = parameters.robot.wheel_count
        self._set_models(parameters)
        self.coupling = CouplingController(self.kinematics, parameters.coupling)
        self._wheels = WheelController(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, parameters.wheel
        )
        self.reference: Array = np.zeros(n)
        self.saturated = False

    def _set_models(self, parameters: PlatformParameters) -> None:
        robot = _calibrated(parameters.robot, parameters.odometry.wheel_scale)
        self.kinematics = PlatformKinematics(robot.wheels)
        self.dynamics = PlatformDynamics(robot, self.kinematics)
        self._parameters = parameters

    def configure(self, parameters: PlatformParameters) -> None:
        """Take over new gains, limits and model values while running."""
        self._set_models(parameters)
        self.coupling.configure(self.kinematics, parameters.coupling)
        self._wheels.configure(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, parameters.wheel
        )

    def reachable(self, twist: Array) -> Array:
        """Scale a twist (3,) down to what the wheels' largest speed allows."""
        scale = saturation(self.kinematics.J @ twist, self._parameters.robot.motor.max_speed)
        self.saturated = scale < 1.0
        return twist * scale

    def rest(self, measured: Array) -> WheelCommand:
        """Zero speed in velocity mode; once the wheels stand, epsilon starts anew."""
        self.reference = np.zeros_like(self.reference)
        self._wheels.reset()
        if not float(np.abs(measured).max()) > REST_SPEED:
            self.coupling.reset()
        return WheelCommand(DriveMode.VELOCITY, np.zeros_like(measured), self.reference)

    def volts(self, volts: Array, measured: Array) -> WheelCommand:
        """Pass voltages (n,) [V] on; the cascade follows, so that it can take over any time."""
        self.reference = measured
        self._wheels.reset()
        return WheelCommand(DriveMode.VOLTAGE, volts)

    def command(
        self, twist: Array, rate: Array, measured: Array, mode: DriveMode, dt: float
    ) -> WheelCommand:
        """Command for a reachable twist.

        Args:
            twist: (3,) in base_link [m/s, m/s, rad/s].
            rate: (3,) its derivative as seen in base_link [m/s^2, rad/s^2].
            measured: (n,) wheel speeds [rad/s].
            mode: What the drives follow.
            dt: Time since the last command [s].
        """
        wheels = self.kinematics.J @ twist
        reference = wheels + self.coupling.correction(wheels)
        fastest = max(self._parameters.robot.motor.max_speed, float(np.abs(wheels).max()))
        reference = reference * saturation(reference, fastest)
        self.reference = reference
        effort = np.zeros_like(wheels)
        if self._parameters.drive.feed_forward:
            effort = self.dynamics.platform_torque(twist, rate)
            effort += self.dynamics.friction_torque(twist, wheels)
            effort = np.clip(effort, -self.dynamics.torque_limit, self.dynamics.torque_limit)
        if mode is DriveMode.VELOCITY:
            self._wheels.reset()
            return WheelCommand(mode, effort, reference)
        if mode is DriveMode.TORQUE:
            torque = self._wheels.torque(reference, measured, effort, dt)
            return WheelCommand(mode, torque)
        limits = self.dynamics.voltage_torques(reference)
        torque = self._wheels.torque(reference, measured, effort, dt, limits)
        return WheelCommand(mode, self.dynamics.voltage(torque, reference))


def _calibrated(robot: Robot, scale: tuple[float, ...]) -> Robot:
    """The robot with its wheels' radii times the odometry's calibration."""
    radius = tuple((np.array(robot.wheels.radius) * scale).tolist())
    return replace(robot, wheels=replace(robot.wheels, radius=radius))
