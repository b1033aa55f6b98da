"""Inverse dynamics of platform, arm, wheels and motors: motion to torque, current and voltage.

Source: CCTA 2017, section IV, (19) to (23), with the corrections: the acceleration in space
includes the centripetal part, wheel torques follow from the power balance F_R = J' tau, and the
gear stands in the motor's torque. Friction after CCTA (23) and MPC 2021 (24).
"""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.robot import Robot

Array = NDArray[np.float64]

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""
SIGN_WIDTH = 0.05
"""Speed over which the model's sign of a speed goes from -1 to 1 [rad/s, m/s]."""


def smooth_sign(speed: Array) -> Array:
    """A sign without a jump: s / sqrt(s^2 + w^2), w = SIGN_WIDTH; elementwise."""
    result: Array = speed / np.sqrt(speed * speed + SIGN_WIDTH * SIGN_WIDTH)
    return result


class PlatformDynamics:
    """Torques that a motion of the platform asks of its wheels, and what motors need for them.

    Idle wheels of the kinematics get no torque: the others drag them along.

    Attributes (read-only arrays):
        mass_matrix: (3, 3) M about base_link's origin, arm included [kg, kg m, kg m^2].
        wheel_inertia: (n, n) W with tau = W phi'': what the wheels feel of platform, arm and
            their own inertia. Accelerations that break the constraints feel the wheels alone.
        loads: (n,) weight on each wheel [N], shared by the centre of mass.
        torque_limit: (n,) torque at the wheel that the current limit allows [N m]; 0 for idle
            wheels.
    """

    def __init__(self, robot: Robot, kinematics: PlatformKinematics) -> None:
        self._kinematics = kinematics
        self._motor = robot.motor
        bodies = (robot.body, robot.arm)
        mass = sum(body.mass for body in bodies)
        mx = sum(body.mass * body.com_x for body in bodies)
        my = sum(body.mass * body.com_y for body in bodies)
        turn = sum(body.inertia + body.mass * (body.com_x**2 + body.com_y**2) for body in bodies)
        self.mass_matrix = np.array([[mass, 0.0, -my], [0.0, mass, mx], [-my, mx, turn]])
        self._mass = mass
        self._moment = np.array([mx, my, 0.0])
        wheels = robot.wheels
        self._inertia = np.array(wheels.inertia)
        idle = list(kinematics.idle)
        driven = np.ones(robot.wheel_count)
        driven[idle] = 0.0
        self._driven = driven
        # What a wheel needs for itself; an idle one's is a force on the platform, (J+)' J'.
        self._carry = np.diag(driven) + kinematics.J_pinv.T @ kinematics.J.T @ np.diag(1 - driven)
        pinv, dragged = kinematics.J_pinv, kinematics.J[idle]
        moved = self.mass_matrix + dragged.T @ (self._inertia[idle, None] * dragged)
        self.wheel_inertia = pinv.T @ moved @ pinv + np.diag(self._inertia)
        spread = np.array([np.ones(len(wheels.x)), wheels.x, wheels.y])
        weight = GRAVITY * np.array([mass, mx, my])
        self.loads = np.maximum(np.linalg.pinv(spread) @ weight, 0.0)
        self._viscous = np.array(robot.friction.viscous)
        self._coulomb = np.array(robot.friction.coulomb)
        self._set_rollers(robot)
        motor = robot.motor
        gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
        self.torque_limit = gain * motor.max_current * driven

    def _set_rollers(self, robot: Robot) -> None:
        """Maps of roller drag: twist to rolling speeds, drag forces to wheel torques, CCTA (5)."""
        wheels = robot.wheels
        angle = np.array(wheels.heading) + np.array(wheels.roller_angle)
        c, s = np.cos(angle), np.sin(angle)
        chassis = np.column_stack([-s, c, np.array(wheels.x) * c + np.array(wheels.y) * s])
        wheel = np.array(wheels.radius) * np.sin(wheels.roller_angle)  # CCTA (6)
        self._rolling = chassis + wheel[:, None] * self._kinematics.J
        self._drag_torque = self._carry * wheel + self._kinematics.J_pinv.T @ chassis.T
        self._drag = np.array(robot.friction.roller) * self.loads

    def platform_torque(self, twist: Array, twist_rate: Array) -> Array:
        """Wheel torques (n,) [N m] that accelerate platform, arm and wheels; no friction.

        Args:
            twist: (3,) x'_R in base_link [m/s, m/s, rad/s].
            twist_rate: (3,) its derivative as seen in base_link, CCTA (20) [m/s^2, rad/s^2].
        """
        vx, vy, w = twist.tolist()
        in_space = twist_rate + np.array([-w * vy, w * vx, 0.0])
        force = self.mass_matrix @ in_space - (w * w) * self._moment
        pinv = self._kinematics.J_pinv
        own = self._inertia * (self._kinematics.J @ twist_rate)
        torque: Array = pinv.T @ force + (self._carry @ own if self._kinematics.idle else own)
        return torque

    def friction_torque(self, twist: Array, wheel_speeds: Array) -> Array:
        """M_fric (n,) [N m] of CCTA (23): shaft friction, MPC 2021 (24), and roller drag.

        Args:
            twist: (3,) in base_link [m/s, m/s, rad/s], for the rollers' speeds.
            wheel_speeds: (n,) [rad/s].
        """
        drag = self._drag * smooth_sign(self._rolling @ twist)
        own = self._viscous * wheel_speeds + self._coulomb * smooth_sign(wheel_speeds)
        carried = self._carry @ own if self._kinematics.idle else own
        torque: Array = carried + self._drag_torque @ drag
        return torque

    def current(self, torque: Array, wheel_speeds: Array) -> Array:
        """Armature currents (n,) [A] for wheel torques (n,), CCTA (21) with the gear.

        A driving motor loses 1 - eta in the gear, a driven one is spared it.
        """
        motor = self._motor
        gain = motor.gear_ratio * motor.torque_constant
        driving = torque * wheel_speeds >= 0.0
        efficiency = np.where(driving, 1.0 / motor.gear_efficiency, motor.gear_efficiency)
        result: Array = torque * efficiency / gain
        return result

    def voltage_torques(self, wheel_speeds: Array) -> tuple[Array, Array]:
        """Least and largest torque (n,) [N m] that voltage and current limits allow at a speed.

        The inverse of :meth:`current` and :meth:`voltage`.
        """
        limit = self._motor.max_voltage
        return self.torque_of(-limit, wheel_speeds), self.torque_of(limit, wheel_speeds)

    def torque_of(self, volts: Array | float, wheel_speeds: Array) -> Array:
        """Torques (n,) [N m] that motor voltages [V], (n,) or one, give at speeds (n,) [rad/s]."""
        motor = self._motor
        gain = motor.gear_ratio * motor.torque_constant
        free = (volts - gain * wheel_speeds) / motor.resistance
        limit = motor.max_current
        amps = np.minimum(np.maximum(free, -limit), limit) * self._driven
        driving = amps * wheel_speeds >= 0.0
        efficiency = np.where(driving, motor.gear_efficiency, 1.0 / motor.gear_efficiency)
        torque: Array = amps * gain * efficiency
        return torque

    def voltage(self, torque: Array, wheel_speeds: Array) -> Array:
        """Motor voltages (n,) [V], CCTA (22) at steady current, clipped to the amplifier's."""
        motor = self._motor
        emf = motor.gear_ratio * motor.torque_constant * wheel_speeds
        volts = motor.resistance * self.current(torque, wheel_speeds) + emf
        limit = motor.max_voltage
        result: Array = np.minimum(np.maximum(volts, -limit), limit)
        return result
