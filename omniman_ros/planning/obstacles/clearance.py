"""Gaps between the robot at many poses and obstacles at rest."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import Workspace, box_gap, outside_by
from omniman_ros.surroundings.ellipses import Ellipses

Index = NDArray[np.intp]  #: Array of indices of obstacles

#: Number of pairs of pose and obstacle that are processed together, to limit memory
PAIRS = 50_000
UNTILED_OBSTACLES = 20  #: Number of obstacles above which these are looked up by tiles
TILE = 0.5  #: Edge of the tiles [m]
WIDE_TILE = 4.0  #: Edge of the tiles from which those are made [m]


class Clearance:
    """Gaps between the robot and static obstacles, fast for many poses among many obstacles.

    Obstacles are looked up by tiles of the ground, each created for the first pose on it. They
    count as being at rest at their centres, and may be ignored beyond `reach` [m].
    """

    def __init__(
        self,
        footprint: Footprint,
        around: Ellipses,
        workspace: Workspace,
        reach: float = math.inf,
    ) -> None:
        pairs = Pairs.of(footprint, around)
        self._whole, self._workspace = footprint.whole, workspace
        self._boxes, self._around = pairs.boxes, pairs.ellipses
        axes = self._around.semi_axes.max(axis=1, initial=0.0)
        self._size = axes + reach + self._boxes.radius
        self._tiled = len(pairs) > UNTILED_OBSTACLES and math.isfinite(reach)
        self._all = np.arange(len(pairs))
        self._tiles: dict[tuple[float, int, int], Index] = {}

    def gaps(self, poses: Array) -> Array:
        """Return the smallest gaps (K,) at poses (K, 3) in odom [m], also to the workspace's edge.

        They are those of `box_gap`, not above zero where the robot touches an obstacle or the
        edge.

        Args:
            poses: (K, 3) poses in odom [m, m, rad].
        """
        result: Array = -outside_by(poses, self._whole, self._workspace)
        if not len(self._around):
            return result
        if not self._tiled or not np.isfinite(poses).all():
            size = max(16, PAIRS // len(self._around))
            for k in range(0, len(poses), size):
                self._lower(result[k : k + size], poses[k : k + size], self._all)
            return result
        tiles = np.floor(poses[:, :2] / TILE).astype(np.intp)
        changes = np.flatnonzero((np.diff(tiles, axis=0) != 0).any(axis=1)) + 1
        ends = [0, *changes.tolist(), len(poses)]
        for first, last in pairwise(ends):
            indices = self._tile(TILE, *tiles[first].tolist())
            if len(indices):
                self._lower(result[first:last], poses[first:last], indices)
        return result

    def _tile(self, edge: float, x: int, y: int) -> Index:
        """Return the indices of the obstacles within reach of any point of a tile."""
        key = edge, x, y
        if key not in self._tiles:
            indices = self._all
            if edge < WIDE_TILE:
                ratio = round(WIDE_TILE / edge)
                indices = self._tile(WIDE_TILE, x // ratio, y // ratio)
            size = self._size[indices]
            offset = np.abs(self._around.centers[indices] - edge * (np.array([x, y]) + 0.5))
            beyond = np.maximum(offset - 0.5 * edge, 0.0)
            self._tiles[key] = indices[(beyond * beyond).sum(axis=1) <= size * size]
        return self._tiles[key]

    def _lower(self, result: Array, poses: Array, indices: Index) -> None:
        """Lower gaps (K,) to those to the obstacles of these indices."""
        offset = poses[:, None, :2] - self._around.centers[indices]
        size = self._size[indices]
        near = ~((offset * offset).sum(axis=2) > size * size)  # NaN counts as near
        k, j = np.nonzero(near)
        if len(k):
            boxes = self._boxes.select(indices[j])
            gap = _pairs(offset[k, j], poses[k, 2], boxes, self._around, indices[j])
            np.minimum.at(result, k, gap)


def _pairs(
    offset: Array, headings: Array, boxes: Rectangles, obstacles: Ellipses, indices: Index
) -> Array:
    """Return gaps (N,) [m] of boxes, one or (N,), from obstacles of these indices (N,).

    Base_link is at offsets (N, 2) from the obstacles.
    """
    axes = obstacles.semi_axes[indices]
    angles = obstacles.angles[indices]
    gap = np.empty(len(offset))
    disc = axes[:, 0] == axes[:, 1]
    if disc.any():  # outside of a disc, this is the result of `box_gap`
        (x, y), heading = offset[disc].T, headings[disc]
        box = boxes.select(disc)
        c, s = np.cos(heading + box.yaw), np.sin(heading + box.yaw)
        ahead, beside = box.own_centre
        forward = np.maximum(np.abs(c * x + s * y + ahead) - box.half[..., 0], 0.0)
        lateral = np.maximum(np.abs(c * y - s * x + beside) - box.half[..., 1], 0.0)
        gap[disc] = np.hypot(forward, lateral) - axes[disc, 0]
    other = ~disc
    if other.any():  # each pair is expressed in the axes of its ellipse
        (x, y), angle = offset[other].T, angles[other]
        c, s = np.cos(angle), np.sin(angle)
        poses = np.column_stack([c * x + s * y, c * y - s * x, headings[other] - angle])
        centers = np.zeros((len(poses), 1, 2))
        box = boxes.select(other)
        if not box.is_single:  # a column
            box = box.select(np.arange(len(poses))[:, None])
        gap[other] = box_gap(poses, box, centers, axes[other][:, None], np.zeros(1))[:, 0]
    return np.where(np.isfinite(gap), gap, -np.inf)
