"""Messages of the arm to core and back: pure functions without a node."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.arm.joint_preview import ACCELERATION, ANGLE, MAX_POINTS, SPEED
from omniman_ros.conversions import time_seconds
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]


def joint_preview(
    message: JointTrajectory, start: float, names: Sequence[str]
) -> tuple[Array, Array, Array, Array | None]:
    """Times, positions, velocities and accelerations for a `JointPreview`, joints in our order.

    Args:
        message: Positions and velocities (needed), accelerations (all or none) of all joints.
        start: Time of the header's stamp on the receiver's clock [s].
        names: Of the joints.

    Raises:
        InputError: Other joints, wrong sizes, too many points, or not finite.
    """
    given = list(message.joint_names)
    if sorted(given) != sorted(names):
        shown = ", ".join(name[:40] for name in given[:12])
        raise InputError(f"joints {shown or '(none)'}, expected {', '.join(names)}")
    if not 1 <= len(message.points) <= MAX_POINTS:
        raise InputError(f"{len(message.points)} points, 1 to {MAX_POINTS} are taken")
    order = [given.index(name) for name in names]
    times = [start + time_seconds(point.time_from_start) for point in message.points]
    arrays: list[Array | None] = []
    for label, bound in (
        ("positions", ANGLE),
        ("velocities", SPEED),
        ("accelerations", ACCELERATION),
    ):
        rows = [getattr(point, label) for point in message.points]
        sizes = {len(row) for row in rows}
        if sizes == {0} and label == "accelerations":
            arrays.append(None)
            continue
        if sizes != {len(names)}:
            raise InputError(f"{label}: {sorted(sizes)} values a point for {len(names)} joints")
        array = np.array(rows, dtype=float)[:, order]
        plausible.demand(array, bound, label)
        arrays.append(array)
    positions, velocities, accelerations = arrays
    assert positions is not None and velocities is not None
    return np.array(times), positions, velocities, accelerations
