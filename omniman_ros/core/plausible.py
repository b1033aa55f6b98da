"""Bounds of what a message may say: NaN, infinity and huge numbers are no input."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError

LENGTH = 1e6
"""Largest coordinate [m]."""
ANGLE = 1e6
"""Largest angle of a pose or a turn [rad]."""
SPEED = 1e3
"""Largest speed of a platform [m/s, rad/s]."""
ACCELERATION = 1e5
"""Largest acceleration of a platform [m/s^2, rad/s^2]."""
WHEEL_ANGLE = 1e12
"""Largest unwrapped position of a wheel [rad]."""
WHEEL_SPEED = 1e5
"""Largest speed of a wheel [rad/s]."""
COVARIANCE = 1e12
"""Largest entry of a pose's covariance [m^2, rad^2]."""
EFFORT = 1e6
"""Largest torque or voltage [N m, V]."""

FEW = 8
"""So many numbers are shown in a message."""


def demand(values: NDArray[np.float64], bound: float, label: str) -> None:
    """Demand finite numbers within +-bound.

    Raises:
        InputError: One is NaN, infinite or beyond the bound; the message has label and values
            (the bad ones among many).
    """
    if values.size and not float(np.abs(values).max()) <= bound:
        shown = values if values.size <= FEW else values[~(np.abs(values) <= bound)][:FEW]
        raise InputError(f"{label} {shown.tolist()} not finite or beyond +-{bound:g}")
