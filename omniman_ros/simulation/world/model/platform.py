"""The platform's body and its wheels."""

from xml.etree.ElementTree import Element

from omniman_ros.core.platform import Platform
from omniman_ros.core.polygon import trapezoids
from omniman_ros.description.inertia import rest_of_body, wheel, wheel_masses
from omniman_ros.description.platform_shape import WHEEL_WIDTH, platform_boxes
from omniman_ros.simulation.plant.contact import mounted_wheels
from omniman_ros.simulation.plant.parameters import MismatchParameters
from omniman_ros.simulation.world.model.floor import Tyres
from omniman_ros.simulation.world.model.mjcf import ROBOT, ROBOT_GROUP, Value, add, add_inertia
from omniman_ros.simulation.world.model.wheels import add_wheel
from omniman_ros.simulation.world.parameters import WorldParameters
from omniman_ros.simulation.world.solids import prism_corners

BASE = "base_link"  #: Name of the platform's body, and of its joint to the world


def deck_height(robot: Platform, mount: float | None) -> float:
    """Return the height of the deck's upper side above the floor [m], by the arm's mount [m]."""
    deck = platform_boxes(robot, mount)[0]
    return deck.centre[2] + 0.5 * deck.size[2]


def add_platform(
    assets: Element,
    world: Element,
    robot: Platform,
    mismatch: MismatchParameters,
    mount: float | None,
    tyres: Tyres,
    parameters: WorldParameters,
) -> Element:
    """Add the platform; return its body, whose frame is base_link.

    Args:
        mount: Height of the arm's base above the floor [m]; None if there is no arm.
    """
    base = add(world, "body", name=BASE)
    add(base, "freejoint", name=BASE)
    boxes, masses = platform_boxes(robot, mount), wheel_masses(robot)
    deck = boxes[0]
    bottom, top = (deck.centre[2] + side * 0.5 * deck.size[2] for side in (-1.0, 1.0))
    add_inertia(base, rest_of_body(robot, masses, bottom, top))
    if robot.body.outline is None:
        for box in boxes:
            _add_shape(base, type="box", pos=box.centre, size=[0.5 * edge for edge in box.size])
    else:
        for k, piece in enumerate(trapezoids(robot.body.outline)):
            name, corners = f"{BASE} {k}", prism_corners(piece, (bottom, top))
            add(assets, "mesh", name=name, vertex=corners.ravel().tolist())
            _add_shape(base, type="mesh", mesh=name)
    for k, mounting in enumerate(mounted_wheels(robot.wheels, mismatch)):
        inertia = wheel(robot, k, masses[k], WHEEL_WIDTH * mounting.radius)
        add_wheel(base, robot.wheels.names[k], mounting, inertia, tyres, parameters)
    return base


def _add_shape(base: Element, **shape: Value) -> None:
    contype, group = str(ROBOT), str(ROBOT_GROUP)
    add(base, "geom", contype=contype, conaffinity="0", group=group, **shape)
