"""Judgement of a motion by its ground truth: when it began to brake, when it was at rest.

The judge knows speeds over time, and neither the robot nor its limits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array

#: fraction of the speed before the fault below which a motion has begun to brake
BRAKED_FRACTION = 0.95
STEADY_TIME = 0.2  #: time before the fault over which the speed is averaged [s]
WINDOW = 0.06  #: time over which a deceleration is averaged [s]


@dataclass(frozen=True)
class StopMeasurement:
    """What became of a motion after a fault."""

    speed: float  #: speed before the fault [m/s or rad/s]
    #: Time from the fault until the motion had begun to brake for good [s]; infinite if it did
    #: not.
    reaction: float
    rest: float  #: time from the fault from which on it was at rest [s]; infinite if it was not
    deceleration: float  #: largest deceleration of the speed [m/s^2 or rad/s^2]
    fastest: float  #: largest speed after the fault [m/s or rad/s]


#: What became of a motion that was not seen
UNKNOWN = StopMeasurement(math.nan, math.inf, math.inf, math.nan, math.nan)


def judge_stop(
    times: Array, speeds: Array, fault: float, end: float, still: float
) -> StopMeasurement:
    """Judge a motion from its speeds.

    Args:
        times: Times (m,) of the samples, increasing [s].
        speeds: Speeds (m,) at these times [m/s or rad/s], not negative.

    Returns:
        The judgement. Without samples before or after the fault, nothing has happened.
    """
    before = (times >= fault - STEADY_TIME) & (times <= fault)
    after = (times > fault) & (times <= end)
    if not before.any() or not after.any():
        return UNKNOWN
    speed = float(np.median(speeds[before]))
    stamps, values = times[after] - fault, speeds[after]
    return StopMeasurement(
        speed=speed,
        reaction=_time_since(stamps, values < BRAKED_FRACTION * speed),
        rest=_time_since(stamps, values < still),
        deceleration=_largest_deceleration(stamps, values),
        fastest=float(values.max()),
    )


def _time_since(times: Array, holds: NDArray[np.bool_]) -> float:
    """Return the first time from which on a condition holds until the end; infinite if none is."""
    fails = np.flatnonzero(~holds)
    first = fails[-1] + 1 if len(fails) else 0
    return float(times[first]) if first < len(times) else math.inf


def _largest_deceleration(times: Array, speeds: Array) -> float:
    """Return the largest decrease of the speed within `WINDOW`, per time; 0 if there is none."""
    later = np.searchsorted(times, times + WINDOW)
    known = later < len(times)
    spans = times[later[known]] - times[known]
    changes = speeds[known] - speeds[later[known]]
    return float(max((changes / spans).max(initial=0.0), 0.0))


def largest_change(times: Array, values: Array, start: float, end: float) -> float:
    """Return how far values (m, k) went from the first one within a time [unit of the values]."""
    within = (times >= start) & (times <= end)
    if not within.any():
        return 0.0
    return float(np.abs(values[within] - values[within][0]).max())
