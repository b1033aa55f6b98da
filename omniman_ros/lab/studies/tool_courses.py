"""Paths of the tool that are driven in the study of tool paths."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.whole_body.model import WholeBodyModel

#: Joint angles of the arm at the start, where base_link is at the origin of odom [rad]
POSTURE = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)
SPACING = 0.02  #: largest distance along the path between successive poses [m]
CIRCLE_RADIUS = 1.2  #: radius of the circle [m]
S_HEADING = 0.8  #: largest heading along the S, relative to its start [rad]
S_HEIGHT = 0.1  #: amplitude of the height along the S [m]

#: The shape of a path: a function from distances (k,) along the path and the length of the path,
#: both in the plane [m], to positions and headings (k, 4) relative to its start [m, m, m, rad].
Course = Callable[[Array, float], Array]


def straight(distance: Array, length: float) -> Array:
    """Return positions and headings (k, 4) on a straight line; see `Course`."""
    return np.outer(distance, [1.0, 0.0, 0.0, 0.0])


def circle(distance: Array, length: float) -> Array:
    """Return positions and headings (k, 4) on a circle; headings are tangential; see `Course`."""
    angle = distance / CIRCLE_RADIUS
    x, y = CIRCLE_RADIUS * np.sin(angle), CIRCLE_RADIUS * (1.0 - np.cos(angle))
    return np.column_stack([x, y, np.zeros_like(distance), angle])


def s_curve(distance: Array, length: float) -> Array:
    """Return positions and headings (k, 4) on an S that rises and falls; see `Course`.

    The heading is a sine of the distance.
    """
    fine = np.linspace(0.0, length, math.ceil(length / 0.001) + 1)
    step = fine[1] - fine[0]
    midpoints = S_HEADING * np.sin(math.tau * (fine[:-1] + 0.5 * step) / length)
    steps = step * np.column_stack([np.cos(midpoints), np.sin(midpoints)])
    positions = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    x, y = (np.interp(distance, fine, column) for column in positions.T)
    phase = math.tau * distance / length
    return np.column_stack([x, y, S_HEIGHT * np.sin(phase), S_HEADING * np.sin(phase)])


def corner(distance: Array, length: float) -> Array:
    """Return positions and headings (k, 4) on an L of two equal straights; see `Course`."""
    half = 0.5 * length
    x, y = np.minimum(distance, half), np.maximum(distance - half, 0.0)
    return np.column_stack([x, y, np.zeros_like(distance), np.zeros_like(distance)])


#: Shapes of the paths, by name
COURSES: Mapping[str, Course] = {"straight": straight, "S": s_curve, "circle": circle}


def start() -> Array:
    """Return the positions (9,) of all axes at the start: platform [m, m, rad], joints [rad]."""
    return np.array([0.0] * len(PLATFORM_AXES) + list(POSTURE))


def tool_poses(model: WholeBodyModel, name: str, length: float, count: int | None = None) -> Array:
    """Return poses (k, 4, 4) of `tool0` in odom along a named course; see `course_poses`."""
    return course_poses(model, COURSES[name], length, count)


def course_poses(
    model: WholeBodyModel, course: Course, length: float, count: int | None = None
) -> Array:
    """Return poses (k, 4, 4) of `tool0` in odom along a course that begins at the start.

    They are equidistant; without a count, they are `SPACING` apart.
    """
    distance = np.linspace(0.0, length, count or math.ceil(length / SPACING) + 1)
    places = course(distance, length)
    poses = np.tile(model.forward(start()), (len(distance), 1, 1))
    poses[:, :3, 3] += places[:, :3]
    c, s = np.cos(places[:, 3]), np.sin(places[:, 3])
    turn = np.zeros((len(distance), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = c
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -s, s, 1.0
    poses[:, :3, :3] = turn @ poses[:, :3, :3]
    return poses
