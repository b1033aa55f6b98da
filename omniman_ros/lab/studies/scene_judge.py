"""Decide whether a rectangular robot truly touched an obstacle or a wall during a drive.

The judge shares no code with the planner that it judges. The robot is a box whose true poses are
known at samples. Between two samples, its centre is assumed to move on a straight line and its
heading to turn at a constant rate; with samples every 5 ms, a robot that accelerates at 6 m/s^2
deviates from this line by 0.02 mm, which the judge neglects. Obstacles are ellipses that move
along known polylines; walls are boxes at rest.

The gap at one time is exact, as `ellipse_gap` and `wall_gap` explain. Between two times the gap
changes by no more than the two bodies travel relative to each other. Time intervals for which this
bound does not decide whether the bodies touch are halved until it does.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_gaps import ellipse_gap, outside, wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, World

Index = NDArray[np.intp]  # indices of bodies, obstacles before walls
CONTACT_GAP = 1e-4
"""Gap below which the robot counts as touching, and the accuracy of the smallest gap [m]."""
MAX_HALVINGS = 60
"""Largest number of times that an interval is halved; its travel is below 0.1 nm long before."""


@dataclass(frozen=True)
class Verdict:
    """The judge's verdict on a drive.

    Attributes:
        gap: Smallest gap [m]; the true one is smaller by no more than `CONTACT_GAP`. It is zero or
            less if the robot overlapped with a body, and inf if there is nothing to touch.
        contact: Time at which the robot was first nearer than `CONTACT_GAP` to a body [s]; inf if
            it never was.
        touched: Kind of the body that the robot touched first, "obstacle" or "wall", and its index
            in the world; None if the robot touched nothing.
        outside: Largest distance by which the robot left the area [m]; a negative value is the
            room that was left, -inf means that there is no area. It is taken at the samples:
            between them, corners leave the area by at most 0.01 mm more.
    """

    gap: float
    gap_time: float  # time of the smallest gap [s]; NaN if there is nothing to touch
    contact: float
    touched: tuple[str, int] | None
    outside: float

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything."""
        return self.touched is not None


def judge(times: Array, poses: Array, box: Box, world: World) -> Verdict:
    """Judge a drive, at its samples and between them.

    Args:
        times: (K,) increasing times [s], at least one.
        poses: (K, 3) true poses in odom [m, m, rad]; headings may be wrapped.
    """
    times, poses = np.asarray(times, dtype=float), np.array(poses, dtype=float)
    if times.ndim != 1 or len(times) == 0 or poses.shape != (len(times), 3):
        raise InputError(
            f"a drive needs poses (K, 3) at times (K,), got {poses.shape} at {times.shape}"
        )
    if not (np.isfinite(times).all() and np.isfinite(poses).all()):
        raise InputError("a pose of the drive, or its time, is not finite")
    if not (np.diff(times) > 0.0).all():
        raise InputError(f"times must increase, the smallest step is {np.diff(times).min()} s")
    poses[:, 2] = np.unwrap(poses[:, 2])
    outside_by = -math.inf if world.area is None else float(outside(poses, box, world.area).max())
    bodies = _Bodies(world, box)
    if bodies.count == 0:
        return Verdict(math.inf, math.nan, math.inf, None, outside_by)
    return _Drive(times, poses, bodies).verdict(outside_by)


class _Bodies:
    """The bodies of a world as arrays, obstacles before walls, and the robot's gaps to them."""

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
        """Return the gaps (N,) of N pairs of the robot and a body [m].

        Args:
            times: (N,) times [s].
            poses: (N, 3) poses of the robot in odom [m, m, rad].
            which: (N,) indices of the bodies.
        """
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
        """Return the kind of a body, "obstacle" or "wall", and its index in the world."""
        moving = len(self.obstacles)
        return ("obstacle", which) if which < moving else ("wall", which - moving)


