"""Gaps between a box of the robot and the ellipse of an obstacle, as rows of the program."""

from typing import NamedTuple

import casadi as ca

from omniman_ros.planning.mpc.step import rotated

#: Number of values of an obstacle at a node: centre, axis (cosine and sine of its angle),
#: semi-axes with their margin, velocity; and of the box of the robot that keeps clear of it:
#: centre, direction (cosine and sine), half length and half width, largest distance of its points
#: from base_link. All are in odom but the box, which is in base_link.
OBSTACLE = 15
GAPS = 2  #: Number of rows of an obstacle
INACTIVE_GAP = 1.0  #: Gap of a row that constrains nothing [m]
SMOOTH = 1e-9  #: Square of the distance or speed below which it is rounded off
SMOOTH_RATE = 0.05  #: Yaw rate below which its amount is rounded off [rad/s]


class EllipseAxes(NamedTuple):
    """Semi-axes of an ellipse, widened by a margin."""

    value: ca.SX  #: (2,) [m]
    by_margin: ca.SX  #: (2,) their derivatives by the margin [-]
    margin_by_y: ca.SX  #: (1, 6) derivative of the margin by the state at the node


def ellipse_axes(y: ca.SX, obstacle: ca.SX, duration: float) -> EllipseAxes:
    """Return semi-axes of the ellipse with which no box slips past it between two nodes.

    The smallest distance of a chord of length L from the centre of its circle of radius r is
    sqrt(r^2 - L^2 / 4). On the circle of radius sqrt(c^2 + L^2 / 4) this is c, the smallest
    radius of curvature of the ellipse: the difference of these two radii is the margin. The axes
    with a margin are those of `surroundings.ellipses.inflated`.

    Args:
        y: State (6,) at the node.
        obstacle: Values of the obstacle, see `OBSTACLE`.
        duration: Time between two nodes [s].
    """
    axes = obstacle[4:6]
    velocity = rotated(y[2], y[3:5])
    relative = velocity - obstacle[6:8]
    speed = ca.sqrt(ca.sumsqr(relative) + SMOOTH)
    yaw_rate = ca.sqrt(y[5] ** 2 + SMOOTH_RATE**2)
    travel = duration * (speed + obstacle[14] * yaw_rate)
    bend = ca.fmin(axes[0], axes[1]) ** 2 / ca.fmax(axes[0], axes[1])
    radius = ca.sqrt(bend**2 + 0.25 * travel**2)
    margin, size = radius - bend, ca.sqrt(0.5 * ca.sumsqr(axes))
    value = ca.sqrt((1.0 + margin / size) * axes**2 + margin * (margin + size))
    by_margin = 0.5 * (axes**2 / size + 2.0 * margin + size) / value
    by_speed = duration * 0.25 * travel / radius
    towards = by_speed / speed * relative
    margin_by_y = ca.horzcat(
        ca.SX(1, 2),
        towards[1] * velocity[0] - towards[0] * velocity[1],
        rotated(-y[2], towards).T,
        by_speed * obstacle[14] * y[5] / yaw_rate,
    )
    return EllipseAxes(value, by_margin, margin_by_y)


def gap_rows(y: ca.SX, obstacle: ca.SX, duration: float) -> tuple[ca.SX, ca.SX]:
    """Return the gaps (2,) between the ellipse and the edges of the box that face its centre [m].

    In the plane whitened by the ellipse, the distance of its centre from an edge, which is a
    segment, is exact; of two opposite edges, only the one on the side of the centre can be the
    nearest. If the centre is inside the box, the nearer edge of the two has to move beyond it, and
    the other one is left out. The second result are the derivatives (2, 6) by the state.

    Arguments are those of :func:`ellipse_axes`.
    """
    half, heading = obstacle[12:14], y[2]
    arms = rotated(heading, obstacle[10:12]), rotated(heading, _left(obstacle[10:12]))
    offset = y[:2] + rotated(heading, obstacle[8:10]) - obstacle[:2]
    place = [-ca.dot(arm, offset) for arm in arms]
    depths = [half[k] - ca.fabs(place[k]) for k in range(2)]
    first, second = depths
    is_inside, is_first = ca.fmin(first, second) > 0, first <= second
    axes, by_margin, margin_by_y = ellipse_axes(y, obstacle, duration)
    scale = ca.fmin(axes[0], axes[1])
    scale_by_margin = ca.if_else(axes[0] < axes[1], by_margin[0], by_margin[1])
    way = ca.if_else(is_inside, -1, 1)
    c, s = obstacle[2], obstacle[3]
    aligned = [ca.vertcat(c * v[0] + s * v[1], c * v[1] - s * v[0]) for v in (offset, *arms)]
    values, slopes = [], []
    for k in range(GAPS):
        face = ca.if_else(place[k] < 0, -half[k], half[k])
        # Along the edge, its nearest point; all in the axes of the ellipse.
        start, edge = aligned[0] + face * aligned[1 + k], half[1 - k] * aligned[2 - k]
        white_edge = edge / axes
        fraction = -ca.dot(start / axes, white_edge) / ca.dot(white_edge, white_edge)
        fraction = ca.fmin(ca.fmax(fraction, -1), 1)
        white = (start + fraction * edge) / axes
        distance = ca.sqrt(ca.sumsqr(white) + SMOOTH)
        # The distance is least along the edge: its derivative by the fraction is zero.
        slope = (way * scale / distance) * white / axes
        by_place = ca.vertcat(c * slope[0] - s * slope[1], s * slope[0] + c * slope[1])
        point = (
            y[:2] - obstacle[:2] - offset - face * arms[k] - fraction * half[1 - k] * arms[1 - k]
        )
        by_heading = by_place[0] * point[1] - by_place[1] * point[0]
        by_axes = scale_by_margin * (way * distance - 1) - ca.dot(slope * white, by_margin)
        is_out = ca.logic_and(is_inside, ca.logic_not(is_first) if k == 0 else is_first)
        counts = ca.logic_not(is_out)
        values.append(ca.if_else(is_out, INACTIVE_GAP, scale * (way * distance - 1)))
        slopes.append(
            counts * (ca.horzcat(by_place.T, by_heading, ca.SX(1, 3)) + by_axes * margin_by_y)
        )
    return ca.vertcat(*values), ca.vertcat(*slopes)


def _left(vector: ca.SX) -> ca.SX:
    """Return a vector (2,) turned to the left by a right angle."""
    return ca.vertcat(-vector[1], vector[0])
