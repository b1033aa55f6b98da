"""Regressor of the platform's dynamics on the floor, linear in all parameters.

The power balance of platform and wheels (CCTA 2017 (19) to (21), corrected) is

    M x'' + J' (I phi'' + a phi' + b sgn phi') + S' D sgn(S x'_R) = J' tau,

where S x'_R are the rolling speeds of the rollers, CCTA (5) and (6), and D their drags: with a and
b, M_fric = f(x'_R) of CCTA (23). Motor k gives the torque K N i_k, of which the gear passes
eta K N i_k to the wheel that it drives, and K N i_k / eta from the wheel that drives it. With the
torques P of driving and Q of driven motors, and everything divided by eta,

    (regressor of the left side) (parameters / eta) - J' Q (1 / eta^2) = J' P

is linear in parameters / eta and in 1 / eta^2. Only currents and known geometry have errors of
their own; the motor constant K N must be known, which sets the scale of all results.
"""

import copy
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.dynamics import GRAVITY, PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.windows import Windows, resample, speeds

GRID_PERIOD = 0.005  #: Period of the grid on which speeds and friction are evaluated [s]
SPREAD = 0.3  #: Expected relative deviation of a mass, an inertia or a friction
MOMENT_SPREAD = 0.1  #: Deviation of the centre of mass that is expected [m]
MIN_FRICTION = 0.003  #: Smallest drag or Coulomb friction expected, over a wheel's weight
SLOPE_SPREAD = 0.01  #: Slope of the floor that is expected [rad]
EFFICIENCY_SPREAD = 0.2  #: Deviation of the gear's efficiency that is expected


@dataclass(frozen=True)
class SignWidths:
    """Widths of the smooth sign functions s / sqrt(s^2 + w^2) of friction."""

    wheel: float = 0.02  #: Width for the Coulomb friction of a wheel [rad/s]
    roller: float = 0.01  #: Width for the drag of a roller [m/s]


@dataclass(frozen=True, eq=False)
class Equations:
    """Linear equations: rows of the platform's three directions in each window."""

    centres: Array  #: (k,) centres of the windows [s]
    matrix: Array  #: (k, 3, p) regressor; force [N, N] and torque [N m] over the unknown's unit
    values: Array  #: (k, 3) forces and torque of the driving motors, J' P [N, N, N m]


