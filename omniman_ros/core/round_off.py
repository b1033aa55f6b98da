"""Round-off that planners leave in what they send: how far it counts as equal, per quantity."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: Speed up to which a motion that is given ends at rest [m/s, rad/s].
#:
#: It is a twentieth of the speed at which a measured axis rests. Planners leave about 1e-4.
REST_SPEED = 1e-3
#: Time up to which two points of a motion are at one instant [s].
#:
#: A point each 0.1 ms is more than any planner gives. Single precision leaves 1e-5 s after two
#: minutes.
SAME_TIME = 1e-5
#: Distance up to which two points are at one position [m, rad].
#:
#: It is a hundredth of the distance at which a measured axis has reached its goal.
SAME_POSITION = 1e-4


def is_rest(velocity: Array) -> bool:
    """Return whether a velocity of any shape [m/s, rad/s] is zero but for round-off."""
    return velocity.size == 0 or float(np.abs(velocity).max()) <= REST_SPEED


def ended(velocities: Array) -> Array:
    """Return velocities (k, d) of a motion [m/s, rad/s]: if it ends at rest, exactly so."""
    if not velocities[-1].any() or not is_rest(velocities[-1]):
        return velocities
    result = velocities.copy()
    result[-1] = 0.0
    return result


def distinct(times: Array, positions: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the points of a motion without repeats, of which the last counts.

    Args:
        times: Times (k,) of the points [s].
        positions: Positions (k, d) [m, rad].

    Returns:
        Times (j,) that increase [s], and the indices (j,) of the points.

    Raises:
        InputError: Times do not increase; the message has the first two points of which that is
            true.
    """
    if (np.diff(times) > SAME_TIME).all():
        return times, np.arange(len(times))
    starts, rows = [float(times[0])], [0]
    for i in range(1, len(times)):
        gap = float(times[i]) - starts[-1]
        if gap > SAME_TIME:
            starts.append(float(times[i]))
            rows.append(i)
            continue
        moved = float(np.abs(positions[i] - positions[rows[-1]]).max(initial=0.0))
        if gap < -SAME_TIME or moved > SAME_POSITION:
            raise InputError(
                f"the times do not increase: point {rows[-1]} at {starts[-1]:g} s, point {i} at "
                f"{times[i]:g} s, {moved:.3g} m or rad apart"
            )
        rows[-1] = i
    return np.array(starts), np.array(rows)
