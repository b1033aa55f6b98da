"""Boxes that represent the platform's body: a deck, and a box below it between the wheels."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Body, Platform
from omniman_ros.description.inertia import Vector
from omniman_ros.description.outline_cover import outline_cover

WHEEL_WIDTH = 0.5  #: Width of a wheel over its radius, as configurations have no width
CLEARANCE = 0.5  #: Ground clearance of the body, over the largest wheel's radius
DECK_BOTTOM = 2.1  #: Height of the deck's bottom above the floor, over the largest wheel's radius
DECK_THICKNESS = 0.4  #: Thickness of the deck without an arm, over the largest wheel's radius
#: Smallest thickness of a deck above the wheels, over the largest wheel's radius
MIN_DECK_THICKNESS = 0.1
#: Gap between the wheels and the box between them, over the largest wheel's radius
WHEEL_GAP = 0.05
MOST_BOXES = 12  #: Largest number of boxes that represent a platform with an outline of its own


@dataclass(frozen=True)
class Box:
    """An upright box."""

    centre: Vector  #: Centre of the box in base_link [m]
    size: Vector  #: Lengths of the edges [m]
    yaw: float = 0.0  #: Direction of the first edge in base_link [rad]


def platform_boxes(robot: Platform, mount: float | None) -> tuple[Box, ...]:
    """Return the deck with the body's length and width, and a box between the wheels below it.

    Configurations have no heights. The deck extends from above the wheels to the base of the arm,
    `mount` above the floor [m] if there is one; if that is too low, the deck starts between the
    wheels. A deck with an outline of its own is covered by several boxes, and has no box below it.
    """
    radius = max(robot.wheels.radius)
    bottom = DECK_BOTTOM * radius
    top = bottom + DECK_THICKNESS * radius if mount is None or mount <= 0.0 else mount
    if top < bottom + MIN_DECK_THICKNESS * radius:
        bottom = min(CLEARANCE * radius, 0.5 * top)
        return _deck(robot.body, bottom, top)
    if robot.body.outline_x:
        return _deck(robot.body, bottom, top)
    deck = _box(robot.body.length, robot.body.width, bottom, top)
    length, width = _between_wheels(robot, WHEEL_GAP * radius)
    if length <= 0.0 or width <= 0.0:
        return (deck,)
    return deck, _box(length, width, CLEARANCE * radius, bottom)


def platform_top(robot: Platform, mount: float | None) -> float:
    """Return the height of the deck's upper side [m]; see `platform_boxes`."""
    deck = platform_boxes(robot, mount)[0]
    return deck.centre[2] + 0.5 * deck.size[2]


def platform_cover(body: Body, most: int) -> Array:
    """Return rectangles whose union contains the platform, from above.

    Rows (P, 5) are those of `outline_cover` in base_link; one, without rounding, if the platform
    is its bounding box.
    """
    if not body.outline_x:
        return np.array([[0.0, 0.0, 0.0, 0.5 * body.length, 0.5 * body.width]])
    return outline_cover(tuple(zip(body.outline_x, body.outline_y, strict=True)), most)


def _deck(body: Body, bottom: float, top: float) -> tuple[Box, ...]:
    """Return the boxes of the deck between two heights [m]."""
    middle, height = 0.5 * (bottom + top), top - bottom
    return tuple(
        Box((x, y, middle), (2.0 * along, 2.0 * across, height), yaw)
        for x, y, yaw, along, across in platform_cover(body, MOST_BOXES).tolist()
    )


def _box(length: float, width: float, bottom: float, top: float) -> Box:
    """Return a centred box of a length and a width [m] between two heights [m]."""
    return Box((0.0, 0.0, 0.5 * (bottom + top)), (length, width, top - bottom))


def _between_wheels(robot: Platform, gap: float) -> tuple[float, float]:
    """Return length and width of the larger box that fits between the wheels: along or across."""
    wheels, body = robot.wheels, robot.body
    half_length, half_width = 0.5 * body.length, 0.5 * body.width
    for x, y, heading, r in zip(wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True):
        c, s, half = abs(math.cos(heading)), abs(math.sin(heading)), 0.5 * WHEEL_WIDTH * r
        half_length = min(half_length, abs(x) - r * c - half * s - gap)
        half_width = min(half_width, abs(y) - r * s - half * c - gap)
    if max(half_width, 0.0) * body.length >= max(half_length, 0.0) * body.width:
        return body.length, 2.0 * half_width
    return 2.0 * half_length, body.width
