"""What the viewer knows of a robot: the last of everything, trails and windows of bounded size."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pose = tuple[float, float, float]
"""x, y [m], heading [rad] in `odom`."""

SPAN = 15.0
"""Length of the plots [s]."""
SAMPLING = 20.0
"""Samples of the plots [Hz]."""
SPACING = 0.02
"""Shortest distance between two points of a trail [m]."""
TRAIL_POINTS = 1500
"""Longest trail: 30 m at the shortest distance."""
JUMP = 0.5
"""A trail is broken where it jumps further than this, as when odometry is set [m]."""
LINE_POINTS = 1000
"""Points of a path that are drawn; of a longer one, every second, third, ..."""
CORNERS = 24
"""Of an obstacle's outline."""
FORGET = 3.0
"""Silence after which what a node complained of is no longer shown [s]."""
SILENCE = 1.0
"""Age at which a pose is no longer taken for the present one [s]."""


class Trail:
    """Where something has been.

    Attributes:
        version: Changes with the points.
    """

    def __init__(self, spacing: float = SPACING, limit: int = TRAIL_POINTS) -> None:
        self._spacing = spacing
        self._limit = limit
        self._points = np.empty((2 * limit, 2))
        self._end = 0
        self.version = 0

    def add(self, x: float, y: float) -> None:
        """Add a position [m], if it is far enough from the last."""
        if self._end:
            last = self._points[self._end - 1]
            if np.hypot(x - last[0], y - last[1]) < self._spacing:
                return
        if self._end == len(self._points):
            self._points[: self._limit] = self._points[self._limit :]
            self._end = self._limit
        self._points[self._end] = x, y
        self._end += 1
        self.version += 1

    def clear(self) -> None:
        """Forget it."""
        self._end = 0
        self.version += 1

    @property
    def points(self) -> Array:
        """Positions (k, 2) [m], the oldest first."""
        return self._points[max(self._end - self._limit, 0) : self._end]


def segments(points: Array, jump: float = np.inf) -> Array:
    """Pieces (k - 1, 2, 2) between neighbours of a line (k, 2), without those that are longer."""
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    near: Array = pieces[np.hypot(*(pieces[:, 1] - pieces[:, 0]).T) <= jump]
    return near


def outlines(centers: Array, semi_axes: Array, angles: Array) -> Array:
    """Points (k, 2) around M ellipses: (M, 2) [m], (M, 2) [m], (M,) [rad]; NaN between two."""
    turn = np.append(np.linspace(0.0, 2.0 * np.pi, CORNERS + 1), np.nan)
    x = semi_axes[:, :1] * np.cos(turn)
    y = semi_axes[:, 1:] * np.sin(turn)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    around = np.stack([c * x - s * y, s * x + c * y], axis=2) + centers[:, None, :]
    flat: Array = around.reshape(-1, 2)
    return flat


def thinned(count: int, limit: int = LINE_POINTS) -> Iterable[int]:
    """Indices of at most `limit` of `count` points, evenly, the first and the last among them."""
    if count <= limit:
        return range(count)
    return map(int, np.linspace(0, count - 1, limit).round())


class Window:
    """The last seconds of some signals, sampled at an even rate.

    Args:
        signals: How many, n.
        span: How long [s].
        rate: How many samples a second; a value that comes sooner replaces the last.
    """

    def __init__(self, signals: int, span: float = SPAN, rate: float = SAMPLING) -> None:
        self._span = span
        # Half a sample is left to jitter of who samples at this very rate.
        self._shortest = 0.5 / rate
        self._times = np.full(round(span * rate), -np.inf)
        self._values = np.full((len(self._times), signals), np.nan)

    def sample(self, now: float, values: Array) -> None:
        """Add values (n,) at a time [s]; NaN for what is not known."""
        if now - self._times[-1] >= self._shortest:
            self._times[:-1] = self._times[1:]
            self._values[:-1] = self._values[1:]
            self._times[-1] = now
        self._values[-1] = values

    def columns(self, now: float) -> tuple[Array, ...]:
        """Times (k,) before now [s, negative], then each signal (k,)."""
        first = int(np.searchsorted(self._times, now - self._span))
        return (self._times[first:] - now, *self._values[first:].T)


@dataclass(frozen=True)
class Condition:
    """What a node says of itself.

    Attributes:
        level: 0 good, 1 warning, 2 error.
        text: In words.
        heard: When [s].
    """

    level: int
    text: str
    heard: float = 0.0


@dataclass
class Line:
    """A line on the floor: points (k, 2) [m]; `version` changes with them."""

    points: Array = field(default_factory=lambda: np.empty((0, 2)))
    version: int = 0

    def set(self, points: Array) -> None:
        """Replace the points."""
        self.points = points
        self.version += 1


