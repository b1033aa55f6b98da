"""Conversion of an occupancy grid into a map of obstacles."""

from collections.abc import Sequence

import numpy as np
from nav_msgs.msg import OccupancyGrid

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.planning.obstacles.grid_map import GridMap


def grid_map(
    message: OccupancyGrid, frames: Sequence[str], threshold: int, unknown_is_free: bool
) -> GridMap:
    """Return the map of a message.

    Args:
        message: Cells, row by row, and the pose of the first cell's corner.
        frames: Frames that the message may be in.
        threshold: Occupancy from which on a cell counts as occupied [%].
        unknown_is_free: Whether cells of unknown occupancy are free.

    Raises:
        InputError: The frame is not allowed, or the origin is not planar; see also `GridMap`.
    """
    check_frame(message.header.frame_id, *frames)
    info = message.info
    position, theta = info.origin.position, yaw_from_quaternion(info.origin.orientation)
    return GridMap.of_occupancy(
        np.asarray(message.data, dtype=np.int8),
        info.width,
        info.height,
        info.resolution,
        np.array([position.x, position.y, theta]),
        threshold,
        unknown_is_free,
    )
