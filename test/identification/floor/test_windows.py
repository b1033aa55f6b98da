import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.identification.floor.windows import Windows, speeds


def test_means_of_derivatives_are_those_of_the_analytic_derivatives():
    times = np.arange(0.0, 4.0, 0.005)
    signal = np.column_stack([np.sin(3.0 * times), times**2])
    first = np.column_stack([3.0 * np.cos(3.0 * times), 2.0 * times])
    second = np.column_stack([-9.0 * np.sin(3.0 * times), np.full_like(times, 2.0)])
    windows = Windows(0.0, 3.9, 0.6, 0.15)
    np.testing.assert_allclose(
        windows.mean(times, signal, 1), windows.mean(times, first), atol=1e-4
    )
    np.testing.assert_allclose(
        windows.mean(times, signal, 2), windows.mean(times, second), atol=1e-3
    )


def test_a_window_with_too_few_samples_is_refused():
    windows = Windows(0.0, 2.0, 0.6, 0.15)
    with pytest.raises(InputError, match="too few"):
        windows.mean(np.arange(0.0, 2.1, 0.2), np.zeros((11, 1)))
    with pytest.raises(InputError, match=r"0\.30 s of data"):
        Windows(0.0, 0.3, 0.6, 0.15)


def test_speeds_of_a_constant_speed_are_exact():
    positions = np.outer(np.arange(200) * 0.005, [2.0, -3.0])
    np.testing.assert_allclose(speeds(positions, 0.005)[10:-10], [[2.0, -3.0]] * 180)
