"""The veto before the wire."""

import math

import numpy as np
import pytest

from omniman_ros.arm.guard import GuardError, JointGuard, JointLimits
from omniman_ros.core.errors import ParameterError

NAMES = ("pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
PERIOD = 0.008
START = np.array([0.1, -1.0, 1.5, 0.0, 0.3, -2.0])


def limits(**changes):
    values = {
        "names": NAMES, "lower": np.full(6, -2 * math.pi), "upper": np.full(6, 2 * math.pi),
        "velocity": np.full(6, 1.0), "acceleration": np.full(6, 5.0), "distance": np.full(6, 0.1),
    }  # fmt: skip
    return JointLimits(**(values | changes))


@pytest.fixture
def guard():
    result = JointGuard(limits(), PERIOD)
    result.begin(START)
    return result


def moved(joint, by):
    setpoint = START.copy()
    setpoint[joint] += by
    return setpoint


def test_the_first_setpoint_is_where_the_arm_is():
    guard = JointGuard(limits(), PERIOD)
    first = guard.begin(START)
    assert np.array_equal(first, START)
    assert np.array_equal(guard.check(START, START), START)


def test_nothing_passes_before_the_arm_was_measured():
    guard = JointGuard(limits(), PERIOD)
    with pytest.raises(GuardError, match="measured joints are known"):
        guard.check(START, START)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_arm_that_is_nowhere_is_not_begun_with_nor_with_an_older_begin(guard, value):
    with pytest.raises(GuardError, match="not finite"):
        guard.begin(moved(2, value))
    with pytest.raises(GuardError, match="measured joints are known"):
        guard.check(START, START)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_arm_beyond_a_limit_may_stay_and_go_back_only(guard, sign):
    beyond = START.copy()
    beyond[2] = sign * (2 * math.pi + 0.2)
    step = np.zeros(6)
    step[2] = sign * 1e-4
    guard.begin(beyond)
    guard.check(beyond, beyond)
    with pytest.raises(GuardError, match="elbow: position"):
        guard.check(beyond + step, beyond)
    inward = guard.check(beyond - step, beyond)
    with pytest.raises(GuardError, match="elbow: position"):
        guard.check(beyond, beyond)
    guard.check(inward, beyond)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_is_refused_by_name_and_forgotten(guard, joint, sign):
    for jump in (0.05, 0.16, 3.0, 2 * math.pi):
        with pytest.raises(GuardError, match=rf"{NAMES[joint]}: "):
            guard.check(moved(joint, sign * jump), START)
    assert np.array_equal(guard.check(START, START), START), "the last good one still counts"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", range(6))
def test_what_is_no_number_is_refused(guard, joint, value):
    with pytest.raises(GuardError, match=NAMES[joint]):
        guard.check(moved(joint, value), START)
    with pytest.raises(GuardError, match=NAMES[joint]):
        guard.check(START, moved(joint, value))


def test_velocity_acceleration_and_distance_have_limits_of_their_own():
    step = 0.9 * PERIOD  # 0.9 rad/s at once: 112 rad/s^2
    fast = JointGuard(limits(acceleration=np.full(6, 1e3)), PERIOD)
    fast.begin(START)
    fast.check(moved(0, step), START)
    with pytest.raises(GuardError, match=r"pan: velocity 1\.1 rad/s, the limit is 1 rad/s"):
        fast.check(moved(0, step + 1.1 * PERIOD), START)
    soft = JointGuard(limits(), PERIOD)
    soft.begin(START)
    with pytest.raises(GuardError, match=r"pan: acceleration 112\.5 rad/s\^2"):
        soft.check(moved(0, step), START)


def test_a_motion_within_all_limits_passes_until_the_arm_does_not_follow(guard):
    position, speed = START.copy(), 0.0
    for _ in range(1000):
        speed = min(speed + 5.0 * PERIOD, 1.0)
        position = position + speed * PERIOD * np.array([1, 0, 0, 0, 0, 0])
        if position[0] - START[0] > 0.1:
            with pytest.raises(GuardError, match="pan: distance to measured"):
                guard.check(position, START)
            return
        guard.check(position, START)
    pytest.fail("the distance was never refused")


def test_a_stop_at_once_is_an_acceleration_too(guard):
    position, speed = START.copy(), 0.0
    for _ in range(30):
        speed = min(speed + 5.0 * PERIOD, 1.0)
        position = position + speed * PERIOD
        guard.check(position, position)
    with pytest.raises(GuardError, match="acceleration"):
        guard.check(position, position)


@pytest.mark.parametrize("size", [0, 5, 7])
def test_six_joints_are_six(guard, size):
    with pytest.raises(GuardError, match=f"{size} joint angles, expected 6"):
        guard.check(np.zeros(size), START)


@pytest.mark.parametrize(
    "changes",
    [
        {"velocity": np.zeros(6)},
        {"acceleration": np.full(6, -1.0)},
        {"distance": np.full(6, math.inf)},
        {"upper": np.full(6, math.nan)},
        {"upper": np.full(5, 1.0)},
        {"lower": np.full(6, 7.0)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_limits_that_are_none_are_refused(changes):
    with pytest.raises(ParameterError, match=next(iter(changes))):
        limits(**changes)


def test_what_is_given_out_and_in_is_not_shared(guard):
    setpoint = START.copy()
    out = guard.check(setpoint, START)
    setpoint += 1.0
    out += 1.0
    assert np.array_equal(guard.check(START, START), START)
    with pytest.raises(ValueError, match="read-only"):
        guard.limits.upper[0] = 1.0
