"""ROS time of messages that have no stamp of their own."""

import numpy as np

from omniman_ros.core.arrays import Array


class ArrivalClock:
    """Converts times of arrival to ROS time, by messages that have a stamp.

    The two differ much if time is simulated.
    """

    def __init__(self) -> None:
        self._arrivals: list[float] = []
        self._offsets: list[float] = []

    def add(self, arrival: float, stamp: float) -> None:
        """Add the arrival and the stamp of a message [s], in the order of arrival."""
        self._arrivals.append(arrival)
        self._offsets.append(stamp - arrival)

    def to_ros_time(self, arrivals: Array) -> Array:
        """Return the ROS times of arrivals (k,) [s]; the arrivals where no stamp is known."""
        if not self._arrivals:
            return arrivals
        return np.asarray(arrivals + np.interp(arrivals, self._arrivals, self._offsets))
