"""Convert between messages and when an occluded pedestrian could be where.

A cell of the grid is 100 where a pedestrian may be now, falls to 0 where none can be within
`HORIZON`, and is -1 where none can be at all. Viewers of maps draw it like that.
"""

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray

from omniman_ros.collision.unseen import Arrivals
from omniman_ros.conversions.maps import map_from_message, map_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.perception.unseen import HORIZON

NOW, NEVER = 100, -1
"""Values of a cell where a pedestrian may be now, and where none can be."""


def unseen_message(
    times: Array, resolution: float, origin: Array, frame: str, stamp: Time
) -> OccupancyGrid:
    """Return the message for times of arrival from its stamp on.

    Args:
        times: (rows along y, columns along x) [s]; NaN where none can be.
        resolution: Edge of a cell [m].
        origin: (2,) corner of the first cell [m].
    """
    # Rounded up: towards an earlier arrival.
    values = np.ceil(NOW * (1.0 - np.minimum(times, HORIZON) / HORIZON))
    cells: NDArray[np.int8] = np.where(np.isnan(times), NEVER, values).astype(np.int8)
    return map_message(cells, resolution, origin, frame, stamp)


def arrivals_from_message(message: OccupancyGrid) -> Arrivals:
    """Return the times of arrival of a message, from its stamp on.

    Raises:
        InputError: A value is out of range, or the grid is turned; see also `map_from_message` and
            `Arrivals`.
    """
    grid = map_from_message(message)
    values = grid.values
    if values.min() < NEVER or values.max() > NOW:
        raise InputError(f"a cell is not {NEVER} to {NOW}")
    if abs(grid.origin[2]) > 1e-6:
        raise InputError("its grid is turned against its frame")
    times = HORIZON * (1.0 - values / NOW)
    times[values <= 0] = np.inf
    return Arrivals(times, grid.resolution, grid.origin[:2])
