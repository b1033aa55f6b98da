"""The platform's error is followed and predicted, and the arm takes it out of the tool's pose."""

import math

import numpy as np
import pytest

from omniman_ros.core.body.correction import (
    BELIEVED,
    FADING,
    LONGEST_GAP,
    PlatformCorrection,
    arm_motion,
    speed_pace,
)
from omniman_ros.core.body.model import BodyModel, Mount
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build

PERIOD, TICK = 0.01, 0.008
REFERENCE = np.array([3.0, -2.0, 0.5])
OFF = np.array([0.004, -0.003, 0.006])
POSTURE = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
MODEL = BodyModel(Mount())


def made(**options):
    return PlatformCorrection(build(ToolPathOptions, options))


def heard(correction, error, seconds=2.0, since=0.0):
    """Feed an error (a function of time); returns the time of the last measurement.

    One that is larger than what is corrected is believed after a while.
    """
    for k in range(1, round(seconds / PERIOD) + 1):
        time = since + k * PERIOD
        try:
            correction.hear(time, REFERENCE + error(time), REFERENCE)
        except InputError as refused:
            assert "off its path" in str(refused) and k < BELIEVED
    return time


def at(correction, *times):
    return correction.error_at(np.array(times))


def test_without_a_measurement_there_is_no_error():
    assert not at(made(), 0.0, 5.0).any()
    assert made().pace() == 1.0


def test_a_constant_error_is_found_and_stays():
    correction = made()
    last = heard(correction, lambda t: OFF)
    assert at(correction, last, last + 1.0) == pytest.approx(np.tile(OFF, (2, 1)), abs=1e-9)


def test_an_error_that_changes_evenly_is_followed_without_lag_and_carried_on():
    correction = made()
    last = heard(correction, lambda t: t * OFF)
    assert correction.error == pytest.approx(last * OFF, abs=1e-7)
    ahead = 0.05
    assert at(correction, last + ahead)[0] == pytest.approx((last + ahead) * OFF, abs=5e-5)
    held = np.abs(correction.error - (last + ahead) * OFF)
    assert (np.abs(at(correction, last + ahead)[0] - (last + ahead) * OFF) < 0.2 * held).all()


def test_a_rate_fades():
    correction = made()
    last = heard(correction, lambda t: t * OFF)
    assert at(correction, 1e6)[0] == pytest.approx((last + FADING) * OFF, rel=1e-3)


def test_before_the_last_measurement_it_is_that_ones_error():
    correction = made()
    last = heard(correction, lambda t: t * OFF)
    assert np.array_equal(at(correction, last - 0.1)[0], correction.error)


def test_the_heading_is_compared_on_the_short_way_round():
    correction = made()
    correction.hear(1.0, np.array([0.0, 0.0, 3.14]), np.array([0.0, 0.0, -3.14 + 4 * math.pi]))
    assert correction.error[2] == pytest.approx(6.28 - math.tau)


def test_noise_is_filtered_and_more_with_less_bandwidth():
    def spread(bandwidth):
        noise = np.random.default_rng(4).normal(0.0, 1e-3, (400, 3))
        correction = made(correction_bandwidth=bandwidth)
        rows = []
        for k, row in enumerate(noise):
            correction.hear(k * PERIOD, REFERENCE + row, REFERENCE)
            rows.append(correction.error)
        return float(np.std(rows[100:]))

    assert spread(5.0) < 0.6 * spread(20.0) < 0.6 * 0.6e-3


def test_a_gap_begins_the_filter_anew():
    correction = made()
    last = heard(correction, lambda t: t * OFF)
    correction.hear(last + 1.1 * LONGEST_GAP, REFERENCE - OFF, REFERENCE)
    assert correction.error == pytest.approx(-OFF)
    assert not correction.rate.any()


@pytest.mark.parametrize("time", [2.0, 1.99, -1.0, math.nan])
def test_a_measurement_that_is_not_newer_is_refused_and_changes_nothing(time):
    correction = made()
    heard(correction, lambda t: OFF)
    before = correction.error, correction.rate, correction.time
    with pytest.raises(InputError, match="the last was of"):
        correction.hear(time, REFERENCE, REFERENCE)
    assert (correction.error, correction.rate, correction.time) == before


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
@pytest.mark.parametrize("axis", range(3))
def test_a_pose_that_is_none_is_refused_and_changes_nothing(value, axis):
    correction = made()
    heard(correction, lambda t: OFF)
    before = correction.error, correction.rate, correction.time
    pose = REFERENCE.copy()
    pose[axis] = value
    with pytest.raises(InputError, match="not finite or beyond"):
        correction.hear(3.0, pose, REFERENCE)
    assert (correction.error, correction.rate, correction.time) == before


def test_switched_off_it_corrects_nothing_but_still_watches():
    correction = made(correction=False)
    last = heard(correction, lambda t: 20.0 * OFF)
    assert not at(correction, last).any()
    assert correction.share > 1.0


