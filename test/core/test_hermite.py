"""Hermite interpolation in any number of dimensions."""

import numpy as np
import pytest

from omniman_ros.core.hermite import Hermite


def polynomial(degree, dimensions, seed):
    """Return coefficients (degree + 1, d), lowest first, and those of two derivatives."""
    rows = [np.random.default_rng(seed).normal(size=(degree + 1, dimensions))]
    for _ in range(2):
        last = rows[-1]
        rows.append(last[1:] * np.arange(1, len(last))[:, None])
    return rows


def at(coefficients, times):
    powers = np.power.outer(np.atleast_1d(times), np.arange(len(coefficients)))
    return powers @ coefficients


@pytest.mark.parametrize("dimensions", [1, 3, 6, 9])
@pytest.mark.parametrize(("degree", "with_accelerations"), [(5, True), (3, False)])
def test_polynomial_of_matching_degree_is_reproduced(dimensions, degree, with_accelerations):
    x, v, a = polynomial(degree, dimensions, seed=dimensions)
    times = np.array([-1.0, -0.3, 0.4, 0.5, 1.2])
    accelerations = at(a, times) if with_accelerations else None
    curve = Hermite(times, at(x, times), at(v, times), accelerations)
    for now in np.linspace(-1.0, 1.2, 50, endpoint=False)[::-1]:
        for sampled, expected in zip(curve.sample(now), (x, v, a), strict=True):
            assert sampled.shape == (dimensions,)
            assert sampled == pytest.approx(at(expected, now)[0], abs=1e-9)


@pytest.mark.parametrize("with_accelerations", [True, False])
def test_vectorised_evaluation_equals_evaluation_one_by_one(with_accelerations):
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.1, 1.0, 5))
    rows = [rng.normal(size=(5, 6)) for _ in range(3)]
    curve = Hermite(times, rows[0], rows[1], rows[2] if with_accelerations else None)
    asked = np.linspace(times[0] - 1.0, times[-1] + 1.0, 200)
    expected = [curve.sample(now)[0] for now in asked]
    assert np.allclose(curve.positions_at(asked), expected, rtol=0, atol=1e-12)


def test_single_point_is_constant_over_all_times():
    curve = Hermite(np.array([1.0]), np.array([[3.0, 4.0]]), np.zeros((1, 2)), None)
    assert curve.positions_at(np.array([0.0, 1.0, 2.0])).tolist() == [[3.0, 4.0]] * 3
