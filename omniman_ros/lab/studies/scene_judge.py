"""Judge whether a rectangular robot truly touched what was around it during a drive.

The judge shares no code with the planner that it judges. The robot is a box whose true poses are
known at samples; between two samples its centre moves on a straight line and its heading turns at
a constant rate. At 5 ms, a robot that accelerates at 6 m/s^2 leaves this line by 0.02 mm, which
the judge does not see. Obstacles are ellipses that move along known polylines; walls are boxes
that stand still.

The gap at one time is exact, as shown at `ellipse_gap` and `wall_gap`. Between two times the gap
changes by no more than the two bodies travel relative to each other. An interval in which that
leaves open whether they touch is halved until it does not.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_gaps import ellipse_gap, outside, wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, World

Index = NDArray[np.intp]
TOUCH = 1e-4
"""Gap below which the robot counts as touching, and the accuracy of the smallest gap [m]."""
HALVINGS = 60
"""Most times that an interval is halved; its travel is below a tenth of a nanometre before."""


@dataclass(frozen=True)
class Verdict:
    """The judge's verdict on a drive.

    Attributes:
        gap: Smallest gap [m]; the true one is smaller by no more than `TOUCH`. Zero or less: the
            robot overlapped with something. inf: there is nothing to touch.
        gap_time: Time of the least gap [s]; NaN if there is nothing to touch.
        contact: Time at which the robot was first nearer than `TOUCH` to something [s]; inf if it
            touched nothing at any time.
        touched: What the robot touched first: "obstacle" or "wall", and its index; None if
            nothing.
        outside: Largest distance by which the robot left the area [m]; negative: the room left;
            -inf: there is no area. It is taken at the samples: between them, corners leave the
            area by 0.01 mm more at most.
    """

    gap: float
    gap_time: float
    contact: float
    touched: tuple[str, int] | None
    outside: float

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything."""
        return self.touched is not None


def judge(times: Array, poses: Array, box: Box, world: World) -> Verdict:
    """Judge a drive, between its samples too.

    Args:
        times: (K,) times [s], increasing, one or more.
        poses: (K, 3) true poses in odom [m, m, rad]; headings may be wrapped.
        box: The robot's outline.
        world: What the robot may have touched.

    Raises:
        InputError: A shape is wrong, a value is not finite, or the times do not increase.
    """
    times, poses = np.asarray(times, dtype=float), np.array(poses, dtype=float)
    if times.ndim != 1 or len(times) == 0 or poses.shape != (len(times), 3):
        raise InputError(
            f"poses (K, 3) at times (K,) are needed, got {poses.shape} at {times.shape}"
        )
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
    """The bodies of a world as arrays, obstacles before walls."""

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
        """Return the gaps (N,) to the bodies (N,) at times (N,) and poses (N, 3) [m]."""
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
        """Return kind and index of a body."""
        moving = len(self.obstacles)
        return ("obstacle", which) if which < moving else ("wall", which - moving)


@dataclass(frozen=True)
class _Intervals:
    """N intervals of time, each of one body: the ends, the gaps there, and the travel between."""

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
        """Lower bounds (N,) of the gaps within the intervals [m]."""
        result: Array = 0.5 * (self.first + self.last - self.travel)
        return result

    def only(self, keep: NDArray[np.bool_]) -> "_Intervals":
        return _Intervals(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    def halves(self, bodies: _Bodies) -> "_Intervals":
        """Return both halves of each interval, all first halves before the second ones."""
        middle, pose = 0.5 * (self.starts + self.ends), 0.5 * (self.before + self.after)
        gap, travel = bodies.gaps(middle, pose, self.which), 0.5 * self.travel
        first = (self.starts, middle, self.before, pose, self.which, self.first, gap, travel)
        second = (middle, self.ends, pose, self.after, self.which, gap, self.last, travel)
        return _Intervals(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


class _Drive:
    """A drive among bodies, of which there is at least one."""

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
            at[first],
            at[last],
            there[first],
            there[last],
            which[first],
            self.gaps[first],
            self.gaps[last],
            travel.ravel(),
        )

    def verdict(self, left: float) -> Verdict:
        """Find the smallest gap, then the first contact if there is one.

        Args:
            left: Largest distance by which the robot left the area [m].
        """
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
        """Return the first time at which a gap is below `TOUCH`, and the index of the body.

        Args:
            contact: A time at which a gap is below `TOUCH` [s].
            touched: Index of the body of that gap.
        """
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
