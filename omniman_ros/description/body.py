"""Boxes that stand for the platform's body: a deck, and what is below it between the wheels."""

import math
from dataclasses import dataclass

from omniman_ros.core.robot import Robot
from omniman_ros.description.inertia import Vector

WHEEL_WIDTH = 0.5
"""Width of a wheel over its radius; configurations have none."""
CLEARANCE = 0.5
"""Height of the body above the floor, over the largest wheel's radius."""
DECK, DECK_HEIGHT = 2.1, 0.4
"""Height of the deck's bottom and its height where no arm says more, over that radius."""
THINNEST = 0.1
"""Of a deck above the wheels, over that radius."""
SPARE = 0.05
"""Gap between wheels and what is between them, over that radius."""


@dataclass(frozen=True)
class Box:
    """A box along the axes of base_link.

    Attributes:
        centre: Its middle [m].
        size: Its edges [m].
    """

    centre: Vector
    size: Vector


def body_boxes(robot: Robot, mount: float | None) -> tuple[Box, ...]:
    """The deck, which has the body's length and width, and a box between the wheels below it.

    Configurations have no heights. The deck begins above the wheels, and ends where the arm is
    mounted; where that is too low for it, it begins between the wheels.

    Args:
        robot: Whose.
        mount: Height of the arm's base above the floor [m]; None: there is no arm.
    """
    radius = max(robot.wheels.radius)
    bottom = DECK * radius
    top = bottom + DECK_HEIGHT * radius if mount is None or mount <= 0.0 else mount
    if top < bottom + THINNEST * radius:
        bottom = min(CLEARANCE * radius, 0.5 * top)
        return (_box(robot.body.length, robot.body.width, bottom, top),)
    deck = _box(robot.body.length, robot.body.width, bottom, top)
    length, width = _between_wheels(robot, SPARE * radius)
    if length <= 0.0 or width <= 0.0:
        return (deck,)
    return deck, _box(length, width, CLEARANCE * radius, bottom)


def _box(length: float, width: float, bottom: float, top: float) -> Box:
    return Box((0.0, 0.0, 0.5 * (bottom + top)), (length, width, top - bottom))


def _between_wheels(robot: Robot, gap: float) -> tuple[float, float]:
    """Length and width of the larger box that fits between the wheels: along or across."""
    wheels, body = robot.wheels, robot.body
    ahead, aside = 0.5 * body.length, 0.5 * body.width
    for x, y, heading, r in zip(wheels.x, wheels.y, wheels.heading, wheels.radius, strict=True):
        c, s, half = abs(math.cos(heading)), abs(math.sin(heading)), 0.5 * WHEEL_WIDTH * r
        ahead = min(ahead, abs(x) - r * c - half * s - gap)
        aside = min(aside, abs(y) - r * s - half * c - gap)
    if max(aside, 0.0) * body.length >= max(ahead, 0.0) * body.width:
        return body.length, 2.0 * aside
    return 2.0 * ahead, body.width
