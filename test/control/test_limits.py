import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.control.limits import TwistLimiter, clamp, ramp_down, ratio, saturation, slew
from test.robots import parameters

LIMITS = parameters("omniman").limits
#: Equal acceleration and deceleration, so that one bound holds for all ticks
EVEN = replace(LIMITS, linear_deceleration=0.8, angular_deceleration=1.2)
SLOPE = 1 + 1e-9

NUMBER = st.floats(-5, 5)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER).map(np.array)
STEP = st.sampled_from([0.001, 0.005, 0.01, 0.05])
INSIDE = VECTOR.map(lambda v: 0.9 * clamp(v, LIMITS.velocity))


def run(limits, targets, dt, start=(0.0, 0, 0)):
    """Return the twists from a start, one per tick plus the start, for (target, ticks) pairs."""
    limiter, twists = TwistLimiter(limits), [np.array(start, dtype=float)]
    for target, ticks in targets:
        for _ in range(ticks):
            twists.append(limiter.step(twists[-1], np.array(target, dtype=float), dt))
    return np.array(twists)


def largest(rows, limit):
    return max(ratio(row, limit) for row in rows)


def rates(twists, dt):
    """Return the accelerations and jerks of a sequence that starts at constant speed."""
    acceleration = np.diff(twists, axis=0) / dt
    return acceleration, np.diff(acceleration, axis=0, prepend=np.zeros((1, 3))) / dt


@given(VECTOR)
def test_clamp_keeps_the_direction_and_the_limit(vector):
    clamped = clamp(vector, (0.5, 0.7))
    assert math.hypot(*clamped[:2]) <= 0.5 * SLOPE
    assert abs(clamped[2]) <= 0.7 * SLOPE
    np.testing.assert_allclose(np.cross(clamped, vector), 0, atol=1e-9)
    assert clamped @ vector >= 0
    if ratio(vector, (0.5, 0.7)) <= 1:
        np.testing.assert_array_equal(clamped, vector)
    else:
        assert ratio(clamped, (0.5, 0.7)) == pytest.approx(1, abs=1e-12)


def test_linear_limits_apply_to_the_vector_and_not_to_its_components():
    np.testing.assert_allclose(clamp(np.array([3.0, 4.0, 0]), (1, 1)), [0.6, 0.8, 0])


@given(st.lists(st.floats(-50, 50), min_size=3, max_size=8).map(np.array))
def test_saturation_scales_all_wheels_by_one_factor(speeds):
    factor = saturation(speeds, 14.0)
    assert 0 < factor <= 1
    assert abs(speeds * factor).max() <= 14.0 * SLOPE
    assert factor == 1 or abs(speeds * factor).max() == pytest.approx(14.0)


@given(VECTOR, STEP)
def test_ramp_down_reaches_exactly_zero_in_the_analytic_time(twist, dt):
    limit, start = (1.2, 2.0), twist
    time = ratio(twist, limit)
    ticks = 0
    while twist.any():
        after = ramp_down(twist, limit, dt)
        assert ratio(twist - after, limit) <= dt * SLOPE
        assert abs(np.cross(after, start)).max() < 1e-9
        assert after @ start >= 0
        twist, ticks = after, ticks + 1
    assert (ticks - 1) * dt <= time + 1e-9
    assert ticks * dt >= time - 1e-9
    np.testing.assert_array_equal(twist, np.zeros(3))


def test_ramp_down_changes_nothing_in_a_zero_time_step():
    twist = np.array([0.5, 0.1, 0.2])
    np.testing.assert_array_equal(ramp_down(twist, (1, 1), 0.0), twist)
    assert not ramp_down(np.zeros(3), (1, 1), 0.0).any()


@given(VECTOR, VECTOR, STEP)
def test_slew_is_straight_within_the_limits_and_reaches_the_target(start, target, dt):
    twist, faster = start, (1.2, 2.0)  # the larger of acceleration and deceleration
    for _ in range(math.ceil(20 / dt)):
        after = slew(twist, target, LIMITS, dt)
        assert ratio(after - twist, faster) <= dt * SLOPE
        assert abs(np.cross(after - start, target - start)).max() < 1e-8
        if (after == target).all():
            break
        twist = after
    np.testing.assert_array_equal(after, target)
    np.testing.assert_array_equal(slew(after, target, LIMITS, dt), target)


@pytest.mark.parametrize(
    ("start", "target", "rate"),
    [
        ((0, 0, 0), (1, 0, 0), 0.8),
        ((1, 0, 0), (0, 0, 0), 1.2),
        ((0.5, 0, 0), (0.5, 1, 0), 0.8),
        ((0, 0, 0), (0, 0, 1), 1.2),
        ((0, 0, -1), (0, 0, 0), 2.0),
    ],
)
def test_slew_uses_the_acceleration_or_the_deceleration_limit(start, target, rate):
    after = slew(np.array(start, float), np.array(target, float), LIMITS, 0.01)
    assert np.linalg.norm(after - start) == pytest.approx(0.01 * rate)


TARGETS = st.lists(st.tuples(INSIDE, st.integers(1, 120)), min_size=1, max_size=6)


