"""Judge of tracked people, by their true discs and the beams that meet them."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from omniman_ros.core.arrays import Array

if TYPE_CHECKING:  # the command line must do without scipy
    from omniman_ros.perception.track import TrackedObstacle

LEAST_BEAMS = 3  #: number of beams that must meet somebody who is seen
TOLERANCE = 0.06  #: distance of a beam's end from a disc up to which the beam has met it [m]
SETTLING = 0.5  #: time after the first sight from which the velocity counts [s]
UNSEEN = 3.0  #: time without being seen after which somebody is seen for the first time again [s]
MATCH = 0.5  #: distance of a reported centre from the true one up to which they are the same [m]
WALKING = 0.3  #: speed from which somebody walks [m/s]
FALSE_SPEED = 0.2  #: speed from which something that stands is reported as moving [m/s]
FALSE_TIME = 0.5  #: time for which it must be, to count [s]
BEFORE, AFTER = 0.3, 0.5  #: times before and after a crossing at which identities are compared [s]


#: A scan: the scanner's place (2,) [m], directions (N,) [rad] and ranges (N,) of the beams [m]
Beams = tuple[Array, Array, Array]


@dataclass
class TrackingJudge:
    """Compares what is reported with the truth, scan by scan."""

    statics: int  #: number of things that stand
    errors: list[float] = field(default_factory=list)  #: of velocity, seen for long enough [m/s]
    walking_errors: list[float] = field(default_factory=list)  #: those of them who walked
    missed: int = 0  #: number of scans and persons for which a walking person was not reported
    false_movers: set[int] = field(default_factory=set)  #: identities of what stands
    crossings: int = 0  #: number of crossings, once for each of the two who cross
    kept: int = 0  #: number of them after which the identity was the same
    _first: dict[int, float] = field(default_factory=dict)
    _last: dict[int, float] = field(default_factory=dict)
    _false_since: dict[int, float] = field(default_factory=dict)
    _numbers: dict[int, list[tuple[float, int]]] = field(default_factory=lambda: defaultdict(list))
    _seen: dict[int, list[float]] = field(default_factory=lambda: defaultdict(list))
    _overlaps: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    _ended: list[tuple[int, int, float, float]] = field(default_factory=list)

    def judge(
        self,
        now: float,
        scan: Beams,
        people: Array,
        radius: float,
        obstacles: Sequence["TrackedObstacle"],
    ) -> None:
        """Judge what is reported of people (P, 4), true positions and velocities [m, m/s]."""
        beams = visible_beams(scan, people[:, :2], radius)
        centers = np.array([thing.center for thing in obstacles]).reshape(-1, 2)
        velocities = np.array([thing.velocity for thing in obstacles]).reshape(-1, 2)
        off = np.hypot(*(people[:, None, :2] - centers[None]).transpose(2, 0, 1))
        for k in range(len(people)):
            if beams[k] < LEAST_BEAMS:
                continue
            self._seen[k].append(now)
            if now - self._last.get(k, -math.inf) > UNSEEN:
                self._first[k] = now
            self._last[k] = now
            nearest = int(off[k].argmin()) if len(centers) else -1
            is_matched = nearest >= 0 and off[k, nearest] < MATCH
            if is_matched:
                self._numbers[k].append((now, obstacles[nearest].number))
            walks = math.hypot(*people[k, 2:]) > WALKING
            if now - self._first[k] < SETTLING - 1e-9:
                continue
            if is_matched:
                error = float(np.hypot(*(velocities[nearest] - people[k, 2:])))
                self.errors.append(error)
                if walks:
                    self.walking_errors.append(error)
            elif walks:
                self.missed += 1
        self._judge_false(now, obstacles, off)
        self._note_crossings(now, scan[0], people[:, :2], radius)

    def _judge_false(self, now: float, obstacles: Sequence["TrackedObstacle"], off: Array) -> None:
        """Note what is seen as moving where nobody is; who is hidden is nowhere for sure."""
        moving = set()
        for k, thing in enumerate(obstacles):
            is_nobody = not len(off) or off[:, k].min() > 2.0 * MATCH
            if is_nobody and not thing.silence and math.hypot(*thing.velocity) > FALSE_SPEED:
                moving.add(thing.number)
                if now - self._false_since.setdefault(thing.number, now) > FALSE_TIME:
                    self.false_movers.add(thing.number)
        self._false_since = {k: t for k, t in self._false_since.items() if k in moving}

    def _note_crossings(self, now: float, origin: Array, places: Array, radius: float) -> None:
        """Note who is in front of whom."""
        away = places - origin
        distance = np.hypot(away[:, 0], away[:, 1])
        bearing = np.arctan2(away[:, 1], away[:, 0])
        half = np.arcsin(np.minimum(radius / distance, 1.0))
        for i in range(len(places)):
            for j in range(i):
                apart = abs(math.remainder(bearing[i] - bearing[j], math.tau))
                pair = (j, i)
                if apart < half[i] + half[j]:
                    begin, _ = self._overlaps.get(pair, (now, now))
                    self._overlaps[pair] = (begin, now)
                elif pair in self._overlaps:
                    begin, end = self._overlaps.pop(pair)
                    self._ended.append((j, i, begin, end))

    def finish(self) -> None:
        """Judge the identities before and after each crossing.

        It counts for whoever of the two was seen and reported before it and is seen after it.
        """
        for first, second, begin, end in self._ended:
            for k in (first, second):
                numbers = self._numbers[k]
                before = [n for t, n in numbers if begin - BEFORE <= t <= begin]
                seen = [t for t in self._seen[k] if end + 0.5 * AFTER <= t <= end + AFTER]
                if not before or not seen:
                    continue
                after = [n for t, n in numbers if end + 0.5 * AFTER <= t <= end + AFTER]
                self.crossings += 1
                self.kept += bool(after) and after[-1] == before[-1]


def visible_beams(scan: Beams, places: Array, radius: float) -> Array:
    """Return the number of beams (P,) that meet each of the discs at places (P, 2) [m]."""
    origin, directions, ranges = scan
    away = places[:, None, :] - origin
    ux, uy = np.cos(directions), np.sin(directions)
    along = away[..., 0] * ux + away[..., 1] * uy
    aside = away[..., 0] * uy - away[..., 1] * ux
    chord = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    with np.errstate(invalid="ignore"):
        meets = (np.abs(aside) < radius) & (np.abs(along - chord - ranges) < TOLERANCE)
    counts: Array = meets.sum(axis=1).astype(np.float64)
    return counts
