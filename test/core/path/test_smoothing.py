import numpy as np
import pytest

from omniman_ros.core.path.smoothing import Smoother, deviation, window_ticks

from .support import DT, assert_smooth_within_limits, axes, continuity


def test_window_is_twice_acceleration_over_jerk_of_the_slowest_group():
    assert window_ticks(axes(), DT) == 25
    assert window_ticks(axes(jerk=4.0), DT) == 50
    assert window_ticks(axes(jerk=1e6)[:1], DT) == 1


@pytest.mark.parametrize("ticks", [1, 2, 7, 25])
def test_a_polynomial_of_first_degree_is_only_delayed(ticks):
    k = np.arange(100.0)
    line = np.column_stack([0.3 * k * DT, 1.0 - 0.1 * k * DT])
    smoother = Smoother(ticks, DT)
    x, v, a = smoother.smooth(line)
    lag = (smoother.memory / 2) * DT
    now = k[smoother.memory :] * DT
    assert x == pytest.approx(np.column_stack([0.3 * (now - lag), 1 - 0.1 * (now - lag)]))
    assert v == pytest.approx(np.broadcast_to([0.3, -0.1], v.shape))
    assert np.abs(a).max() < 1e-9


def test_rest_stays_where_it_is():
    x, v, a = Smoother(25, DT).smooth(np.full((60, 3), 7.5))
    assert x == pytest.approx(7.5) and np.abs(v).max() < 1e-12 and np.abs(a).max() < 1e-10


@pytest.mark.parametrize("seed", range(20))
def test_any_motion_within_a_ball_keeps_it_and_gets_a_bounded_jerk(seed):
    """Accelerations that jump at will within their limit: no reversal is too hard."""
    rng = np.random.default_rng(seed)
    groups = axes(velocity=1e3)
    fine = 40  # steps of the inner motion in a tick
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


def test_the_jerk_is_as_large_as_allowed_for_a_reversal():
    k = np.arange(400) * DT
    reversal = np.where(k < 1.6, 0.4 * k**2, 1.024 + 1.28 * (k - 1.6) - 0.4 * (k - 1.6) ** 2)
    _, _, a = Smoother(25, DT).smooth(reversal[:, None])
    jerk = np.abs(np.diff(a[:, 0])).max() / DT
    assert jerk == pytest.approx(8.0, rel=0.01)


def test_a_very_long_window_takes_no_more_memory_than_its_length():
    x, v, a = Smoother(20_000, DT).smooth(np.full((20_010, 1), 2.0))
    assert x == pytest.approx(2.0) and np.abs(v).max() < 1e-9 and np.abs(a).max() < 1e-9


def test_leaves_a_circle_by_no_more_than_it_says():
    radius, speed = 0.5, 0.5
    phase = speed / radius * np.arange(600) * DT
    circle = radius * np.column_stack([np.cos(phase), np.sin(phase)])
    x, _, _ = Smoother(25, DT).smooth(circle)
    bound = deviation(speed**2 / radius, 25, DT)
    off = radius - np.hypot(*x.T)
    assert 0.9 * bound < off.max() <= bound


def test_the_result_is_a_cubic_between_ticks():
    rng = np.random.default_rng(3)
    x, v, a = Smoother(9, DT).smooth(np.cumsum(rng.normal(size=(200, 3)), axis=0) * 1e-3)
    assert continuity(x, v, a) < 1e-12
