import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.control.encoder import Unwrapper, VelocityObserver
from omniman_ros.core.errors import InputError
from test.robots import robot


@pytest.mark.parametrize("span", [math.tau, 2.0**32, 65536.0, 1.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_counters_wrap_in_both_directions(span, direction):
    true = direction * np.outer(np.arange(400) * 0.013 * span, [1.0, -1.0, 0.4])
    unwrapper = Unwrapper(span)
    positions = np.array([unwrapper.update(np.mod(row, span)) for row in true])
    np.testing.assert_allclose(positions - positions[0], true - true[0], atol=1e-9 * span)


@given(st.lists(st.floats(-0.49, 0.49), max_size=60), st.floats(-0.5, 0.5))
def test_steps_below_half_the_span_are_followed(steps, origin):
    span = 10.0
    true = span * np.cumsum([origin, *steps])
    unwrapper = Unwrapper(span)
    # A counter with both signs, like that of a driver with signed 32 bits.
    read = [unwrapper.update(np.array([math.remainder(value, span)]))[0] for value in true]
    np.testing.assert_allclose(np.diff(read), np.diff(true), atol=1e-9)


def test_first_reading_is_the_origin_and_input_arrays_are_copied():
    unwrapper, reading = Unwrapper(math.tau), np.array([1.0, 2.0])
    first = unwrapper.update(reading)
    np.testing.assert_array_equal(first, [1, 2])
    reading[:] = 99
    np.testing.assert_array_equal(first, [1, 2])
    np.testing.assert_allclose(unwrapper.update(np.array([1.1, 1.9])), [1.1, 1.9])


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_span_and_bandwidth_must_be_positive(value):
    with pytest.raises(InputError, match="span"):
        Unwrapper(value)
    with pytest.raises(InputError, match="bandwidth"):
        VelocityObserver(value)


@pytest.mark.parametrize("dt", [0.001, 0.005, 0.02, 0.1])
@pytest.mark.parametrize("bandwidth", [10.0, 60.0, 300.0])
def test_ramp_is_followed_without_steady_state_error(dt, bandwidth):
    observer, slope = VelocityObserver(bandwidth), np.array([3.0, -7.0])
    steps = math.ceil(40 / bandwidth / dt) + 3
    for i in range(steps):
        speed = observer.update(1.0 + slope * i * dt, dt)
    np.testing.assert_allclose(speed, slope, atol=1e-9)


def test_step_in_speed_settles_within_a_few_time_constants_with_bounded_overshoot():
    observer, dt = VelocityObserver(60.0), 0.005
    speeds = []
    for i in range(100):
        speeds.append(float(observer.update(np.array([2.0 * i * dt]), dt)[0]))
    assert max(speeds) < 2.0 * 1.14  # critically damped: only the observer's zero causes overshoot
    assert abs(np.array(speeds[round(0.15 / dt) :]) - 2.0).max() < 0.02


@given(
    st.lists(st.tuples(st.floats(1e-5, 100), st.floats(-1, 1)), min_size=1, max_size=100),
    st.floats(0.1, 1e4),
)
def test_observer_is_stable_for_any_time_step(samples, bandwidth):
    observer = VelocityObserver(bandwidth)
    observer.update(np.zeros(1), 0.0)
    for dt, position in samples:
        speed = observer.update(np.array([position]), dt)
        assert np.isfinite(speed).all()
    for _ in range(400):
        speed = observer.update(np.array([0.5]), 10 / bandwidth)
    assert abs(speed[0]) < 1e-6 * bandwidth


def test_observer_is_far_less_noisy_than_the_difference_quotient():
    counts, dt = robot("ig42").motor.encoder_counts, 0.005
    assert counts == 480
    for true in (0.37, 2.1, 9.3):
        position = np.floor(true * np.arange(2000) * dt * counts / math.tau) * math.tau / counts
        observer = VelocityObserver(60.0)
        speed = np.array([observer.update(np.array([p]), dt)[0] for p in position])[400:]
        quotient = np.diff(position)[400:] / dt
        assert speed.mean() == pytest.approx(true, rel=0.02)
        assert speed.std() < 0.35 * quotient.std()
        assert abs(speed - true).max() < 0.4 * abs(quotient - true).max()


def test_zero_time_step_changes_nothing_and_reset_starts_at_rest():
    observer = VelocityObserver(60.0)
    for i in range(100):
        speed = observer.update(np.array([0.01 * i]), 0.005)
    np.testing.assert_array_equal(observer.update(np.array([5.0]), 0.0), speed)
    observer.reset()
    assert observer.update(np.array([50.0]), 0.005)[0] == 0.0
    assert observer.update(np.array([50.0]), 0.005)[0] == 0.0