@dataclass(frozen=True)
class _Intervals:
    """N time intervals, each paired with one body."""

    starts: Array  # (N,) times at which the intervals begin [s]
    ends: Array  # (N,) times at which the intervals end [s]
    start_poses: Array  # (N, 3) poses of the robot at the beginning [m, m, rad]
    end_poses: Array  # (N, 3) poses of the robot at the end [m, m, rad]
    which: Index  # (N,) indices of the bodies
    start_gaps: Array  # (N,) gaps at the beginning [m]
    end_gaps: Array  # (N,) gaps at the end [m]
    travel: Array  # (N,) upper bounds of the relative travel of robot and body in between [m]

    @property
    def lower(self) -> Array:
        """Lower bounds (N,) of the gaps within the intervals [m]."""
        result: Array = 0.5 * (self.start_gaps + self.end_gaps - self.travel)
        return result

    def select(self, keep: NDArray[np.bool_]) -> "_Intervals":
        """Return the intervals for which `keep` (N,) is true."""
        return _Intervals(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))

    def halves(self, bodies: _Bodies) -> "_Intervals":
        """Return both halves of each interval, all first halves before all second halves."""
        middle = 0.5 * (self.starts + self.ends)
        pose = 0.5 * (self.start_poses + self.end_poses)
        gap, travel = bodies.gaps(middle, pose, self.which), 0.5 * self.travel
        first = (
            self.starts,
            middle,
            self.start_poses,
            pose,
            self.which,
            self.start_gaps,
            gap,
            travel,
        )
        second = (middle, self.ends, pose, self.end_poses, self.which, gap, self.end_gaps, travel)
        return _Intervals(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


class _Drive:
    """The search for the smallest gap and the first contact of a drive among bodies.

    Args:
        times: (K,) increasing times [s].
        poses: (K, 3) poses of the robot in odom, headings not wrapped [m, m, rad].
    """

    def __init__(self, times: Array, poses: Array, bodies: _Bodies) -> None:
        self.bodies = bodies
        count = bodies.count
        which = np.tile(np.arange(count), len(times))
        at, robot = np.repeat(times, count), np.repeat(poses, count, axis=0)
        self.gaps = bodies.gaps(at, robot, which)
        self.times, self.which = at, which
        step = np.abs(np.diff(poses, axis=0))
        own = np.hypot(step[:, 0], step[:, 1]) + bodies.box.radius * step[:, 2]
        travel = own[:, None] + np.diff(times)[:, None] * bodies.speeds
        last = slice(count, None)
        first = slice(None, len(at) - count)
        self.intervals = _Intervals(
            at[first],
            at[last],
            robot[first],
            robot[last],
            which[first],
            self.gaps[first],
            self.gaps[last],
            travel.ravel(),
        )

    def verdict(self, outside_by: float) -> Verdict:
        """Return the verdict: the smallest gap, then the first contact if there is one."""
        best = int(self.gaps.argmin())
        gap, when, which = float(self.gaps[best]), float(self.times[best]), int(self.which[best])
        undecided = self.intervals
        for _ in range(MAX_HALVINGS):
            undecided = undecided.select(undecided.lower < gap - CONTACT_GAP)
            if not len(undecided.starts):
                break
            undecided = undecided.halves(self.bodies)
            least = int(undecided.end_gaps.argmin())
            if undecided.end_gaps[least] < gap:
                gap, when = float(undecided.end_gaps[least]), float(undecided.ends[least])
                which = int(undecided.which[least])
        if gap > CONTACT_GAP:
            return Verdict(gap, when, math.inf, None, outside_by)
        contact, touched = self._first_contact(when, which)
        return Verdict(gap, when, contact, self.bodies.name(touched), outside_by)

    def _first_contact(self, contact: float, touched: int) -> tuple[float, int]:
        """Return the time at which a gap is below `CONTACT_GAP`, and the index of the body."""
        near = np.flatnonzero(self.gaps <= CONTACT_GAP)
        if len(near) and self.times[near[0]] < contact:
            contact, touched = float(self.times[near[0]]), int(self.which[near[0]])
        undecided = self.intervals
        for _ in range(MAX_HALVINGS):
            undecided = undecided.select((undecided.starts < contact) & (undecided.lower <= 0.0))
            if not len(undecided.starts):
                break
            undecided = undecided.halves(self.bodies)
            near = np.flatnonzero(undecided.end_gaps <= CONTACT_GAP)
            if len(near):
                first = near[undecided.ends[near].argmin()]
                if undecided.ends[first] < contact:
                    contact, touched = float(undecided.ends[first]), int(undecided.which[first])
        return contact, touched
