"""Whether a rectangular robot truly touched what was around it: the judge of the random scenes.

It shares no code with the planner that it judges. The robot is a box whose true poses are known
at samples; between two samples its centre moves on a straight line and its heading turns evenly.
At 5 ms a robot that accelerates at 6 m/s^2 leaves this line by 0.02 mm, which is not seen.
Obstacles are ellipses that move on known polylines, and walls, boxes that stand.

The gap at one time is exact, as is shown at `ellipse_gap` and `wall_gap`. Between two times it
changes by no more than the two travel relative to each other; an interval in which that leaves
open whether they touch is halved until it does not.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Point = tuple[float, float]
Area = tuple[float, float, float, float]

TOUCH = 1e-4
"""Nearer than this counts as a contact, and the least gap is exact to this [m]."""
NEWTON = 12
"""Steps to the point of an ellipse that is nearest to a corner; a step too few is pessimistic."""
HALVINGS = 60
"""Of an interval; travel is below a tenth of a nanometre before."""


# ---- what there is ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Box:
    """The robot's outline, centred at its pose, its length along its heading.

    Attributes:
        length, width: [m], above zero.

    Raises:
        InputError: A size is not above zero.
    """

    length: float
    width: float

    def __post_init__(self) -> None:
        _above_zero("length of the box", self.length)
        _above_zero("width of the box", self.width)

    @property
    def half(self) -> Point:
        """Half length and half width [m]."""
        return 0.5 * self.length, 0.5 * self.width

    @property
    def radius(self) -> float:
        """Distance of the corners from the centre [m]."""
        return math.hypot(*self.half)


@dataclass(frozen=True)
class Route:
    """A polyline in time: even motion from each place to the next, then on at a velocity.

    Before the first time it stands at the first place.

    Attributes:
        times: When it is at the places [s], increasing, one or more.
        places: (x, y) in odom [m].
        velocity: From the last time on [m/s].

    Raises:
        InputError: Times don't increase, their number is not that of the places, or a value is
            not finite.
    """

    times: tuple[float, ...]
    places: tuple[Point, ...]
    velocity: Point = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.places):
            raise InputError(f"a route needs a time for each place, got {len(self.times)} times "
                             f"and {len(self.places)} places")  # fmt: skip
        values = np.array([*self.times, *np.ravel(self.places), *self.velocity])
        if not (np.isfinite(values).all() and (np.diff(self.times) > 0.0).all()):
            raise InputError(f"times of a route must increase and all be finite, got {self}")

    @staticmethod
    def still(x: float, y: float) -> "Route":
        """Stand at a place [m]."""
        return Route((0.0,), ((x, y),))

    @staticmethod
    def straight(place: Point, velocity: Point, since: float = 0.0) -> "Route":
        """From a place [m] at a constant velocity [m/s] since a time [s]."""
        return Route((since,), (place,), velocity)

    def __call__(self, now: float) -> Array:
        """Where it is (2,) [m] at a time [s]."""
        result: Array = self.at(np.array([now]))[0]
        return result

    def at(self, times: Array) -> Array:
        """Where it is (K, 2) [m] at times (K,) [s]."""
        places = np.array(self.places)
        x, y = (np.interp(times, self.times, places[:, i]) for i in (0, 1))
        late = np.maximum(times - self.times[-1], 0.0)
        result: Array = np.stack((x + late * self.velocity[0], y + late * self.velocity[1]), 1)
        return result

    @property
    def speed(self) -> float:
        """Largest [m/s]."""
        steps = np.diff(np.array(self.places), axis=0) / np.diff(self.times)[:, None]
        speeds = np.hypot(steps[:, 0], steps[:, 1])
        return float(max(speeds.max(initial=0.0), math.hypot(*self.velocity)))


@dataclass(frozen=True)
class Ellipse:
    """An obstacle, filled; a disc if its semi-axes are equal.

    Attributes:
        semi_axes: [m], above zero.
        place: Where its centre is, a function of time.
        angle: Of its first axis in odom [rad]; it does not turn.

    Raises:
        InputError: A semi-axis is not above zero or the angle not finite.
    """

    semi_axes: Point
    place: Route
    angle: float = 0.0

    def __post_init__(self) -> None:
        for axis in self.semi_axes:
            _above_zero("semi-axis", axis)
        _finite("angle of the ellipse", self.angle)

    @property
    def fixed(self) -> bool:
        """Whether it stands."""
        return self.place.speed == 0.0


@dataclass(frozen=True)
class Wall:
    """A box that stands.

    Attributes:
        x, y, heading: Of its centre in odom [m, m, rad].
        length, width: Along its heading and across it [m], above zero.

    Raises:
        InputError: A size is not above zero or a value not finite.
    """

    x: float
    y: float
    heading: float
    length: float
    width: float

    def __post_init__(self) -> None:
        for name in ("x", "y", "heading"):
            _finite(f"{name} of the wall", getattr(self, name))
        _above_zero("length of the wall", self.length)
        _above_zero("width of the wall", self.width)


@dataclass(frozen=True)
class World:
    """All that the robot may touch.

    Attributes:
        obstacles: Ellipses, fixed and moving.
        walls: Boxes, fixed.
        area: x_min, y_min, x_max, y_max in odom that all of the robot should stay in [m], or
            None. To leave it is no contact.

    Raises:
        InputError: The area is empty.
    """

    obstacles: tuple[Ellipse, ...] = ()
    walls: tuple[Wall, ...] = ()
    area: Area | None = None

    def __post_init__(self) -> None:
        if self.area is not None:
            low, high = np.array(self.area[:2]), np.array(self.area[2:])
            if not (np.isfinite(self.area).all() and (low < high).all()):
                raise InputError(f"the area must be x_min, y_min, x_max, y_max, got {self.area}")


def _above_zero(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise InputError(f"{name} must be above zero and finite, got {value} m")


def _finite(name: str, value: float) -> None:
    if not math.isfinite(value):
        raise InputError(f"{name} must be finite, got {value}")


# ---- gaps at one time ---------------------------------------------------------------------------


def ellipse_gap(poses: Array, box: Box, centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Gap between box and ellipse, both filled, for N pairs.

    Along any direction n the two are apart by the distance of their centres less what each
    reaches, n.(p - c) - h_box(n) - h_ellipse(n), and the gap is the largest of this over all n.
    Where they don't overlap it is reached across the box's edge, or along the normal of the
    ellipse at its point nearest to a corner: those directions are tried. As none gives more than
    the gap, an error of the nearest point makes the gap too small, never too large.

    Args:
        poses: (N, 3) of the box in odom [m, m, rad].
        box: The robot.
        centers: (N, 2) of the ellipses in odom [m].
        semi_axes: (N, 2) [m].
        angles: (N,) of their first axes in odom [rad].

    Returns:
        (N,) [m]: exact to round-off where above zero; zero or less where the two touch or overlap.
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
    """Normal of an ellipse, along its axes, at its point nearest to a point outside of it.

    That point is (a^2 x / (t + a^2), b^2 y / (t + b^2)) with the t >= 0 that puts it on the
    ellipse. What is left of the ellipse's equation is convex and falls with t: Newton's steps
    from a t too small never pass it. A point inside gets a normal of no use, which is allowed.
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
    """Gap between box and wall, both filled, for N pairs.

    Of two boxes apart, the nearest points include a corner of one of them.

    Args:
        poses: (N, 3) of the box in odom [m, m, rad].
        box: The robot.
        walls: (N, 5) x, y, heading, length, width [m, m, rad, m, m].

    Returns:
        (N,) [m]: exact where above zero, elsewhere less the depth of the overlap.
    """
    mine = np.tile(box.half, (len(poses), 1))
    theirs = 0.5 * walls[:, 3:]
    one, corners_one = _corners_seen(poses, mine, walls[:, :3], theirs)
    two, corners_two = _corners_seen(walls[:, :3], theirs, poses, mine)
    depth = np.maximum(one, two)
    return np.where(depth > 0.0, np.minimum(corners_one, corners_two), depth)