@given(TARGETS, st.sampled_from([0.005, 0.01, 0.02, 0.05]))
def test_velocity_acceleration_and_jerk_are_kept_at_every_tick(targets, dt):
    twists = run(EVEN, targets, dt)
    acceleration, jerk = rates(twists, dt)
    assert np.isfinite(twists).all()
    assert largest(twists, EVEN.velocity) <= SLOPE
    assert largest(acceleration, EVEN.acceleration) <= 1 + 1e-7
    assert largest(jerk, EVEN.jerk) <= 1 + 1e-6


@given(st.lists(st.tuples(VECTOR, st.integers(1, 120)), min_size=1, max_size=6), STEP)
def test_targets_beyond_the_limits_never_exceed_velocity_or_acceleration(targets, dt):
    twists = run(LIMITS, targets, dt)
    acceleration, _ = rates(twists, dt)
    assert largest(twists, LIMITS.velocity) <= SLOPE
    assert largest(acceleration, LIMITS.deceleration) <= 1 + 1e-7  # the larger of the two


def test_braking_uses_the_deceleration_and_starting_the_acceleration_limit():
    twists = run(LIMITS, [((1, 0, 0), 2000), ((0, 0, 0), 2000)], 0.001)
    acceleration = np.diff(twists[:, 0]) / 0.001
    assert acceleration.max() == pytest.approx(0.8, rel=1e-6)
    assert acceleration.min() == pytest.approx(-1.2, rel=1e-6)


@given(TARGETS, st.sampled_from([0.005, 0.01, 0.02, 0.05]))
def test_twist_reaches_the_target_exactly_and_stays(targets, dt):
    settle = (targets[-1][0], math.ceil(6 / dt))
    twists = run(LIMITS, [*targets, settle], dt)
    np.testing.assert_array_equal(twists[-20:], np.tile(targets[-1][0], (20, 1)))


@given(INSIDE, st.sampled_from([0.005, 0.01, 0.05]))
def test_twist_from_rest_is_straight_and_monotonic(target, dt):
    twists = run(LIMITS, [(target, math.ceil(4 / dt))], dt)
    length = np.linalg.norm(target)
    assert abs(np.cross(twists, target)).max() < 1e-9
    if length > 1e-6:
        along = twists @ target / length
        assert (np.diff(along) >= -1e-12).all()  # no chatter
        assert along.max() <= length + 1e-12  # no overshoot
    np.testing.assert_array_equal(twists[-1], target)


@given(INSIDE.filter(lambda v: np.linalg.norm(v) > 1e-3), INSIDE, st.sampled_from([0.005, 0.02]))
def test_twist_between_constant_motions_is_straight_without_overshoot(start, target, dt):
    twists = run(LIMITS, [(target, math.ceil(5 / dt))], dt, start)
    way = target - start
    assert abs(np.cross(twists - start, way)).max() < 1e-9
    along = (twists - start) @ way
    assert along.max() <= way @ way + 1e-9
    np.testing.assert_array_equal(twists[-1], target)


@pytest.mark.parametrize(
    ("target", "speed", "rate", "jerk"),
    [
        ((1, 0, 0), 1.0, 0.8, 8.0),
        ((0, -0.5, 0), 0.5, 0.8, 8.0),
        ((0, 0, 1.2), 1.2, 1.2, 12.0),
        ((0.05, 0, 0), 0.05, 0.8, 8.0),
    ],
)
@pytest.mark.parametrize("dt", [0.001, 0.005, 0.02])
def test_duration_is_close_to_the_optimum_of_a_single_axis(target, speed, rate, jerk, dt):
    twists = run(LIMITS, [(target, math.ceil(4 / dt))], dt)
    ticks = int(np.argmax((twists == target).all(axis=1)))
    full = rate * rate / jerk  # change of speed in the two jerk-limited phases alone
    best = speed / rate + rate / jerk if speed > full else 2 * math.sqrt(speed / jerk)
    assert best - 1.01 * dt <= ticks * dt <= best + 3.01 * dt


def test_acceleration_starts_at_zero_after_a_restart():
    limiter = TwistLimiter(LIMITS)
    twist = np.zeros(3)
    for _ in range(100):
        twist = limiter.step(twist, np.array([1.0, 0, 0]), 0.005)
    limiter.restart()
    after = limiter.step(twist, np.array([1.0, 0, 0]), 0.005)
    assert after[0] - twist[0] == pytest.approx(8.0 * 0.005**2)


def test_zero_time_step_changes_nothing():
    limiter, twist = TwistLimiter(LIMITS), np.array([0.3, 0, 0])
    for dt in (0.0, -1.0):
        np.testing.assert_array_equal(limiter.step(twist, np.ones(3), dt), twist)


def test_twist_above_a_lowered_limit_is_reduced_to_the_limit():
    limiter, twist = TwistLimiter(LIMITS), np.zeros(3)
    for _ in range(1000):
        twist = limiter.step(twist, np.array([1.0, 0, 0]), 0.005)
    limiter.limits = replace(LIMITS, linear_velocity=0.4)
    for _ in range(1000):
        before, twist = twist, limiter.step(twist, np.array([1.0, 0, 0]), 0.005)
        assert ratio(twist - before, LIMITS.deceleration) <= 0.005 * SLOPE
    np.testing.assert_allclose(twist, [0.4, 0, 0])
    assert before[0] == twist[0]
