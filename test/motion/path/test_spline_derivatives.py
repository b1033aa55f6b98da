import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.core.errors import InputError
from omniman_ros.motion.path import spline_derivatives
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.timed_curve import TimedCurve

SEEDS = st.integers(0, 10_000)
ONE = np.ones(2)
UNITS = ("rad", "rad")


def points(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 2.0, n))])
    return times, rng.normal(size=(n + 1, 2))


def one_sided_derivatives(curve: TimedCurve, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a derivative at the inner points from the polynomials on the left and right."""
    spans = np.diff(curve.times)[:, None]
    c = curve._coefficients(np.arange(len(spans)))
    for _ in range(order):
        c = (np.arange(len(c)).reshape(-1, 1, 1) * c)[1:]
    return (c.sum(axis=0) / spans**order)[:-1], (c[0] / spans**order)[1:]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS)
def test_the_minimum_jerk_spline_passes_all_points_with_four_continuous_derivatives(seed):
    times, x = points(seed)
    curve = TimedCurve(times, x, *spline_derivatives.minimum_jerk(times, x, 0 * ONE, 0 * ONE))
    assert curve.sample(times)[0] == pytest.approx(x, abs=1e-12)
    for order in (1, 2, 3, 4):
        left, right = one_sided_derivatives(curve, order)
        scale = max(1.0, float(np.abs(left).max()))
        assert left == pytest.approx(right, abs=1e-7 * scale)


def test_the_minimum_jerk_spline_of_a_quintic_is_that_quintic():
    times = np.array([0.0, 0.3, 1.1, 2.0])
    u = times / 2.0
    x = (u**3 * (10 - 15 * u + 6 * u * u))[:, None] * [1.0, -2.0]
    curve = TimedCurve(times, x, *spline_derivatives.minimum_jerk(times, x, 0 * ONE, 0 * ONE))
    at = np.linspace(0, 2, 101)
    u = at / 2.0
    assert curve.sample(at)[0][:, 0] == pytest.approx(u**3 * (10 - 15 * u + 6 * u * u), abs=1e-12)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS)
def test_the_third_derivative_is_continuous_for_given_velocities(seed):
    times, x = points(seed)
    v = np.random.default_rng(seed + 1).normal(size=x.shape)
    a = spline_derivatives.accelerations(times, x, v, ONE)
    curve = TimedCurve(times, x, v, a)
    assert (a[0] == ONE).all() and not a[-1].any()
    left, right = one_sided_derivatives(curve, 3)
    assert left == pytest.approx(right, abs=1e-8 * max(1.0, float(np.abs(left).max(initial=0))))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(SEEDS)
def test_extrema_agree_with_a_fine_sampling(seed):
    times, x = points(seed)
    rng = np.random.default_rng(seed + 2)
    curve = TimedCurve(times, x, rng.normal(size=x.shape), rng.normal(size=x.shape))
    inner = [np.linspace(a, b, 400) for a, b in itertools.pairwise(times)]
    at = np.concatenate([*inner[:-1], inner[-1] - 1e-12])
    for (_, values), sampled in zip(curve.extremes(), curve.sample(at), strict=False):
        high, low = values.max(axis=(0, 1)), values.min(axis=(0, 1))
        slack = 1e-3 * (high - low)
        assert (sampled.max(axis=0) <= high + 1e-9).all()
        assert (sampled.max(axis=0) >= high - slack).all()
        assert (sampled.min(axis=0) >= low - 1e-9).all()
        assert (sampled.min(axis=0) <= low + slack).all()


@pytest.mark.parametrize(
    ("label", "value", "words"),
    [
        ("upper", 0.99, "b: position 1 rad at 2.000 s, the limit is 0.99 rad"),
        ("velocity", 0.93, "b: velocity 0.9375 rad/s at 1.000 s, the limit is 0.93 rad/s"),
        ("acceleration", 1.44, r"b: acceleration -?1.443 rad/s\^2 at .*, the limit is -?1.44"),
        ("jerk", 7.4, r"b: jerk 7.5 rad/s\^3 at .*, the limit is 7.4 rad/s\^3"),
    ],
)
def test_a_violated_limit_is_reported_with_joint_time_and_value(label, value, words):
    rest = np.zeros((2, 2))
    curve = TimedCurve(np.array([0.0, 2.0]), np.array([[0.0, 0.0], [0.2, 1.0]]), rest, rest)
    free = {"lower": -9 * ONE, "upper": 9 * ONE, "velocity": ONE, "acceleration": 2 * ONE}
    free["jerk"] = 8 * ONE
    AxisLimits(("a", "b"), **free, units=UNITS).require_kept(curve, 1.0)
    limits = AxisLimits(("a", "b"), **(free | {label: value * ONE}), units=UNITS)
    with pytest.raises(InputError, match=words):
        limits.require_kept(curve, 1.0)
    if label == "jerk":
        limits.require_kept(curve, 1.1)
