"""Inverse dynamics of platform, arm, wheels and motors: torque, current and voltage of a motion.

Source: CCTA 2017, section IV, (19) to (23), with corrections: the inertial acceleration includes
the centripetal part, wheel torques follow from the power balance F_R = J' tau, and the motor's
torque includes the gear. Friction follows CCTA (23) and MPC 2021 (24).
"""

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import ratio
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform

GRAVITY = 9.80665  #: Standard gravity [m/s^2]
#: Width of the smoothed sign function, the speed at which it is 1 / sqrt(2) [rad/s, m/s]
SIGN_WIDTH = 0.05


def smooth_sign(speed: Array) -> Array:
    """Return the smoothed sign s / sqrt(s^2 + w^2), w = SIGN_WIDTH, of speeds s [rad/s or m/s]."""
    result: Array = speed / np.sqrt(speed * speed + SIGN_WIDTH * SIGN_WIDTH)
    return result


class PlatformDynamics:
    """Computes wheel torques for a motion of the platform, and motor currents and voltages.

    Idle wheels of the kinematics get no torque: the other wheels drag them along.

    Attributes:
        mass_matrix: Mass matrix M (3, 3) about base_link's origin, arm included
            [kg, kg m, kg m^2].
        wheel_inertia: Matrix W (n, n) with tau = W phi'' [kg m^2]: inertia of platform, arm and
            wheels as seen by the wheels. Wheel accelerations that violate the constraints are
            resisted by the wheels' own inertia alone.
        loads: Weight on each wheel (n,) [N], distributed according to the centre of mass.
        torque_limit: Largest torque of each wheel (n,) that the current limit allows [N m]; 0 for
            idle wheels.
        rolling: Matrix (n, 3) from a twist in base_link to the speeds [m/s] with which the ground
            rollers roll across their axes, CCTA (5) and (6).
    """

    def __init__(self, robot: Platform, kinematics: PlatformKinematics) -> None:
        self._kinematics = kinematics
        self._motor = robot.motor
        bodies = (robot.body, robot.arm)
        mass = sum(body.mass for body in bodies)
        mx = sum(body.mass * body.com_x for body in bodies)
        my = sum(body.mass * body.com_y for body in bodies)
        yaw_inertia = sum(b.inertia + b.mass * (b.com_x**2 + b.com_y**2) for b in bodies)
        self.mass_matrix = np.array([[mass, 0.0, -my], [0.0, mass, mx], [-my, mx, yaw_inertia]])
        self._mass = mass
        self._moment = np.array([mx, my, 0.0])
        wheels = robot.wheels
        self._inertia = np.array(wheels.inertia)
        idle = list(kinematics.idle)
        driven = np.ones(robot.wheel_count)
        driven[idle] = 0.0
        self._driven = driven
        # Maps the torques that accelerate the wheels themselves and overcome their friction to
        # torques of the driven wheels: that of an idle wheel becomes a force on the platform,
        # (J+)' J'.
        self._carry = np.diag(driven) + kinematics.J_pinv.T @ kinematics.J.T @ np.diag(1 - driven)
        pinv, dragged = kinematics.J_pinv, kinematics.J[idle]
        mass_matrix = self.mass_matrix + dragged.T @ (self._inertia[idle, None] * dragged)
        self.wheel_inertia = pinv.T @ mass_matrix @ pinv + np.diag(self._inertia)
        # The loads balance the weight and its moments about the y and x axes.
        balance = np.array([np.ones(len(wheels.x)), wheels.x, wheels.y])
        weight = GRAVITY * np.array([mass, mx, my])
        self.loads = np.maximum(np.linalg.pinv(balance) @ weight, 0.0)
        self._viscous = np.array(robot.friction.viscous)
        self._coulomb = np.array(robot.friction.coulomb)
        self._set_rollers(robot)
        motor = robot.motor
        gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
        self.torque_limit = gain * motor.max_current * driven

    def _set_rollers(self, robot: Platform) -> None:
        """Compute the maps of roller drag: twist to rolling speed, force to torque, CCTA (5)."""
        wheels = robot.wheels
        angle = np.array(wheels.heading) + np.array(wheels.roller_angle)
        c, s = np.cos(angle), np.sin(angle)
        chassis = np.column_stack([-s, c, np.array(wheels.x) * c + np.array(wheels.y) * s])
        wheel = np.array(wheels.radius) * np.sin(wheels.roller_angle)  # CCTA (6)
        self.rolling = chassis + wheel[:, None] * self._kinematics.J
        self._drag_torque = self._carry * wheel + self._kinematics.J_pinv.T @ chassis.T
        self._drag = np.array(robot.friction.roller) * self.loads

    def platform_torque(self, twist: Array, twist_rate: Array) -> Array:
        """Return wheel torques (n,) [N m] that accelerate platform, arm and wheels.

        Friction is not included.

        Args:
            twist: Twist x'_R (3,) in base_link [m/s, m/s, rad/s].
            twist_rate: Derivative (3,) of its components in base_link, CCTA (20)
                [m/s^2, m/s^2, rad/s^2].
        """
        force = self.body_wrench(twist, twist_rate)
        pinv = self._kinematics.J_pinv
        wheel_torque = self._inertia * (self._kinematics.J @ twist_rate)
        if self._kinematics.idle:
            wheel_torque = self._carry @ wheel_torque
        torque: Array = pinv.T @ force + wheel_torque
        return torque

    def body_wrench(self, twist: Array, twist_rate: Array) -> Array:
        """Return the wrench (3,) in base_link that moves platform and arm [N, N, N m].

        Args:
            twist: Twist x'_R (3,) in base_link [m/s, m/s, rad/s].
            twist_rate: Derivative (3,) of its components in base_link, CCTA (20) [m/s^2, m/s^2,
                rad/s^2].
        """
        vx, vy, w = twist.tolist()
        inertial = twist_rate + np.array([-w * vy, w * vx, 0.0])
        wrench: Array = self.mass_matrix @ inertial - (w * w) * self._moment
        return wrench

    def momentum_map(self) -> Array:
        """Return the map (3, n) of wheel speeds to the momentum of platform, arm and wheels.

        It is M J+ + J' I, with the wheels' own inertia I [kg m, kg m, kg m^2 per rad].
        """
        kinematics = self._kinematics
        result: Array = self.mass_matrix @ kinematics.J_pinv + kinematics.J.T * self._inertia
        return result

    def friction_wrenches(self) -> tuple[Array, Array]:
        """Return the maps to the wrenches in base_link that friction takes, CCTA (23).

        Returns:
            Map (3, n) of the wheel speeds [rad/s] to the wrench of viscous friction, and map
            (3, 2 n) of the smoothed signs of the wheels' and of the rollers' speeds to the wrench
            of dry friction and roller drag [N, N, N m]. Together they are J' times
            :meth:`friction_torque`.
        """
        forward = self._kinematics.J.T
        drag = forward @ self._drag_torque * self._drag
        return forward * self._viscous, np.hstack([forward * self._coulomb, drag])

    def friction_torque(self, twist: Array, wheel_speeds: Array) -> Array:
        """Return wheel torques M_fric (n,) [N m] that overcome friction, CCTA (23).

        Friction consists of shaft friction, MPC 2021 (24), and roller drag.

        Args:
            twist: Twist (3,) in base_link [m/s, m/s, rad/s], for the speeds of the rollers.
            wheel_speeds: Wheel speeds (n,) [rad/s].
        """
        drag = self._drag * smooth_sign(self.rolling @ twist)
        shaft = self._viscous * wheel_speeds + self._coulomb * smooth_sign(wheel_speeds)
        if self._kinematics.idle:
            shaft = self._carry @ shaft
        torque: Array = shaft + self._drag_torque @ drag
        return torque

    def current(self, torque: Array, wheel_speeds: Array) -> Array:
        """Return armature currents (n,) [A] at torques [N m] and speeds [rad/s], CCTA (21).

        The gear's efficiency eta raises the current of a driving motor to 1 / eta of that without
        losses, and lowers that of a braking motor to eta.
        """
        motor = self._motor
        gain = motor.gear_ratio * motor.torque_constant
        driving = torque * wheel_speeds >= 0.0
        efficiency = np.where(driving, 1.0 / motor.gear_efficiency, motor.gear_efficiency)
        result: Array = torque * efficiency / gain
        return result

    def voltage_torques(self, wheel_speeds: Array) -> tuple[Array, Array]:
        """Return the least and greatest torques (n,) [N m] within voltage and current limits.

        Args:
            wheel_speeds: Wheel speeds (n,) [rad/s].
        """
        limit = self._motor.max_voltage
        return self.torque_of(-limit, wheel_speeds), self.torque_of(limit, wheel_speeds)

    def torque_of(self, volts: Array | float, wheel_speeds: Array) -> Array:
        """Return wheel torques (n,) [N m] within the current limit: the inverse of `voltage`.

        Args:
            volts: Motor voltages (n,) [V], or a single voltage for all motors.
            wheel_speeds: Wheel speeds (n,) [rad/s].
        """
        motor = self._motor
        gain = motor.gear_ratio * motor.torque_constant
        unlimited = (volts - gain * wheel_speeds) / motor.resistance
        limit = motor.max_current
        amps = np.minimum(np.maximum(unlimited, -limit), limit) * self._driven
        driving = amps * wheel_speeds >= 0.0
        efficiency = np.where(driving, motor.gear_efficiency, 1.0 / motor.gear_efficiency)
        torque: Array = amps * gain * efficiency
        return torque

    def voltage(self, torque: Array, wheel_speeds: Array) -> Array:
        """Return motor voltages (n,) [V], CCTA (22) at constant current, within their limit.

        Args:
            torque: Wheel torques (n,) [N m].
            wheel_speeds: Wheel speeds (n,) [rad/s].
        """
        motor = self._motor
        emf = motor.gear_ratio * motor.torque_constant * wheel_speeds
        volts = motor.resistance * self.current(torque, wheel_speeds) + emf
        limit = motor.max_voltage
        result: Array = np.minimum(np.maximum(volts, -limit), limit)
        return result

    def limited_voltage(
        self, volts: Array, twist: Array, wheel_speeds: Array, limit: tuple[float, float]
    ) -> Array:
        """Return motor voltages (n,) [V] that accelerate the platform no faster than a limit.

        What the torques leave beyond those that hold the present twist accelerates platform, arm
        and wheels, (M + J' I J) x'' = J' (torque beyond). It is scaled down where x'' is too
        large, so the direction of the acceleration is kept.

        Args:
            twist: Twist (3,) in base_link [m/s, m/s, rad/s].
            wheel_speeds: Wheel speeds (n,) [rad/s].
            limit: Linear and angular limit of the rate of the twist [m/s^2, rad/s^2].
        """
        hold = self.platform_torque(twist, np.zeros(3)) + self.friction_torque(twist, wheel_speeds)
        beyond = self.torque_of(volts, wheel_speeds) - hold
        forward = self._kinematics.J
        inertia = self.momentum_map() @ forward
        rate = np.asarray(np.linalg.solve(inertia, forward.T @ beyond), dtype=np.float64)
        excess = ratio(rate, limit)
        return volts if excess <= 1.0 else self.voltage(hold + beyond / excess, wheel_speeds)
