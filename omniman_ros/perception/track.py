"""One thing that is followed from scan to scan."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.perception.parameters import TrackerParameters
from omniman_ros.surroundings.tracking import ObstacleTrack, TrackingParameters

MOST_MISSES = 3  #: Number of scans in a row that look through a thing after which it is gone
#: Number of scans that must show a thing where nothing was, before it counts as moving
EVIDENCE = 3
SIGNIFICANT = 3.0  #: Ratio of a speed to its standard deviation from which something may be moving
AT_REST = 0.1  #: Speed up to which something that moved is at rest [m/s]
WALKING = 0.3  #: Speed from which something moves right now [m/s]
#: Number of scans in a row as a part of something wide after which a thing belongs to it
MOST_LIKE_STRUCTURE = 10
GATE, STANDING_GATE = 0.25, 0.15
"""Mean distance of points from the outline up to which they may be a track's [m]: of one that
walks, and of one that stands."""
GATE_GROWTH, WIDEST_GATE = 0.8, 1.2
"""Growth of that distance with the time since the track was seen [m/s], and its largest value
[m]."""


@dataclass(frozen=True)
class TrackedObstacle:
    """Something that moves, or that has moved and rests."""

    number: int  #: Its identity
    time: float  #: Time of this state [s]
    center: tuple[float, float]  #: (x, y) in odom [m]
    velocity: tuple[float, float]  #: (x, y) in odom [m/s]
    radius: float  #: Radius [m]
    #: Variances of each component of position [m^2] and velocity [m^2/s^2], and their covariance
    #: [m^2/s] in between.
    covariance: tuple[float, float, float]
    age: float  #: Time since it was first seen [s]
    silence: float  #: Time since it was last seen [s]; above 0 while it is hidden


class Track:
    """A thing by its disc, from the scan on in which it was first seen.

    Times are those of the first scan and of the last one in which it was seen [s].

    Attributes:
        position: (2,) where it is expected now [m].
        is_moving: Whether it moves, or has moved lately.
        is_gone: Whether it is no longer there.
    """

    def __init__(
        self,
        number: int,
        time: float,
        center: Array,
        radius: float,
        front: Array,
        motion: TrackingParameters,
    ) -> None:
        x, y = center.tolist()
        self._filter = ObstacleTrack(motion, time, x, y)
        self.number, self.radius, self.begin, self.seen = number, radius, time, time
        self.birth, self.front = center, front
        self.position = center
        self._position_time = time
        self.is_moving = self.is_gone = False
        self._views = 0
        self._evidence = 0
        self._misses = 0
        self._like_structure = 0
        self._moved = time

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity (x, y) in odom [m/s]."""
        return self._filter.velocity

    @property
    def is_walking(self) -> bool:
        """Whether it moves right now: then it is not where something stands."""
        return self.is_moving and math.hypot(*self._filter.velocity) > WALKING

    def expect(self, time: float) -> Array:
        """Return where it is expected at a time, (2,) [m]."""
        vx, vy = self._filter.velocity
        ahead = min(max(time - self._position_time, 0.0), 1.0)
        return self.position + ahead * np.array((vx, vy))

    def gate(self, time: float) -> float:
        """Return how far points may be from its outline at a time [m]."""
        least = GATE if self.is_walking else STANDING_GATE
        return min(least + GATE_GROWTH * max(time - self.seen, 0.0), WIDEST_GATE)

    def observe(self, time: float, center: Array) -> None:
        """Use a centre (2,) that was seen at a time."""
        x, y = center.tolist()
        self._filter.observe(time, x, y)
        self.seen, self._misses = time, 0
        self._position_time = time
        self.position = np.array(self._filter.position)
        if self._filter.doubted < math.inf:
            self.position = center

    def measure_radius(self, radius: float, is_whole: bool) -> None:
        """Use a radius [m] that was seen; of what is hidden in part it is a lower bound."""
        if is_whole:
            self._views += 1
            self.radius += (radius - self.radius) / min(self._views, 20)
        elif self._views == 0 or radius > 1.3 * self.radius:
            self.radius = max(self.radius, radius)

    def wait(self, time: float, position: Array) -> None:
        """Expect it, which is hidden, at a place (2,) [m]."""
        self.position, self._position_time, self._misses = position, time, 0

    def miss(self) -> bool:
        """Count a scan that looks through it; return whether it is gone."""
        self._misses += 1
        return self._misses >= MOST_MISSES

    def resembles_structure(self, does: bool) -> bool:
        """Note whether it seems to be a part of something wide; return whether it is one."""
        self._like_structure = self._like_structure + 1 if does else 0
        return not self.is_moving and self._like_structure >= MOST_LIKE_STRUCTURE

    def judge(self, time: float, is_new_place: bool, p: TrackerParameters) -> bool:
        """Decide whether it moves at a time [s]; return whether it has just begun to.

        Speed alone is no evidence: the visible part of a wall slides along it behind whatever
        passes. It must be where nothing was, or have left a place that is free now: in a new
        place.
        """
        speed = math.hypot(*self._filter.velocity)
        if self.is_moving:
            if speed > AT_REST:
                self._moved = time
            elif time - self._moved > p.rest_time:
                self.is_moving, self._evidence = False, 0
                self.birth = self.front = self.position
            return False
        self._evidence = min(self._evidence + 1, EVIDENCE) if is_new_place else self._evidence
        way = float(np.hypot(*(self.position - self.birth)))
        deviation = self._filter.velocity_deviation
        is_significant = speed > max(p.least_speed, SIGNIFICANT * deviation)
        if not (is_significant and way > p.least_way and self._evidence >= EVIDENCE):
            return False
        self.is_moving, self._moved = True, time
        return True

    def state(self, time: float) -> TrackedObstacle:
        """Return what is known of it at a time [s]."""
        x, y = self.expect(time).tolist()
        vx, vy = self._filter.velocity
        pp, pv, vv = self._filter.covariance
        silence = max(time - self.seen, 0.0)
        grown = (pp + silence * (2.0 * pv + silence * vv), pv + silence * vv, vv)
        return TrackedObstacle(
            self.number, time, (x, y), (vx, vy), self.radius, grown, time - self.begin, silence
        )
