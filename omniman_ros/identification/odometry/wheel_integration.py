"""Integration of recorded wheel positions to poses, as the odometry does it."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Wheels
from omniman_ros.identification.odometry.campaign import Pose


@lru_cache(maxsize=64)
def _forward_jacobian(wheels: Wheels, scale: tuple[float, ...]) -> Array:
    """Return J+ (3, n) of CCTA 2017 (3) with calibrated radii."""
    radius = tuple((np.array(wheels.radius) * scale).tolist())
    return PlatformKinematics(replace(wheels, radius=radius)).J_pinv


def forward_matrix(wheels: Wheels, parameters: OdometryParameters) -> Array:
    """Return the calibrated forward Jacobian (3, n), from wheel steps [rad] to [m, m, rad]."""
    forward: Array = parameters.correction @ _forward_jacobian(wheels, parameters.wheel_scale)
    return forward


def arcs(displacements: Array) -> tuple[Array, Array, Array]:
    """Integrate twists (k, 3) times their durations [m, m, rad] on SE(2).

    Returns:
        The displacements ahead (k,) and to the left (k,) in the frame at the start [m], and the
        turns (k,) [rad].
    """
    x, y, turn = displacements.T
    is_small = np.abs(turn) < 1e-4
    divisor = np.where(is_small, 1.0, turn)
    sinc = np.where(is_small, 1.0 - turn**2 / 6.0, np.sin(turn) / divisor)
    cosc = np.where(is_small, turn * (0.5 - turn**2 / 24.0), (1.0 - np.cos(turn)) / divisor)
    return sinc * x - cosc * y, cosc * x + sinc * y, turn


def integrate(forward: Array, positions: Array, start: Pose = (0.0, 0.0, 0.0)) -> Array:
    """Integrate wheel positions (k, n) [rad] to poses (k, 3) [m, m, rad], not wrapped.

    The steps are composed on SE(2) with a constant twist within each, as `Odometry.update` does.
    """
    dx, dy, turn = arcs(np.diff(positions, axis=0) @ forward.T)
    poses = np.empty((len(positions), 3))
    poses[0] = start
    poses[1:, 2] = start[2] + np.cumsum(turn)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = start[0] + np.cumsum(c * dx - s * dy)
    poses[1:, 1] = start[1] + np.cumsum(s * dx + c * dy)
    return poses


def compose(first: Array, second: Array) -> Array:
    """Return the pose (3,) whose coordinates in the frame of `first` are `second`, not wrapped.

    Args:
        first: (3,) pose in the outer frame [m, m, rad].
        second: (3,) pose in the frame of `first` [m, m, rad].
    """
    c, s = math.cos(first[2]), math.sin(first[2])
    x, y, theta = second.tolist()
    pose: Array = first + np.array([c * x - s * y, s * x + c * y, theta])
    return pose


def between(first: Array, second: Array) -> Array:
    """Return the pose (3,) of `second` in the frame of `first`; the heading is not wrapped."""
    return se2.to_robot(float(first[2]), second - first)
