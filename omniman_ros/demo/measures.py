"""Intervals in which the demo measures, and the limits of its figures."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array


@dataclass(frozen=True)
class Interval:
    """A named interval of ROS time, both ends included."""

    name: str  #: Name of the motion that was driven
    start: float  #: [s]
    end: float  #: [s]

    def contains(self, times: Array) -> NDArray[np.bool_]:
        """Return which of the times (k,) lie in the interval."""
        return (times >= self.start) & (times <= self.end)


class Bound(Enum):
    """How a figure is compared with its limit; the values are the words of a report."""

    AT_MOST = "at most"
    AT_LEAST = "at least"
    ABOVE = "above"


@dataclass(frozen=True)
class Limit:
    """A limit of one figure of the demo's result; a maximum applies to the magnitude."""

    figure: str  #: Keys in the result, separated by dots; of a list, the limit is each item's
    name: str  #: Quantity and unit, for reports
    value: float  #: The limit, in that unit
    bound: Bound = Bound.AT_MOST

    def holds(self, value: float) -> bool:
        """Return whether a value is within the limit; NaN never is."""
        if self.bound is Bound.AT_MOST:
            return abs(value) <= self.value
        return value >= self.value if self.bound is Bound.AT_LEAST else value > self.value


LIMITS = (
    Limit("tracking.rms_mm", "tracking RMS, mm", 5.0),
    Limit("tracking.max_mm", "tracking max, mm", 20.0),
    Limit("tracking.final_mm", "final position, mm", 10.0),
    Limit("tracking.final_heading_deg", "final heading, deg", 1.0),
    Limit("contacts.count", "things that the robot touched", 0.0),
    Limit("odometry.position_mm", "odometry position, mm", 100.0),
    Limit("odometry.heading_deg", "odometry heading, deg", 6.0),
    Limit("timing.odom.rate_hz", "odom rate, Hz", 80.0, Bound.AT_LEAST),
    Limit("timing.wheel_commands.rate_hz", "wheel_commands rate, Hz", 160.0, Bound.AT_LEAST),
    Limit("goal.position_mm", "goal position, mm", 40.0),
    Limit("goal.heading_deg", "goal heading, deg", 3.0),
    Limit("goal.clearance_m", "clearance of the obstacles, m", 0.0, Bound.ABOVE),
    Limit("arm.final_mrad", "arm final position, mrad", 3.0),
    Limit("arm.lag_ms", "arm behind its reference, ms", 100.0),
    Limit("arm.rms_mrad", "arm off its path, mrad", 10.0),
    Limit("tool.rms_mm", "tool off its path RMS, mm", 2.0),
    Limit("tool.max_mm", "tool off its path max, mm", 5.0),
    Limit("tool.clearance_m", "clearance on the tool's path, m", 0.0, Bound.ABOVE),
    Limit("dead_wheel.noticed_s", "dead wheel noticed, s", 2.0),
    Limit("dead_wheel.rms_mm", "tracking without a wheel RMS, mm", 20.0),
    Limit("emergency_stop.rest_s", "at rest after an emergency stop, s", 1.0),
    Limit("emergency_stop.arm_rest_s", "arm at rest after an emergency stop, s", 1.0),
    Limit("emergency_stop.moved_mm", "moved after the reset, mm", 1.0),
    Limit("emergency_stop.arm_moved_mrad", "arm moved after the reset, mrad", 1.0),
    Limit("twists.linear_m_s", "twist error, m/s", 0.03),
    Limit("twists.angular_rad_s", "twist error, rad/s", 0.05),
)  #: All limits of the demo


def violations(result: Mapping[str, Any], limits: Iterable[Limit] = LIMITS) -> list[str]:
    """Return a sentence for each figure of the result that is beyond its limit.

    A figure that is missing violates nothing.
    """
    return [
        f"{limit.name}: {value:.3g}, {limit.bound.value} {limit.value:g}"
        for limit in limits
        for value in _values(result, limit.figure.split("."))
        if not limit.holds(value)
    ]


def _values(item: Any, keys: list[str]) -> Iterator[float]:
    """Yield the values under the keys, through lists and mappings."""
    if isinstance(item, list):
        for inner in item:
            yield from _values(inner, keys)
    elif not keys:
        yield item
    elif keys[0] in item:
        yield from _values(item[keys[0]], keys[1:])
