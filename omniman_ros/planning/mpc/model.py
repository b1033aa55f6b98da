"""Model of the robot for planning, MPC 2021 (13) to (24), for any wheels, in casadi's symbols.

The state is pose and body twist (x, y, psi, v_x, v_y, omega): in base_link the mass matrix is
constant and wheel speeds are linear, phi' = J v, so that the energy is convex in state and control
without any approximation. Controls are the motor currents, constant over a step; by (21) they
correspond to the voltages v = R i + N K phi', which follow the back-EMF within the step. Constant
voltages would make the system stiff for strong motors (the time constant of `omniman` is 32 ms).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import casadi as ca
import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics, smooth_sign
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated

STATES = 6  #: Number of states
#: Wheel speed over which Coulomb friction rises [rad/s]: makes MPC 2021 (24) differentiable
SIGN_WIDTH = 0.3
ROLLING_WIDTH = 0.03  #: Rolling speed over which the drag of rollers rises [m/s]


@dataclass(frozen=True)
class PlanningModel(Validated):
    """Constants of the model; its arrays must not be changed."""

    J: Annotated[Array, Shape("n", 3)]  #: (n, 3) inverse Jacobian [1/m, 1/m, 1]
    #: (3, 3) H of (14) in base_link: platform, arm and wheels [kg, kg m, kg m^2]
    inertia: Annotated[Array, Shape(3, 3)]
    mass: Annotated[Array, Shape(3, 3)]  #: (3, 3) the same without the wheels' own inertia
    #: (3,) first moment of mass, for the centripetal force [kg m]
    moment: Annotated[Array, Shape(3)]
    resistance: float  #: R of each motor [ohm]
    emf: float  #: N K of each motor, at the wheel [V s/rad]
    efficiency: float  #: Efficiency eta of all gears [-]
    viscous: Annotated[Array, Shape("n")]  #: (n,) viscous friction a of (24) [N m s/rad]
    coulomb: Annotated[Array, Shape("n")]  #: (n,) Coulomb friction b of (24) [N m]
    #: (n, 3) matrix from a twist to the rolling speeds of the rollers [-, -, m]
    rolling: Annotated[Array, Shape("n", 3)]
    drag: Annotated[Array, Shape("n")]  #: (n,) largest drag of each roller [N]
    #: (n,) largest currents that amplifier and traction allow [A]
    max_current: Annotated[Array, Shape("n")]
    max_voltage: float  #: Largest motor voltage [V]
    max_speed: float  #: Largest wheel speed [rad/s]
    half: Annotated[Array, Shape(2)]  #: (2,) half length and half width of the bounding box [m]

    @staticmethod
    def of(robot: Platform) -> "PlanningModel":
        """Return the model of a robot."""
        kinematics = PlatformKinematics(robot.wheels)
        dynamics = PlatformDynamics(robot, kinematics)
        wheels, motor = robot.wheels, robot.motor
        emf = motor.gear_ratio * motor.torque_constant
        jacobian = np.array(kinematics.J)
        wheel_inertia = jacobian.T @ np.diag(wheels.inertia) @ jacobian
        angle = np.array(wheels.heading) + np.array(wheels.roller_angle)
        c, s = np.cos(angle), np.sin(angle)
        chassis = np.column_stack([-s, c, np.array(wheels.x) * c + np.array(wheels.y) * s])
        rolling = (
            chassis + (np.array(wheels.radius) * np.sin(wheels.roller_angle))[:, None] * jacobian
        )
        # A wheel pushes along its roller's axis: a force mu N is a torque mu N r cos(gamma).
        grip = robot.friction.mu * dynamics.loads * wheels.radius * np.cos(wheels.roller_angle)
        mass = np.array(dynamics.mass_matrix)
        return PlanningModel(
            J=jacobian,
            inertia=mass + wheel_inertia,
            mass=mass,
            moment=np.array([mass[1, 2], -mass[0, 2], 0.0]),
            resistance=motor.resistance,
            emf=emf,
            efficiency=motor.gear_efficiency,
            viscous=np.array(robot.friction.viscous),
            coulomb=np.array(robot.friction.coulomb),
            rolling=rolling,
            drag=np.array(robot.friction.roller) * dynamics.loads,
            max_current=np.minimum(motor.max_current, grip / (motor.gear_efficiency * emf)),
            max_voltage=motor.max_voltage,
            max_speed=motor.max_speed,
            half=np.array([0.5 * robot.body.length, 0.5 * robot.body.width]),
        )

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return int(self.J.shape[0])

    def voltages(self, currents: Array, twists: Array) -> Array:
        """Return the voltages (..., n) [V] of currents (..., n) at body twists (..., 3), (21)."""
        result: Array = self.resistance * currents + self.emf * (twists @ self.J.T)
        return result

    @property
    def is_voltage_limited(self) -> bool:
        """Whether the largest current may need more than the largest voltage at some speed.

        A tenth more than the largest speed counts as possible.
        """
        emf = self.emf * 1.1 * self.max_speed
        return self.resistance * float(self.max_current.max()) + emf > self.max_voltage

    @cached_property
    def drive(self) -> Array:
        """(3, n) accelerations of the robot by each motor's current [m/s^2/A, rad/s^2/A]."""
        result: Array = np.linalg.inv(self.inertia) @ (self.efficiency * self.emf * self.J.T)
        return result

    def twist_rate(self, twist: ca.SX, currents: ca.SX) -> ca.SX:
        """Return the derivative (3,) of the body twist at currents (n,): (13) in base_link."""
        return ca.DM(self.drive) @ currents + self._free_rate(twist)

    @cached_property
    def free_rate(self) -> ca.Function:
        """Derivative (3,) of a twist without currents, and its Jacobian (3, 3) by the twist."""
        twist = ca.SX.sym("twist", 3)
        speeds, strength, width = self.dry_speeds(twist)
        root = ca.sqrt(speeds**2 + width**2)
        slope = ca.DM(strength * width) / (root * (width + root))
        each = np.vstack([self.J, self.rolling])
        friction = weighted_sum([np.outer(row, row) for row in each], slope)
        friction += ca.DM(self.J.T @ (self.viscous[:, None] * self.J))
        frame_rate, centripetal = self._turning(twist)
        turning = ca.jacobian(frame_rate + centripetal, twist)
        slopes = ca.DM(np.linalg.inv(self.inertia)) @ -(friction + turning)
        outputs = ca.cse([self._free_rate(twist), ca.densify(slopes)])
        return ca.Function("free_rate", [twist], outputs)

    def _free_rate(self, twist: ca.SX) -> ca.SX:
        force = ca.DM(self.J.T) @ (-self.viscous * (ca.DM(self.J) @ twist))
        speeds, strength, width = self.dry_speeds(twist)
        friction = strength * speeds / (width + ca.sqrt(speeds**2 + width**2))
        force -= ca.DM(np.vstack([self.J, self.rolling]).T) @ friction
        frame, centripetal = self._turning(twist)
        return ca.DM(np.linalg.inv(self.inertia)) @ (force - frame - centripetal)

    def _turning(self, twist: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the forces of inertia (3,) of the frame that turns: Coriolis, centripetal."""
        frame_rate = ca.vertcat(-twist[2] * twist[1], twist[2] * twist[0], 0)
        return ca.DM(self.mass) @ frame_rate, -(twist[2] ** 2) * ca.DM(self.moment)

    def dry_speeds(self, twist: ca.SX) -> tuple[ca.SX, Array, Array]:
        """Return the speeds (2n,) with dry friction, its strength, and the width of its rise.

        The values are those of the wheels [rad/s, N m], then those of the rollers [m/s, N]. The
        friction is strength * s / (w + sqrt(s^2 + w^2)), its power strength * (sqrt(s^2 + w^2) -
        w), which is convex and smooth.
        """
        n = self.wheel_count
        speeds = ca.vertcat(ca.DM(self.J) @ twist, ca.DM(self.rolling) @ twist)
        width = np.repeat([SIGN_WIDTH, ROLLING_WIDTH], n)
        return speeds, np.concatenate([self.coulomb, self.drag]), width

    def dry_current(self, twist: Array) -> Array:
        """Return currents (n,) [A] for friction that the optimisation leaves out at a twist (3,).

        In the optimisation Coulomb friction rises over SIGN_WIDTH; in reality it acts at once:
        without these currents the robot would stop short of its goal.
        """
        wheel = self.J @ twist
        full = smooth_sign(wheel)
        planned = wheel / (SIGN_WIDTH + np.sqrt(wheel * wheel + SIGN_WIDTH * SIGN_WIDTH))
        result: Array = self.coulomb * (full - planned) / (self.efficiency * self.emf)
        return result

    def kinetic_energy(self, twist: Array) -> Array:
        """Return the kinetic energy [J] of body twists (..., 3), wheels included, (4)."""
        result: Array = 0.5 * np.einsum("...i,ij,...j->...", twist, self.inertia, twist)
        return result


def weighted_sum(matrices: Sequence[Array], weights: ca.SX) -> ca.SX:
    """Return the sum of constant symmetric matrices, each times its weight.

    Each pair of entries that mirror each other is computed once.
    """
    size = len(matrices[0])
    upper = np.triu_indices(size)
    entries = ca.DM(np.array([matrix[upper] for matrix in matrices]).T) @ weights
    result = ca.SX(size, size)
    for k, (i, j) in enumerate(zip(*upper, strict=True)):
        result[int(i), int(j)] = result[int(j), int(i)] = entries[k]
    return result


def congruence(matrix: ca.SX, slope: ca.SX) -> ca.SX:
    """Return slope' matrix slope for a symmetric matrix, each mirrored pair computed once."""
    product = matrix @ slope
    columns = slope.size2()
    result = ca.SX(columns, columns)
    for i in range(columns):
        for j in range(i, columns):
            result[i, j] = result[j, i] = ca.dot(slope[:, i], product[:, j])
    return result
