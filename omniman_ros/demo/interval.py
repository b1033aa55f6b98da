"""Intervals of ROS time in which the demo measures."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array


@dataclass(frozen=True)
class Interval:
    """A named interval of ROS time, both ends included; without bounds it contains no time.

    Attributes:
        name: Name of the motion that was driven.
        start: ROS time of the start [s].
        end: ROS time of the end [s].
    """

    name: str = ""
    start: float = math.nan
    end: float = math.nan

    def contains(self, times: Array) -> NDArray[np.bool_]:
        """Return which of the times (k,) lie in the interval."""
        return (times >= self.start) & (times <= self.end)