class FloorModel:
    """Unknowns and regressor of a robot.

    Attributes:
        names: Names of the p unknowns: `mass`, `moment_x`, `moment_y`, `inertia` (of the whole
            robot about base_link), `wheel_inertia` (over the configured), `viscous.WHEEL`,
            `coulomb.WHEEL`, `drag.WHEEL` [N], `slope_x`, `slope_y` (force of gravity along a
            sloping floor in odom [N]), all over eta, and `gear` (1 / eta^2).
        expected: (p,) values by the configuration.
        spread: (p,) deviations from them that are expected.
    """

    def __init__(self, robot: Platform) -> None:
        self.robot = robot  #: The same
        self.is_gear_known = False  #: Whether the gear's efficiency stays as expected
        self.kinematics = PlatformKinematics(robot.wheels)
        dynamics = PlatformDynamics(robot, self.kinematics)
        self.rolling = dynamics.rolling  #: (n, 3) matrix S from twist to rolling speeds
        self._inertia = np.array(robot.wheels.inertia)
        bodies = dynamics.mass_matrix
        self._mass = bodies[0, 0]
        #: (2,) centre of mass in which the force of a slope acts [m]; as configured
        self.com = np.array([bodies[1, 2], -bodies[0, 2]]) / self._mass
        wheels = robot.wheels.names
        per_wheel = [
            f"{kind}.{name}" for kind in ("viscous", "coulomb", "drag") for name in wheels
        ]
        self.names = (
            "mass",
            "moment_x",
            "moment_y",
            "inertia",
            "wheel_inertia",
            *per_wheel,
            "slope_x",
            "slope_y",
            "gear",
        )
        self._set_expectations(dynamics)

    def _set_expectations(self, dynamics: PlatformDynamics) -> None:
        robot, n = self.robot, self.robot.wheel_count
        friction, eta = robot.friction, robot.motor.gear_efficiency
        mass, inertia = self._mass, dynamics.mass_matrix[2, 2]
        drag = np.array(friction.roller) * dynamics.loads
        expected = [mass, *(mass * self.com), inertia, 1.0]
        frictions = [*friction.viscous, *friction.coulomb, *drag]
        self.expected = np.array([*expected, *frictions, 0.0, 0.0]) / eta
        radius = np.array(robot.wheels.radius)
        least_force = MIN_FRICTION * GRAVITY * mass / n
        top_speed = robot.motor.max_speed
        spread = SPREAD * np.array([mass, 0.0, 0.0, inertia, 1.0, *frictions, 0.0, 0.0])
        spread[1:3] = MOMENT_SPREAD * mass
        least = np.concatenate(
            [least_force * radius / top_speed, least_force * radius, np.full(n, least_force)]
        )
        spread[5:-2] = np.maximum(spread[5:-2], least)
        spread[-2:] = SLOPE_SPREAD * GRAVITY * mass
        self.expected = np.append(self.expected, 1.0 / eta**2)
        # Over eta, whose own deviation adds to that of each value.
        spread = np.hypot(spread, EFFICIENCY_SPREAD * self.expected[:-1] * eta) / eta
        self.spread = np.append(spread, 2.0 * EFFICIENCY_SPREAD / eta**2)

    def with_com(self, com: Array) -> "FloorModel":
        """Return the model with another centre of mass (2,) [m] for the force of a slope."""
        other = copy.copy(self)
        other.com = com
        return other

    def without_gear(self) -> "FloorModel":
        """Return the model that takes the gear's efficiency as configured, though uncertain."""
        other = copy.copy(self)
        other.is_gear_known = True
        return other

    def with_bound(self) -> "FloorModel":
        """Return the model whose gear has no losses."""
        other = self.without_gear()
        other.expected, other.spread = self.expected.copy(), self.spread.copy()
        other.expected[-1], other.spread[-1] = 1.0, 0.0
        return other

    def index(self, kind: str) -> slice:
        """Return the indices of `viscous`, `coulomb` or `drag` of all wheels."""
        n = self.robot.wheel_count
        first = 5 + n * ("viscous", "coulomb", "drag").index(kind)
        return slice(first, first + n)

    def equations(
        self, drive: FloorDrive, back_emf: Array, windows: Windows, widths: SignWidths
    ) -> Equations:
        """Return the equations of a drive with motor constants K N (n,) at the wheel [N m/A]."""
        times, positions = resample(drive.times, drive.positions, GRID_PERIOD)
        rates = speeds(positions, GRID_PERIOD)
        matrix = self._bodies(times, positions, rates, windows, widths)
        torque = drive.currents * back_emf
        at = np.column_stack([np.interp(drive.electrical_times, times, w) for w in rates.T])
        driving = np.where(torque * at >= 0.0, torque, 0.0)
        forces = np.hstack([driving, torque - driving]) @ np.kron(np.eye(2), self.kinematics.J)
        means = windows.mean(drive.electrical_times, forces)
        matrix = np.concatenate([matrix, -means[:, 3:, None]], axis=2)
        return Equations(windows.centres, matrix, means[:, :3])

    def _bodies(
        self,
        times: Array,
        positions: Array,
        rates: Array,
        windows: Windows,
        widths: SignWidths,
    ) -> Array:
        """Return the columns (k, 3, p - 1) of all unknowns but the gear's."""
        jacobian, forward = self.kinematics.J, self.kinematics.J_pinv
        twist = rates @ forward.T
        vx, vy, w = twist.T
        heading = positions @ forward[2]
        heading = heading - heading[0]
        change = windows.mean(times, positions, 2)  # phi''
        ax, ay, aw = (change @ forward.T).T
        c, s = np.cos(heading), np.sin(heading)
        x, y = self.com
        signs = rates / np.hypot(rates, widths.wheel)
        rolling = twist @ self.rolling.T
        drags = rolling / np.hypot(rolling, widths.roller)
        centripetal = np.column_stack([w * vy, w * vx, w * w, c, s])
        turning = windows.mean(times, np.hstack([centripetal, rates, signs, drags]))
        wvy, wvx, ww, c, s = turning[:, :5].T
        ix, iy, zero = ax - wvy, ay + wvx, np.zeros_like(ax)
        inertial = np.stack(
            [
                np.column_stack([ix, iy, zero]),
                np.column_stack([-ww, aw, iy]),
                np.column_stack([-aw, -ww, -ix]),
                np.column_stack([zero, zero, aw]),
                (change * self._inertia) @ jacobian,
            ],
            axis=2,
        )
        n = self.robot.wheel_count
        shaft = turning[:, 5 : 5 + 2 * n].reshape(-1, 2, 1, n) * jacobian.T
        shaft = np.concatenate([shaft[:, 0], shaft[:, 1]], axis=2)
        drag = turning[:, None, 5 + 2 * n :] * self.rolling.T
        slope = np.stack(
            [
                np.column_stack([-c, s, x * s + y * c]),
                np.column_stack([-s, -c, y * s - x * c]),
            ],
            axis=2,
        )
        return np.concatenate([inertial, shaft, drag, slope], axis=2)
