"""Study of handing over a load: its measurements, and the drive of the leader."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core import se2
from omniman_ros.lab.studies.closed_loop import PERIOD, MotionRecord
from omniman_ros.lab.studies.handover import (
    KEPT_TIME,
    SPEED,
    HandoverCase,
    HandoverRun,
    station_error,
)
from omniman_ros.lab.studies.scene_geometry import RectangularOutline

OFFSET = (0.0, -1.3, 0.0)
BOX = RectangularOutline(1.0, 0.7)


def made(error=(0.0, 0.0, 0.0), seconds=8.0):
    """Return a run on an arc, with a constant error in the frame of the station."""
    times = PERIOD * np.arange(round(seconds / PERIOD))
    twist = np.array([SPEED, 0.0, 0.1])
    leader = np.array([se2.arc(twist * time) for time in times])
    follower = np.array([se2.compose(se2.compose(pose, OFFSET), error) for pose in leader])
    energies = np.column_stack([times, 2.0 * times])
    case = HandoverCase("S", "PI")
    return HandoverRun(case, OFFSET, BOX, times, leader, follower, energies, 2.0)


def test_error_is_measured_in_the_frame_of_the_station_beside_the_true_leader():
    errors = made((0.01, -0.02, 0.03)).errors()
    np.testing.assert_allclose(errors, np.tile([0.01, -0.02, 0.03], (len(errors), 1)), atol=1e-12)
    error = station_error((1.0, 2.0, 3.0), (0.0, -1.3, 0.5), (1.0, 2.0, -3.0))
    assert error[2] == pytest.approx(math.tau - 6.5)


def test_gap_is_that_between_the_sides_of_robots_side_by_side():
    np.testing.assert_allclose(made().gaps(), 0.6, atol=1e-9)
    np.testing.assert_allclose(made((0.0, -0.1, 0.0)).gaps(), 0.7, atol=1e-9)


def test_judged_time_has_the_whole_length_or_what_was_driven_of_it():
    assert made().errors()[made().kept].shape == (round(KEPT_TIME / PERIOD) + 1, 3)
    late = replace(made(), kept_from=7.0)
    assert len(late.errors()[late.kept]) == round(1.0 / PERIOD)


def test_run_joins_records_that_begin_and_end_at_different_times():
    leader, follower = MotionRecord(), MotionRecord()
    for record, first, last in ((leader, 0, 100), (follower, 20, 130)):
        for tick in range(first, last):
            record.times.append(tick * PERIOD)
            record.poses.append(np.full(3, tick, dtype=float))
            record.energy.append(float(tick))
    run = HandoverRun.of(HandoverCase("S", "PI"), OFFSET, BOX, leader, follower, 50 * PERIOD)
    assert len(run.times) == len(run.leader) == len(run.follower) == 80
    np.testing.assert_array_equal(run.leader, run.follower)
    assert run.energies[0].tolist() == [0.0, 0.0] and run.kept_from == pytest.approx(30 * PERIOD)
