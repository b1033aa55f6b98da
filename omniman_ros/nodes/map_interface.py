"""The map of fixed obstacles, which stays in its own frame."""

import math
from collections.abc import Callable

import numpy as np
from nav_msgs.msg import OccupancyGrid

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.core import se2
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.transform_tree import Placement
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.planning.obstacles.grid_map import GridMap

MOST_SHIFT = 0.005
"""Distance by which a map may be wrong where the robot is, before it is moved [m]."""
MOST_TURN = 0.002
"""Angle by which a map may be wrong before it is moved [rad]: 1 cm at a distance of 5 m."""


def grid_map(
    message: OccupancyGrid, placement: Placement, threshold: int, unknown_is_free: bool
) -> GridMap:
    """Return the map of a message, in the frame of its placement.

    Args:
        message: Cells, row by row, and the pose of the first cell's corner.
        placement: Place of the message's coordinates.
        threshold: Occupancy from which on a cell counts as occupied [%].
        unknown_is_free: Whether cells of unknown occupancy are free.

    Raises:
        InputError: The origin or the placement is not planar; see also `GridMap`.
    """
    info = message.info
    position, theta = info.origin.position, yaw_from_quaternion(info.origin.orientation)
    origin = se2.compose(placement.transform.planar(), (position.x, position.y, theta))
    return GridMap.of_occupancy(
        np.asarray(message.data, dtype=np.int8),
        info.width,
        info.height,
        info.resolution,
        np.array(origin),
        threshold,
        unknown_is_free,
    )


class MapInterface:
    """Keeps the last map, and says where it is in odom whenever that has changed.

    Args:
        frames: Transforms of the node.
        use: Called with the map in odom.
    """

    def __init__(self, frames: FrameTransforms, use: Callable[[GridMap], None]) -> None:
        self._frames, self._use = frames, use
        self._grid: GridMap | None = None
        self._received: tuple[OccupancyGrid, Placement] | None = None
        self._rule: tuple[int, bool] | None = None
        self._frame = ""
        self._anchor: PlanarPose = (0.0, 0.0, 0.0)

    def receive(self, message: OccupancyGrid, threshold: int, unknown_is_free: bool) -> GridMap:
        """Keep and return the map of a message; see :func:`grid_map`.

        Raises:
            InputError: The map is refused; the last one stays.
        """
        placement = self._frames.placement(message.header)
        grid = grid_map(message, placement, threshold, unknown_is_free)
        anchor = self._frames.anchor(placement.frame).planar()
        self._received, self._rule = (message, placement), (threshold, unknown_is_free)
        self._grid, self._frame = grid, placement.frame
        self._place(anchor)
        return grid

    def configure(self, threshold: int, unknown_is_free: bool) -> None:
        """Read the cells of the last map by another threshold, or unknown cells otherwise.

        A latched map may be sent only once, so the one that is kept has to follow its parameters.

        Args:
            threshold: Occupancy from which on a cell counts as occupied, 1 to 100 [%].
            unknown_is_free: Whether cells of unknown occupancy are free.
        """
        rule = (threshold, unknown_is_free)
        if self._received is None or rule == self._rule:
            return
        self._grid, self._rule = grid_map(*self._received, *rule), rule
        self._place(self._anchor)

    def update(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom.

        Args:
            robot: Pose of the robot in odom, near which the map has to be right [m, m, rad].
        """
        if self._grid is None:
            return
        anchor = self._frames.anchor(self._frame).planar()
        if anchor == self._anchor:
            return
        x, y, theta = se2.displacement(self._anchor, anchor, robot)
        if math.hypot(x, y) > MOST_SHIFT or abs(theta) > MOST_TURN:
            self._place(anchor)

    def _place(self, anchor: PlanarPose) -> None:
        assert self._grid is not None
        self._anchor = anchor
        self._use(self._grid if not self._frame else self._grid.displaced(anchor))
