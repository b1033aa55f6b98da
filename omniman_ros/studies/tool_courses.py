"""The paths of the tool that the study of tool paths drives."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.body.model import PLATFORM_AXES, BodyModel

Array = NDArray[np.float64]

POSTURE = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)
"""Of the arm in the beginning [rad]; the platform is at the origin."""
SPACING = 0.02
"""Way between two poses [m]."""
RADIUS, SWING, LIFT = 1.2, 0.8, 0.1
"""Of the circle [m]; largest heading of the S [rad], and how far it goes up and down [m]."""

Course = Callable[[Array, float], Array]


def straight(way: Array, length: float) -> Array:
    """Places and headings (k, 4) [m, m, m, rad] on a line after ways (k,) [m] of a length [m]."""
    zero = np.zeros_like(way)
    return np.column_stack([way, zero, zero, zero])


def circle(way: Array, length: float) -> Array:
    """The same on a circle, looking along it."""
    turn = way / RADIUS
    return np.column_stack(
        [RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)), np.zeros_like(way), turn]
    )


def s_curve(way: Array, length: float) -> Array:
    """The same on an S that goes up and down: the heading is a sine of the way."""
    fine = np.linspace(0.0, length, math.ceil(length / 0.001) + 1)
    step = fine[1] - fine[0]
    between = SWING * np.sin(math.tau * (fine[:-1] + 0.5 * step) / length)
    steps = step * np.column_stack([np.cos(between), np.sin(between)])
    places = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    x, y = (np.interp(way, fine, column) for column in places.T)
    share = math.tau * way / length
    return np.column_stack([x, y, LIFT * np.sin(share), SWING * np.sin(share)])


COURSES: Mapping[str, Course] = {"straight": straight, "S": s_curve, "circle": circle}


def start() -> Array:
    """All axes (9,) in the beginning."""
    return np.array([0.0] * len(PLATFORM_AXES) + list(POSTURE))


def tool_poses(model: BodyModel, name: str, length: float) -> Array:
    """Poses (k, 4, 4) of `tool0` in odom along a course, from where the tool is at the start.

    Args:
        model: Of the robot.
        name: One of COURSES.
        length: Of the way in the plane [m].
    """
    way = np.linspace(0.0, length, math.ceil(length / SPACING) + 1)
    course = COURSES[name](way, length)
    poses = np.tile(model.forward(start()), (len(way), 1, 1))
    poses[:, :3, 3] += course[:, :3]
    c, s = np.cos(course[:, 3]), np.sin(course[:, 3])
    turn = np.zeros((len(way), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = c
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -s, s, 1.0
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    return poses
