"""Plant: a rigid body on wheels that can slip, integrated with an exact energy balance."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.contact import (
    centre_of_mass,
    mounted_wheels,
    roller_directions,
    wheel_loads,
)
from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.gear_motor import configure_motors
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.wheel import Wheel

TOLERANCE = 1e-6  #: Allowed deviation of a contact force from its law, as a fraction of its bound
MAX_ITERATIONS = 40  #: Largest number of Newton iterations per step


class Plant:
    """Body and wheels, moved by motor voltages.

    The body is platform and arm in one, planar, with its own velocities; each wheel has its own
    speed. They act on one another through the contact forces only. State: velocity of the centre
    of mass in the world, yaw rate, wheel speeds, motor currents.

    Each step is linearised for the wheel speeds, which are eliminated one by one, and solved for
    the body's three velocities (Newton, 1 to 2 iterations), in the chassis frame at the end of the
    step, where the contact laws hold.

    Raises:
        ParameterError: The robot tips over, or an array has neither one value nor one per wheel.
    """

    def __init__(self, robot: Platform, parameters: SimulationParameters) -> None:
        self._heading = 0.0
        self._com = (0.0, 0.0)  # in the world
        self._velocity = (0.0, 0.0)  # of the centre of mass, in the world
        self._yaw_rate = 0.0
        self._offset = (0.0, 0.0)  # centre of mass in base_link
        self._mass = self._inertia = 0.0
        self._external = self._turnover = self._initial = 0.0
        self._started = False
        self.iterations = 0
        self.unsettled = 0
        self.wheels: tuple[Wheel, ...] = ()
        self.configure(robot, parameters)
        self._started = True

    def configure(self, robot: Platform, parameters: SimulationParameters) -> None:
        """Replace parameters or masses; pose, velocities and wheels stay as they are.

        A change of kinetic energy by this counts as external work.
        """
        plant, mismatch = parameters.plant, parameters.mismatch
        wheels, friction = robot.wheels, robot.friction
        n = robot.wheel_count
        mass, com, inertia = centre_of_mass(robot)
        mounted = mounted_wheels(wheels, mismatch)
        loads = wheel_loads(
            [wheel.x for wheel in mounted],
            [wheel.y for wheel in mounted],
            com,
            mass * plant.gravity,
        )
        geometry = [
            roller_directions(
                wheel.x - com[0],
                wheel.y - com[1],
                wheel.heading,
                wheel.roller_angle,
                wheel.radius,
            )
            for wheel in mounted
        ]

        last_kinetic = self.kinetic if self._started else 0.0
        pose = self.pose
        twist = self.twist
        if not self._started:
            self.wheels = tuple(Wheel() for _ in range(n))
        configure_motors(self.wheels, robot, parameters)
        self._step = plant.substep
        self._mass, self._offset, self._inertia = mass, com, inertia
        self._mu = friction.mu
        self._patch: tuple[float, float, float, float, float] | None = None
        if plant.patch_x_max > plant.patch_x_min and plant.patch_y_max > plant.patch_y_min:
            self._patch = (
                plant.patch_x_min,
                plant.patch_x_max,
                plant.patch_y_min,
                plant.patch_y_max,
                plant.patch_mu,
            )
        self._contacts = tuple((wheel.x, wheel.y) for wheel in mounted)
        self._loads = tuple(0.0 if plant.lifted else float(load) for load in loads)
        for k, wheel in enumerate(self.wheels):
            for contact, direction, limit, width in (
                (wheel.axis, geometry[k][0], friction.mu, plant.slip_velocity),
                (wheel.free, geometry[k][1], friction.roller[k], plant.roller_velocity),
            ):
                contact.row, contact.arm = direction.row, direction.arm
                contact.set_floor(limit * self._loads[k], width)
            wheel.inertia = wheels.inertia[k]
        self.set_pose(pose)
        self.set_twist(np.zeros(3) if plant.lifted else twist, external=False)
        if self._started:
            self._external += self.kinetic - last_kinetic

    @property
    def pose(self) -> NDArray[np.float64]:
        """Pose (x, y, heading) of base_link in the world [m], [rad], shape (3,); not wrapped."""
        c, s = math.cos(self._heading), math.sin(self._heading)
        cx, cy = self._offset
        return np.array(
            [self._com[0] - c * cx + s * cy, self._com[1] - s * cx - c * cy, self._heading]
        )

    def set_pose(self, pose: Sequence[float] | NDArray[np.float64]) -> None:
        """Set the pose (3,) [m, m, rad]; the velocities in the robot's frame stay as they are.

        Args:
            pose: Pose (x, y, heading) of base_link in the world [m], [rad], shape (3,).
        """
        x, y, heading = (float(value) for value in pose)
        rotation = heading - self._heading
        vx, vy = self._velocity
        c, s = math.cos(rotation), math.sin(rotation)
        self._velocity = (c * vx - s * vy, s * vx + c * vy)
        c, s = math.cos(heading), math.sin(heading)
        cx, cy = self._offset
        self._heading = heading
        self._com = (x + c * cx - s * cy, y + s * cx + c * cy)

    @property
    def twist(self) -> NDArray[np.float64]:
        """Twist (vx, vy, w) of base_link in its own frame [m/s], [rad/s], shape (3,)."""
        c, s = math.cos(self._heading), math.sin(self._heading)
        vx, vy = self._velocity
        cx, cy = self._offset
        w = self._yaw_rate
        return np.array([c * vx + s * vy + w * cy, -s * vx + c * vy - w * cx, w])

    def set_twist(
        self, twist: Sequence[float] | NDArray[np.float64], external: bool = True
    ) -> None:
        """Set the twist (3,) of base_link [m/s, rad/s]; the wheel speeds stay as they are.

        Unless `external` is false, the change of energy counts as external work.

        Args:
            twist: Twist of base_link in its own frame [m/s], [rad/s], shape (3,).
        """
        last_kinetic = self.kinetic
        vx, vy, w = (float(value) for value in twist)
        cx, cy = self._offset
        vx, vy = vx - w * cy, vy + w * cx
        c, s = math.cos(self._heading), math.sin(self._heading)
        self._velocity = (c * vx - s * vy, s * vx + c * vy)
        self._yaw_rate = w
        if external:
            self._external += self.kinetic - last_kinetic

    def set_wheel_speeds(self, speeds: Sequence[float] | NDArray[np.float64]) -> None:
        """Set the wheel speeds (n,) [rad/s]; the change of energy counts as external work."""
        last_kinetic = self.kinetic
        for wheel, speed in zip(self.wheels, speeds, strict=True):
            wheel.set_speed(float(speed))
        self._external += self.kinetic - last_kinetic

    @property
    def kinetic(self) -> float:
        """Kinetic energy of body and wheels [J]."""
        vx, vy = self._velocity
        w = self._yaw_rate
        body = 0.5 * (self._mass * (vx * vx + vy * vy) + self._inertia * w * w)
        return float(body + sum(wheel.kinetic for wheel in self.wheels))

    @property
    def energy(self) -> EnergyLedger:
        """Ledger of the energies since the start."""
        totals = {
            name: sum(getattr(wheel, name) for wheel in self.wheels)
            for name in ("electrical", "copper", "gear", "shaft", "roller", "slip")
        }
        return EnergyLedger(
            external=self._external,
            kinetic=self.kinetic,
            inductive=sum(wheel.inductive for wheel in self.wheels),
            turnover=self._turnover,
            **totals,
        )

    def _update_grip(self) -> None:
        if self._patch is None:
            return
        x_min, x_max, y_min, y_max, patch_mu = self._patch
        x0, y0, heading = self.pose
        c, s = math.cos(heading), math.sin(heading)
        for wheel, (x, y), load in zip(self.wheels, self._contacts, self._loads, strict=True):
            wx, wy = x0 + c * x - s * y, y0 + s * x + c * y
            slippery = x_min <= wx <= x_max and y_min <= wy <= y_max
            grip = load * (patch_mu if slippery else self._mu)
            if grip != wheel.axis.limit:
                wheel.axis.set_floor(grip, wheel.axis.width)

    def step(self, voltages: Sequence[float]) -> None:
        """Integrate one substep with voltages (n,) requested from the amplifiers [V]."""
        step = self._step
        self._update_grip()
        vx, vy = self._velocity
        w0 = self._yaw_rate
        c, s = math.cos(self._heading + step * w0), math.sin(self._heading + step * w0)
        ux, uy = c * vx + s * vy, c * vy - s * vx
        for wheel, voltage in zip(self.wheels, voltages, strict=True):
            wheel.begin(voltage, step, ux, uy, w0)

        x1, y1, w1 = self._solve(ux, uy, w0)

        mx, my, mw = 0.5 * (ux + x1), 0.5 * (uy + y1), 0.5 * (w0 + w1)
        turnover = 0.0
        for wheel in self.wheels:
            turnover += wheel.finish(step, mx, my, mw)
        self._turnover += turnover
        self._velocity = (c * x1 - s * y1, s * x1 + c * y1)
        self._yaw_rate = w1
        x, y = self._com
        self._com = (x + step * (c * mx - s * my), y + step * (s * mx + c * my))
        self._heading += step * mw

    def _solve(self, ux: float, uy: float, w0: float) -> tuple[float, float, float]:
        """Find the body's velocities and wheel speeds at the end of the step."""
        wheels = self.wheels
        mass, inertia = self._mass / self._step, self._inertia / self._step
        for _ in range(MAX_ITERATIONS):
            self.iterations += 1
            system = [
                mass,
                0.0,
                0.0,
                mass,
                0.0,
                inertia,
                mass * ux,
                mass * uy,
                inertia * w0,
            ]
            for wheel in wheels:
                wheel.reduce(system)
            x, y, w = _solve_symmetric(system)
            settled = True
            for wheel in wheels:
                settled &= wheel.resolve(x, y, w, TOLERANCE)
            if settled:
                break
        self.unsettled += not settled
        return x, y, w


def _solve_symmetric(system: list[float]) -> tuple[float, float, float]:
    """Solve a positive definite 3 x 3 system, given as in `Wheel.reduce`, by its LDL factors."""
    d1, a12, a13, a22, a23, a33, f1, f2, f3 = system
    l21, l31 = a12 / d1, a13 / d1
    d2 = a22 - l21 * a12
    l32 = (a23 - l31 * a12) / d2
    d3 = a33 - l31 * a13 - l32 * l32 * d2
    y2 = f2 - l21 * f1
    y3 = f3 - l31 * f1 - l32 * y2
    x3 = y3 / d3
    x2 = y2 / d2 - l32 * x3
    return f1 / d1 - l21 * x2 - l31 * x3, x2, x3
