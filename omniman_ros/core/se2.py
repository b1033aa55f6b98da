"""Rigid motion in the plane: poses (x, y, theta) and body displacements."""

import math

import numpy as np

from omniman_ros.core.arrays import Array


def wrap(angle: float) -> float:
    """Return the angle in (-pi, pi] [rad]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def nearest_turns(angles: Array, start: float) -> Array:
    """Return angles shifted by whole revolutions, so that each is nearest to the one before.

    It is for headings, which have no end; joints with limits are at other positions a turn later.

    Args:
        angles: Angles (k,) in the order of time [rad].
        start: Angle before the first [rad].
    """
    shifted: Array = np.unwrap(np.concatenate([[start], angles]))[1:]
    return shifted


def rotation(theta: float) -> Array:
    """Return R(theta) of CCTA 2017 (1), (3, 3): velocities from the world to the robot frame."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def to_robot(theta: float, world: Array) -> Array:
    """Rotate a world-frame velocity or acceleration (3,) to the robot frame, CCTA 2017 (1)."""
    c, s = math.cos(theta), math.sin(theta)
    x, y, w = world.tolist()
    return np.array([c * x + s * y, c * y - s * x, w])


def to_world(theta: float, robot: Array) -> Array:
    """Rotate a robot-frame velocity or acceleration (3,) to the world frame, CCTA 2017 (1)."""
    c, s = math.cos(theta), math.sin(theta)
    x, y, w = robot.tolist()
    return np.array([c * x - s * y, s * x + c * y, w])


def compose(
    pose: tuple[float, float, float], relative: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the pose whose coordinates in the frame of another pose are `relative` [m, m, rad].

    The heading is not wrapped.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y, theta = relative
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y, pose[2] + theta


def inverse(pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the pose of the origin in the frame of a pose [m, m, rad]."""
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    return -c * x - s * y, s * x - c * y, -theta


def displacement(
    before: tuple[float, float, float],
    after: tuple[float, float, float],
    point: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Return how far a pose moves that is fixed in a frame whose own pose changes.

    Args:
        before: Pose of the frame [m, m, rad].
        after: Pose of the frame, changed.
        point: The pose that it carries along, before the change.

    Returns:
        x, y [m] along the axes in which all poses are given, and the angle [rad], wrapped.
    """
    x, y, theta = compose(after, compose(inverse(before), point))
    return x - point[0], y - point[1], wrap(theta - point[2])


def displaced(poses: Array, frame: tuple[float, float, float]) -> Array:
    """Return poses (..., 3) that are given in a frame, by the pose of that frame [m, m, rad]."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    x, y, theta = poses[..., 0], poses[..., 1], poses[..., 2]
    rows = (frame[0] + c * x - s * y, frame[1] + s * x + c * y, frame[2] + theta)
    return np.stack(rows, axis=-1)


def arc(displacement: Array) -> tuple[float, float, float]:
    """Return the pose after a constant twist, relative to the pose before (exponential map).

    Args:
        displacement: Twist times time (3,) in the moving body's frame [m, m, rad].

    Returns:
        dx, dy [m] in the frame at the start, and dtheta [rad].
    """
    x, y, angle = displacement.tolist()
    if abs(angle) < 1e-4:  # the series is exact to round-off here
        square = angle * angle
        sinc, cosc = 1.0 - square / 6.0, angle * (0.5 - square / 24.0)
    else:
        sinc, cosc = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle
    return sinc * x - cosc * y, cosc * x + sinc * y, angle
