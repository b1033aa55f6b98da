"""Errors of the platform relative to its reference."""

import math

import numpy as np
import pytest

from omniman_ros.demo.interval import Interval
from omniman_ros.demo.tracking import Reference, coupling_figures, tracking_figures
from test.demo.samples import MOVEMENTS, START, odometry_rows, perfect_run, reference_rows


def test_a_robot_without_constraints_has_no_coupling_error():
    none = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    assert coupling_figures([(0.0,), (0.1,)], MOVEMENTS) == none


def test_the_coupling_error_of_a_path_counts_from_its_start():
    before = [(START - 2.0, 0.1), (START - 0.1, 0.4), (START + 1.0, 0.4), (START + 2.0, 0.6)]
    assert coupling_figures(before, MOVEMENTS[:1])["max_rad"] == pytest.approx(0.2)


def test_the_tracking_error_is_taken_at_the_stamps():
    reference = Reference(reference_rows())
    result = tracking_figures(odometry_rows((0.003, 0.004, 0.01)), reference, MOVEMENTS)
    assert result["rms_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["max_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["final_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["heading_rms_deg"] == pytest.approx(math.degrees(0.01), abs=0.01)
    delayed = tracking_figures(odometry_rows(delay=0.02), reference, MOVEMENTS)
    assert delayed["rms_mm"] > 5.0


def test_a_heading_that_is_a_full_turn_away_is_the_same_heading():
    odom = odometry_rows((0.0, 0.0, math.tau))
    result = tracking_figures(odom, Reference(reference_rows()), MOVEMENTS)
    assert result["heading_max_deg"] == pytest.approx(0.0, abs=0.01)


def test_a_pose_after_the_path_is_not_the_final_one():
    recording, _ = perfect_run()
    odom = np.array(recording.odom)
    later = odom[-1] + np.array([3.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0])
    reference = Reference(recording.reference)
    result = tracking_figures(np.vstack([odom, later]), reference, MOVEMENTS)
    assert result["final_mm"] == pytest.approx(0.0, abs=0.01)
    assert result["final_heading_deg"] == pytest.approx(0.0, abs=0.01)


def test_only_the_movements_count():
    odom = odometry_rows()
    between = (odom[:, 0] > START + 5.01) & (odom[:, 0] < START + 5.99)
    odom[between, 1] += 1.0
    assert tracking_figures(odom, Reference(reference_rows()), MOVEMENTS)["max_mm"] < 0.1


@pytest.mark.parametrize(
    ("rows", "movements"),
    [([], MOVEMENTS), (reference_rows(), []), (reference_rows(), [Interval("x", 1.0, 2.0)])],
)
def test_the_error_is_infinite_without_a_reference_at_those_times(rows, movements):
    figures = tracking_figures(odometry_rows(), Reference(rows), movements)
    assert figures["rms_mm"] == math.inf


def test_an_undefined_interval_contains_no_time():
    assert not Interval().contains(np.array([0.0, START])).any()
