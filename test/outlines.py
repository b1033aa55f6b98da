"""Platforms with outlines of their own, and convex pieces of these that were found by hand."""

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.robots import robot_parameters

OCTAGON = [
    (0.5, -0.2),
    (0.5, 0.2),
    (0.35, 0.35),
    (-0.35, 0.35),
    (-0.5, 0.2),
    (-0.5, -0.2),
    (-0.35, -0.35),
    (0.35, -0.35),
]  #: A rectangle without corners
FORKS = [
    (-0.5, -0.35),
    (0.5, -0.35),
    (0.5, -0.15),
    (0.0, -0.1),
    (0.0, 0.1),
    (0.5, 0.15),
    (0.5, 0.35),
    (-0.5, 0.35),
]  #: A U that is open to the front; its left fork and its back are in line
HAND_MADE = {
    "octagon": (OCTAGON, [OCTAGON]),
    "forks": (
        FORKS,
        [
            [(-0.5, -0.35), (0.0, -0.35), (0.0, 0.35), (-0.5, 0.35)],
            [(0.0, -0.35), (0.5, -0.35), (0.5, -0.15), (0.0, -0.1)],
            [(0.0, 0.1), (0.5, 0.15), (0.5, 0.35), (0.0, 0.35)],
        ],
    ),
}  #: Outlines, each with its convex pieces


def outlined(outline, name="omniman"):
    """Return the description of a robot of the package with another outline (k, 2)."""
    x, y = ([corner[axis] for corner in outline] for axis in (0, 1))
    values = robot_parameters(name) | {"body.outline_x": x, "body.outline_y": y}
    return build(DescriptionParameters, values)
