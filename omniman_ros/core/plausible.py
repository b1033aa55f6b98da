"""Bounds of plausible input: NaN, infinity and huge numbers are refused."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

LENGTH = 1e6  #: Largest plausible coordinate [m]
ANGLE = 1e6  #: Largest plausible angle of a pose or a rotation [rad]
SPEED = 1e3  #: Largest plausible speed of a platform [m/s, rad/s]
ACCELERATION = 1e5  #: Largest plausible acceleration of a platform [m/s^2, rad/s^2]
YAW_RATE = 1e3  #: Largest plausible angular velocity that an inertial sensor measures [rad/s]
SPECIFIC_FORCE = 1e5  #: Largest plausible acceleration that an inertial sensor measures [m/s^2]
WHEEL_ANGLE = 1e12  #: Largest plausible unwrapped position of a wheel [rad]
WHEEL_SPEED = 1e5  #: Largest plausible speed of a wheel [rad/s]
COVARIANCE = 1e12  #: Largest plausible entry of a pose's covariance [m^2, rad^2]
EFFORT = 1e6  #: Largest plausible torque or voltage [N m, V]

MAX_SHOWN = 8  #: Number of values that an error message shows at most


def demand(values: Array, bound: float, label: str) -> None:
    """Check that all numbers are finite and within +-`bound`.

    Args:
        bound: Largest plausible magnitude, in the unit of the values.

    Raises:
        InputError: A value is NaN, infinite or beyond the bound. The message has the label and
            the values; of many values, only those at fault.
    """
    if values.size and not float(np.abs(values).max()) <= bound:
        within = np.abs(values) <= bound
        shown = values if values.size <= MAX_SHOWN else values[~within][:MAX_SHOWN]
        raise InputError(f"{label} {shown.tolist()} are not finite or beyond +-{bound:g}")
