"""The way out of occupied cells and obstacles in which the robot stands, according to the map."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.walls import MAX_COMPUTED_GAP, Walls
from omniman_ros.surroundings.grid_map import GridMap

DIRECTIONS = 48  #: Number of directions that are tried
STEP = 0.02  #: Distance between two poses on a way [m]
EXIT_GAP = 0.01  #: Gap to everything at the end of a way [m]
#: Largest distance between the points of the robot that must not enter occupied cells [m]
SPACING = 0.05
FINEST = 0.02  #: Distance between them that suffices for the finest maps [m]
#: Length up to which a way may lead back over a thin wall, which the robot overlaps by an error of
#: its localisation [m].
SHORT = 0.15
BACK = 0.005  #: Distance by which a motion may go back on a way, which is noise [m]
ASIDE = 0.02  #: Distance by which a motion may be beside a way [m]
TURNED = 0.05  #: Angle by which a motion may turn on a way [rad]


@dataclass(frozen=True)
class EscapePath(Validated):
    """Straight line on which the robot leaves what it overlaps, without going deeper.

    The robot cannot be where something stands: map or localisation are wrong there. Discs at the
    boundary of an occupied area repel to both sides, so they cannot tell which way is out. This
    way is the shortest translation to a pose that is clear; on it, the robot touches no obstacle
    that it does not touch already, and no part that is on free ground enters occupied cells. A
    SHORT one may lead back over cells that the robot touches already, and every one over cells
    that are wholly under the robot at its start: nothing can stand there.
    """

    start: Annotated[Array, Shape(3)]  #: (3,) pose in odom at which it begins [m, m, rad]
    end: Annotated[Array, Shape(3)]  #: (3,) clear pose at which it ends, of the same heading

    @staticmethod
    def find(pose: Array, environment: Environment) -> "EscapePath | None":
        """Return the shortest way out from a pose (3,) in odom, or None if there is none.

        It is no longer than the robot: one that is wholly inside stays.
        """
        count = math.ceil(2.0 * environment.footprint.radius / STEP)
        lengths = STEP * np.arange(1.0, count + 1.0)
        angles = pose[2] + math.tau / DIRECTIONS * np.arange(DIRECTIONS)
        found = []
        for angle in angles.tolist():
            poses = np.tile(pose, (count, 1))
            poses[:, 0] += lengths * math.cos(angle)
            poses[:, 1] += lengths * math.sin(angle)
            gaps = environment.gaps(poses, MAX_COMPUTED_GAP)
            clear = (gaps > EXIT_GAP) & ~environment.is_inside(poses)
            if clear.any():
                last = int(clear.argmax())
                found.append((last, -float(gaps[last]), poses[last]))
        grid = environment.grid
        solid = grid and _without_islands(grid, environment.footprint, pose)
        for _, _, end in sorted(found, key=lambda way: way[:2]):
            way = EscapePath(pose, end)
            if way._goes_no_deeper(environment, solid):
                return way
        return None

    @cached_property
    def _poses(self) -> Array:
        """Poses (K, 3) on the way, STEP or less apart."""
        count = max(math.ceil(self._length / STEP), 1) + 1
        return np.linspace(self.start, self.end, count)

    @property
    def _length(self) -> float:
        return math.dist(self.start[:2].tolist(), self.end[:2].tolist())

    def _goes_no_deeper(self, environment: Environment, solid: GridMap | None) -> bool:
        """Return whether the robot enters nothing new, of the map and all else, on this way."""
        count = len(environment.walls)
        before, after = (environment.touched(some) for some in (self._poses[:1], self._poses))
        is_new = after & ~before
        if is_new[count:].any():
            return False
        if solid is None or (self._length <= SHORT and not is_new[:count].any()):
            return True
        local = _points(environment.footprint, max(solid.resolution, FINEST))
        at = np.concatenate([se2.displaced(local, pose.tolist()) for pose in self._poses])
        inside = solid.occupied_at(at[:, :2]).reshape(len(self._poses), -1)
        return not inside[:, ~inside[0]].any()

    def without(self, walls: Walls, footprint: Footprint, margin: float) -> Walls:
        """Return the discs that are farther than a margin [m] from the robot all along the way."""
        gaps = walls.gaps_of_each(self._poses, footprint.whole)
        return Walls(walls.centers[gaps > margin], walls.radius)

    def left_at(self, times: Array, poses: Array) -> float:
        """Return the time from which on a motion is not on this way; infinity if it stays on it.

        The first of the poses (K, 3) is allowed.

        Args:
            poses: (K, 3) poses in odom, the first of which is allowed [m, m, rad].
        """
        direction = (self.end[:2] - self.start[:2]) / max(self._length, STEP)
        x, y = (poses[:, :2] - self.start[:2]).T
        along = direction[0] * x + direction[1] * y
        aside = np.abs(direction[0] * y - direction[1] * x)
        turned = np.abs(np.remainder(poses[:, 2] - self.start[2] + math.pi, math.tau) - math.pi)
        is_on = along >= np.maximum.accumulate(along) - BACK
        is_on &= aside <= max(ASIDE, float(aside[0]) + BACK)
        is_on &= turned <= max(TURNED, float(turned[0]) + BACK)
        return math.inf if is_on.all() else float(times[int((~is_on).argmax())])


def _without_islands(grid: GridMap, footprint: Footprint, pose: Array) -> GridMap:
    """Return a map without the occupied cells that are all under the robot, with their neighbours.

    Cells that are connected to others beside the robot stay: a wall may reach under it.
    """
    cells = np.argwhere(grid.occupied)
    middles = (cells[:, ::-1] + 0.5) * grid.resolution
    places = se2.displaced(np.column_stack([middles, np.zeros(len(cells))]), grid.origin.tolist())
    near = np.hypot(*(places[:, :2] - pose[:2]).T) < footprint.radius + 2.0 * grid.resolution
    cells, places = cells[near], places[near, :2]
    is_solid = np.ones(len(cells), dtype=bool)
    for part in footprint.whole.each():
        x0, y0, yaw = part.poses(pose[None])[0].tolist()
        x, y = (places - (x0, y0)).T
        c, s = math.cos(yaw), math.sin(yaw)
        local = np.abs(np.column_stack([c * x + s * y, c * y - s * x]))
        is_solid &= ~(local <= part.half - grid.radius).all(axis=1)
    is_next = np.abs(cells[:, None] - cells).max(axis=2) <= 1
    while (grown := (is_next & is_solid).any(axis=1)).sum() > is_solid.sum():
        is_solid = grown
    occupied = grid.occupied.copy()
    occupied[tuple(cells[~is_solid].T)] = False
    return GridMap(occupied, grid.resolution, grid.origin)


def _points(footprint: Footprint, spacing: float) -> Array:
    """Return points (N, 3) of the robot, of heading zero, at most a spacing apart [m]."""
    spacing = min(spacing, SPACING)
    points = []
    for part in footprint.whole.each():
        x, y = (
            np.linspace(-half, half, math.ceil(2.0 * half / spacing) + 1)
            for half in part.half.tolist()
        )
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        c, s = math.cos(float(part.yaw)), math.sin(float(part.yaw))
        points.append(part.centre + grid @ np.array([[c, s], [-s, c]]))
    all_points = np.concatenate(points)
    return np.column_stack([all_points, np.zeros(len(all_points))])