@pytest.mark.parametrize("direction", [(0.6, -0.8, 0.0), (0.0, 0.0, -1.0), (0.3, 0.4, 0.9)])
def test_no_more_than_the_largest_error_is_corrected(direction):
    correction = made(max_error=0.02, max_heading_error=0.04)
    last = heard(correction, lambda t: 0.2 * np.array(direction))
    assert correction.share > 1.0
    error = at(correction, last)[0]
    share = max(math.hypot(*error[:2]) / 0.02, abs(error[2]) / 0.04)
    assert share == pytest.approx(1.0)
    assert np.cross(error, direction) == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_motion_is_slowed_from_half_of_the_largest_error_on():
    def pace(error):
        correction = made(max_error=0.04, max_heading_error=0.1)
        heard(correction, lambda t: np.array(error))
        return correction.pace()

    assert pace((0.019, 0.0, 0.0)) == pace((0.0, 0.0, -0.049)) == 1.0
    assert pace((0.0, -0.03, 0.0)) == pytest.approx(0.5)
    assert pace((0.0, 0.0, 0.075)) == pytest.approx(0.5)
    assert pace((0.03, 0.03, 0.0)) == 0.0


def test_the_platform_is_expected_at_its_reference_and_the_error():
    correction = made()
    last = heard(correction, lambda t: OFF)
    reference = np.arange(6.0).reshape(2, 3)
    expected = correction.platform_at(reference, np.array([last, last + 0.1]))
    assert expected == pytest.approx(reference + OFF, abs=1e-9)


def carried(count=30):
    """Times, platform and tool (count + 2) of a drive on an arc with the arm in one posture."""
    times = TICK * np.arange(-1.0, count + 1.0)
    platform = np.column_stack([0.2 * times, 0.1 * times**2, 0.3 * np.sin(times)])
    tool = MODEL.forward(np.hstack([platform, np.tile(POSTURE, (len(times), 1))]))
    return times, platform, tool


def test_the_tool_is_where_it_is_to_be_from_where_the_platform_is():
    _, platform, tool = carried()
    there = platform + OFF
    branch = MODEL.arm.branch_of(POSTURE)
    q, _, _ = arm_motion(MODEL, there, tool, branch, POSTURE, TICK)
    assert q.shape == (30, 6)
    reached = MODEL.forward(np.hstack([there[1:-1], q]))
    assert np.abs(reached - tool[1:-1]).max() < 1e-9
    assert 1e-3 < np.abs(q - POSTURE).max() < 0.05


def test_rates_and_second_derivatives_belong_to_the_angles():
    times, platform, tool = carried()
    branch = MODEL.arm.branch_of(POSTURE)
    drift = np.sin(3.0 * times)[:, None] * OFF
    q, v, a = arm_motion(MODEL, platform + drift, tool, branch, POSTURE, TICK)
    assert np.abs(v).max() > 1e-3
    assert np.gradient(q, TICK, axis=0)[1:-1] == pytest.approx(v[1:-1], abs=1e-9)
    assert np.gradient(v, TICK, axis=0)[2:-2] == pytest.approx(a[2:-2], abs=2e-3)


def test_what_is_out_of_reach_is_refused_with_the_place():
    _, platform, tool = carried()
    tool[7:, 2, 3] += 2.0
    with pytest.raises(InputError, match=r"tool0 at .* is out of the arm's reach") as refused:
        arm_motion(MODEL, platform, tool, MODEL.arm.branch_of(POSTURE), POSTURE, TICK)
    assert f"({tool[7, 0, 3]:.3f}" in str(refused.value)


def test_no_joint_is_driven_faster_than_it_may_be():
    limits = np.array([1.0, 2.0])
    assert speed_pace(np.array([[0.9, -1.9], [0.0, 0.1]]), limits) == 1.0
    assert speed_pace(np.array([[0.9, -4.0], [1.5, 0.1]]), limits) == pytest.approx(0.5)
    assert speed_pace(np.zeros((0, 2)), limits) == 1.0


def test_a_motion_that_was_slowed_for_its_joints_stays_so():
    limits, full = np.array([1.0, 2.0]), np.array([[0.4, -5.0]])
    pace = speed_pace(full, limits)
    assert pace == pytest.approx(0.4)
    assert speed_pace(pace * full, limits, pace) == pytest.approx(pace)
    assert speed_pace(pace * 0.3 * full, limits, pace) == 1.0
    assert speed_pace(np.zeros((4, 2)), limits, 0.0) == 1.0  # it goes on from a halt


def test_one_pose_that_is_far_off_is_refused_and_changes_nothing():
    correction = PlatformCorrection(ToolPathOptions())
    for i in range(20):
        correction.hear(0.01 * i, np.array([0.002, 0.0, 0.0]), np.zeros(3))
    before, rate = correction.error.copy(), correction.rate.copy()
    with pytest.raises(InputError, match="0.100 m"):
        correction.hear(0.2, np.array([0.1, 0.0, 0.0]), np.zeros(3))
    assert correction.error == pytest.approx(before) and correction.rate == pytest.approx(rate)
    correction.hear(0.21, np.array([0.002, 0.0, 0.0]), np.zeros(3))
    assert correction.share < 0.1


def test_poses_that_stay_far_off_are_believed():
    correction = PlatformCorrection(ToolPathOptions())
    far = np.array([0.0, 0.0, 0.3])
    for i in range(2):
        with pytest.raises(InputError, match="0.300 rad"):
            correction.hear(0.01 * i, far, np.zeros(3))
    correction.hear(0.02, far, np.zeros(3))
    assert correction.share == pytest.approx(3.0)
