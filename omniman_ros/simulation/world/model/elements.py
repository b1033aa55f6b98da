"""What is around the robot: fixed elements, things that move, and persons."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from omniman_ros.simulation.world.model.mjcf import (
    LOOSE,
    PERSON,
    ROBOT,
    WHEEL,
    WORLD_GROUP,
    Value,
    add,
)
from omniman_ros.simulation.world.scene import Column, Crate, Load, Person, Scene
from omniman_ros.simulation.world.solids import (
    Cylinder,
    UprightBox,
    column_solid,
    plain_solids,
    prism_corners,
)

MEETS = str(ROBOT | WHEEL | LOOSE | PERSON)  #: What fixed and loose things collide with


def person_joints(name: str) -> tuple[str, str]:
    """Return the names of the joints along x and y on which a person moves."""
    return f"{name}_x", f"{name}_y"


def add_elements(assets: Element, world: Element, scene: Scene, deck: float) -> None:
    """Add the elements of a scene, each as a body of its name; loads on the robot at the origin.

    A column is a body that a study may place elsewhere (`mocap`); nothing else moves it. Loads lie
    on the platform's upper side, at the height `deck` [m].
    """
    for name, solids in plain_solids(scene):
        body = add(world, "body", name=name)
        for solid in solids:
            _add_solid(body, solid)
    for column in scene.columns:
        _add_column(assets, world, column)
    for crate in scene.crates:
        _add_loose(world, crate, (crate.x, crate.y, 0.5 * crate.height), crate.yaw)
    for load in scene.loads:
        _add_loose(world, load, (load.x, load.y, deck + 0.5 * load.height), load.yaw)
    for person in scene.persons:
        _add_person(world, person)


def _add_shape(body: Element, contype: int, **shape: Value) -> None:
    add(body, "geom", contype=str(contype), conaffinity=MEETS, group=str(WORLD_GROUP), **shape)


def _add_solid(body: Element, solid: UprightBox | Cylinder) -> None:
    if isinstance(solid, UprightBox):
        half = [0.5 * edge for edge in solid.size]
        rotation = (0.0, 0.0, solid.yaw)
        _add_shape(body, 0, type="box", pos=solid.centre, euler=rotation, size=half)
    else:
        size = (solid.radius, 0.5 * solid.height)
        _add_shape(body, 0, type="cylinder", pos=solid.centre, size=size)


def _add_column(assets: Element, world: Element, column: Column) -> None:
    solid, name = column_solid(column), column.name
    outline, half = solid.outline, 0.5 * solid.height
    corners = prism_corners(outline, (-half, half))
    add(assets, "mesh", name=name, vertex=corners.ravel().tolist())
    body = add(world, "body", name=name, pos=solid.centre, mocap="true")
    _add_shape(body, 0, type="mesh", mesh=name)


def _add_loose(world: Element, box: Crate | Load, centre: Sequence[float], yaw: float) -> None:
    body = add(world, "body", name=box.name, pos=centre, euler=(0.0, 0.0, yaw))
    add(body, "freejoint", name=box.name)
    size = (0.5 * box.length, 0.5 * box.width, 0.5 * box.height)
    _add_shape(body, LOOSE, type="box", size=size, mass=box.mass)


def _add_person(world: Element, person: Person) -> None:
    """Add a person: an upright capsule that slides over the floor and does not turn."""
    body = add(world, "body", name=person.name, pos=(person.x[0], person.y[0], 0.0))
    for name, axis in zip(person_joints(person.name), ((1, 0, 0), (0, 1, 0)), strict=True):
        add(body, "joint", name=name, type="slide", axis=axis)
    middle = 0.5 * person.height
    _add_shape(
        body,
        PERSON,
        type="capsule",
        pos=(0.0, 0.0, middle),
        size=(person.radius, max(middle - person.radius, 0.01)),
        mass=person.mass,
    )
