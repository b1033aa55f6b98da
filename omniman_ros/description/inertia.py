"""Masses and inertias of links: principal moments that a rigid body can have."""

import math
from dataclasses import dataclass

from omniman_ros.core.robot import Robot

Vector = tuple[float, float, float]

SHARE = 0.5
"""Largest part of the body's mass, and of its inertia, that is given to the wheels."""


@dataclass(frozen=True)
class Inertia:
    """Mass and principal moments of a link.

    Attributes:
        mass: Its mass [kg].
        moments: About axes through the centre of mass [kg m^2].
        centre: Centre of mass in the link's frame [m].
        rpy: Turn of the axes against the link's frame: roll, pitch, yaw [rad].
    """

    mass: float
    moments: Vector
    centre: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


def cylinder(mass: float, radius: float, length: float, centre: Vector, rpy: Vector) -> Inertia:
    """A full cylinder along the z of its own axes [kg, m, m]."""
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    return Inertia(mass, (across, across, 0.5 * mass * radius**2), centre, rpy)


def wheel_masses(robot: Robot) -> tuple[float, ...]:
    """Mass of each wheel [kg], which is a part of the body's.

    Each is that of a full cylinder with the wheel's inertia, 2 I / r^2. As I has gear and rotor
    in it this can be too much: then all are made smaller by one factor, until wheels leave
    :data:`SHARE` of the body's mass, and of its inertia about the vertical, to the rest.
    """
    wheels, body = robot.wheels, robot.body
    full = [2.0 * i / r**2 for i, r in zip(wheels.inertia, wheels.radius, strict=True)]
    total = sum(full)
    away = [(x - body.com_x, y - body.com_y) for x, y in zip(wheels.x, wheels.y, strict=True)]
    # The rest lies opposite to wheels that are not even: with a factor s, what it has less than
    # the whole about the vertical is at most s a + s^2 b, as its mass is no less than the SHARE.
    a = sum(m * (x * x + y * y) for m, (x, y) in zip(full, away, strict=True))
    first = [sum(m * d[k] for m, d in zip(full, away, strict=True)) for k in (0, 1)]
    b = (first[0] ** 2 + first[1] ** 2) / ((1.0 - SHARE) * body.mass)
    turning = SHARE * body.inertia
    by_inertia = 2.0 * turning / (a + math.sqrt(a * a + 4.0 * b * turning)) if a > 0.0 else 1.0
    factor = min(1.0, SHARE * body.mass / total, by_inertia)
    return tuple(factor * m for m in full)


def wheel(robot: Robot, i: int, mass: float, width: float) -> Inertia:
    """A wheel about its axle y; about the axle it has all that turns: gear and rotor too.

    Args:
        robot: Whose.
        i: Which wheel.
        mass: Of :func:`wheel_masses` [kg].
        width: Of the wheel [m].
    """
    axle = robot.wheels.inertia[i]
    across = 0.5 * axle + mass * width**2 / 12.0
    return Inertia(mass, (across, axle, across))


def rest_of_body(robot: Robot, masses: tuple[float, ...], bottom: float, top: float) -> Inertia:
    """The platform without its wheels, in base_link.

    With the wheels as points it has the body's mass, centre of mass and inertia about the
    vertical. In the other directions it is a box, which a body always can be: half the sum of the
    moments is above each of them.

    Args:
        robot: Whose.
        masses: Of the wheels [kg].
        bottom, top: Heights of the box [m].
    """
    wheels, body = robot.wheels, robot.body
    points = list(zip(masses, wheels.x, wheels.y, strict=True))
    mass = body.mass - sum(masses)
    x = (body.mass * body.com_x - sum(m * px for m, px, _ in points)) / mass
    y = (body.mass * body.com_y - sum(m * py for m, _, py in points)) / mass
    upright = body.inertia - mass * ((x - body.com_x) ** 2 + (y - body.com_y) ** 2)
    upright -= sum(m * ((px - body.com_x) ** 2 + (py - body.com_y) ** 2) for m, px, py in points)
    long = body.length**2 / (body.length**2 + body.width**2)
    vertical = mass * (top - bottom) ** 2 / 12.0
    moments = (upright * (1.0 - long) + vertical, upright * long + vertical, upright)
    return Inertia(mass, moments, (x, y, 0.5 * (bottom + top)))
