"""Tests of the estimated platform error and its compensation by the arm."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.motion.whole_body.correction import (
    MAX_GAP,
    OUTLIER_COUNT,
    RATE_DECAY_TIME,
    PlatformCorrection,
    corrected_arm_motion,
    joint_speed_pace,
)
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions

PERIOD, TICK = 0.01, 0.008
REFERENCE = np.array([3.0, -2.0, 0.5])
ERROR = np.array([0.004, -0.003, 0.006])
POSTURE = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
MODEL = WholeBodyModel(Mount())


def make_correction(**options):
    return PlatformCorrection(build(ToolPathOptions, options))


def feed_error(correction, error, seconds=2.0, since=0.0):
    """Feed an error, a function of time, and return the time of the last measurement.

    An error beyond the largest corrected one is accepted after `OUTLIER_COUNT` measurements.
    """
    for k in range(1, round(seconds / PERIOD) + 1):
        time = since + k * PERIOD
        try:
            correction.update(time, REFERENCE + error(time), REFERENCE)
        except InputError as refused:
            assert "off its path" in str(refused) and k < OUTLIER_COUNT
    return time


def error_at_times(correction, *times):
    return correction.error_at(np.array(times))


def test_the_error_is_zero_before_the_first_measurement():
    assert not error_at_times(make_correction(), 0.0, 5.0).any()
    assert make_correction().max_pace() == 1.0


def test_a_constant_error_is_estimated_exactly_and_kept():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: ERROR)
    assert error_at_times(correction, last_time, last_time + 1.0) == pytest.approx(
        np.tile(ERROR, (2, 1)), abs=1e-9
    )


def test_a_linear_error_is_tracked_without_lag_and_extrapolated():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: t * ERROR)
    assert correction.error == pytest.approx(last_time * ERROR, abs=1e-7)
    ahead = 0.05
    assert error_at_times(correction, last_time + ahead)[0] == pytest.approx(
        (last_time + ahead) * ERROR, abs=5e-5
    )
    held = np.abs(correction.error - (last_time + ahead) * ERROR)
    assert (
        np.abs(error_at_times(correction, last_time + ahead)[0] - (last_time + ahead) * ERROR)
        < 0.2 * held
    ).all()


def test_the_extrapolated_rate_decays():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: t * ERROR)
    assert error_at_times(correction, 1e6)[0] == pytest.approx(
        (last_time + RATE_DECAY_TIME) * ERROR, rel=1e-3
    )


def test_times_before_the_last_measurement_take_its_error():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: t * ERROR)
    assert np.array_equal(error_at_times(correction, last_time - 0.1)[0], correction.error)


def test_the_heading_error_takes_the_short_way_round():
    correction = make_correction()
    correction.update(1.0, np.array([0.0, 0.0, 3.14]), np.array([0.0, 0.0, -3.14 + 4 * math.pi]))
    assert correction.error[2] == pytest.approx(6.28 - math.tau)


def test_a_lower_bandwidth_filters_more_noise():
    def spread(bandwidth):
        noise = np.random.default_rng(4).normal(0.0, 1e-3, (400, 3))
        correction = make_correction(correction_bandwidth=bandwidth)
        rows = []
        for k, row in enumerate(noise):
            correction.update(k * PERIOD, REFERENCE + row, REFERENCE)
            rows.append(correction.error)
        return float(np.std(rows[100:]))

    assert spread(5.0) < 0.6 * spread(20.0) < 0.6 * 0.6e-3


def test_a_gap_restarts_the_filter():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: t * ERROR)
    correction.update(last_time + 1.1 * MAX_GAP, REFERENCE - ERROR, REFERENCE)
    assert correction.error == pytest.approx(-ERROR)
    assert not correction.rate.any()


@pytest.mark.parametrize("time", [2.0, 1.99, -1.0, math.nan])
def test_an_outdated_measurement_is_refused_and_changes_nothing(time):
    correction = make_correction()
    feed_error(correction, lambda t: ERROR)
    before = correction.error, correction.rate, correction.time
    with pytest.raises(InputError, match="not newer than the last one of"):
        correction.update(time, REFERENCE, REFERENCE)
    assert (correction.error, correction.rate, correction.time) == before


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
@pytest.mark.parametrize("axis", range(3))
def test_an_invalid_pose_is_refused_and_changes_nothing(value, axis):
    correction = make_correction()
    feed_error(correction, lambda t: ERROR)
    before = correction.error, correction.rate, correction.time
    pose = REFERENCE.copy()
    pose[axis] = value
    with pytest.raises(InputError, match="not finite or beyond"):
        correction.update(3.0, pose, REFERENCE)
    assert (correction.error, correction.rate, correction.time) == before


def test_a_disabled_correction_still_monitors_the_error():
    correction = make_correction(correction=False)
    last_time = feed_error(correction, lambda t: 20.0 * ERROR)
    assert not error_at_times(correction, last_time).any()
    assert correction.error_ratio > 1.0


@pytest.mark.parametrize("direction", [(0.6, -0.8, 0.0), (0.0, 0.0, -1.0), (0.3, 0.4, 0.9)])
def test_at_most_the_largest_error_is_corrected(direction):
    correction = make_correction(max_error=0.02, max_heading_error=0.04)
    last_time = feed_error(correction, lambda t: 0.2 * np.array(direction))
    assert correction.error_ratio > 1.0
    error = error_at_times(correction, last_time)[0]
    fraction = max(math.hypot(*error[:2]) / 0.02, abs(error[2]) / 0.04)
    assert fraction == pytest.approx(1.0)
    assert np.cross(error, direction) == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_motion_is_slowed_above_half_of_the_largest_error():
    def pace(error):
        correction = make_correction(max_error=0.04, max_heading_error=0.1)
        feed_error(correction, lambda t: np.array(error))
        return correction.max_pace()

    assert pace((0.019, 0.0, 0.0)) == pace((0.0, 0.0, -0.049)) == 1.0
    assert pace((0.0, -0.03, 0.0)) == pytest.approx(0.5)
    assert pace((0.0, 0.0, 0.075)) == pytest.approx(0.5)
    assert pace((0.03, 0.03, 0.0)) == 0.0


def test_the_platform_is_predicted_at_its_reference_plus_the_error():
    correction = make_correction()
    last_time = feed_error(correction, lambda t: ERROR)
    reference = np.arange(6.0).reshape(2, 3)
    expected = correction.platform_at(reference, np.array([last_time, last_time + 0.1]))
    assert expected == pytest.approx(reference + ERROR, abs=1e-9)


def arc_drive(count=30):
    """Return times, platform and tool (count + 2) of an arc with the arm in one posture."""
    times = TICK * np.arange(-1.0, count + 1.0)
    platform = np.column_stack([0.2 * times, 0.1 * times**2, 0.3 * np.sin(times)])
    tool = MODEL.forward(np.hstack([platform, np.tile(POSTURE, (len(times), 1))]))
    return times, platform, tool


def test_the_corrected_arm_puts_the_tool_on_its_reference():
    _, platform, tool = arc_drive()
    there = platform + ERROR
    branch = MODEL.arm.branch_of(POSTURE)
    q, _, _ = corrected_arm_motion(MODEL, there, tool, branch, POSTURE, TICK)
    assert q.shape == (30, 6)
    reached = MODEL.forward(np.hstack([there[1:-1], q]))
    assert np.abs(reached - tool[1:-1]).max() < 1e-9
    assert 1e-3 < np.abs(q - POSTURE).max() < 0.05


def test_rates_and_accelerations_are_derivatives_of_the_angles():
    times, platform, tool = arc_drive()
    branch = MODEL.arm.branch_of(POSTURE)
    drift = np.sin(3.0 * times)[:, None] * ERROR
    q, v, a = corrected_arm_motion(MODEL, platform + drift, tool, branch, POSTURE, TICK)
    assert np.abs(v).max() > 1e-3
    assert np.gradient(q, TICK, axis=0)[1:-1] == pytest.approx(v[1:-1], abs=1e-9)
    assert np.gradient(v, TICK, axis=0)[2:-2] == pytest.approx(a[2:-2], abs=2e-3)


def test_a_tool_out_of_reach_is_refused_with_its_position():
    _, platform, tool = arc_drive()
    tool[7:, 2, 3] += 2.0
    with pytest.raises(InputError, match=r"tool0 at .* is out of the arm's reach") as refused:
        corrected_arm_motion(MODEL, platform, tool, MODEL.arm.branch_of(POSTURE), POSTURE, TICK)
    assert f"({tool[7, 0, 3]:.3f}" in str(refused.value)


def test_the_pace_keeps_every_joint_within_its_speed_limit():
    limits = np.array([1.0, 2.0])
    assert joint_speed_pace(np.array([[0.9, -1.9], [0.0, 0.1]]), limits) == 1.0
    assert joint_speed_pace(np.array([[0.9, -4.0], [1.5, 0.1]]), limits) == pytest.approx(0.5)
    assert joint_speed_pace(np.zeros((0, 2)), limits) == 1.0


def test_a_motion_slowed_for_its_joints_stays_slowed():
    limits, full = np.array([1.0, 2.0]), np.array([[0.4, -5.0]])
    pace = joint_speed_pace(full, limits)
    assert pace == pytest.approx(0.4)
    assert joint_speed_pace(pace * full, limits, pace) == pytest.approx(pace)
    assert joint_speed_pace(pace * 0.3 * full, limits, pace) == 1.0
    assert (
        joint_speed_pace(np.zeros((4, 2)), limits, 0.0) == 1.0
    )  # the motion can continue after a halt


def test_a_single_outlier_is_refused_and_changes_nothing():
    correction = PlatformCorrection(ToolPathOptions())
    for i in range(20):
        correction.update(0.01 * i, np.array([0.002, 0.0, 0.0]), np.zeros(3))
    before, rate = correction.error.copy(), correction.rate.copy()
    with pytest.raises(InputError, match=r"0\.100 m"):
        correction.update(0.2, np.array([0.1, 0.0, 0.0]), np.zeros(3))
    assert correction.error == pytest.approx(before) and correction.rate == pytest.approx(rate)
    correction.update(0.21, np.array([0.002, 0.0, 0.0]), np.zeros(3))
    assert correction.error_ratio < 0.1


def test_repeated_outliers_are_accepted():
    correction = PlatformCorrection(ToolPathOptions())
    far = np.array([0.0, 0.0, 0.3])
    for i in range(2):
        with pytest.raises(InputError, match=r"0\.300 rad"):
            correction.update(0.01 * i, far, np.zeros(3))
    correction.update(0.02, far, np.zeros(3))
    assert correction.error_ratio == pytest.approx(3.0)
