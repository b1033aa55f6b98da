"""True shapes of a scene, their exact gaps, and the judge of a drive among them.

The judge shares no code with the planner that it judges. A gap changes by no more than robot and
obstacle travel relative to each other: between two samples, gaps g and h, it is at least
0.5 (g + h - travel). Where this bound does not exclude a contact, there is one. With samples 5 ms
apart and 1.6 m/s, what counts as a contact is at most 4 mm away from one.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array

Point = tuple[float, float]  #: components along x and y of a position [m] or a velocity [m/s]
Area = tuple[float, float, float, float]  #: x_min, y_min, x_max, y_max in odom [m]
NEWTON_STEPS = 12  #: number of Newton steps towards an ellipse's point nearest to a corner


@dataclass(frozen=True)
class RectangularOutline:
    """The robot's outline: a rectangle centred at its pose, with its length along its heading."""

    length: float
    width: float

    @property
    def half(self) -> tuple[float, float]:
        """Half length and half width [m]."""
        return 0.5 * self.length, 0.5 * self.width

    @property
    def radius(self) -> float:
        """Distance of the corners from the centre [m]."""
        return math.hypot(*self.half)


@dataclass(frozen=True)
class PolylineMotion:
    """The motion of a point along a polyline, at constant velocity between successive corners.

    The point rests at the first corner before the first time, and moves on at a given velocity
    after the last time.
    """

    times: tuple[float, ...]  #: at which the corners are reached [s], increasing
    places: tuple[Point, ...]  #: corners in odom [m], one for each time
    velocity: Point = (0.0, 0.0)  #: in odom after the last time [m/s]

    @staticmethod
    def still(x: float, y: float) -> "PolylineMotion":
        """Return the motion of a point that rests at (x, y) in odom [m]."""
        return PolylineMotion((0.0,), ((x, y),))

    @staticmethod
    def straight(place: Point, velocity: Point) -> "PolylineMotion":
        """Return a motion at constant velocity from a place in odom on."""
        return PolylineMotion((0.0,), (place,), velocity)

    def __call__(self, now: float) -> Array:
        """Return the position (2,) in odom [m] at the time `now` [s]."""
        result: Array = self.at(np.array([now]))[0]
        return result

    def at(self, times: Array) -> Array:
        """Return the positions (K, 2) in odom [m] at times (K,) [s]."""
        places = np.array(self.places)
        x, y = (np.interp(times, self.times, places[:, i]) for i in (0, 1))
        beyond = np.maximum(times - self.times[-1], 0.0)
        result: Array = np.stack((x + beyond * self.velocity[0], y + beyond * self.velocity[1]), 1)
        return result

    @property
    def speed(self) -> float:
        """Largest speed at any time [m/s]."""
        steps = np.diff(np.array(self.places), axis=0) / np.diff(self.times)[:, None]
        speeds = np.hypot(steps[:, 0], steps[:, 1])
        return float(max(speeds.max(initial=0.0), math.hypot(*self.velocity)))


@dataclass(frozen=True)
class MovingObstacle:
    """An elliptic obstacle as it truly moves; it never turns."""

    semi_axes: tuple[float, float]  #: [m]
    place: Callable[[float], Array]  #: position (2,) of its centre in odom [m] at a time [s]
    angle: float = 0.0  #: of its first semi-axis in odom [rad]

    @property
    def is_fixed(self) -> bool:
        """Whether it stands still in the first second."""
        return not np.ptp([self.place(0.0), self.place(1.0)], axis=0).any()


@dataclass(frozen=True)
class Ellipse(MovingObstacle):
    """An elliptic obstacle whose centre moves along a polyline."""

    place: PolylineMotion

    @property
    def is_fixed(self) -> bool:
        """Whether the obstacle never moves."""
        return self.place.speed == 0.0


@dataclass(frozen=True)
class WallRectangle:
    """A wall: a fixed rectangle, given by centre, heading, and size along and across."""

    x: float
    y: float
    heading: float
    length: float
    width: float

    @property
    def row(self) -> Array:
        """Centre, heading and size (1, 5) [m, m, rad, m, m]."""
        return np.array([[self.x, self.y, self.heading, self.length, self.width]])


