"""Where the wheels touch the floor: geometry of the ground rollers, loads and friction laws.

Everything is worked out from positions, headings, roller axes and radii by rigid-body mechanics;
nothing is taken from the controller's kinematics.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.robot import Robot, Wheels
from omniman_ros.drive.parameters import Mismatch, per_wheel

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class Direction:
    """One direction of the roller on the floor, along its axis or across it.

    The wheel's surface at the contact moves over the floor with v_chassis(contact) - r phi' d,
    where d is the wheel's rolling direction. Its component in a direction e is

        speed = row . twist - arm phi'

    A contact force f along e does the work f * speed, so it loads the chassis with row * f and
    the wheel with the torque -arm * f.

    Attributes:
        row: e, and its lever about the point whose twist is used; shape (3,).
        arm: Wheel radius times d . e, m.
    """

    row: Vector3
    arm: float


@dataclass(frozen=True)
class Mounting:
    """Where a real wheel is: contact in base_link [m], angles [rad] and radius [m]."""

    x: float
    y: float
    heading: float
    roller_angle: float
    radius: float


def mounted_wheels(wheels: Wheels, mismatch: Mismatch) -> list[Mounting]:
    """Mount the wheels as they really are, not as the robot's data has them.

    Raises:
        ParameterError: A mismatch has neither one value nor n.
    """
    n = len(wheels.names)

    def added(name: str) -> Sequence[float]:
        return per_wheel(f"mismatch.{name}", getattr(mismatch, name), n)

    columns = (
        np.add(wheels.x, added("offset_x")),
        np.add(wheels.y, added("offset_y")),
        np.add(wheels.heading, added("heading")),
        np.add(wheels.roller_angle, added("roller_angle")),
        np.multiply(wheels.radius, added("radius")),
    )
    return [Mounting(*map(float, values)) for values in zip(*columns, strict=True)]


def roller_directions(
    x: float, y: float, heading: float, roller_angle: float, radius: float
) -> tuple[Direction, Direction]:
    """Work out the directions of the ground roller in which the floor can push.

    The roller turns about its own axis: the contact slips along the axis, and rolls across it
    (CCTA 2017 Fig. 3: the roller's axis lies at heading + roller angle).

    Args:
        x, y: Contact from the point whose twist is used, chassis frame, m.
        heading: Rolling direction of the wheel in the chassis frame, rad.
        roller_angle: From the wheel's rolling direction to the roller's axis, rad.
        radius: Wheel radius, m.

    Returns:
        The direction along the roller's axis, and the one across it, a quarter turn further.
    """
    rolling = (math.cos(heading), math.sin(heading))
    axis = (math.cos(heading + roller_angle), math.sin(heading + roller_angle))

    def direction(e: tuple[float, float]) -> Direction:
        lever = x * e[1] - y * e[0]
        return Direction((*e, lever), radius * (rolling[0] * e[0] + rolling[1] * e[1]))

    return direction(axis), direction((-axis[1], axis[0]))


def wheel_loads(
    x: Sequence[float], y: Sequence[float], com: tuple[float, float], weight: float
) -> NDArray[np.float64]:
    """Share the weight over the wheels, at rest, on an elastic floor.

    The loads of smallest norm that balance weight and both moments: what equal springs under the
    wheels give. Wheels that would pull are taken out, and the others share again.

    Args:
        x, y: Contacts in the chassis frame, m, n each.
        com: Centre of mass in the same frame, m.
        weight: Weight, N.

    Returns:
        Loads in N, shape (n,), none negative.

    Raises:
        ParameterError: The centre of mass is not above the wheels.
    """
    balance = np.vstack([np.ones(len(x)), np.asarray(x) - com[0], np.asarray(y) - com[1]])
    target = np.array([weight, 0.0, 0.0])
    carrying = np.ones(len(x), dtype=bool)
    while carrying.any():
        loads = np.zeros(len(x))
        loads[carrying] = np.linalg.lstsq(balance[:, carrying], target, rcond=None)[0]
        if np.abs(balance @ loads - target).max() > 1e-9 * max(weight, 1.0):
            break
        pulling = loads < -1e-12 * max(weight, 1.0)
        if not pulling.any():
            return np.maximum(loads, 0.0)
        carrying &= ~pulling
    raise ParameterError("body.com", com, "the centre of mass is not above the wheels: it tips")


def centre_of_mass(robot: Robot) -> tuple[float, tuple[float, float], float]:
    """Join platform and arm to one rigid body (parallel axes).

    Returns:
        Mass in kg, centre of mass (x, y) in base_link in m, inertia about it in kg m^2.
    """
    parts = [(part.mass, part.com_x, part.com_y, part.inertia) for part in (robot.body, robot.arm)]
    mass = sum(part[0] for part in parts)
    x = sum(part[0] * part[1] for part in parts) / mass
    y = sum(part[0] * part[2] for part in parts) / mass
    inertia = sum(i + m * ((px - x) ** 2 + (py - y) ** 2) for m, px, py, i in parts)
    return mass, (x, y), inertia


def smooth_friction(speed: float, limit: float, width: float) -> tuple[float, float]:
    """Regularised Coulomb friction: force = -limit s / sqrt(s^2 + width^2).

    Returns:
        Force in N and its negative slope -d force / d speed >= 0 in N s/m.
    """
    root = math.sqrt(speed * speed + width * width)
    ratio = speed / root
    return -limit * ratio, limit * (1.0 - ratio * ratio) / root


class Contact:
    """Friction of one wheel on the floor in one direction, and its share of a step's equations.

    The force follows its law at the end of the step, which damps what is stiff. Where that would
    feed energy in, because the speed changes its sign within the step, it follows the law at the
    mean speed of that step instead; so it never does.

    Attributes:
        row, arm: See :class:`Direction`.
        limit, width: Bound of the force, N, and width of the law, m/s.
        slope, offset: The force is offset - slope * (speed at the end of the step).
        force: Force over the step, N.
        speed: Speed at the end of the step, m/s.
    """

    def __init__(self) -> None:
        self.row, self.arm = (0.0, 0.0, 0.0), 0.0
        self.limit, self.width = 0.0, 1.0
        self.force = self.speed = self.slope = self.offset = 0.0
        self._start, self._weight = 0.0, 1.0
        self._law = self._law_slope = self._law_speed = 0.0

    def lay(self, limit: float, width: float) -> None:
        """Put the wheel on a floor: bound of the force, N, and width of the law, m/s."""
        self.limit, self.width = limit, width
        self._law, self._law_slope = smooth_friction(self._law_speed, limit, width)

    def over_floor(self, ux: float, uy: float, turn: float, wheel_speed: float) -> float:
        """Speed of the contact over the floor, m/s, for a twist and a wheel speed in rad/s."""
        row = self.row
        return row[0] * ux + row[1] * uy + row[2] * turn - self.arm * wheel_speed

    def begin(self, start: float) -> None:
        """Start a step at a speed, m/s."""
        self._start, self._weight = start, 1.0

    def linearise(self) -> None:
        """Set slope and offset to the tangent of the law."""
        slope, weight = self._law_slope, self._weight
        self.offset = self._law + slope * (self._law_speed - (1.0 - weight) * self._start)
        self.slope = slope * weight

    def resolve(self, speed: float, tolerance: float) -> bool:
        """Take the speed at the end of the step, m/s; tell whether the force fits the law.

        Args:
            speed: Speed, m/s.
            tolerance: Allowed distance from the law, over the bound.
        """
        self.speed = speed
        force = self.force = self.offset - self.slope * speed
        weight, start = self._weight, self._start
        at = weight * speed + (1.0 - weight) * start
        law, slope = smooth_friction(at, self.limit, self.width)
        settled = abs(law - force) <= tolerance * self.limit
        if not settled and at * self._law_speed < 0.0:
            # thrown over from one flat end of the law to the other: start again from its middle
            at, law, slope = 0.0, 0.0, self.limit / self.width
        elif weight == 1.0 and force * (start + speed) > 0.0:
            self._weight, settled = 0.5, False
        self._law_speed, self._law, self._law_slope = at, law, slope
        return settled
