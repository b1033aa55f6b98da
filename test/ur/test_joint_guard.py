"""The joint guard: the last check before a setpoint is sent."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.ur.joint_guard import GuardError, JointGuard, JointLimits

NAMES = ("pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
PERIOD = 0.008
START = np.array([0.1, -1.0, 1.5, 0.0, 0.3, -2.0])


def limits(**changes):
    values = {
        "names": NAMES,
        "lower": np.full(6, -2 * math.pi),
        "upper": np.full(6, 2 * math.pi),
        "velocity": np.full(6, 1.0),
        "acceleration": np.full(6, 5.0),
        "distance": np.full(6, 0.1),
    }
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


def test_first_setpoint_must_be_the_measured_position():
    guard = JointGuard(limits(), PERIOD)
    first = guard.begin(START)
    assert np.array_equal(first, START)
    assert np.array_equal(guard.check(START, START), START)


def test_no_setpoint_passes_before_the_arm_is_measured():
    guard = JointGuard(limits(), PERIOD)
    with pytest.raises(GuardError, match="must be known before"):
        guard.check(START, START)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_invalid_start_position_is_rejected_and_clears_the_earlier_start(guard, value):
    with pytest.raises(GuardError, match="must be finite"):
        guard.begin(moved(2, value))
    with pytest.raises(GuardError, match="must be known before"):
        guard.check(START, START)


@pytest.mark.parametrize("sign", [1, -1])
def test_arm_beyond_a_limit_may_only_stay_or_return(guard, sign):
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
def test_jump_is_rejected_naming_the_joint_and_not_remembered(guard, joint, sign):
    for jump in (0.05, 0.16, 3.0, 2 * math.pi):
        with pytest.raises(GuardError, match=rf"{NAMES[joint]}: "):
            guard.check(moved(joint, sign * jump), START)
    assert np.array_equal(guard.check(START, START), START), (
        "the last accepted setpoint remains the reference"
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", range(6))
def test_non_finite_setpoint_is_rejected(guard, joint, value):
    with pytest.raises(GuardError, match=NAMES[joint]):
        guard.check(moved(joint, value), START)
    with pytest.raises(GuardError, match=NAMES[joint]):
        guard.check(START, moved(joint, value))


def test_velocity_acceleration_and_distance_have_separate_limits():
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


def test_motion_within_limits_passes_until_the_arm_does_not_follow(guard):
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


def test_instantaneous_stop_exceeds_the_acceleration_limit(guard):
    position, speed = START.copy(), 0.0
    for _ in range(30):
        speed = min(speed + 5.0 * PERIOD, 1.0)
        position = position + speed * PERIOD
        guard.check(position, position)
    with pytest.raises(GuardError, match="acceleration"):
        guard.check(position, position)


@pytest.mark.parametrize("size", [0, 5, 7])
def test_setpoint_needs_six_joints(guard, size):
    with pytest.raises(GuardError, match=f"must be 6 joint angles, got {size}"):
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
def test_invalid_limits_are_rejected(changes):
    with pytest.raises(ParameterError, match=next(iter(changes))):
        limits(**changes)


def test_arrays_passed_in_and_out_are_copied(guard):
    setpoint = START.copy()
    out = guard.check(setpoint, START)
    setpoint += 1.0
    out += 1.0
    assert np.array_equal(guard.check(START, START), START)
    with pytest.raises(ValueError, match="read-only"):
        guard.limits.upper[0] = 1.0
