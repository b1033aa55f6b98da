"""Elements of MJCF, MuJoCo's XML: https://mujoco.readthedocs.io/en/stable/XMLreference.html."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from omniman_ros.description.inertia import Inertia

Value = str | float | Sequence[float]  #: A word, a number or several numbers

TYRE, ROBOT, WHEEL, LOOSE, PERSON = 1, 2, 4, 8, 16
"""Bits of what collides: tyres, the robot's other parts, wheels but for the floor, things that
move, persons."""
#: Groups of shapes: what is around the robot, the robot, and its tyres within the wheels
WORLD_GROUP, ROBOT_GROUP, TYRE_GROUP = 0, 1, 2

HINGE_FRICTION: dict[str, Value] = {
    "solreffriction": (0.002, 1.0),
    "solimpfriction": (0.999, 0.999, 0.001),
}  #: Stiff dry friction, so that a hinge that friction holds does not creep


def add(parent: Element, tag: str, **attributes: Value) -> Element:
    """Add an element; numbers are written so that reading them gives the same values."""
    return SubElement(parent, tag, {key: _text(value) for key, value in attributes.items()})


def add_inertia(body: Element, inertia: Inertia) -> None:
    """Add mass, centre of mass and moments of inertia to a body."""
    add(
        body,
        "inertial",
        pos=inertia.centre,
        euler=inertia.rpy,
        mass=inertia.mass,
        diaginertia=inertia.moments,
    )


def _text(value: Value) -> str:
    if isinstance(value, str):
        return value
    numbers = [value] if isinstance(value, int | float) else value
    return " ".join(repr(float(number) + 0.0) for number in numbers)
