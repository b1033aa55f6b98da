"""Read what others perceive: maps, tracked obstacles and contacts of a simulated world."""

import math
from collections.abc import Mapping

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.scans import cloud_fields
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

TRACK_FIELDS = ("x", "y", "vx", "vy", "radius", "position_variance", "velocity_variance")
"""Fields of a tracked obstacle that are read, in this order."""
MOST_CELLS = 25_000_000
"""Largest number of cells of a map."""


def occupancy(message: OccupancyGrid) -> tuple[NDArray[np.int8], float, Array]:
    """Return a map's cells, their size, and where the first one is.

    Returns:
        (rows along y, columns along x) occupancies [%], -1 where nothing is known; edge of a cell
        [m]; (3,) pose of the corner of the first cell in the frame of the message [m, m, rad].

    Raises:
        InputError: The numbers do not fit together, or are not finite or plausible.
    """
    info = message.info
    count = info.width * info.height
    if not 0 < count <= MOST_CELLS or len(message.data) != count:
        raise InputError(
            f"{info.width} x {info.height} cells, expected 1 to {MOST_CELLS}, but "
            f"{len(message.data)} values"
        )
    resolution = float(info.resolution)
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise InputError(f"resolution {resolution} m must be above 0")
    position = info.origin.position
    corner = np.array([position.x, position.y, yaw_from_quaternion(info.origin.orientation)])
    plausible.demand(corner, plausible.LENGTH, "origin")
    plausible.demand(resolution * np.array([info.width, info.height]), plausible.LENGTH, "size")
    cells = np.asarray(message.data, dtype=np.int8).reshape(info.height, info.width)
    return cells, resolution, corner


def tracked_obstacles(message: PointCloud2) -> Array:
    """Return tracked obstacles as rows (M, 7) with the columns `TRACK_FIELDS`.

    Raises:
        InputError: A field is missing, a number is not finite or plausible, or a radius or a
            variance is negative.
    """
    rows = cloud_fields(message, TRACK_FIELDS)
    plausible.demand(rows, plausible.LENGTH, "tracks")
    if rows.size and float(rows[:, 4:].min()) < 0.0:
        raise InputError("a radius or a variance is negative")
    return rows


def contact_place(values: Mapping[str, str]) -> tuple[Array, float]:
    """Return the place (3,) [m] and the force [N] of a contact.

    Args:
        values: Values of the contact by key, see `contacts_message`.

    Raises:
        InputError: A number is missing, or is not finite or plausible.
    """
    try:
        numbers = np.array(
            [float(values[f"{kind}{axis}"]) for kind in ("", "force_") for axis in "xyz"]
        )
    except (KeyError, ValueError) as error:
        raise InputError(f"a contact without place or force: {error}") from error
    plausible.demand(numbers, plausible.LENGTH, "place and force")
    return numbers[:3], float(np.linalg.norm(numbers[3:]))
