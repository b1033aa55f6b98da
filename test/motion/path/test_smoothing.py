import numpy as np
import pytest

from omniman_ros.motion.path.smoothing import Smoother, deviation, window_ticks
from test.motion.path.support import DT, assert_smooth_within_limits, axes, continuity


def test_the_window_is_twice_acceleration_over_jerk_of_the_slowest_group():
    assert window_ticks(axes(), DT) == 25
    assert window_ticks(axes(jerk=4.0), DT) == 50
    assert window_ticks(axes(jerk=1e6)[:1], DT) == 1


@pytest.mark.parametrize("ticks", [1, 2, 7, 25])
def test_a_motion_at_constant_velocity_is_only_delayed(ticks):
    k = np.arange(100.0)
    line = np.column_stack([0.3 * k * DT, 1.0 - 0.1 * k * DT])
    smoother = Smoother(ticks, DT)
    x, v, a = smoother.smooth(line)
    lag = (smoother.memory / 2) * DT
    now = k[smoother.memory :] * DT
    assert x == pytest.approx(np.column_stack([0.3 * (now - lag), 1 - 0.1 * (now - lag)]))
    assert v == pytest.approx(np.broadcast_to([0.3, -0.1], v.shape))
    assert np.abs(a).max() < 1e-9


def test_a_motion_at_rest_is_unchanged():
    x, v, a = Smoother(25, DT).smooth(np.full((60, 3), 7.5))
    assert x == pytest.approx(7.5) and np.abs(v).max() < 1e-12 and np.abs(a).max() < 1e-10


@pytest.mark.parametrize("seed", range(20))
def test_smoothing_keeps_acceleration_limits_and_bounds_the_jerk(seed):
    """The accelerations jump arbitrarily within their limit, including full reversals."""
    rng = np.random.default_rng(seed)
    groups = axes(velocity=1e3)
    fine = 40  # steps of the unsmoothed motion in a tick
    jumps = rng.normal(size=(40, 3))
    jumps[:, :2] *= 0.8 / np.hypot(*jumps[:, :2].T)[:, None]
    jumps[:, 2] = 1.2 * np.sign(jumps[:, 2])
    acceleration = np.repeat(jumps, rng.integers(1, 12, size=40) * fine // 3, axis=0)
    h = DT / fine
    velocity = np.cumsum(acceleration, axis=0) * h
    position = np.cumsum(velocity, axis=0) * h
    raw = position[::fine]
    groups = (groups[0], axes()[1].__class__((2,), 1e3, 1.2, 12.0, 0.1))
    smoother = Smoother(window_ticks(groups, DT), DT)
    x, v, a = smoother.smooth(raw)
    if len(x) > 2:
        assert_smooth_within_limits(groups, x, v, a)


def test_a_reversal_uses_the_full_jerk_limit():
    k = np.arange(400) * DT
    reversal = np.where(k < 1.6, 0.4 * k**2, 1.024 + 1.28 * (k - 1.6) - 0.4 * (k - 1.6) ** 2)
    _, _, a = Smoother(25, DT).smooth(reversal[:, None])
    jerk = np.abs(np.diff(a[:, 0])).max() / DT
    assert jerk == pytest.approx(8.0, rel=0.01)


def test_a_very_long_window_needs_no_more_memory_than_the_motion():
    x, v, a = Smoother(20_000, DT).smooth(np.full((20_010, 1), 2.0))
    assert x == pytest.approx(2.0) and np.abs(v).max() < 1e-9 and np.abs(a).max() < 1e-9


def test_the_deviation_from_a_circle_is_within_the_stated_bound():
    radius, speed = 0.5, 0.5
    phase = speed / radius * np.arange(600) * DT
    circle = radius * np.column_stack([np.cos(phase), np.sin(phase)])
    x, _, _ = Smoother(25, DT).smooth(circle)
    bound = deviation(speed**2 / radius, 25, DT)
    off = radius - np.hypot(*x.T)
    assert 0.9 * bound < off.max() <= bound


def test_the_smoothed_motion_is_cubic_between_ticks():
    rng = np.random.default_rng(3)
    x, v, a = Smoother(9, DT).smooth(np.cumsum(rng.normal(size=(200, 3)), axis=0) * 1e-3)
    assert continuity(x, v, a) < 1e-12
