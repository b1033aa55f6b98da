"""What scanners send where a beam meets nothing: REP 117 and what came before it."""

import math

from omniman_ros.core.arrays import Array

REP_117, ZERO, NAN, RANGE_MAX = "rep_117", "zero", "not_a_number", "range_max"
#: Values that may mean that a beam meets nothing within range: infinity, as in REP 117, or also 0,
#: NaN, or the longest range and more. None of the names is a number in YAML, as inf and nan are.
NO_RETURN = (REP_117, ZERO, NAN, RANGE_MAX)
#: Fraction of the longest range by which a measurement of it may fall short of it [-]
ROUND_OFF = 1e-3


def rep117_ranges(ranges: Array, range_min: float, range_max: float, no_return: str) -> Array:
    """Return ranges (N,) in the terms of `Scan` [m]; `no_return` is one of `NO_RETURN`."""
    result = ranges.copy()
    if no_return == ZERO:
        result[ranges == 0.0] = math.inf
    elif no_return == NAN:
        result[ranges != ranges] = math.inf
    elif no_return == RANGE_MAX:
        result[ranges >= (1.0 - ROUND_OFF) * range_max] = math.inf
    result[(result < range_min) & (result != 0.0)] = -math.inf
    return result
