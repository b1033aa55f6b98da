"""Distance of the robot's boxes from moving ellipses, at poses and in the motion between them.

A box is a rectangle that is fixed to base_link. There is one for all obstacles, or one for each.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.surroundings.ellipses import Ellipses

Mask = NDArray[np.bool_]  #: Array of flags, one per obstacle
Workspace = tuple[float, float, float, float]  #: Bounds x_min, y_min, x_max, y_max in odom [m]


def box_gap(
    poses: Array, box: Rectangles, centers: Array, semi_axes: Array, angles: Array
) -> Array:
    """Return a lower bound of the distance from the box to each ellipse, both filled.

    Whitened by the ellipse, this is a unit disc and the box a parallelogram; d is the signed
    distance from the disc's centre to the parallelogram's boundary, negative inside. Proof: the
    unit vector n to the nearest point has n.y >= d on the parallelogram and n.y <= 1 on the disc,
    and the two lines n.y = d and n.y = 1 of the whitened plane are (d - 1) / |W^T n| apart in the
    plane itself, W being the whitening. This is at least the smaller semi-axis times (d - 1),
    which is returned where d <= 1: there the two touch or overlap.

    Args:
        poses: (K, 3) poses of base_link in odom [m, m, rad].
        box: One box, or boxes (M,) or (K, M).
        centers: (K, M, 2) of the ellipses in odom [m].
        semi_axes: (K, M, 2) [m], above zero.
        angles: (M,) or (K, M) of the ellipses' x axes in odom [rad].

    Returns:
        (K, M) [m]: exact for circles outside of the box and wherever the shortest connection is
        along an axis of the ellipse; zero or less where the two touch or overlap, also if one
        contains the other; -inf where an input is not finite, so that every comparison fails.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        return _finite(_nearest(_placed(poses, box, centers, angles), semi_axes).gap)