@dataclass(frozen=True)
class SceneVerdict:
    """The judge's verdict on a drive; gap and room at the samples."""

    gap: float  #: smallest gap [m]; not above zero after a contact, inf with nothing to touch
    contact: float  #: time of the first contact [s]; inf without one
    touched: int | None  #: index of the obstacle that the robot touched first
    outside: float  #: largest distance by which the robot left its area [m]; -inf without one

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything."""
        return self.touched is not None


def judge(
    times: Array,
    poses: Array,
    box: RectangularOutline,
    obstacles: Sequence[Ellipse],
    area: Area | None = None,
) -> SceneVerdict:
    """Judge a drive, given by its times (K,) [s] and true poses (K, 3) in odom [m, m, rad].

    Args:
        obstacles: What the robot may have touched.
        area: Where its whole outline should stay; leaving it is no contact. None: anywhere.
    """
    beyond = -math.inf if area is None else float(outside(poses, box, area).max())
    if not obstacles:
        return SceneVerdict(math.inf, math.inf, None, beyond)
    centers = np.stack([each.place.at(times) for each in obstacles], axis=1)
    axes, angles = (
        np.array([o.semi_axes for o in obstacles]),
        np.array([o.angle for o in obstacles]),
    )
    gaps = ellipse_gaps(poses, box, centers, axes, angles)
    steps, turns = np.diff(poses[:, :2], axis=0), np.abs(np.diff(np.unwrap(poses[:, 2])))
    own = np.hypot(steps[:, 0], steps[:, 1]) + box.radius * turns
    travel = own[:, None] + np.outer(np.diff(times), [o.place.speed for o in obstacles])
    least = np.vstack([gaps[:1], np.minimum(gaps[1:], 0.5 * (gaps[1:] + gaps[:-1] - travel))])
    rows = np.flatnonzero((least <= 0.0).any(axis=1))
    if not len(rows):
        return SceneVerdict(float(gaps.min()), math.inf, None, beyond)
    contact, touched = float(times[rows[0]]), int(least[rows[0]].argmin())
    return SceneVerdict(min(float(gaps.min()), 0.0), contact, touched, beyond)


def ellipse_gaps(
    poses: Array, box: RectangularOutline, centers: Array, semi_axes: Array, angles: Array
) -> Array:
    """Compute the gaps between a filled box at K poses and M filled ellipses.

    Along a unit vector n, the separation of the two is the distance of their centres less the
    extent of each body, n.(p - c) - h_box(n) - h_ellipse(n). The gap is the largest separation
    over all n. Where the two do not overlap, n is either perpendicular to an edge of the box, or
    normal to the ellipse at its point nearest to a corner of the box: these directions are tried.
    As none of them gives more than the gap, an inexact nearest point makes the result too small,
    never too large.

    Args:
        poses: (K, 3) poses of the box in odom [m, m, rad].
        centers: (K, M, 2) centres of the ellipses in odom [m].
        semi_axes: (M, 2) semi-axes [m].
        angles: (M,) angles of the first semi-axes in odom [rad].

    Returns:
        (K, M) gaps [m]: exact to round-off where above zero; zero or less where the two touch or
        overlap.
    """
    a, b = semi_axes[:, 0], semi_axes[:, 1]
    dx, dy = np.moveaxis(poses[:, None, :2] - centers, -1, 0)  # (K, M) each
    c, s = np.cos(angles), np.sin(angles)
    x, y = c * dx + s * dy, c * dy - s * dx
    ux, uy = np.cos(poses[:, 2:] - angles), np.sin(poses[:, 2:] - angles)
    along, across = box.half

    def separation(nx: Array, ny: Array) -> Array:
        """Return the separations (K, M) [m] along unit vectors in the axes of the ellipses."""
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
    """Return unit normals of ellipses at their points nearest to points outside them, (K, M) each.

    The nearest point is (a^2 x / (t + a^2), b^2 y / (t + b^2)) for the t >= 0 that puts it on the
    ellipse. The residual of the ellipse's equation is convex and falls with t, so Newton steps
    from a t that is too small never overshoot. For a point inside its ellipse, some unit vector is
    returned, along which the separation is a lower bound of the gap like along any other.

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


def wall_gap(poses: Array, box: RectangularOutline, walls: Array) -> Array:
    """Compute the gaps of N pairs of a filled box and a filled wall.

    Of the two nearest points of separate boxes, at least one is a corner.

    Args:
        poses: (N, 3) poses of the box in odom [m, m, rad].
        walls: (N, 5) or (1, 5) x, y, heading, length and width in odom [m, m, rad, m, m].

    Returns:
        (N,) gaps [m]: exact where above zero; where the two overlap, the negative depth of the
            overlap.
    """
    box_half = np.array([box.half])
    wall_half = 0.5 * walls[:, 3:]
    in_wall, box_corners = _axis_and_corner_gaps(poses, box_half, walls[:, :3], wall_half)
    in_box, wall_corners = _axis_and_corner_gaps(walls[:, :3], wall_half, poses, box_half)
    separation = np.maximum(in_wall, in_box)
    return np.where(separation > 0.0, np.minimum(box_corners, wall_corners), separation)


def _axis_and_corner_gaps(
    boxes: Array, half: Array, frames: Array, other: Array
) -> tuple[Array, Array]:
    """Return separations of box pairs: along the second box's axes, and from the first's corners.

    The first is (N,) the largest separation along an axis, negative where the boxes overlap along
    both; the second (N,) the distance from the second box to the nearest corner [m].
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


def outside(poses: Array, box: RectangularOutline, area: Area) -> Array:
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
