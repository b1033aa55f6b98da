"""Masses and inertias of links, with physically possible principal moments."""

import math
from dataclasses import dataclass

from omniman_ros.core.platform import Platform

#: Three components x, y, z: a position [m], roll, pitch, yaw [rad], or moments [kg m^2]
Vector = tuple[float, float, float]

#: Largest fraction of the body's mass, and of its inertia, that is assigned to the wheels
MAX_WHEEL_FRACTION = 0.5


@dataclass(frozen=True)
class Inertia:
    """Mass and principal moments of a link."""

    mass: float  #: Mass [kg]
    moments: Vector  #: Moments of inertia about axes through the centre of mass [kg m^2]
    centre: Vector = (0.0, 0.0, 0.0)  #: Centre of mass in the link's frame [m]
    #: Rotation of the axes in the link's frame: roll, pitch, yaw [rad]
    rpy: Vector = (0.0, 0.0, 0.0)


def cylinder(mass: float, radius: float, length: float, centre: Vector, rpy: Vector) -> Inertia:
    """Return the inertia of an obstacle cylinder along z of its own axes [kg, m, m, m, rad]."""
    transverse = mass * (3.0 * radius**2 + length**2) / 12.0
    return Inertia(mass, (transverse, transverse, 0.5 * mass * radius**2), centre, rpy)


def wheel_masses(robot: Platform) -> tuple[float, ...]:
    """Return the mass of each wheel [kg], which is part of the body's mass.

    Each is that of a solid cylinder with the wheel's inertia, 2 I / r^2. This can be too much, as
    I contains gear and rotor. Then all masses are scaled down by one factor, so that the wheels
    have at most :data:`MAX_WHEEL_FRACTION` of the body's mass and its inertia about the vertical.
    """
    wheels, body = robot.wheels, robot.body
    masses = [2.0 * i / r**2 for i, r in zip(wheels.inertia, wheels.radius, strict=True)]
    total = sum(masses)
    offsets = [(x - body.com_x, y - body.com_y) for x, y in zip(wheels.x, wheels.y, strict=True)]
    # The rest of the body balances asymmetric wheels: with a factor s, its inertia about the
    # vertical is less than the whole by at most s a + s^2 b, as its mass is at least
    # 1 - MAX_WHEEL_FRACTION of the body's.
    a = sum(m * (x * x + y * y) for m, (x, y) in zip(masses, offsets, strict=True))
    first = [sum(m * d[k] for m, d in zip(masses, offsets, strict=True)) for k in (0, 1)]
    b = (first[0] ** 2 + first[1] ** 2) / ((1.0 - MAX_WHEEL_FRACTION) * body.mass)
    limit = MAX_WHEEL_FRACTION * body.inertia
    by_inertia = 2.0 * limit / (a + math.sqrt(a * a + 4.0 * b * limit)) if a > 0.0 else 1.0
    factor = min(1.0, MAX_WHEEL_FRACTION * body.mass / total, by_inertia)
    return tuple(factor * m for m in masses)


def wheel(robot: Platform, i: int, mass: float, width: float) -> Inertia:
    """Return the inertia of a wheel of a mass [kg] and width [m], with gear and rotor."""
    axle = robot.wheels.inertia[i]
    transverse = 0.5 * axle + mass * width**2 / 12.0
    return Inertia(mass, (transverse, axle, transverse))


def rest_of_body(robot: Platform, masses: tuple[float, ...], bottom: float, top: float) -> Inertia:
    """Return the inertia of the platform without its wheels, in base_link.

    Together with the wheels as point masses [kg] it has the body's mass, centre of mass and
    inertia about the vertical. In the other directions it is a box between two heights above the
    floor [m], which is always physically possible: half the sum of the moments exceeds each of
    them.

    The centre of mass is in the middle of the box or, if the robot's file has a height, where body
    and wheels together have it.
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
    z = 0.5 * (bottom + top)
    if body.com_z > 0.0:
        z = body.mass * body.com_z - sum(m * r for m, r in zip(masses, wheels.radius, strict=True))
        z /= mass
    return Inertia(mass, moments, (x, y, z))
