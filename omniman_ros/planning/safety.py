"""The last word on every motion: whether it keeps clear of what is known, all the way to rest."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.separation import Workspace, box_gap, outside_by, swept_gap, within_reach
from omniman_ros.planning.walls import Walls

Array = NDArray[np.float64]

PARTS = 4
"""Into so many parts each span of a motion is cut for the check."""
CLOSER = 0.02
"""So much of the margin may be used up where the robot is about as close as allowed [m]."""
WALL_PARTS = 16
"""The same next to walls, whose check is coarser in space."""
SAME = 1e-6
"""Gaps that differ by less are equal [m]."""


@dataclass(frozen=True)
class Surroundings:
    """What a motion is checked against.

    Attributes:
        half: (2,) half length and half width of the robot's box [m].
        ellipses: Obstacles, as they are known now.
        workspace: (x_min, y_min, x_max, y_max) in odom [m].
        margin: Gap that is kept to both [m].
        until: A motion is looked at until then even where it is at rest before [s].
        walls: What stands for good.
    """

    half: Array
    ellipses: Ellipses
    workspace: Workspace
    margin: float
    until: float = -math.inf
    walls: Walls = field(default_factory=Walls.none)

    def outside(self, poses: Array) -> float:
        """By how much the box at poses (K, 3) leaves the workspace, its margin included [m]."""
        return float(outside_by(poses, self.half, self.workspace).max()) + self.margin

    def overlap(self, poses: Array) -> float:
        """By how much the box at poses (K, 3) is too close to an obstacle as it is now [m]."""
        e = self.ellipses
        into = self.margin - float(self.walls.gaps(poses, self.half).min())
        if not len(e):
            return into if len(self.walls) else -math.inf
        times = np.full(len(poses), e.time)
        axes = e.axes_at(times, self.margin)
        gaps = box_gap(poses, self.half, e.centers_at(times), axes, e.angles)
        return max(-float(gaps.min()), into if len(self.walls) else -math.inf)

    def contact(self, motion: Motion, now: float) -> float:
        """Time at which a motion comes too close to anything, from `now` on [s]; or infinity.

        Where the robot is too close already it may go on, but not closer, so that it gets away
        from there; what is allowed beyond the margin does not add up over calls.
        """
        times, poses, velocities = motion.fine(now, self.until, PARTS)
        first = math.inf
        out = outside_by(poses, self.half, self.workspace) + self.margin
        allowed = max(float(out[0]) + 1e-3, 0.0) if math.isfinite(out[0]) else -math.inf
        left = ~(out <= allowed)
        if left.any():
            first = float(times[int(left.argmax())])
        first = min(first, self._at_wall(motion, now, self.margin))
        reached = within_reach(times, poses, velocities, self.half, self.ellipses, self.margin)
        if not reached.any():
            return first
        near = self.ellipses.select(reached)
        gaps = swept_gap(times, poses, velocities, self.half, near, self.margin)
        allowed = np.minimum(np.maximum(gaps[0] - CLOSER, -min(CLOSER, self.margin)), 0.0)
        nodes = box_gap(
            poses, self.half, near.centers_at(times), near.axes_at(times, self.margin), near.angles
        )
        leaves = (nodes[0] <= 0.0) & (nodes[1:] >= nodes[0] - SAME)
        touched = ~((gaps > allowed) | leaves).all(axis=1)
        touched |= (gaps[0] == -math.inf).any()
        if touched.any():
            first = min(first, float(times[int(touched.argmax())]))
        return first

    def _at_wall(self, motion: Motion, now: float, margin: float) -> float:
        """Time at which a motion comes too close to a wall [s], or infinity; see `contact`."""
        if not len(self.walls):
            return math.inf
        times, poses, velocities = motion.fine(now, -math.inf, WALL_PARTS)
        nodes, gaps = self.walls.swept(times, poses, velocities, self.half)
        allowed = margin + min(max(float(gaps[0]) - margin - CLOSER, -min(CLOSER, margin)), 0.0)
        leaves = (-math.inf < nodes[0] <= margin) & (nodes[1:] >= nodes[0] - SAME)
        touched = ~((gaps > allowed) | leaves)
        return float(times[int(touched.argmax())]) if touched.any() else math.inf

    def threat(self, motion: Motion, now: float) -> tuple[float, float]:
        """How bad a motion is that is not clear: of two, the greater is the better one.

        Returns:
            When the robot itself touches an obstacle where it is expected, without any margin [s];
            and the least gap until then or to the end [m].
        """
        wall = self._at_wall(motion, now, 0.0)
        times, poses, velocities = motion.fine(now, self.until, PARTS)
        certain = replace(self.ellipses, growth=np.zeros(len(self.ellipses)))
        reached = within_reach(times, poses, velocities, self.half, certain, CLOSER)
        if not reached.any():
            return wall, CLOSER if wall == math.inf else 0.0
        gaps = swept_gap(times, poses, velocities, self.half, certain.select(reached))
        least = gaps.min(axis=1)
        touched = ~(least > 0.0)
        first = int(touched.argmax()) if touched.any() else len(least) - 1
        contact = float(times[first]) if touched.any() else math.inf
        if wall < contact:
            return wall, 0.0
        return contact, min(float(least[: first + 1].min()), CLOSER)

    def longest(
        self, motion: Motion, now: float, earliest: float, deceleration: tuple[float, float]
    ) -> Motion | None:
        """As much of a motion as can be driven and then braked without contact.

        Args:
            motion: It need not end at rest.
            now: From when on it is driven [s].
            earliest: The braking begins no earlier than here [s].
            deceleration: Linear and angular, of the braking [m/s^2, rad/s^2].

        Returns:
            A motion that ends at rest, or None if there is none.
        """
        whole = motion.braked(motion.end, deceleration)
        contact = self.contact(whole, now)
        if contact == math.inf:
            return whole
        nodes = motion.times[(motion.times >= earliest) & (motion.times < contact)]
        # One by one: an earlier braking need not be safer, where an obstacle comes along behind.
        for begin in nodes[::-1].tolist():
            shorter = motion.braked(begin, deceleration)
            if self.contact(shorter, now) == math.inf:
                return shorter
        return None
