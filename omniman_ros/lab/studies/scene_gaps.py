"""Exact gaps at single instants from a box to ellipses, walls and the border of an area."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_geometry import Area, Box

NEWTON_STEPS = 12
"""Number of Newton steps towards the point of an ellipse nearest to a corner; with too few steps,
the gap comes out too small."""


def ellipse_gap(poses: Array, box: Box, centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Compute the gaps of N pairs of a filled box and a filled ellipse.

    Along a unit vector n, the separation of the two is the distance of their centres less the
    extent of each body, n.(p - c) - h_box(n) - h_ellipse(n). The gap is the largest separation
    over all n. Where the two do not overlap, n is either perpendicular to an edge of the box, or
    normal to the ellipse at its point nearest to a corner of the box: these directions are tried.
    As none of them gives more than the gap, an inexact nearest point makes the result too small,
    never too large.

    Args:
        poses: (N, 3) poses of the box in odom [m, m, rad].
        centers: (N, 2) centres of the ellipses in odom [m].
        semi_axes: (N, 2) semi-axes [m].
        angles: (N,) angles of the first semi-axes in odom [rad].

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

    def separation(nx: Array, ny: Array) -> Array:
        """Return the separations (N,) [m] along unit vectors in the axes of the ellipses."""
        extent = along * np.abs(nx * ux + ny * uy) + across * np.abs(ny * ux - nx * uy)
        result: Array = nx * x + ny * y - extent - np.hypot(a * nx, b * ny)
        return result

    ahead, left = x * ux + y * uy, y * ux - x * uy
    front, side = np.copysign(1.0, ahead), np.copysign(1.0, left)
    gap = np.maximum(separation(front * ux, front * uy), separation(-side * uy, side * ux))
    for i, j in ((along, across), (along, -across), (-along, across), (-along, -across)):
        gap = np.maximum(gap, separation(*_normal(x + i * ux - j * uy, y + i * uy + j * ux, a, b)))
    return gap


def _normal(x: Array, y: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Return unit normals of ellipses at their points nearest to points outside them.

    The nearest point is (a^2 x / (t + a^2), b^2 y / (t + b^2)) for the t >= 0 that puts it on the
    ellipse. The residual of the ellipse's equation is convex and falls with t, so Newton steps
    from a t that is too small never overshoot. For a point inside its ellipse, some unit vector is
    returned, along which the separation is a lower bound of the gap like along any other.

    Args:
        x: (N,) coordinates of the points along the first semi-axes [m].
        y: (N,) coordinates of the points along the second semi-axes [m].
        a: (N,) first semi-axes [m].
        b: (N,) second semi-axes [m].

    Returns:
        (N,) components of the normals along the first and along the second semi-axes.
    """
    t = np.maximum(np.maximum(a * (np.abs(x) - a), b * (np.abs(y) - b)), 0.0)
    for _ in range(NEWTON_STEPS):
        p, q = (a * x / (t + a * a)) ** 2, (b * y / (t + b * b)) ** 2
        slope = 2.0 * (p / (t + a * a) + q / (t + b * b))
        t = t + np.maximum(p + q - 1.0, 0.0) / np.maximum(slope, 1e-300)
    nx, ny = x / (t + a * a), y / (t + b * b)
    length = np.hypot(nx, ny)
    at_centre = length < 1e-12
    length = np.where(at_centre, 1.0, length)
    return np.where(at_centre, 1.0, nx / length), np.where(at_centre, 0.0, ny / length)


def wall_gap(poses: Array, box: Box, walls: Array) -> Array:
    """Compute the gaps of N pairs of a filled box and a filled wall.

    Of the two nearest points of separate boxes, at least one is a corner.

    Args:
        poses: (N, 3) poses of the box in odom [m, m, rad].
        walls: (N, 5) x, y, heading, length and width of the walls in odom [m, m, rad, m, m].

    Returns:
        (N,) gaps [m]: exact where above zero; where the two overlap, the negative depth of the
            overlap.
    """
    box_half = np.tile(box.half, (len(poses), 1))
    wall_half = 0.5 * walls[:, 3:]
    in_wall, box_corners = _axis_and_corner_gaps(poses, box_half, walls[:, :3], wall_half)
    in_box, wall_corners = _axis_and_corner_gaps(walls[:, :3], wall_half, poses, box_half)
    separation = np.maximum(in_wall, in_box)
    return np.where(separation > 0.0, np.minimum(box_corners, wall_corners), separation)


def _axis_and_corner_gaps(
    boxes: Array, half: Array, frames: Array, other: Array
) -> tuple[Array, Array]:
    """Return separations of box pairs: along the second box's axes, and from the first's corners.

    Args:
        boxes: (N, 3) poses of the first boxes [m, m, rad].
        half: (N, 2) half lengths and half widths of the first boxes [m].
        frames: (N, 3) poses of the second boxes [m, m, rad].
        other: (N, 2) half lengths and half widths of the second boxes [m].

    Returns:
        (N,) largest separation along an axis of the second box [m], negative where the boxes
            overlap along both; (N,) distance from the second box to the nearest corner of the
            first [m].
    """
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
    """Compute how far a box extends beyond the border of an area.

    Args:
        poses: (K, 3) poses of the box in odom [m, m, rad].

    Returns:
        (K,) distances [m]; a negative value is the room that is left within the area.
    """
    c, s = np.abs(np.cos(poses[:, 2])), np.abs(np.sin(poses[:, 2]))
    along, across = box.half
    reach = np.stack((along * c + across * s, along * s + across * c), axis=1)
    low, high = np.array(area[:2]), np.array(area[2:])
    result: Array = (np.maximum(low - poses[:, :2], poses[:, :2] - high) + reach).max(axis=1)
    return result
