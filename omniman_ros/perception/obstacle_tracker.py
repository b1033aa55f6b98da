"""From scans to a map of what stands and tracks of what moves."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.perception.clusters import NONE, Clusters, Outlines, fitted_centers
from omniman_ros.perception.local_map import LocalMap
from omniman_ros.perception.parameters import (
    MapParameters,
    TrackerParameters,
    UnseenParameters,
)
from omniman_ros.perception.pose_history import PoseHistory
from omniman_ros.perception.scan import Indices, Mask, Scan, View, placed
from omniman_ros.perception.track import Track, TrackedObstacle
from omniman_ros.perception.unseen import UnseenSpace
from omniman_ros.surroundings.tracking import TrackingParameters

OWN_MARGIN = 0.05  #: Distance around the robot's own parts within which points are its own [m]
#: Time after a jump of the odometry during which scans are not used [s]: a robot that is moved by
#: hand, or by a simulation, is not moved at the same moment as its odometry.
SETTLING_TIME = 0.1
#: Distance from the outline of a track up to which points are its own, whatever the map says [m]
OUTLINE_TOLERANCE = 0.15
SPLIT, STANDING_SPLIT = 0.3, 0.1
"""Distance from the outline of a track that walks, and of one that stands, up to which points are
not those of another one [m]."""
LEAST_POINTS = 3  #: Number of points with which a track begins
#: Fraction of a thing's points that must lie where free space was seen, as evidence of motion
MIN_FREED_FRACTION = 0.2
#: Distance outside of a track up to which the middle of points is a part of it [m]
ABSORBING = 0.1
#: Distance of two discs, in the sum of their radii, below which they are in one place
OVERLAP = 0.5
#: Distance behind the middle of a disc, in its radius, from which on a point cannot be on it
MAX_DEPTH_FRACTION = 0.4
#: Fraction of a thing's points in what stands from which it is not somebody who walks
STRUCTURE_FRACTION = 0.6
LEFT_RADIUS = 0.1  #: Radius of the place that a thing must have left, as evidence of motion [m]
IMPOSSIBLE_COST = 1e6  #: Cost of a pair that is not possible


@dataclass(frozen=True)
class _Points:
    """Points of a scan in odom, in the order of their beams."""

    positions: Array  #: (N, 2) [m]
    gaps: Array  #: (N,) distances from which each does not belong to the one before [m]
    stand: Mask  #: (N,) whether the map says that something stands there
    is_wide: Mask  #: (N,) whether they are a part of something wide


class ObstacleTracker:
    """Follows what moves around a robot, and maps what stands.

    Points are taken into odom by the pose of the robot at the time of each beam, and its own parts
    are taken out. What is narrow is followed by its disc; the map takes what does not move.
    Nothing here reads a clock: the same odometry and scans give the same tracks.

    Attributes:
        parameters: May be replaced.
        motion: Noise and acceleration for the filters of new tracks.
        unseen: Where somebody may be who is not seen; kept while its speed is above 0.
        time: Time up to which scans were used [s].
        robot: (2,) position of the robot in odom at that time [m].
    """

    def __init__(
        self,
        parameters: TrackerParameters,
        map_parameters: MapParameters,
        motion: TrackingParameters,
        unseen: UnseenParameters | None = None,
    ) -> None:
        self.parameters, self.map_parameters, self.motion = parameters, map_parameters, motion
        self.map = LocalMap(map_parameters)
        self.unseen = UnseenSpace(unseen or build(UnseenParameters, {}), map_parameters.size)
        self.poses = PoseHistory()
        self.time = -np.inf
        self.robot = np.zeros(2)
        self._tracks: list[Track] = []
        self._next = 1
        self._mapped: dict[int, float] = {}
        self._since = -np.inf

    def clear(self) -> None:
        """Forget everything, because time went back or the odometry was reset."""
        self.map.clear()
        self.unseen.clear()
        self.poses = PoseHistory()
        self.time = -np.inf
        self._tracks.clear()
        self._mapped.clear()

    # ---- results --------------------------------------------------------------------------------

    @property
    def count(self) -> int:
        """Number of all things that are followed, most of which stand."""
        return len(self._tracks)

    def obstacles(self, time: float) -> list[TrackedObstacle]:
        """Return what moves, or has moved and rests, as expected at a time [s]."""
        return [track.state(time) for track in self._tracks if track.is_moving]

    def occupancy(self) -> "np.ndarray[tuple[int, int], np.dtype[np.int8]]":
        """Return the occupancy of the map's cells without what moves; see `LocalMap`."""
        moving = [track for track in self._tracks if track.is_moving]
        centers = np.array([track.position for track in moving]).reshape(-1, 2)
        return self.map.occupancy(centers, np.array([track.radius for track in moving]))

    # ---- odometry -------------------------------------------------------------------------------

    def add_pose(self, time: float, pose: Array, velocity: Array) -> str:
        """Use a pose (3,) of the robot in odom at a time [s], and its rate (3,) in odom.

        Returns:
            Why all was forgotten, since map and tracks are in another odom now; or nothing. Scans
            of the next SETTLING_TIME are not used: they may be from where the robot was before.
        """
        reason = self.poses.jump(time, pose)
        if reason:
            self.clear()
            self._since = time + SETTLING_TIME
        self.poses.add(time, pose, velocity)
        return reason

    # ---- scans ----------------------------------------------------------------------------------

    def add_scan(self, scan: Scan, own: Footprint, scanner: int = 0) -> bool:
        """Use a scan; return whether it was entered in the map.

        Raises:
            InputError: The odometry does not cover the time of the scan; nothing is changed then.
        """
        if scan.time < self._since:
            return False
        poses = self.poses.at(scan.times)
        beams = scan.hits
        local = scan.local_points(beams)
        known = ~self._is_own(local, scan, own)
        positions = placed(local, poses[beams])
        x, y, theta = poses[-1].tolist()
        view = View.of(scan, (x, y, theta), beams, positions, known)
        self.time, self.robot = max(self.time, scan.end), poses[-1, :2]
        self.map.follow(self.robot)
        positions, ranges = positions[known], scan.ranges[beams[known]]
        points = self._judged(positions, ranges, scan)
        moving = self._follow(points, scan.end, view)
        due = self._mapped.get(scanner, -np.inf) + 0.9 / self.map_parameters.rate
        if self._mapped.get(scanner, -np.inf) <= scan.end < due:
            return False
        self._mapped[scanner] = scan.end
        reach = min(scan.range_max, self.parameters.range)
        self.map.update(view, positions[~moving], reach)
        self.map.occupy((x, y, theta), self._parts(scan, own), OWN_MARGIN)
        if self.unseen.parameters.speed > 0.0:
            body = (x, y, theta), own.whole
            self.unseen.update(scan.end, view, reach, positions, self.map.standing(), body)
        return True

    def _is_own(self, local: Array, scan: Scan, own: Footprint) -> Mask:
        """Return which points (N, 2) in base_link are on the robot itself."""
        result: Mask = np.zeros(len(local), dtype=bool)
        near = np.flatnonzero(np.hypot(local[:, 0], local[:, 1]) < own.radius + OWN_MARGIN)
        if not len(near):
            return result
        for part in self._parts(scan, own).each():
            c, s = np.cos(part.yaw), np.sin(part.yaw)
            x, y = (local[near] - part.centre).T
            beside = np.column_stack((np.abs(c * x + s * y), np.abs(c * y - s * x)))
            result[near] |= (beside <= part.half + OWN_MARGIN).all(axis=1)
        return result

    @staticmethod
    def _parts(scan: Scan, own: Footprint) -> Rectangles:
        """Return the robot's own parts at the heights of a scan."""
        low, high = scan.heights
        parts, _ = own.against(np.array([low]), np.array([high]))
        return parts

    def _judged(self, positions: Array, ranges: Array, scan: Scan) -> _Points:
        """Return points (N, 2) with what the map and their neighbours say of them."""
        p = self.parameters
        gaps = np.maximum(p.gap, 3.0 * abs(scan.increment) * ranges)
        is_wide = np.zeros(len(positions), dtype=bool)
        if len(positions):
            all_things = Clusters.of(positions, gaps)
            is_wide = (all_things.widths(positions) > p.max_diameter)[all_things.number]
        return _Points(positions, gaps, self.map.stands(positions), is_wide)

    # ---- tracks ---------------------------------------------------------------------------------

    def _follow(self, points: _Points, time: float, view: View) -> Mask:
        """Bring all tracks up to a time; return which points (N,) belong to what moves."""
        positions, tracks = points.positions, self._tracks
        expected = np.array([track.expect(time) for track in tracks]).reshape(-1, 2)
        radii = np.array([track.radius for track in tracks])
        walks = np.array([track.is_walking for track in tracks], dtype=bool)
        surface = _distances(positions, expected, radii, view.origin)
        moving = np.zeros(len(positions), dtype=bool)
        label = np.full(len(positions), NONE, dtype=np.intp)
        is_near = np.zeros(len(positions), dtype=bool)
        if tracks and len(positions):
            nearest = surface.argmin(axis=0)
            least = surface[nearest, np.arange(len(positions))]
            is_split = least < np.where(walks, SPLIT, STANDING_SPLIT)[nearest]
            label[is_split] = nearest[is_split]
            is_near = least < OUTLINE_TOLERANCE
        kept = np.flatnonzero(~points.stand | is_near)
        kept = kept[np.hypot(*(positions[kept] - view.origin).T) < self.parameters.range]
        clusters = Clusters.of(positions[kept], points.gaps[kept], label[kept])
        owner = np.full(len(clusters), NONE, dtype=np.intp)
        is_found = np.zeros(len(tracks), dtype=bool)
        if len(clusters):
            gates = np.array([track.gate(time) for track in tracks])
            stand = clusters.means(points.stand[kept].astype(float)) > STRUCTURE_FRACTION
            costs = clusters.means(surface[:, kept])
            costs[walks[:, None] & stand] = IMPOSSIBLE_COST
            owner = self._assigned(costs, gates, clusters.counts)
            outlines = Outlines.of(clusters, positions[kept], view, self.parameters.partial_radius)
            found = np.flatnonzero(owner != NONE)
            is_found[owner[found]] = True
            is_wide = points.is_wide[kept]
            self._observe(clusters, owner, outlines, positions[kept], is_wide, view, time)
            self._absorb(clusters, owner, positions[kept])
            self._begin(clusters, owner, outlines, positions[kept], time)
            owned = owner[clusters.number]
            flags = np.array([track.is_moving for track in self._tracks] + [False])
            moving[kept] = flags[owned]
        for k in np.flatnonzero(~is_found).tolist():
            self._search(tracks[k], time, expected[k], view)
        self._part()
        self._tracks = [track for track in self._tracks if not track.is_gone]
        return moving

    def _part(self) -> None:
        """End what is in the place of something else: two things cannot be in one place."""
        tracks = [track for track in self._tracks if not track.is_gone]
        if len(tracks) < 2:
            return
        positions = np.array([track.position for track in tracks])
        radii = np.array([track.radius for track in tracks])
        apart = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1))
        overlap = apart < OVERLAP * (radii[:, None] + radii)
        for i, k in np.argwhere(np.triu(overlap, 1)).tolist():
            min(tracks[i], tracks[k], key=_precedence).is_gone = True

    @staticmethod
    def _assigned(costs: Array, gates: Array, counts: Indices) -> Indices:
        """Return the number of the track of each cluster (C,), or NONE.

        Costs (T, C) are mean distances of a cluster's points from an outline, at most `gates` (T,)
        [m].
        """
        owner = np.full(costs.shape[1], NONE, dtype=np.intp)
        possible = (costs < gates[:, None]) & (counts > 1)
        rows, columns = np.flatnonzero(possible.any(axis=1)), np.flatnonzero(possible.any(axis=0))
        if len(rows):
            part = np.where(possible, costs, IMPOSSIBLE_COST)[np.ix_(rows, columns)]
            first, second = linear_sum_assignment(part)
            is_real = part[first, second] < IMPOSSIBLE_COST
            owner[columns[second[is_real]]] = rows[first[is_real]]
        return owner

    def _observe(
        self,
        clusters: Clusters,
        owner: Indices,
        outlines: Outlines,
        positions: Array,
        is_wide: Mask,
        view: View,
        time: float,
    ) -> None:
        """Correct tracks by the clusters that are theirs."""
        found = np.flatnonzero(owner != NONE)
        if not len(found):
            return
        p, tracks = self.parameters, self._tracks
        for cluster in found.tolist():
            radius, is_whole = outlines.radii[cluster], bool(outlines.is_whole[cluster])
            limit = 0.5 * p.max_diameter
            tracks[owner[cluster]].measure_radius(min(float(radius), limit), is_whole)
        number = np.full(len(clusters), NONE, dtype=np.intp)
        number[found] = np.arange(len(found))
        each = number[clusters.number]
        mine = each != NONE
        expected = np.array([tracks[owner[cluster]].expect(time) for cluster in found])
        middles = np.column_stack([clusters.means(axis) for axis in positions.T])[found]
        is_before = ((middles - expected) * (expected - view.origin)).sum(axis=1) > 0.0
        expected[is_before] = outlines.centers[found[is_before]]
        radii = np.array([tracks[owner[cluster]].radius for cluster in found])
        centers = fitted_centers(positions[mine], each[mine], expected, radii)
        is_free = clusters.means(self.map.was_free(positions).astype(float))[found]
        wide = clusters.means(is_wide.astype(float))[found]
        for k, cluster in enumerate(found.tolist()):
            track = tracks[owner[cluster]]
            track.observe(time, centers[k])
            if track.resembles_structure(bool(wide[k] > 0.5)):
                track.is_gone = True
            elif track.judge(time, is_free[k] >= MIN_FREED_FRACTION or has_left(track, view), p):
                self.map.forget(track.birth, track.radius + OUTLINE_TOLERANCE)

    def _absorb(self, clusters: Clusters, owner: Indices, positions: Array) -> None:
        """Give clusters without a track to a track that they are a part of, such as a leg."""
        free = np.flatnonzero(owner == NONE)
        owned = np.unique(owner[owner != NONE])
        if not len(free) or not len(owned):
            return
        middles = np.column_stack([clusters.means(axis) for axis in positions.T])[free]
        centers = np.array([self._tracks[k].position for k in owned])
        reach = np.array([self._tracks[k].radius for k in owned]) + ABSORBING
        far = np.hypot(*(middles[:, None] - centers[None]).transpose(2, 0, 1)) - reach
        nearest = far.argmin(axis=1)
        is_part = far[np.arange(len(free)), nearest] < 0.0
        owner[free[is_part]] = owned[nearest[is_part]]

    def _begin(
        self,
        clusters: Clusters,
        owner: Indices,
        outlines: Outlines,
        positions: Array,
        time: float,
    ) -> None:
        """Begin tracks of clusters that are nobody's, are narrow, and have enough points."""
        p = self.parameters
        narrow = (clusters.widths(positions) < p.max_diameter) & (clusters.counts >= LEAST_POINTS)
        for cluster in np.flatnonzero((owner == NONE) & narrow).tolist():
            if len(self._tracks) >= p.most:
                return
            begin, count = int(clusters.begins[cluster]), int(clusters.counts[cluster])
            front = positions[begin + count // 2].copy()
            radius = min(float(outlines.radii[cluster]), 0.5 * p.max_diameter)
            center = outlines.centers[cluster].copy()
            owner[cluster] = len(self._tracks)
            self._tracks.append(Track(self._next, time, center, radius, front, self.motion))
            self._next += 1

    def _search(self, track: Track, time: float, expected: Array, view: View) -> None:
        """Decide what has become of a track that was not found.

        What is hidden is expected where it is hidden: not farther than to where it would be seen.
        """
        through = view.sees_through(expected, track.radius)
        if through:
            expected = track.position
            through = view.sees_through(expected, track.radius)
        if through:
            track.is_gone = track.miss()
        else:
            track.wait(time, expected)
            track.is_gone = time - track.seen > self.parameters.occlusion_time


def _precedence(track: Track) -> tuple[float, bool, int]:
    """Return what decides which of two tracks in one place stays: the one with the larger."""
    return track.seen, track.is_moving, -track.number


def has_left(track: Track, view: View) -> bool:
    """Return whether the place where a track was first seen is free now."""
    return bool(view.sees_through(track.front, LEFT_RADIUS))


def _distances(positions: Array, centers: Array, radii: Array, origin: Array) -> Array:
    """Return distances (T, N) of points (N, 2) from the sides of discs that face `origin` [m]."""
    if not len(centers):
        return np.zeros((0, len(positions)))
    away = centers - origin
    ux, uy = away.T / np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)
    x = positions[None, :, 0] - centers[:, :1]
    y = positions[None, :, 1] - centers[:, 1:]
    off, own = np.hypot(x, y), radii[:, None]
    is_behind = x * ux[:, None] + y * uy[:, None] > MAX_DEPTH_FRACTION * own
    distances: Array = np.where(is_behind, off + own, np.abs(off - own))
    return distances