class Picture:
    """All that is shown.

    Args:
        wheels: Number of wheels n.
        constraints: Number of coupling errors m.

    Attributes:
        odom, truth: Poses, None until heard.
        odom_trail, truth_trail: Where they have been.
        path, reference, plan, obstacles: Lines.
        wheel_angles: (n,) measured [rad].
        wheel_speeds: Window of n measured and n commanded speeds [rad/s].
        coupling: Window of m errors [rad].
        active_source: Who drives, empty if not heard.
        progress: Of the path, 0 to 1; it counts while it is fresh.
        stops: Node name to its stop state.
        complaints: Node name to what it warns of in its diagnostics.
        services: Names of the services that can be called.
        note: What the last button did.
    """

    def __init__(self, wheels: int, constraints: int) -> None:
        self.odom: Pose | None = None
        self.truth: Pose | None = None
        self.odom_trail, self.truth_trail = Trail(), Trail()
        self.path, self.reference = Line(), Line()
        self.plan, self.obstacles = Line(), Line()
        self.wheel_angles = np.zeros(wheels)
        self.wheel_speeds = Window(2 * wheels)
        self.coupling = Window(constraints)
        self.active_source = ""
        self.progress = 0.0
        self.stops: dict[str, Condition] = {}
        self.complaints: dict[str, Condition] = {}
        self.services: frozenset[str] = frozenset()
        self.note = ""
        self._measured = np.full(wheels, np.nan)
        self._commanded = np.full(wheels, np.nan)
        self._errors = np.full(constraints, np.nan)
        self._heard: dict[str, float] = {}

    def hear_odom(self, pose: Pose, now: float) -> None:
        """Take in a pose of odometry."""
        self.odom = pose
        self.odom_trail.add(*pose[:2])
        self._heard["odom"] = now

    def hear_truth(self, pose: Pose, now: float) -> None:
        """Take in a pose of the simulation."""
        self.truth = pose
        self.truth_trail.add(*pose[:2])
        self._heard["truth"] = now

    def hear_wheels(self, angles: Array | None, speeds: Array | None, now: float) -> None:
        """Take in measured angles (n,) [rad] and speeds (n,) [rad/s]."""
        if angles is not None:
            self.wheel_angles = angles
        if speeds is not None:
            self._measured = speeds
            self._heard["measured"] = now

    def hear_commands(self, speeds: Array | None, now: float) -> None:
        """Take in commanded speeds (n,) [rad/s], None in torque and voltage mode."""
        self._commanded = np.full_like(self._commanded, np.nan) if speeds is None else speeds
        self._heard["commanded"] = now

    def hear_coupling(self, errors: Array, now: float) -> None:
        """Take in coupling errors [rad]; as many as constraints are shown."""
        shown = min(len(errors), len(self._errors))
        self._errors[:shown] = errors[:shown]
        self._heard["coupling"] = now

    def hear_reference(self, points: Array, now: float) -> None:
        """Take in what comes next of a path, points (k, 2) [m]."""
        self.reference.set(points)
        self._heard["reference"] = now

    def hear_plan(self, points: Array, now: float) -> None:
        """Take in the planned motion, points (k, 2) [m]."""
        self.plan.set(points)
        self._heard["plan"] = now

    def hear_progress(self, progress: float, now: float) -> None:
        """Take in how much of the path is driven, 0 to 1."""
        self.progress = progress
        self._heard["progress"] = now

    def hear_complaint(self, name: str, level: int, text: str, now: float) -> None:
        """Take in a node's diagnostics; good news clears what it complained of."""
        if level == 0:
            self.complaints.pop(name, None)
        else:
            self.complaints[name] = Condition(level, text, now)

    def sample(self, now: float) -> None:
        """Add what is known now to the plots, and forget what is not repeated."""
        unknown = np.full_like(self._measured, np.nan)
        measured = self._measured if self.is_fresh("measured", now) else unknown
        commanded = self._commanded if self.is_fresh("commanded", now) else unknown
        self.wheel_speeds.sample(now, np.concatenate([measured, commanded]))
        fresh = self.is_fresh("coupling", now)
        self.coupling.sample(now, self._errors if fresh else np.full_like(self._errors, np.nan))
        for line, name in ((self.reference, "reference"), (self.plan, "plan")):
            if len(line.points) and not self.is_fresh(name, now):
                line.set(line.points[:0])
        self.complaints = {
            name: condition
            for name, condition in self.complaints.items()
            if now - condition.heard < FORGET
        }

    def is_fresh(self, what: str, now: float) -> bool:
        """Whether it was heard in the last second: odom, truth, progress, ..."""
        return now - self._heard.get(what, -np.inf) < SILENCE

    def keep_stops(self, there: Iterable[str]) -> None:
        """Mark the nodes that are no longer there."""
        there = set(there)
        for name, condition in self.stops.items():
            if name not in there and condition.text != "gone":
                self.stops[name] = Condition(2, "gone")
