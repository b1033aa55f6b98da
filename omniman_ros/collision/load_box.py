"""The box that the arm holds."""

import numpy as np

from omniman_ros.collision.arm_segments import Segments
from omniman_ros.collision.parameters import LoadShape
from omniman_ros.collision.prism import ConvexPrism
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array

#: Numbers (2, 12) of the corners at the ends of each edge of a box: bit k of a corner's number is
#: its side along axis k.
EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]).T


class LoadBox:
    """A box that is fixed to the flange, and its distances from other shapes.

    Two boxes touch first where an edge of one meets the other. Therefore the distance between them
    is the least distance of the edges of each from the other. Its extent [m] is from the flange's
    origin to its farthest point.
    """

    def __init__(self, shape: LoadShape) -> None:
        near, far = shape.distance, shape.distance + shape.height
        self._box = UprightObstacles.box((0.0, 0.0, 0.0), shape.length, shape.width, (near, far))
        self._corners = box_corners(self._box)[:, 0]
        self.extent = float(np.linalg.norm(self._corners, axis=0).max())

    def edges(self, flange: Array) -> Segments:
        """Return the edges (3, ..., 12) of the load for poses (..., 4, 4) of the flange."""
        rotation, origin = flange[..., :3, :3], flange[..., :3, 3]
        corners = np.moveaxis(rotation @ self._corners + origin[..., None], -2, 0)
        return Segments(corners[..., EDGES[0]], corners[..., EDGES[1]])

    def distances(self, flange: Array, segments: Segments, cutoff: float) -> Array:
        """Return the distances (..., S) of segments (3, ..., S) from the load [m].

        The flange has poses (..., 4, 4); above `cutoff` [m] a lower bound is enough.
        """
        start, end = (_in_frame(flange, points) for points in (segments.start, segments.end))
        return self._box.distances(start[..., None], end[..., None], cutoff)[..., 0]

    def distances_from_obstacles(
        self, flange: Array, obstacles: UprightObstacles, cutoff: float
    ) -> Array:
        """Return the distances (..., M) of obstacles from the load [m].

        That of a rounded solid may be too small by its rounding where a side of the load, not an
        edge, is the nearest. The flange has poses (..., 4, 4) in the frame of the obstacles; above
        `cutoff` [m] a lower bound is enough.
        """
        edges = self.edges(flange)
        own = obstacles.distances(edges.start[..., None], edges.end[..., None], cutoff).min(
            axis=-2
        )
        corners = box_corners(obstacles)
        of_solids = Segments(*(corners[..., EDGES[k]].reshape(3, -1) for k in (0, 1)))
        shape = (3, *flange.shape[:-2], of_solids.start.shape[-1])
        start, end = (
            np.broadcast_to(points.reshape(3, *(1,) * (flange.ndim - 2), -1), shape)
            for points in (of_solids.start, of_solids.end)
        )
        other = self.distances(
            flange, Segments(start, end), cutoff + obstacles.rounding.max(initial=0)
        )
        other = other.reshape(*flange.shape[:-2], len(obstacles), len(EDGES[0])).min(axis=-1)
        result: Array = np.minimum(own, np.maximum(other - obstacles.rounding, 0.0))
        return result

    def distances_from_prism(self, flange: Array, prism: ConvexPrism, cutoff: float) -> Array:
        """Return the distances (...) of a prism from the load [m].

        The flange has poses (..., 4, 4) in its frame; above `cutoff` [m] a lower bound is enough.
        """
        edges = self.edges(flange)
        own = prism.distances(edges.start, edges.end, cutoff).min(axis=-1)
        shape = (3, *flange.shape[:-2], prism.edges.start.shape[-1])
        start, end = (
            np.broadcast_to(points.reshape(3, *(1,) * (flange.ndim - 2), -1), shape)
            for points in (prism.edges.start, prism.edges.end)
        )
        other = self.distances(flange, Segments(start, end), cutoff).min(axis=-1)
        result: Array = np.minimum(own, other)
        return result


def box_corners(obstacles: UprightObstacles) -> Array:
    """Return the corners (3, M, 8) of obstacles without their rounding [m]."""
    side = np.array(
        [[1.0 if number >> axis & 1 else -1.0 for number in range(8)] for axis in range(3)]
    )
    c, s = np.cos(obstacles.yaw)[:, None], np.sin(obstacles.yaw)[:, None]
    along, across = (obstacles.half[k][:, None] * side[k] for k in (0, 1))
    return np.stack(
        (
            obstacles.centre[0][:, None] + c * along - s * across,
            obstacles.centre[1][:, None] + s * along + c * across,
            np.where(side[2] > 0.0, obstacles.upper[:, None], obstacles.lower[:, None]),
        )
    )


def _in_frame(flange: Array, points: Array) -> Array:
    """Return points (3, ..., S) in frames (..., 4, 4)."""
    shifted = points - np.moveaxis(flange[..., :3, 3], -1, 0)[..., None]
    result: Array = np.einsum("...ij,i...s->j...s", flange[..., :3, :3], shifted)
    return result
