"""Convert between messages and maps of occupancy."""

from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import Header

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import is_stamped, time_seconds
from omniman_ros.core.arrays import Array
from omniman_ros.surroundings.occupancy import MapUpdate, OccupancyMap, cells_of


def map_from_message(message: OccupancyGrid) -> OccupancyMap:
    """Return the map of a message, in the frame of its header without a leading slash.

    Raises:
        InputError: The number of cells is not what the message states, or the map is refused; see
            `OccupancyMap`.
    """
    info, position = message.info, message.info.origin.position
    values = np.asarray(message.data, dtype=np.int8)
    return OccupancyMap(
        cells_of(values, info.width, info.height),
        float(info.resolution),
        np.array([position.x, position.y, yaw_from_quaternion(info.origin.orientation)]),
        message.header.frame_id.lstrip("/"),
        _stamp_seconds(message.header),
    )


def map_update_from_message(message: Any) -> MapUpdate:
    """Return the update of a `map_msgs/OccupancyGridUpdate`; raise InputError for a wrong size."""
    values = np.asarray(message.data, dtype=np.int8)
    return MapUpdate(
        cells_of(values, message.width, message.height),
        message.x,
        message.y,
        message.header.frame_id.lstrip("/"),
        _stamp_seconds(message.header),
    )


def map_message(
    occupancy: NDArray[np.int8], resolution: float, origin: Array, frame: str, stamp: Time
) -> OccupancyGrid:
    """Return the message for a map.

    Args:
        occupancy: (rows along y, columns along x) occupancy [%], -1 where nothing is known.
        resolution: Edge of a cell [m].
        origin: (2,) corner of the first cell [m].
    """
    message = OccupancyGrid(header=Header(stamp=stamp, frame_id=frame))
    info = message.info
    info.map_load_time = stamp
    info.resolution = float(resolution)
    info.height, info.width = occupancy.shape
    info.origin.position.x, info.origin.position.y = origin.tolist()
    info.origin.orientation.w = 1.0
    message.data = array("b", occupancy.tobytes())
    return message


def map_update_message(
    kind: Any, occupancy: NDArray[np.int8], part: tuple[slice, slice], frame: str, stamp: Time
) -> Any:
    """Return the message for a rectangle of a map.

    Args:
        kind: The type, `map_msgs/OccupancyGridUpdate`, which is not installed everywhere.
        occupancy: (rows along y, columns along x) occupancy of the whole map [%].
    """
    rows, columns = part
    message = kind(header=Header(stamp=stamp, frame_id=frame))
    message.x, message.y = columns.start, rows.start
    message.width, message.height = columns.stop - columns.start, rows.stop - rows.start
    message.data = array("b", occupancy[part].tobytes())
    return message


def _stamp_seconds(header: Header) -> float | None:
    """Return the stamp of a header [s]; None without one."""
    return time_seconds(header.stamp) if is_stamped(header.stamp) else None
