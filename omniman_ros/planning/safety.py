"""Final check of a motion: whether it keeps its gap to all obstacles until it is at rest."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core.arrays import Array
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.obstacles.escape_path import EscapePath
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import (
    Workspace,
    box_gap,
    outside_by,
    swept_gap,
    within_distance,
)
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.surroundings.ellipses import Ellipses

#: Number of parts into which the check divides each span between two nodes of a motion
SPAN_PARTS = 4
#: Number of these parts in the check against walls, which is less exact in space
WALL_SPAN_PARTS = 16
#: Part of the margin that may be consumed if the robot is about as close as allowed [m]
MARGIN_TOLERANCE = 0.02
GAP_TOLERANCE = 1e-6  #: Difference below which gaps count as equal [m]


@dataclass(frozen=True)
class Surroundings:
    """Obstacles, workspace and map that a motion is checked against."""

    footprint: Footprint  #: Outline of the robot
    ellipses: Ellipses  #: Obstacles as they are known now
    workspace: Workspace  #: (x_min, y_min, x_max, y_max) in odom [m]
    margin: float  #: Gap to keep to obstacles, workspace edge and walls [m]
    #: Time up to which a motion is checked even if it is at rest before [s]
    until: float = -math.inf
    #: Occupied cells of the map, without those that the way out leads along
    walls: Walls = field(default_factory=Walls.none)
    #: Way on which the robot leaves what it touches, and which it must not leave; None if it
    #: touches nothing.
    escape_path: EscapePath | None = None

    @cached_property
    def _pairs(self) -> Pairs:
        return Pairs.of(self.footprint, self.ellipses)

    def outside(self, poses: Array) -> float:
        """Return how far the robot at poses (K, 3) leaves the workspace, margin included [m]."""
        return float(outside_by(poses, self.footprint.whole, self.workspace).max()) + self.margin

    def overlap(self, poses: Array) -> float:
        """Return how much the robot at poses (K, 3) is too close to a present obstacle [m]."""
        pairs = self._pairs
        e = pairs.ellipses
        into = self.margin - float(self.walls.gaps(poses, self.footprint.whole).min())
        if not len(e):
            return into if len(self.walls) else -math.inf
        times = np.full(len(poses), e.time)
        axes = e.axes_at(times, self.margin)
        gaps = box_gap(poses, pairs.boxes, e.centers_at(times), axes, e.angles)
        return max(-float(gaps.min()), into if len(self.walls) else -math.inf)

    def contact(self, motion: HermiteTrajectory, now: float) -> float:
        """Return the time from `now` on at which a motion comes too close to an obstacle [s].

        It is the start of an interval, or infinity. A robot that is too close already may move,
        but not closer, so that it can leave; the part of the margin that may be consumed does not
        add up over calls.
        """
        times, poses, velocities = motion.fine(now, self.until, SPAN_PARTS)
        first = math.inf
        out = outside_by(poses, self.footprint.whole, self.workspace) + self.margin
        allowed = max(float(out[0]) + 1e-3, 0.0) if math.isfinite(out[0]) else -math.inf
        left = ~(out <= allowed)
        if left.any():
            first = float(times[int(left.argmax())])
        first = min(first, self._at_wall(motion, now, self.margin))
        boxes, known = self._pairs.boxes, self._pairs.ellipses
        reached = within_distance(times, poses, velocities, boxes, known, self.margin)
        if not reached.any():
            return first
        boxes, near = boxes.select(reached), known.select(reached)
        gaps = swept_gap(times, poses, velocities, boxes, near, self.margin)
        allowed = np.minimum(
            np.maximum(gaps[0] - MARGIN_TOLERANCE, -min(MARGIN_TOLERANCE, self.margin)), 0.0
        )
        nodes = box_gap(
            poses, boxes, near.centers_at(times), near.axes_at(times, self.margin), near.angles
        )
        leaves = (nodes[0] <= 0.0) & (nodes[1:] >= nodes[0] - GAP_TOLERANCE)
        touched = ~((gaps > allowed) | leaves).all(axis=1)
        touched |= (gaps[0] == -math.inf).any()
        if touched.any():
            first = min(first, float(times[int(touched.argmax())]))
        return first

    def _at_wall(self, motion: HermiteTrajectory, now: float, margin: float) -> float:
        """Return the time of too small a distance from a wall, or off the way out; `contact`."""
        if not len(self.walls) and self.escape_path is None:
            return math.inf
        times, poses, velocities = motion.fine(now, -math.inf, WALL_SPAN_PARTS)
        left = math.inf if self.escape_path is None else self.escape_path.left_at(times, poses)
        nodes, gaps = self.walls.swept(
            times, poses, velocities, self.footprint.whole, enough=margin
        )
        allowed = margin + min(
            max(float(gaps[0]) - margin - MARGIN_TOLERANCE, -min(MARGIN_TOLERANCE, margin)), 0.0
        )
        leaves = (-math.inf < nodes[0] <= margin) & (nodes[1:] >= nodes[0] - GAP_TOLERANCE)
        touched = ~((gaps > allowed) | leaves)
        return min(left, float(times[int(touched.argmax())]) if touched.any() else math.inf)

    def threat(self, motion: HermiteTrajectory, now: float) -> tuple[float, float]:
        """Rate a motion that is not clear: of two results, the greater one is better.

        Returns:
            Time at which the robot itself touches an obstacle at its predicted position, without
            any margin [s], and the smallest gap until then or until the end, less the distance by
            which the robot leaves the workspace, its margin included [m]. What it touches already
            counts for the gap alone: whoever gets away from it must not touch something else.
        """
        times, poses, velocities = motion.fine(now, self.until, SPAN_PARTS)
        contact, gap = self._contact_and_gap(motion, now, times, poses, velocities)
        out = outside_by(poses, self.footprint.whole, self.workspace) + self.margin
        return contact, gap - max(float(out.max()) - max(float(out[0]), 0.0), 0.0)

    def _contact_and_gap(
        self, motion: HermiteTrajectory, now: float, times: Array, poses: Array, velocities: Array
    ) -> tuple[float, float]:
        wall = self._at_wall(motion, now, 0.0)
        boxes, known = self._pairs.boxes, self._pairs.ellipses
        certain = replace(known, growth=np.zeros(len(known)))
        reached = within_distance(times, poses, velocities, boxes, certain, MARGIN_TOLERANCE)
        if not reached.any():
            return wall, MARGIN_TOLERANCE if wall == math.inf else 0.0
        boxes, near = boxes.select(reached), certain.select(reached)
        gaps = swept_gap(times, poses, velocities, boxes, near)
        at = times[:1]
        start = box_gap(poses[:1], boxes, near.centers_at(at), near.axes_at(at), near.angles)[0]
        touched = ~(gaps[:, start > 0.0] > 0.0).all(axis=1)
        first = int(touched.argmax()) if touched.any() else len(gaps) - 1
        contact = float(times[first]) if touched.any() else math.inf
        if wall < contact:
            return wall, 0.0
        return contact, min(float(gaps[: first + 1].min()), MARGIN_TOLERANCE)