def facing_gap(
    poses: Array, box: Rectangles, centers: Array, semi_axes: Array, angles: Array
) -> Array:
    """Return another lower bound of the distance of :func:`box_gap`, in half its time.

    The point of the box that is the nearest to the ellipse's centre is r away from it, in the
    direction n. The box lies beyond the line through that point across n, and no point of the
    ellipse is farther towards it than h(n) = sqrt((a n.x)^2 + (b n.y)^2): the bound is r - h(n).
    It is exact for circles; with the centre inside the box it is the negative larger semi-axis.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        dx, dy = centers[..., 0] - poses[:, :1], centers[..., 1] - poses[:, 1:2]
        x = cos * dx + sin * dy - box.centre[..., 0]
        y = cos * dy - sin * dx - box.centre[..., 1]
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        x, y = c * x + s * y, c * y - s * x
        a, b = box.half[..., 0], box.half[..., 1]
        x = x - np.maximum(np.minimum(x, a), -a)
        y = y - np.maximum(np.minimum(y, b), -b)
        turn = angles - box.yaw - poses[:, 2:]
        c, s = np.cos(turn), np.sin(turn)
        distance = np.hypot(x, y)
        reach = np.hypot(semi_axes[..., 0] * (c * x + s * y), semi_axes[..., 1] * (c * y - s * x))
        inside = distance <= 0.0
        extent = reach / np.where(inside, 1.0, distance)
        return _finite(np.where(inside, -semi_axes.max(axis=-1), distance - extent))


def swept_gap(
    times: Array,
    poses: Array,
    velocities: Array,
    box: Rectangles,
    ellipses: Ellipses,
    margin: float = 0.0,
) -> Array:
    """Return a lower bound of the distance of `box_gap` over each interval between two samples.

    The linear and angular acceleration of base_link are assumed to be constant between two
    samples. Its speeds relative to an obstacle then are convex in time: none exceeds the larger of
    its values at the two ends. Two bounds hold; the larger is returned, but no more than the gap
    at an end:

    * (g0 + g1 - L) / 2, where g0 and g1 are the gaps at the ends and L is the largest travel of
      any point of the box relative to the obstacle plus the growth of the obstacle, as the
      distance changes by no more than L. Only the bounds on the speeds are needed.
    * The separation along one fixed direction, that of the gap at either end: each point of the
      box leaves the chord of its motion by at most a dt^2 / 8, a = |x''| + radius (w^2 + |w'|).
      This lets the box drive close along an obstacle.

    Args:
        times: (K,) increasing [s], two or more.
        poses: (K, 3) poses of base_link in odom [m, m, rad].
        velocities: (K, 3) of base_link in odom [m/s, m/s, rad/s].
        box: One box, or boxes (M,).
        ellipses: M obstacles.
        margin: Margin around each obstacle in addition to its growth [m].

    Returns:
        (K - 1, M) [m]; not above zero where the two may touch, and there a lower bound of
        `box_gap` within the interval; -inf where an input is not finite.

    Raises:
        InputError: The times do not increase, or there are fewer than two.
    """
    dt = _intervals(times)[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        axes = ellipses.axes_at(times, margin)
        placed = _placed(poses, box, ellipses.centers_at(times), ellipses.angles)
        near = _nearest(placed, axes)
        start, end = near.gap[:-1], near.gap[1:]
        before, after = placed[:-1], placed[1:]
        # An ellipse whose axes grow by this stays within this distance of the original one.
        growth = np.abs(np.diff(axes, axis=0)).max(axis=-1, initial=0.0)

        radius = box.radius
        relative = velocities[:, None, :2] - ellipses.velocities
        speed = np.hypot(relative[..., 0], relative[..., 1])
        yaw_rate = np.abs(velocities[:, 2:])
        spin = np.maximum(yaw_rate[:-1], yaw_rate[1:])
        displacement = dt * (np.maximum(speed[:-1], speed[1:]) + radius * spin) + growth
        by_travel = 0.5 * (start + end - displacement)

        change = np.abs(np.diff(velocities, axis=0))
        bend = np.hypot(change[:, :1], change[:, 1:2]) + radius * change[:, 2:]
        sagitta = 0.125 * dt * (bend + dt * radius * spin * spin)
        forward = np.minimum(start - growth, _separation(near[:-1], after, axes[1:]))
        backward = np.minimum(end, _separation(near[1:], before, axes[1:]))
        # Where the two overlap there is no direction.
        forward = np.where(start > 0.0, forward, -np.inf)
        backward = np.where(end > 0.0, backward, -np.inf)
        by_direction = np.maximum(forward, backward) - sagitta

        ends = np.minimum(start, end)
        return _finite(np.minimum(ends, np.maximum(by_travel, by_direction)))


def within_distance(
    times: Array,
    poses: Array,
    velocities: Array,
    box: Rectangles,
    ellipses: Ellipses,
    margin: float = 0.0,
) -> Mask:
    """Return the mask of obstacles that the box may come near to; the others cannot touch it.

    One circle contains the box throughout its motion, and one circle contains each obstacle, whose
    centre moves on a straight line. Assumptions and arguments are those of `swept_gap`.

    Returns:
        (M,) mask; all true where an input of the box is not finite.

    Raises:
        InputError: The times do not increase, or there are fewer than two.
    """
    dt = _intervals(times)
    if not (np.isfinite(poses).all() and np.isfinite(velocities).all()):
        return np.ones(len(ellipses), dtype=bool)
    positions = poses[:, :2]
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    # The box is never farther than half an interval's travel from the nearer end of the interval.
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    detour = 0.5 * float((dt * np.maximum(speed[:-1], speed[1:])).max())
    offset = positions - middle
    radius = float(np.hypot(offset[:, 0], offset[:, 1]).max()) + box.radius + detour
    ends = times[[0, -1]]
    first, last = ellipses.centers_at(ends) - middle
    displacement = last - first
    squared_length = np.maximum((displacement * displacement).sum(axis=1), np.finfo(float).tiny)
    fraction = np.clip(-(first * displacement).sum(axis=1) / squared_length, 0.0, 1.0)
    closest = first + fraction[:, None] * displacement
    reach = radius + ellipses.axes_at(ends, margin).max(axis=(0, 2), initial=0.0)
    result: Mask = ~(np.hypot(closest[:, 0], closest[:, 1]) > reach)  # NaN stays
    return result


def first_contact(
    times: Array,
    poses: Array,
    velocities: Array,
    box: Rectangles,
    ellipses: Ellipses,
    margin: float = 0.0,
) -> float:
    """Return the start of the first interval in which the box may touch an obstacle.

    Arguments are those of `swept_gap`.

    Returns:
        Time [s]; inf if it touches none. A pose or velocity that is not finite counts as a
        contact in the interval that leads to it, with or without obstacles.

    Raises:
        InputError: The times do not increase, or there are fewer than two.
    """
    _intervals(times)
    fit = np.isfinite(poses).all(axis=1) & np.isfinite(velocities).all(axis=1)
    count = len(times) if fit.all() else int(np.argmin(fit))
    if count >= 2:
        known = times[:count], poses[:count], velocities[:count]
        near = within_distance(*known, box, ellipses, margin)
        gaps = swept_gap(*known, box.select(near), ellipses.select(near), margin)
        contact = ~(gaps > 0.0).all(axis=1)
        if contact.any():
            return float(times[np.argmax(contact)])
    return math.inf if count == len(times) else float(times[max(count - 1, 0)])


def outside_by(poses: Array, boxes: Rectangles, workspace: Workspace) -> Array:
    """Return the distance (K,) by which the boxes leave the workspace at poses (K, 3) [m].

    MPC 2021 (29) and (30), the latter corrected: distance of the farthest corner beyond a side or,
    negative, distance of all corners from the nearest side inside; inf for a pose that is not
    finite.

    Args:
        poses: (K, 3) poses of base_link in odom [m, m, rad].
    """
    with np.errstate(invalid="ignore"):
        low, high = np.array(workspace[:2]), np.array(workspace[2:])
        result: Array = np.full(len(poses), -np.inf)
        for box in boxes.each():
            own = box.poses(poses)
            c, s = np.abs(np.cos(own[:, 2])), np.abs(np.sin(own[:, 2]))
            a, b = box.half
            extent = np.stack((a * c + b * s, a * s + b * c), axis=1)
            beyond = np.maximum(low - own[:, :2], own[:, :2] - high) + extent
            result = np.maximum(result, beyond.max(axis=1))
    return np.where(np.isfinite(result), result, np.inf)


@dataclass(frozen=True)
class _Placed:
    """Centre and half edges of the box along the axes of each ellipse, (K, M) each."""

    x: Array
    y: Array
    length: tuple[Array, Array]
    width: tuple[Array, Array]

    def __getitem__(self, rows: slice) -> "_Placed":
        (a, b), (c, d) = self.length, self.width
        return _Placed(self.x[rows], self.y[rows], (a[rows], b[rows]), (c[rows], d[rows]))


@dataclass(frozen=True)
class _Nearest:
    """Gap [m] and its direction, along the ellipse's axes and away from it, (K, M) each.

    The direction has length 1 where the gap is above zero, and is undefined elsewhere.
    """

    gap: Array
    x: Array
    y: Array

    def __getitem__(self, rows: slice) -> "_Nearest":
        return _Nearest(self.gap[rows], self.x[rows], self.y[rows])


def _placed(poses: Array, box: Rectangles, centers: Array, angles: Array) -> _Placed:
    """Express the box in the axes of the ellipses: rotated by their angles, not scaled yet."""
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = box.centre[..., 0], box.centre[..., 1]
    dx = poses[:, :1] + (cos * x - sin * y) - centers[..., 0]
    dy = poses[:, 1:2] + (sin * x + cos * y) - centers[..., 1]
    c, s = np.cos(angles), np.sin(angles)
    heading = poses[:, 2:] + box.yaw - angles
    ch, sh = np.cos(heading), np.sin(heading)
    a, b = box.half[..., 0], box.half[..., 1]
    return _Placed(c * dx + s * dy, c * dy - s * dx, (a * ch, a * sh), (-b * sh, b * ch))


def _nearest(box: _Placed, semi_axes: Array) -> _Nearest:
    """Find the point of the whitened box's boundary that is nearest to the disc's centre."""
    a, b = semi_axes[..., 0], semi_axes[..., 1]
    x, y = box.x / a, box.y / b
    ux, uy = box.length[0] / a, box.length[1] / b
    vx, vy = box.width[0] / a, box.width[1] / b
    area = ux * vy - uy * vx
    # The disc's centre is (x, y) + along u + across v. Of two opposite edges only the one on its
    # side can be the nearest, whether it is inside or not: two edges are left.
    along, across = (y * vx - x * vy) / area, (x * uy - y * ux) / area
    side, edge = np.copysign(1.0, along), np.copysign(1.0, across)
    x1, y1 = _on_edge(x + side * ux, y + side * uy, vx, vy)
    x2, y2 = _on_edge(x + edge * vx, y + edge * vy, ux, uy)
    square1, square2 = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
    first = square1 < square2
    x, y = np.where(first, x1, x2), np.where(first, y1, y2)
    distance = np.sqrt(np.minimum(square1, square2))
    inside = np.maximum(np.abs(along), np.abs(across)) < 1.0
    apart = (distance > 1.0) & ~inside
    x, y = x / a, y / b
    scale = np.where(apart, np.hypot(x, y), 1.0)
    depth = np.where(inside, -distance, distance) - 1.0
    gap = depth * np.where(apart, distance / scale, np.minimum(a, b))
    return _Nearest(gap, x / scale, y / scale)


def _on_edge(x: Array, y: Array, ex: Array, ey: Array) -> tuple[Array, Array]:
    """Return the point of the edge (x, y) -+ (ex, ey) that is nearest to the origin."""
    fraction = np.clip(-(x * ex + y * ey) / (ex * ex + ey * ey), -1.0, 1.0)
    return x + fraction * ex, y + fraction * ey


def _separation(near: _Nearest, box: _Placed, semi_axes: Array) -> Array:
    """Return the width (K, M) [m] of the strip between box and ellipse across a direction."""
    x, y = near.x, near.y
    length = np.abs(x * box.length[0] + y * box.length[1])
    width = np.abs(x * box.width[0] + y * box.width[1])
    ellipse = np.hypot(x * semi_axes[..., 0], y * semi_axes[..., 1])
    result: Array = x * box.x + y * box.y - length - width - ellipse
    return result


def _finite(gap: Array) -> Array:
    """Replace gaps that are not finite by -inf, so that an unknown gap does not count as free."""
    return np.where(np.isfinite(gap), gap, -np.inf)


def _intervals(times: Array) -> Array:
    """Return the lengths (K - 1,) [s] of the intervals between times, which must increase."""
    dt = np.diff(times)
    if len(dt) == 0 or not (np.isfinite(times).all() and (dt > 0.0).all()):
        raise InputError(f"two or more times that increase are needed, got {times.tolist()}")
    return dt
