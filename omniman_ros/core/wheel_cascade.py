"""From a twist to a command for the drives: the right-hand half of CCTA 2017 Fig. 6."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.coupling_controller import CouplingController
from omniman_ros.core.dynamics import PlatformDynamics
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.kinematics import MARGIN, PlatformKinematics
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


class WheelCascade:
    """Inverse kinematics, saturation, coupling controller, computed torque, wheel controllers.

    Attributes:
        kinematics, dynamics: Models with calibrated wheel radii; idle wheels get no torque.
        coupling: The coupling error epsilon.
        reference: (n,) wheel speeds asked for in the last command [rad/s].
        asked: (n,) wheel torques asked for in it, or computed where the drive makes them [N m].
        saturated: Whether the last twist was scaled down to the wheels' speed.
    """

    def __init__(self, parameters: PlatformParameters, idle: Collection[int] = ()) -> None:
        n = parameters.robot.wheel_count
        self._set_models(parameters, idle)
        self.coupling = CouplingController(self.kinematics, parameters.coupling)
        self._wheels = WheelController(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, parameters.wheel
        )
        self.reference: Array = np.zeros(n)
        self.asked: Array = np.zeros(n)
        self.saturated = False

    def _set_models(self, parameters: PlatformParameters, idle: Collection[int]) -> None:
        robot = _calibrated(parameters.robot, parameters.odometry.wheel_scale)
        whole = PlatformKinematics(robot.wheels)
        if idle and whole.remains(idle) < MARGIN:
            reason = "the other wheels do not determine the twist"
            raise ParameterError("drive.dead", parameters.drive.dead, reason)
        self.kinematics = PlatformKinematics(robot.wheels, idle) if idle else whole
        self.dynamics = PlatformDynamics(robot, self.kinematics)
        self._parameters = parameters

    def configure(self, parameters: PlatformParameters, idle: Collection[int] = ()) -> None:
        """Take over new gains, limits, model values and idle wheels while running.

        Raises:
            GeometryError: The wheels would not make a platform; nothing is changed.
            ParameterError: Those that are not idle would not; nothing is changed.
        """
        before = self.kinematics.idle
        self._set_models(parameters, idle)
        if self.kinematics.idle != before:
            self.coupling.reset()  # other constraints
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
        self.asked = np.zeros_like(self.asked)
        self._wheels.reset()
        if not max(map(abs, measured.tolist())) > REST_SPEED:
            self.coupling.reset()
        return WheelCommand(DriveMode.VELOCITY, np.zeros_like(measured), self.reference)

    def volts(self, volts: Array, measured: Array, probe: Array | None = None) -> WheelCommand:
        """Pass voltages (n,) [V] on; the cascade follows, so that it can take over any time.

        Args:
            volts, measured: Voltages, and speeds (n,) [rad/s].
            probe: (n,) torques to add [N m].
        """
        self.reference = measured
        self.asked = self.dynamics.torque_of(volts, measured)
        self._wheels.reset()
        if probe is not None:
            volts = self.dynamics.voltage(self.asked + probe, measured)
        return WheelCommand(DriveMode.VOLTAGE, volts)

    def command(
        self,
        twist: Array,
        rate: Array,
        measured: Array,
        mode: DriveMode,
        dt: float,
        probe: Array | None = None,
    ) -> WheelCommand:
        """Command for a reachable twist.

        Args:
            twist: (3,) in base_link [m/s, m/s, rad/s].
            rate: (3,) its derivative as seen in base_link [m/s^2, rad/s^2].
            measured: (n,) wheel speeds [rad/s].
            mode: What the drives follow.
            dt: Time since the last command [s].
            probe: (n,) torques to add, whatever the feed-forward is [N m].
        """
        wheels = self.kinematics.J @ twist
        reference = wheels + self.coupling.correction(wheels)
        fastest = max(self._parameters.robot.motor.max_speed, *map(abs, wheels.tolist()))
        reference = reference * saturation(reference, fastest)
        self.reference = reference
        effort = self.dynamics.platform_torque(twist, rate)
        effort += self.dynamics.friction_torque(twist, wheels)
        limit = self.dynamics.torque_limit
        effort = np.minimum(np.maximum(effort, -limit), limit)  # np.clip takes four times as long
        self.asked = effort
        if not self._parameters.drive.feed_forward:
            effort = np.zeros_like(wheels)
        if mode is DriveMode.VELOCITY:
            self._wheels.reset()
            return WheelCommand(mode, effort if probe is None else effort + probe, reference)
        limits = None
        if mode is DriveMode.VOLTAGE:
            limits = self.dynamics.voltage_torques(reference)
        torque = self._wheels.torque(reference, measured, effort, dt, limits)
        self.asked = torque
        if probe is not None:
            torque = torque + probe
        if mode is DriveMode.TORQUE:
            return WheelCommand(mode, torque)
        return WheelCommand(mode, self.dynamics.voltage(torque, reference))


def _calibrated(robot: Robot, scale: tuple[float, ...]) -> Robot:
    """The robot with its wheels' radii times the odometry's calibration."""
    radius = tuple((np.array(robot.wheels.radius) * scale).tolist())
    return replace(robot, wheels=replace(robot.wheels, radius=radius))
