"""Cascade from a twist to a command for the drives (right-hand half of CCTA 2017 Fig. 6)."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import Enum
from typing import Annotated

import numpy as np

from omniman_ros.control.coupling_controller import CouplingController
from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import MIN_REMAINING_FRACTION, PlatformKinematics
from omniman_ros.control.limits import saturation
from omniman_ros.control.odometry import REST_SPEED
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_controller import WheelController
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Arm
from omniman_ros.core.validated import Validated


class DriveMode(Enum):
    """Quantity that the drives of the wheels follow."""

    VELOCITY = "velocity"
    TORQUE = "torque"
    VOLTAGE = "voltage"


@dataclass(frozen=True)
class WheelCommand(Validated):
    """A command to the drives of the n wheels, in the robot's order."""

    mode: DriveMode  #: Quantity that the drives follow
    #: Torque feed-forward [N m] in VELOCITY mode, torque [N m] in TORQUE mode, motor voltage [V]
    #: in VOLTAGE mode (n,).
    effort: Annotated[Array, Shape("n")]
    #: Wheel speeds (n,) [rad/s] in VELOCITY mode, else None
    velocity: Annotated[Array | None, Shape("n")] = None


class WheelCascade:
    """Converts twists to commands for the drives of the n wheels.

    The cascade consists of inverse kinematics, saturation, coupling controller, computed torque
    and wheel controllers.

    Args:
        idle: Indices of the wheels that roll without drive and get no torque.

    Raises:
        GeometryError: The wheels do not make a platform.
        ParameterError: The wheels that are not idle do not determine the twist.

    Attributes:
        robot: The robot with calibrated wheel radii, and the arm in its last known posture.
        kinematics: Kinematics with calibrated wheel radii.
        whole: The same without idle wheels.
        dynamics: Dynamics with calibrated wheel radii; idle wheels get no torque.
        reference: Wheel speeds (n,) that the last command demands [rad/s].
        demanded_torque: Wheel torques (n,) that it demands [N m]; in velocity mode those that the
            model computes.
        saturated: Whether the last twist was scaled down to the largest wheel speed.
    """

    def __init__(self, parameters: PlatformParameters, idle: Collection[int] = ()) -> None:
        n = parameters.robot.wheel_count
        self._arm: Arm | None = None
        self._set_models(parameters, idle)
        self.coupling = CouplingController(self.kinematics, parameters.coupling)
        self._wheels = WheelController(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, parameters.wheel
        )
        self.reference: Array = np.zeros(n)
        self.demanded_torque: Array = np.zeros(n)
        self.saturated = False

    def _set_models(self, parameters: PlatformParameters, idle: Collection[int]) -> None:
        robot = parameters.odometry.calibrated(parameters.robot)
        whole = PlatformKinematics(robot.wheels)
        if idle and whole.remaining_fraction(idle) < MIN_REMAINING_FRACTION:
            reason = "must leave wheels that determine the twist"
            raise ParameterError("drive.dead", parameters.drive.dead, reason)
        self.whole = whole
        self.kinematics = PlatformKinematics(robot.wheels, idle) if idle else whole
        self.robot = robot if self._arm is None else replace(robot, arm=self._arm)
        self.dynamics = PlatformDynamics(self.robot, self.kinematics)
        self._parameters = parameters

    def configure(self, parameters: PlatformParameters, idle: Collection[int] = ()) -> None:
        """Set new gains, limits, model values and idle wheels while running.

        Raises:
            GeometryError: The wheels do not make a platform; nothing is changed.
            ParameterError: The wheels that are not idle do not determine the twist; nothing is
                changed.
        """
        before = self.kinematics.idle
        self._set_models(parameters, idle)
        if self.kinematics.idle != before:
            self.coupling.reset()  # Its errors belong to other constraints.
        self.coupling.configure(self.kinematics, parameters.coupling)
        self._wheels.configure(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, parameters.wheel
        )

    def set_arm(self, arm: Arm) -> None:
        """Set the arm as a body at rest in another posture; all else goes on."""
        self._arm = arm
        self.robot = replace(self.robot, arm=arm)
        self.dynamics = PlatformDynamics(self.robot, self.kinematics)
        self._wheels.configure(
            self.dynamics.wheel_inertia, self.dynamics.torque_limit, self._parameters.wheel
        )

    def reachable(self, twist: Array) -> Array:
        """Return a twist (3,) scaled down so that no wheel exceeds its largest speed.

        Sets `saturated`.

        Args:
            twist: Twist (3,) in base_link [m/s, m/s, rad/s].
        """
        scale = saturation(self.kinematics.J @ twist, self._parameters.robot.motor.max_speed)
        self.saturated = scale < 1.0
        return twist * scale

    def rest_command(self, measured: Array) -> WheelCommand:
        """Return a command of zero speeds; tell the coupling controller once the wheels rest.

        Args:
            measured: Measured wheel speeds (n,) [rad/s].
        """
        self.reference = np.zeros_like(self.reference)
        self.demanded_torque = np.zeros_like(self.demanded_torque)
        self._wheels.reset()
        if not max(map(abs, measured.tolist())) > REST_SPEED:
            self.coupling.rest()
        return WheelCommand.unchecked(
            mode=DriveMode.VELOCITY, effort=np.zeros_like(measured), velocity=self.reference
        )

    def voltage_command(
        self, volts: Array, measured: Array, probe: Array | None = None
    ) -> WheelCommand:
        """Return a command of motor voltages that were computed outside the cascade.

        The cascade follows the wheels meanwhile, so that it can take over at any time.

        Args:
            volts: Motor voltages (n,) [V].
            measured: Measured wheel speeds (n,) [rad/s].
            probe: Test torques (n,) to add [N m], or None.
        """
        self.reference = measured
        self.demanded_torque = self.dynamics.torque_of(volts, measured)
        self._wheels.reset()
        if probe is not None:
            volts = self.dynamics.voltage(self.demanded_torque + probe, measured)
        return WheelCommand.unchecked(mode=DriveMode.VOLTAGE, effort=volts, velocity=None)

    def command(
        self,
        twist: Array,
        rate: Array,
        measured: Array,
        mode: DriveMode,
        dt: float,
        probe: Array | None = None,
    ) -> WheelCommand:
        """Return the command for a reachable twist.

        Args:
            twist: Twist (3,) in base_link [m/s, m/s, rad/s], as returned by :meth:`reachable`.
            rate: Derivative (3,) of its components in base_link [m/s^2, m/s^2, rad/s^2].
            measured: Measured wheel speeds (n,) [rad/s].
            probe: Test torques (n,) to add [N m], even if feed-forward is off, or None.
        """
        wheel_speeds = self.kinematics.J @ twist
        reference = wheel_speeds + self.coupling.correction(wheel_speeds, float(twist[2]))
        fastest = max(self._parameters.robot.motor.max_speed, *map(abs, wheel_speeds.tolist()))
        reference = reference * saturation(reference, fastest)
        self.reference = reference
        effort = self.dynamics.platform_torque(twist, rate)
        effort += self.dynamics.friction_torque(twist, wheel_speeds)
        limit = self.dynamics.torque_limit
        effort = np.minimum(np.maximum(effort, -limit), limit)  # np.clip takes four times as long
        self.demanded_torque = effort
        if not self._parameters.drive.feed_forward:
            effort = np.zeros_like(wheel_speeds)
        if mode is DriveMode.VELOCITY:
            self._wheels.reset()
            effort = effort if probe is None else effort + probe
            return WheelCommand.unchecked(mode=mode, effort=effort, velocity=reference)
        torque_range = None
        if mode is DriveMode.VOLTAGE:
            torque_range = self.dynamics.voltage_torques(reference)
        torque = self._wheels.torque(reference, measured, effort, dt, torque_range)
        self.demanded_torque = torque
        if probe is not None:
            torque = torque + probe
        if mode is DriveMode.TORQUE:
            return WheelCommand.unchecked(mode=mode, effort=torque, velocity=None)
        volts = self.dynamics.voltage(torque, reference)
        return WheelCommand.unchecked(mode=mode, effort=volts, velocity=None)
