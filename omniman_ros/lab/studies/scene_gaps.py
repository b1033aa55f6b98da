"""Exact gaps at single instants: from a box to ellipses, walls and the border of an area."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_geometry import Area, Box

NEWTON = 12
"""Number of Newton steps towards the point of an ellipse nearest to a corner; with too few steps,
the gap comes out too small."""


def ellipse_gap(poses: Array, box: Box, centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Compute the gaps of N pairs of a filled box and a filled ellipse.

    Along any direction n the two are separated by the distance of their centres less the extent
    of each, n.(p - c) - h_box(n) - h_ellipse(n), and the gap is the largest of these over all n.
    Where the two do not overlap, the largest is across an edge of the box, or along the normal of
    the ellipse at its point nearest to a corner: these directions are tried. As none of them gives
    more than the gap, an error of the nearest point makes the gap too small, never too large.

    Args:
        poses: (N, 3) poses of the box in odom [m, m, rad].
        box: The robot's outline.
        centers: (N, 2) centres of the ellipses in odom [m].
        semi_axes: (N, 2) semi-axes [m].
        angles: (N,) angles of the first axes in odom [rad].

    Returns:
        (N,) gaps [m]: exact to round-off where above zero; zero or less where the two touch or
        overlap.
    """
    a, b = semi_axes[:, 0], semi_axes[:, 1]
    dx, dy = poses[:, 0] - centers[:, 0], poses[:, 1] - centers[:, 1]
    c, s = np.cos(angles), np.sin(angles)
    x, y = c * dx + s * dy, c * dy - s * dx
    ux, uy = np.cos(poses[:, 2] - angles), np.sin(poses[:, 2] - angles)
    along, across = box.half

    def apart(nx: Array, ny: Array) -> Array:
        reach = along * np.abs(nx * ux + ny * uy) + across * np.abs(ny * ux - nx * uy)
        result: Array = nx * x + ny * y - reach - np.hypot(a * nx, b * ny)
        return result

    ahead, left = x * ux + y * uy, y * ux - x * uy
    front, side = np.copysign(1.0, ahead), np.copysign(1.0, left)
    gap = np.maximum(apart(front * ux, front * uy), apart(-side * uy, side * ux))
    for i, j in ((along, across), (along, -across), (-along, across), (-along, -across)):
        gap = np.maximum(gap, apart(*_normal(x + i * ux - j * uy, y + i * uy + j * ux, a, b)))
    return gap


def _normal(x: Array, y: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Return the ellipse's normal, in its own axes, at its point nearest to a point outside.

    The nearest point is (a^2 x / (t + a^2), b^2 y / (t + b^2)) for the t >= 0 that puts it on the
    ellipse. The residual of the ellipse's equation is convex and falls with t, so that Newton
    steps from a t that is too small never overshoot. For a point inside, the normal is of no use,
    which the caller allows for.
    """
    t = np.maximum(np.maximum(a * (np.abs(x) - a), b * (np.abs(y) - b)), 0.0)
    for _ in range(NEWTON):
        p, q = (a * x / (t + a * a)) ** 2, (b * y / (t + b * b)) ** 2
        slope = 2.0 * (p / (t + a * a) + q / (t + b * b))
        t = t + np.maximum(p + q - 1.0, 0.0) / np.maximum(slope, 1e-300)
    nx, ny = x / (t + a * a), y / (t + b * b)
    length = np.hypot(nx, ny)
    middle = length < 1e-12
    length = np.where(middle, 1.0, length)
    return np.where(middle, 1.0, nx / length), np.where(middle, 0.0, ny / length)


def wall_gap(poses: Array, box: Box, walls: Array) -> Array:
    """Compute the gaps of N pairs of a filled box and a filled wall.

    The nearest points of two separate boxes include a corner of one of them.

    Args:
        poses: (N, 3) poses of the box in odom [m, m, rad].
        box: The robot's outline.
        walls: (N, 5) x, y, heading, length, width of the walls [m, m, rad, m, m].

    Returns:
        (N,) gaps [m]: exact where above zero, elsewhere the negative depth of the overlap.
    """
    mine = np.tile(box.half, (len(poses), 1))
    theirs = 0.5 * walls[:, 3:]
    one, corners_one = _corners_seen(poses, mine, walls[:, :3], theirs)
    two, corners_two = _corners_seen(walls[:, :3], theirs, poses, mine)
    depth = np.maximum(one, two)
    return np.where(depth > 0.0, np.minimum(corners_one, corners_two), depth)


def _corners_seen(boxes: Array, half: Array, frames: Array, other: Array) -> tuple[Array, Array]:
    """Return the separation of boxes along the axes of others, and of their nearest corners."""
    dx, dy = boxes[:, 0] - frames[:, 0], boxes[:, 1] - frames[:, 1]
    c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    x, y = c * dx + s * dy, c * dy - s * dx
    ux, uy = np.cos(boxes[:, 2] - frames[:, 2]), np.sin(boxes[:, 2] - frames[:, 2])
    i = half[:, :1] * np.array([1.0, 1.0, -1.0, -1.0])
    j = half[:, 1:] * np.array([1.0, -1.0, 1.0, -1.0])
    px = x[:, None] + i * ux[:, None] - j * uy[:, None]
    py = y[:, None] + i * uy[:, None] + j * ux[:, None]
    along = np.maximum(px.min(axis=1), -px.max(axis=1)) - other[:, 0]
    across = np.maximum(py.min(axis=1), -py.max(axis=1)) - other[:, 1]
    beyond = np.hypot(
        np.maximum(np.abs(px) - other[:, :1], 0.0), np.maximum(np.abs(py) - other[:, 1:], 0.0)
    )
    return np.maximum(along, across), beyond.min(axis=1)


def outside(poses: Array, box: Box, area: Area) -> Array:
    """Compute how far a box reaches out of an area.

    Args:
        poses: (K, 3) poses of the box in odom [m, m, rad].
        box: The robot's outline.
        area: The area in odom [m].

    Returns:
        (K,) distances [m]; negative: the room that is left within the area.
    """
    c, s = np.abs(np.cos(poses[:, 2])), np.abs(np.sin(poses[:, 2]))
    along, across = box.half
    reach = np.stack((along * c + across * s, along * s + across * c), axis=1)
    low, high = np.array(area[:2]), np.array(area[2:])
    result: Array = (np.maximum(low - poses[:, :2], poses[:, :2] - high) + reach).max(axis=1)
    return result
