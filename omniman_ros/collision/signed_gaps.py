"""Signed distances of points and upright rectangles from upright obstacles, with derivatives.

Inside of an obstacle they are below zero, minus the way out, so that a motion that was planned too
near can be corrected. Outside they are the distances of
:mod:`omniman_ros.collision.upright_obstacles`.

The centres of the obstacles may have more axes, (2, ..., M), which are broadcast with those of
points or poses: obstacles that are elsewhere for each of them.
"""

import numpy as np

from omniman_ros.collision.upright_obstacles import UprightObstacles, corner_distances
from omniman_ros.core.arrays import Array

STEP = 1e-5  #: Step of the numerical derivative of a rectangle's gap [m, rad]


def point_gaps(obstacles: UprightObstacles, points: Array) -> tuple[Array, Array]:
    """Return signed distances (..., M) of points (3, ...) and their derivatives (3, ..., M).

    Args:
        points: Points (3, ...) [m].
    """
    dx, dy = (points[k][..., None] - obstacles.centre[k] for k in (0, 1))
    c, s = np.cos(obstacles.yaw), np.sin(obstacles.yaw)
    x, y = c * dx + s * dy, c * dy - s * dx
    beyond_x, beyond_y = np.abs(x) - obstacles.half[0], np.abs(y) - obstacles.half[1]
    out_x, out_y = np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0)
    distance = np.hypot(out_x, out_y)
    is_within = distance == 0.0
    along_x = is_within & (beyond_x >= beyond_y)
    scale = 1.0 / np.where(is_within, 1.0, distance)
    nx = np.where(is_within, along_x, out_x * scale) * np.where(x < 0.0, -1.0, 1.0)
    ny = np.where(is_within, ~along_x, out_y * scale) * np.where(y < 0.0, -1.0, 1.0)
    level = np.where(is_within, np.maximum(beyond_x, beyond_y), distance) - obstacles.rounding
    z = points[2][..., None]
    over, under = z - obstacles.upper, obstacles.lower - z
    upright = np.maximum(over, under)
    gap, fraction = _combined(level, upright)
    normal = np.stack(
        (
            fraction * (c * nx - s * ny),
            fraction * (s * nx + c * ny),
            np.sqrt(np.maximum(1.0 - fraction * fraction, 0.0))
            * np.where(over >= under, 1.0, -1.0),
        )
    )
    return gap, normal


def point_gap_values(obstacles: UprightObstacles, points: Array) -> Array:
    """Return the distances (..., M) of `point_gaps` alone [m]."""
    dx, dy = (points[k][..., None] - obstacles.centre[k] for k in (0, 1))
    c, s = np.cos(obstacles.yaw), np.sin(obstacles.yaw)
    beyond_x = np.abs(c * dx + s * dy) - obstacles.half[0]
    beyond_y = np.abs(c * dy - s * dx) - obstacles.half[1]
    level = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
    level += np.minimum(np.maximum(beyond_x, beyond_y), 0.0) - obstacles.rounding
    z = points[2][..., None]
    upright = np.maximum(z - obstacles.upper, obstacles.lower - z)
    both = np.hypot(np.maximum(level, 0.0), np.maximum(upright, 0.0))
    result: Array = both + np.minimum(np.maximum(level, upright), 0.0)
    return result


def rectangle_gaps(
    obstacles: UprightObstacles, poses: Array, half: Array, heights: tuple[float, float]
) -> Array:
    """Return signed distances (..., M) of an upright box at poses (..., 3) from obstacles [m].

    Poses are those of the centre of its rectangle, with half length and half width (2,) [m].

    Args:
        poses: Poses of the centre of the rectangle [m, m, rad].
    """
    yaw = obstacles.yaw - poses[..., 2, None]
    x, y = (obstacles.centre[k] - poses[..., k, None] for k in (0, 1))
    c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
    own_x, own_y = c * x + s * y, c * y - s * x
    own, is_apart = corner_distances(own_x, own_y, yaw, obstacles.half, half[:, None])
    cs, ss = np.cos(obstacles.yaw), np.sin(obstacles.yaw)
    back_x, back_y = -cs * x - ss * y, ss * x - cs * y
    other, is_apart_too = corner_distances(back_x, back_y, -yaw, half[:, None], obstacles.half)
    overlap = np.maximum(
        _separation(own_x, own_y, yaw, obstacles.half, half[:, None]),
        _separation(back_x, back_y, yaw, half[:, None], obstacles.half),
    )
    level = np.where(is_apart | is_apart_too, np.minimum(own, other), overlap) - obstacles.rounding
    upright = np.maximum(obstacles.lower - heights[1], heights[0] - obstacles.upper)
    gap, _ = _combined(level, np.broadcast_to(upright, level.shape))
    return gap


def rectangle_gap_derivative(
    obstacles: UprightObstacles, poses: Array, half: Array, heights: tuple[float, float]
) -> tuple[Array, Array]:
    """Return what `rectangle_gaps` does, and the derivatives (..., M, 3) by the poses."""
    offsets = np.vstack((np.zeros(3), STEP * np.eye(3), -STEP * np.eye(3)))
    offsets = offsets.reshape(-1, *(1,) * (poses.ndim - 1), 3)
    around = rectangle_gaps(obstacles, poses + offsets, half, heights)
    slopes = (around[1:4] - around[4:]) / (2.0 * STEP)
    return around[0], np.moveaxis(slopes, 0, -1)


def _combined(level: Array, upright: Array) -> tuple[Array, Array]:
    """Return signed gaps from horizontal and vertical ones, and the derivatives by the former."""
    both = np.hypot(np.maximum(level, 0.0), np.maximum(upright, 0.0))
    is_beyond = both > 0.0
    gap = np.where(is_beyond, both, np.maximum(level, upright))
    fraction = np.where(
        is_beyond, np.maximum(level, 0.0) / np.where(is_beyond, both, 1.0), level >= upright
    )
    return gap, fraction


def _separation(x: Array, y: Array, yaw: Array, half: Array, fixed: Array) -> Array:
    """Return by how much the sides of a fixed rectangle separate another one [m]."""
    c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    result: Array = np.maximum(
        np.abs(x) - fixed[0] - half[0] * c - half[1] * s,
        np.abs(y) - fixed[1] - half[0] * s - half[1] * c,
    )
    return result
