"""Conversion of joint states to arrays with the joints in a given order."""

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import PLANAR_VARIABLES, PLATFORM_AXES

#: Names of the platform's axes by those of the variables of its planar joint
_AXES = dict(zip(PLANAR_VARIABLES, PLATFORM_AXES, strict=True))


def axis_names(names: Sequence[str]) -> list[str]:
    """Return names of axes in place of names of the variables of the planar joint."""
    return [_AXES.get(name, name) for name in names]


def joint_arrays(
    message: JointState, names: Sequence[str]
) -> tuple[Array | None, Array | None, Array | None]:
    """Return positions, velocities and efforts (n,) of a joint state, in the order of `names`.

    An array that is empty in the message is None. Joints that are not in `names` are ignored.

    Raises:
        InputError: A joint is missing, a name is repeated, or an array and the names in the
            message differ in length.
    """
    received = message.name
    parts = []
    for label in ("position", "velocity", "effort"):
        values = getattr(message, label)
        if len(values) not in (0, len(received)):
            raise InputError(f"there are {len(values)} {label} values for {len(received)} names")
        parts.append(np.array(values, dtype=float) if len(values) else None)
    if list(received) == list(names):
        return parts[0], parts[1], parts[2]
    if len(set(received)) != len(received):
        raise InputError(f"a name is repeated among {abbreviate_names(received)}")
    missing = [name for name in names if name not in received]
    if missing:
        raise InputError(
            f"there is no {', '.join(missing)} among the names {abbreviate_names(received)}"
        )
    order = [received.index(name) for name in names]
    position, velocity, effort = (None if part is None else part[order] for part in parts)
    return position, velocity, effort


def abbreviate_names(names: Sequence[str]) -> str:
    """Return the first eight names as a list for an error message; long names are cut off."""
    shown = ", ".join(name[:40] for name in names[:8])
    return f"{shown}, ..." if len(names) > 8 else shown or "(none)"


def require_array(array: Array | None, bound: float, label: str) -> Array:
    """Return an array after checking that it is present, finite and within +-`bound`.

    Raises:
        InputError: It is missing, or a value is not finite or beyond the bound, in its unit.
    """
    if array is None:
        raise InputError(f"it has no {label}")
    plausible.demand(array, bound, label)
    return array
