"""An occupancy grid into a map of the floor."""

from collections.abc import Sequence

import numpy as np
from nav_msgs.msg import OccupancyGrid

from omniman_ros import conversions
from omniman_ros.planning.grid_map import GridMap


def grid(
    message: OccupancyGrid, frames: Sequence[str], threshold: int, unknown_is_free: bool
) -> GridMap:
    """The map of a message.

    Args:
        message: Cells, row by row, and the pose of the corner of the first.
        frames: Which its frame may be.
        threshold: A cell of this many percent or more is occupied.
        unknown_is_free: Whether a cell of which nothing is known is free.

    Raises:
        InputError: Wrong frame, an origin that is not planar, or see `GridMap`.
    """
    conversions.check_frame(message.header.frame_id, *frames)
    info = message.info
    place, theta = info.origin.position, conversions.yaw(info.origin.orientation)
    return GridMap.of_occupancy(
        np.asarray(message.data, dtype=np.int8), info.width, info.height, info.resolution,
        np.array([place.x, place.y, theta]), threshold, unknown_is_free,
    )  # fmt: skip
