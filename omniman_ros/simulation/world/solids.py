"""Boxes, cylinders and prisms that the fixed elements of a scene consist of."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.scene import Column, Pallet, Post, Scene, Table, Wall

SIDES = 96  #: Sides of the prism for an elliptic cylinder: it is at most 0.06 % smaller
Vector = tuple[float, float, float]  #: Position (x, y, z) in the world, or edges of a box [m]


@dataclass(frozen=True)
class UprightBox:
    """An upright box."""

    centre: Vector  #: Centre in the world [m]
    size: Vector  #: Lengths of the edges [m]
    yaw: float = 0.0  #: Rotation about the vertical [rad]

    @property
    def height(self) -> float:
        """Height [m]."""
        return self.size[2]


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder."""

    centre: Vector  #: Centre in the world [m]
    radius: float  #: Radius [m]
    height: float  #: Height [m]


@dataclass(frozen=True)
class EllipticPrism:
    """An upright prism whose outline has `SIDES` corners on an ellipse."""

    centre: Vector  #: Centre in the world [m]
    semi_axes: tuple[float, float]  #: Semi-axes of the ellipse [m]
    yaw: float  #: Direction of the first axis [rad]
    height: float  #: Height [m]

    @property
    def outline(self) -> Array:
        """Corners (`SIDES`, 2) around the centre [m]."""
        return ellipse_corners(self.semi_axes, self.yaw)


Solid = UprightBox | Cylinder | EllipticPrism  #: Convex part of an element


def ellipse_corners(semi_axes: tuple[float, float], yaw: float) -> Array:
    """Return `SIDES` corners (k, 2) on an ellipse around the origin [m].

    Args:
        yaw: Direction of the first axis [rad].
    """
    turn = np.arange(SIDES) * (math.tau / SIDES)
    u, v = semi_axes[0] * np.cos(turn), semi_axes[1] * np.sin(turn)
    c, s = math.cos(yaw), math.sin(yaw)
    return np.column_stack([c * u - s * v, s * u + c * v])


def footprint(solid: Solid) -> tuple[Array, float]:
    """Return points (k, 2) and a radius: an obstacle on the floor is their hull grown by it."""
    centre = np.array([solid.centre[:2]])
    if isinstance(solid, Cylinder):
        return centre, solid.radius
    if isinstance(solid, EllipticPrism):
        return centre + solid.outline, 0.0
    c, s = math.cos(solid.yaw), math.sin(solid.yaw)
    along, across = 0.5 * solid.size[0] * np.array([c, s]), 0.5 * solid.size[1] * np.array([-s, c])
    return centre + [along + across, along - across, -along - across, -along + across], 0.0


def fixed_solids(scene: Scene) -> Iterator[tuple[str, tuple[Solid, ...]]]:
    """Yield the name of each fixed element of a scene, and the obstacles it consists of."""
    yield from plain_solids(scene)
    for column in scene.columns:
        yield column.name, (column_solid(column),)


def plain_solids(scene: Scene) -> Iterator[tuple[str, tuple[UprightBox | Cylinder, ...]]]:
    """Yield the fixed elements of a scene that consist of boxes and cylinders, as above."""
    for wall in scene.walls:
        yield wall.name, wall_solids(wall)
    for post in scene.posts:
        yield post.name, (post_solid(post),)
    for table in scene.tables:
        yield table.name, table_solids(table)
    for pallet in scene.pallets:
        yield pallet.name, (pallet_solid(pallet),)


def wall_solids(wall: Wall) -> tuple[UprightBox, ...]:
    """Return the pieces of a wall between corners and doors; they overlap at the corners."""
    pieces = []
    half = 0.5 * wall.thickness
    begin = 0.0
    for x0, y0, x1, y1 in zip(wall.x, wall.y, wall.x[1:], wall.y[1:], strict=False):
        length = math.hypot(x1 - x0, y1 - y0)
        yaw = math.atan2(y1 - y0, x1 - x0)
        gaps = sorted((door - begin - 0.5 * wall.door_width) for door in wall.doors)
        at = -half
        for left, right in [*((g, g + wall.door_width) for g in gaps), (length + half,) * 2]:
            end = min(left, length + half)
            if end > at and right > at:
                middle = 0.5 * (at + end)
                centre = x0 + middle * math.cos(yaw), y0 + middle * math.sin(yaw)
                size = (end - at, wall.thickness, wall.height)
                pieces.append(UprightBox((*centre, 0.5 * wall.height), size, yaw))
            at = max(at, right)
        begin += length
    return tuple(pieces)


def post_solid(post: Post) -> Cylinder:
    """Return the cylinder of a post."""
    return Cylinder((post.x, post.y, 0.5 * post.height), post.radius, post.height)


def column_solid(column: Column) -> EllipticPrism:
    """Return the prism of a column."""
    centre = column.x, column.y, 0.5 * column.height
    semi_axes = 0.5 * column.length, 0.5 * column.width
    return EllipticPrism(centre, semi_axes, column.yaw, column.height)


def table_solids(table: Table) -> tuple[UprightBox, ...]:
    """Return the top of a table, and its legs."""
    bottom = table.height - table.thickness
    top = UprightBox(
        (table.x, table.y, bottom + 0.5 * table.thickness),
        (table.length, table.width, table.thickness),
        table.yaw,
    )
    c, s = math.cos(table.yaw), math.sin(table.yaw)
    legs = []
    for i in (1.0, -1.0):
        for j in (1.0, -1.0):
            x = i * 0.5 * (table.length - table.leg)
            y = j * 0.5 * (table.width - table.leg)
            centre = (table.x + c * x - s * y, table.y + s * x + c * y, 0.5 * bottom)
            legs.append(UprightBox(centre, (table.leg, table.leg, bottom), table.yaw))
    return (top, *legs)


def pallet_solid(pallet: Pallet) -> UprightBox:
    """Return the box of a pallet."""
    centre = (pallet.x, pallet.y, 0.5 * pallet.height)
    return UprightBox(centre, (pallet.length, pallet.width, pallet.height), pallet.yaw)


def prism_corners(outline: Array, heights: tuple[float, float]) -> Array:
    """Return the corners (2 k, 3) of an upright prism between two heights [m]."""
    return np.concatenate([np.insert(outline, 2, z, axis=1) for z in heights])
