"""What beams without a measurement mean, and what is said of a scanner with too many of them."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.perception.no_return import (
    NAN,
    NO_RETURN,
    RANGE_MAX,
    REP_117,
    ZERO,
    rep117_ranges,
)
from omniman_ros.perception.scan import Scan
from omniman_ros.perception.scan_check import ScanCheck, ScanCheckParameters

inf, nan = math.inf, math.nan
RANGE_MIN, RANGE_MAX_M = 0.1, float(np.float32(30.3))
SENT = np.array([inf, -inf, nan, 0.0, 0.05, 2.0, RANGE_MAX_M, 65.533, RANGE_MAX_M - 0.01])
MEANT = {
    REP_117: [inf, -inf, nan, 0.0, -inf, 2.0, RANGE_MAX_M, 65.533, RANGE_MAX_M - 0.01],
    ZERO: [inf, -inf, nan, inf, -inf, 2.0, RANGE_MAX_M, 65.533, RANGE_MAX_M - 0.01],
    NAN: [inf, -inf, inf, 0.0, -inf, 2.0, RANGE_MAX_M, 65.533, RANGE_MAX_M - 0.01],
    RANGE_MAX: [inf, -inf, nan, 0.0, -inf, 2.0, inf, inf, inf],
}


@pytest.mark.parametrize("no_return", NO_RETURN)
def test_only_the_declared_value_and_infinity_mean_that_nothing_is_in_range(no_return):
    found = rep117_ranges(SENT, RANGE_MIN, RANGE_MAX_M, no_return)
    np.testing.assert_array_equal(found, MEANT[no_return])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"increment": 0.0}, "its beams span 0.000 rad"),
        ({"increment": -0.7}, "its beams span 6.300 rad"),
        ({"range_max": 0.0}, "range_max is 0.0 m"),
        ({"beam_time": -0.01}, "time_increment is -0.01 s"),
        ({"beam_time": 0.11}, "time_increment is 0.11 s"),
    ],
)
def test_a_scan_that_no_scanner_makes_is_refused(change, text):
    numbers = {"angle_min": 0.0, "increment": 0.6, "range_max": 30.0, "beam_time": 0.1} | change
    with pytest.raises(InputError, match=f"^{text}, expected"):
        Scan(time=0.0, ranges=np.ones(10), mount=(0.0, 0.0, 0.0), **numbers)


def fault(*beams):
    """Return the fault of a scan of (count, range) beams that was sent as in REP 117."""
    sent = np.concatenate([np.full(count, value) for count, value in beams])
    ranges = rep117_ranges(sent, RANGE_MIN, RANGE_MAX_M, REP_117)
    scan = Scan(0.0, ranges, 0.0, 0.01, RANGE_MAX_M, (0.0, 0.0, 0.0))
    return ScanCheck().fault(scan, np.zeros(3), build(ScanCheckParameters, {}))


@pytest.mark.parametrize(("value", "word"), [(0.0, ZERO), (nan, NAN)])
def test_an_open_hall_of_such_beams_names_the_parameter_that_would_help(value, word):
    text = fault((90, value), (5, 0.05), (5, 2.0))
    assert text.startswith("covered: 95 % of the beams measure nothing; 90 % are ")
    assert f"set scanners.no_return to {word}" in text


@pytest.mark.parametrize("near", [0.05, -inf])
def test_a_covered_scanner_is_not_told_that_its_beams_may_be_free(near):
    assert fault((90, near), (5, 0.0), (5, 2.0)) == "covered: 95 % of the beams measure nothing"
