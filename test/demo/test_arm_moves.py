"""Errors of the arm relative to its reference."""

import pytest

from omniman_ros.demo.arm_moves import arm_figures
from test.demo.samples import arm_run


def test_the_lag_of_the_arm_is_separated_from_its_error():
    recording, _, moves = arm_run(lag=0.04)
    figures = arm_figures(recording, moves)
    assert figures["moves"] == 2
    assert figures["lag_ms"] == pytest.approx(40.0, abs=2.1)
    assert figures["rms_mrad"] < 1.0
    assert figures["final_mrad"] < 12.0, "the last sample is up to 8 ms old"
    assert figures["travel_rad"] == pytest.approx(4.0, rel=0.3)
    assert figures["setpoints"]["p99_ms"] == pytest.approx(8.0)
