"""Read what others perceive: tracked obstacles and contacts of a simulated world."""

from collections.abc import Mapping

import numpy as np
from sensor_msgs.msg import PointCloud2

from omniman_ros.conversions.scans import cloud_fields
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: Fields of a tracked obstacle that are read, in this order
TRACK_FIELDS = ("x", "y", "vx", "vy", "radius", "position_variance", "velocity_variance")


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


def contact_position(values: Mapping[str, str]) -> tuple[Array, float]:
    """Return the place (3,) [m] and the force [N] of a contact in `contacts_message`.

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
