"""Contact of wheels and floor: geometry of the ground rollers, wheel loads and friction laws.

Everything follows from positions, headings, roller axes and radii by rigid-body mechanics,
independently of the controller's kinematics.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Platform, Wheels
from omniman_ros.simulation.plant.parameters import MismatchParameters, per_wheel

Vector3 = tuple[float, float, float]  #: Direction (x, y) and lever about the vertical axis [m]


@dataclass(frozen=True)
class Direction:
    """One direction in the contact of roller and floor, along the roller's axis or across it.

    The wheel's surface at the contact moves over the floor with v_chassis(contact) - r phi' d,
    where d is the wheel's rolling direction. Its component in a direction e is

        speed = row . twist - arm phi'

    A contact force f along e does the work f * speed, so it loads the chassis with row * f and
    the wheel with the torque -arm * f.
    """

    row: Vector3  #: Direction e, and its lever about the point whose twist is used [m]; shape (3,)
    arm: float  #: Wheel radius times d . e [m]


@dataclass(frozen=True)
class Mounting:
    """Mounting of a real wheel."""

    x: float  #: Contact point in base_link, forward [m]
    y: float  #: Contact point in base_link, to the left [m]
    heading: float  #: Rolling direction in base_link [rad]
    roller_angle: float  #: Angle from the rolling direction to the roller's axis [rad]
    radius: float  #: Wheel radius [m]


def mounted_wheels(wheels: Wheels, mismatch: MismatchParameters) -> list[Mounting]:
    """Return the real wheels' mountings; mismatches of a wrong number raise a ParameterError."""
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
    """Return the directions of the ground roller in which the floor exerts forces.

    The roller rotates about its own axis: the contact slips along the axis and rolls across it
    (CCTA 2017 Fig. 3: the roller's axis lies at heading + roller angle).

    Args:
        x, y: Contact, relative to the point whose twist is used, in the chassis frame [m].
        heading: Rolling direction of the wheel in the chassis frame [rad].
        roller_angle: Angle from the wheel's rolling direction to the roller's axis [rad].

    Returns:
        The direction along the roller's axis, and the one across it, 90 degrees further.
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
    """Distribute the weight over the wheels, at rest, on an elastic floor.

    These are the loads of smallest norm that balance the weight and both moments, as with equal
    springs under the wheels. Wheels with negative loads are removed, and the weight is distributed
    over the others again.

    Args:
        x, y, com: Contact points (n,) and centre of mass in the chassis frame [m].
        weight: Weight [N].

    Returns:
        Loads (n,), none negative [N].

    Raises:
        ParameterError: The centre of mass is not above the wheels.
    """
    balance = np.vstack([np.ones(len(x)), np.asarray(x) - com[0], np.asarray(y) - com[1]])
    target = np.array([weight, 0.0, 0.0])
    is_loaded = np.ones(len(x), dtype=bool)
    while is_loaded.any():
        loads = np.zeros(len(x))
        loads[is_loaded] = np.linalg.lstsq(balance[:, is_loaded], target, rcond=None)[0]
        if np.abs(balance @ loads - target).max() > 1e-9 * max(weight, 1.0):
            break
        is_negative = loads < -1e-12 * max(weight, 1.0)
        if not is_negative.any():
            return np.maximum(loads, 0.0)
        is_loaded &= ~is_negative
    raise ParameterError("body.com", com, "the centre of mass must be above the wheels")


def centre_of_mass(robot: Platform) -> tuple[float, tuple[float, float], float]:
    """Return mass [kg], centre of mass (x, y) in base_link [m], and inertia about it [kg m^2]."""
    parts = [(part.mass, part.com_x, part.com_y, part.inertia) for part in (robot.body, robot.arm)]
    mass = sum(part[0] for part in parts)
    x = sum(part[0] * part[1] for part in parts) / mass
    y = sum(part[0] * part[2] for part in parts) / mass
    inertia = sum(i + m * ((px - x) ** 2 + (py - y) ** 2) for m, px, py, i in parts)
    return mass, (x, y), inertia


def smooth_friction(speed: float, limit: float, width: float) -> tuple[float, float]:
    """Return the regularised Coulomb friction: force = -limit s / sqrt(s^2 + width^2).

    Returns:
        Force [N] and its negative slope -d force / d speed >= 0 [N s/m].
    """
    root = math.sqrt(speed * speed + width * width)
    ratio = speed / root
    return -limit * ratio, limit * (1.0 - ratio * ratio) / root


class ContactFriction:
    """Friction of one wheel on the floor in one direction, linearised for the equations of a step.

    The force follows its law at the end of the step, which damps stiff laws. Where that would add
    energy, because the speed changes its sign within the step, the force follows the law at the
    mean speed of the step instead, so it never adds energy.

    Attributes:
        row: Direction and lever, see :class:`Direction`.
        arm: Lever of the wheel [m], see :class:`Direction`.
        limit: Bound of the force [N].
        width: Width of the friction law [m/s].
        slope: Slope of the force over the speed: force = offset - slope * speed [N s/m].
        offset: Force at zero speed at the end of the step [N].
        force: Force over the step [N].
        speed: Speed at the end of the step [m/s].
    """

    def __init__(self) -> None:
        self.row, self.arm = (0.0, 0.0, 0.0), 0.0
        self.limit, self.width = 0.0, 1.0
        self.force = self.speed = self.slope = self.offset = 0.0
        self._start, self._weight = 0.0, 1.0
        self._law = self._law_slope = self._law_speed = 0.0

    def set_floor(self, limit: float, width: float) -> None:
        """Set the bound of the force [N] and the width of the friction law [m/s]."""
        self.limit, self.width = limit, width
        self._law, self._law_slope = smooth_friction(self._law_speed, limit, width)

    def slip_speed(self, ux: float, uy: float, yaw_rate: float, wheel_speed: float) -> float:
        """Return the speed of the contact over the floor [m/s] for a twist and a wheel speed."""
        row = self.row
        return row[0] * ux + row[1] * uy + row[2] * yaw_rate - self.arm * wheel_speed

    def begin(self, start: float) -> None:
        """Start a step at a speed [m/s]."""
        self._start, self._weight = start, 1.0

    def linearise(self) -> None:
        """Set slope and offset to the tangent of the friction law."""
        slope, weight = self._law_slope, self._weight
        self.offset = self._law + slope * (self._law_speed - (1.0 - weight) * self._start)
        self.slope = slope * weight

    def resolve(self, speed: float, tolerance: float) -> bool:
        """Set the speed at the end of the step [m/s]; return whether the force fits the law.

        `tolerance` is the allowed deviation, as a fraction of the bound.
        """
        self.speed = speed
        force = self.force = self.offset - self.slope * speed
        weight, start = self._weight, self._start
        law_speed = weight * speed + (1.0 - weight) * start
        law, slope = smooth_friction(law_speed, self.limit, self.width)
        fits = abs(law - force) <= tolerance * self.limit
        if not fits and law_speed * self._law_speed < 0.0:
            # The iteration jumps between the flat ends of the law: restart from its middle.
            law_speed, law, slope = 0.0, 0.0, self.limit / self.width
        elif weight == 1.0 and force * (start + speed) > 0.0:
            self._weight, fits = 0.5, False
        self._law_speed, self._law, self._law_slope = law_speed, law, slope
        return fits
