"""Wheels: a driven hinge each, with passive rollers around it or with one ideal contact.

A real wheel touches the floor with the roller at its bottom, whose axis is horizontal there. An
ideal wheel is a sphere on two hinges: a free one along that axis, below the driven one. Whoever
steps the model turns the free hinge back to zero, which a sphere does not feel, so that the
axis stays where the mounting has it.
"""

import math
from dataclasses import replace
from xml.etree.ElementTree import Element

from omniman_ros.description.inertia import Inertia
from omniman_ros.description.platform_shape import WHEEL_WIDTH
from omniman_ros.simulation.plant.contact import Mounting
from omniman_ros.simulation.world.model.floor import Tyres
from omniman_ros.simulation.world.model.mjcf import (
    HINGE_FRICTION,
    ROBOT_GROUP,
    TYRE,
    TYRE_GROUP,
    WHEEL,
    Value,
    add,
    add_inertia,
)
from omniman_ros.simulation.world.parameters import IDEAL, WorldParameters

IDEAL_INERTIA = 0.02  #: Inertia of an ideal wheel's sphere over the wheel's about its axle
ROLLER_MASS = 0.25  #: Fraction of a wheel's mass that its rollers have together
QUARTER_TURN = 0.5 * math.pi  #: Angle of 90 degrees [rad]


def body_name(wheel: str) -> str:
    """Return the name of a wheel's body: the link of the robot's description."""
    return f"{wheel}_wheel"


def free_joint(wheel: str) -> str:
    """Return the name of an ideal wheel's free hinge."""
    return f"{wheel}_free"


def add_wheel(
    base: Element,
    name: str,
    mounting: Mounting,
    inertia: Inertia,
    tyres: Tyres,
    parameters: WorldParameters,
) -> None:
    """Add a wheel with its axle along y of its own frame, x being the rolling direction.

    Args:
        inertia: Mass and moments; the one about y includes gear and rotor.
    """
    radius = mounting.radius
    body = add(
        base,
        "body",
        name=body_name(name),
        pos=(mounting.x, mounting.y, radius),
        euler=(0.0, 0.0, mounting.heading),
    )
    if parameters.wheels == IDEAL:
        _add_ideal(body, name, mounting, inertia, tyres)
    else:
        _add_rim(body, name, mounting, inertia, tyres, parameters)
    add(
        body,
        "geom",
        type="cylinder",
        size=(radius, 0.5 * WHEEL_WIDTH * radius),
        euler=(QUARTER_TURN, 0.0, 0.0),
        contype=str(WHEEL),
        conaffinity="0",
        group=str(ROBOT_GROUP),
    )


def _add_drive(body: Element, name: str, armature: float) -> None:
    """Add the driven hinge, with the inertia that turns with it alone [kg m^2]."""
    axis = (0.0, 1.0, 0.0)
    add(body, "joint", name=name, axis=axis, armature=armature, **HINGE_FRICTION)


def _add_ideal(
    body: Element, name: str, mounting: Mounting, inertia: Inertia, tyres: Tyres
) -> None:
    axle = inertia.moments[1]
    small = IDEAL_INERTIA * axle
    add_inertia(body, Inertia(inertia.mass, (small, small, small)))
    angle = mounting.roller_angle
    axis = (math.cos(angle), math.sin(angle), 0.0)
    add(body, "joint", name=free_joint(name), axis=axis)
    _add_drive(body, name, axle - small)
    _add_tyre(body, tyres, type="sphere", size=(mounting.radius,))


def _add_rim(
    body: Element,
    name: str,
    mounting: Mounting,
    inertia: Inertia,
    tyres: Tyres,
    parameters: WorldParameters,
) -> None:
    count, radius, angle = parameters.rollers, mounting.radius, mounting.roller_angle
    middle = parameters.roller_radius * radius
    half = roller_half_length(radius, middle, angle, count)
    mass = ROLLER_MASS * inertia.mass / count
    # Of an obstacle ellipsoid; about the long axis last.
    roller = Inertia(mass, (0.2 * mass * (middle**2 + half**2),) * 2 + (0.4 * mass * middle**2,))
    distance = radius - middle
    rollers = count * (mass * distance**2 + 0.5 * (roller.moments[0] + roller.moments[2]))
    rim = max(inertia.moments[1] - rollers, 0.1 * inertia.moments[1])
    across = 0.5 * rim + 0.01 * inertia.moments[1]
    add_inertia(
        body, replace(inertia, mass=inertia.mass - count * mass, moments=(across, rim, across))
    )
    _add_drive(body, name, 0.0)
    c, s = math.cos(angle), math.sin(angle)
    for k in range(count):
        turn = math.tau * k / count
        ct, st = math.cos(turn), math.sin(turn)
        axis = (c * ct, s, -c * st)
        part = add(body, "body", pos=(-distance * st, 0.0, -distance * ct), zaxis=axis)
        add_inertia(part, roller)
        add(part, "joint", axis=(0.0, 0.0, 1.0))
        _add_tyre(part, tyres, type="ellipsoid", size=(middle, middle, half))


def _add_tyre(body: Element, tyres: Tyres, **shape: Value) -> None:
    add(
        body,
        "geom",
        contype=str(TYRE),
        conaffinity="0",
        group=str(TYRE_GROUP),
        **tyres.attributes,
        **shape,
    )


def roller_half_length(radius: float, middle: float, angle: float, count: int) -> float:
    """Return the half-length of the ellipsoid that a roller is [m].

    It is such that the roller reaches exactly as deep as the wheel's radius both when it is at the
    wheel's bottom and when it hands over to the next roller.

    Args:
        angle: Angle from the wheel's rolling direction to the roller's axis [rad].
    """
    turn = math.pi / count
    depth = radius - (radius - middle) * math.cos(turn)
    slope = math.cos(angle) * math.sin(turn)
    return math.sqrt(middle**2 + (depth**2 - middle**2) / slope**2)