def _corners_seen(boxes: Array, half: Array, frames: Array, other: Array) -> tuple[Array, Array]:
    """See boxes from others: how far they are apart along the others' axes, and their corners."""
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
    beyond = np.hypot(np.maximum(np.abs(px) - other[:, :1], 0.0),
                      np.maximum(np.abs(py) - other[:, 1:], 0.0))  # fmt: skip
    return np.maximum(along, across), beyond.min(axis=1)


def outside(poses: Array, box: Box, area: Area) -> Array:
    """By how far (K,) the box at poses (K, 3) leaves an area [m]; negative: the room left."""
    c, s = np.abs(np.cos(poses[:, 2])), np.abs(np.sin(poses[:, 2]))
    along, across = box.half
    reach = np.stack((along * c + across * s, along * s + across * c), axis=1)
    low, high = np.array(area[:2]), np.array(area[2:])
    result: Array = (np.maximum(low - poses[:, :2], poses[:, :2] - high) + reach).max(axis=1)
    return result


# ---- gaps over a drive --------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """What a drive came to.

    Attributes:
        gap: Least gap [m]; the truth is no more than `TOUCH` smaller. Zero or less: overlap. inf
            if there is nothing to touch.
        gap_time: When [s]; NaN if there is nothing.
        contact: When the robot was first nearer than `TOUCH` to something [s]; inf if never, and
            then it touched nothing at any time.
        touched: What it touched first: "obstacle" or "wall" and which; None if nothing.
        outside: How far the robot left the area at most [m]; negative: the room left; -inf
            without an area. At the samples: between them corners leave by 0.01 mm more at most.
    """

    gap: float
    gap_time: float
    contact: float
    touched: tuple[str, int] | None
    outside: float

    @property
    def collided(self) -> bool:
        """Whether it touched anything."""
        return self.touched is not None


def judge(times: Array, poses: Array, box: Box, world: World) -> Verdict:
    """Judge a drive, between its samples too.

    Args:
        times: (K,) [s], increasing, one or more.
        poses: (K, 3) true poses in odom [m, m, rad]; headings may be wrapped.
        box: The robot.
        world: What it may have touched.

    Raises:
        InputError: A shape is wrong, a value is not finite or the times don't increase.
    """
    times, poses = np.asarray(times, dtype=float), np.array(poses, dtype=float)
    if times.ndim != 1 or len(times) == 0 or poses.shape != (len(times), 3):
        raise InputError(f"poses (K, 3) at times (K,) are needed, got {poses.shape} at "
                         f"{times.shape}")  # fmt: skip
    if not (np.isfinite(times).all() and np.isfinite(poses).all()):
        raise InputError("a true pose or its time is not finite")
    if not (np.diff(times) > 0.0).all():
        raise InputError(f"times must increase, the least step is {np.diff(times).min()} s")
    poses[:, 2] = np.unwrap(poses[:, 2])
    left = -math.inf if world.area is None else float(outside(poses, box, world.area).max())
    bodies = _Bodies(world, box)
    if bodies.count == 0:
        return Verdict(math.inf, math.nan, math.inf, None, left)
    return _Drive(times, poses, bodies).verdict(left)


class _Bodies:
    """All bodies of a world, obstacles before walls, in arrays."""

    def __init__(self, world: World, box: Box) -> None:
        self.box = box
        self.obstacles = world.obstacles
        self.count = len(world.obstacles) + len(world.walls)
        self.axes = np.array([o.semi_axes for o in world.obstacles]).reshape(-1, 2)
        self.angles = np.array([o.angle for o in world.obstacles])
        self.walls = np.array([(w.x, w.y, w.heading, w.length, w.width) for w in world.walls])
        self.speeds = np.zeros(self.count)
        self.speeds[: len(self.obstacles)] = [o.place.speed for o in world.obstacles]

    def gaps(self, times: Array, poses: Array, which: Index) -> Array:
        """Gaps (N,) to the bodies (N,) at times (N,) and poses (N, 3) [m]."""
        result = np.empty(len(times))
        moving = len(self.obstacles)
        centers = np.zeros((len(times), 2))
        for k, obstacle in enumerate(self.obstacles):
            rows = np.flatnonzero(which == k)
            centers[rows] = obstacle.place.at(times[rows])
        rows, kind = np.flatnonzero(which < moving), which[which < moving]
        if len(rows):
            result[rows] = ellipse_gap(
                poses[rows], self.box, centers[rows], self.axes[kind], self.angles[kind]
            )
        rows, kind = np.flatnonzero(which >= moving), which[which >= moving] - moving
        if len(rows):
            result[rows] = wall_gap(poses[rows], self.box, self.walls[kind])
        return result

    def name(self, which: int) -> tuple[str, int]:
        """Kind and number of a body."""
        moving = len(self.obstacles)
        return ("obstacle", which) if which < moving else ("wall", which - moving)


@dataclass(frozen=True)
class _Intervals:
    """N intervals of time, each with one body."""

    starts: Array
    ends: Array
    before: Array
    after: Array
    which: Index
    first: Array
    last: Array
    travel: Array

    @property
    def lower(self) -> Array:
        """Lower bounds of the gaps (N,) on the whole intervals [m]."""
        result: Array = 0.5 * (self.first + self.last - self.travel)
        return result

    def only(self, keep: NDArray[np.bool_]) -> "_Intervals":
        return _Intervals(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    def halves(self, bodies: _Bodies) -> "_Intervals":
        """Both halves of each, the first ones first."""
        middle, pose = 0.5 * (self.starts + self.ends), 0.5 * (self.before + self.after)
        gap, travel = bodies.gaps(middle, pose, self.which), 0.5 * self.travel
        one = (self.starts, middle, self.before, pose, self.which, self.first, gap, travel)
        two = (middle, self.ends, pose, self.after, self.which, gap, self.last, travel)
        return _Intervals(*(np.concatenate(pair) for pair in zip(one, two, strict=True)))


class _Drive:
    """A drive among bodies, of which there is one at least."""

    def __init__(self, times: Array, poses: Array, bodies: _Bodies) -> None:
        self.bodies = bodies
        count = bodies.count
        which = np.tile(np.arange(count), len(times))
        at, there = np.repeat(times, count), np.repeat(poses, count, axis=0)
        self.gaps = bodies.gaps(at, there, which)
        self.times, self.which = at, which
        step = np.abs(np.diff(poses, axis=0))
        own = np.hypot(step[:, 0], step[:, 1]) + bodies.box.radius * step[:, 2]
        travel = own[:, None] + np.diff(times)[:, None] * bodies.speeds
        last = slice(count, None)
        first = slice(None, len(at) - count)
        self.intervals = _Intervals(
            at[first], at[last], there[first], there[last], which[first],
            self.gaps[first], self.gaps[last], travel.ravel(),
        )  # fmt: skip

    def verdict(self, left: float) -> Verdict:
        """Search the least gap, then the first contact if there is one."""
        best = int(self.gaps.argmin())
        gap, when, which = float(self.gaps[best]), float(self.times[best]), int(self.which[best])
        open_ = self.intervals
        for _ in range(HALVINGS):
            open_ = open_.only(open_.lower < gap - TOUCH)
            if not len(open_.starts):
                break
            open_ = open_.halves(self.bodies)
            least = int(open_.last.argmin())
            if open_.last[least] < gap:
                gap, when = float(open_.last[least]), float(open_.ends[least])
                which = int(open_.which[least])
        if gap > TOUCH:
            return Verdict(gap, when, math.inf, None, left)
        contact, touched = self._first(when, which)
        return Verdict(gap, when, contact, self.bodies.name(touched), left)

    def _first(self, contact: float, touched: int) -> tuple[float, int]:
        """First time at which a gap is below `TOUCH`, and whose, given one that is."""
        near = np.flatnonzero(self.gaps <= TOUCH)
        if len(near) and self.times[near[0]] < contact:
            contact, touched = float(self.times[near[0]]), int(self.which[near[0]])
        open_ = self.intervals
        for _ in range(HALVINGS):
            open_ = open_.only((open_.starts < contact) & (open_.lower <= 0.0))
            if not len(open_.starts):
                break
            open_ = open_.halves(self.bodies)
            near = np.flatnonzero(open_.last <= TOUCH)
            if len(near):
                first = near[open_.ends[near].argmin()]
                if open_.ends[first] < contact:
                    contact, touched = float(open_.ends[first]), int(open_.which[first])
        return contact, touched
