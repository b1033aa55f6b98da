import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.core import se2

ANGLE = st.floats(-100, 100)
SPEED = st.floats(-3, 3)


def exponential(x: float, y: float, angle: float) -> np.ndarray:
    """Return the matrix exponential of a planar displacement by its series."""
    generator = np.array([[0, -angle, x], [angle, 0, y], [0, 0, 0.0]])
    term = total = np.eye(3)
    for i in range(1, 40):
        term = term @ generator / i
        total = total + term
    return total


def matrix(pose: tuple[float, float, float]) -> np.ndarray:
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


@given(ANGLE)
def test_wrap_keeps_the_direction_and_returns_at_most_half_a_turn(angle):
    wrapped = se2.wrap(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-12)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-12)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0, 0), (math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (1.5, 1.5)],
)
def test_wrap_returns_known_angles(angle, wrapped):
    assert se2.wrap(angle) == wrapped


@pytest.mark.parametrize(
    ("angles", "start", "expected"),
    [
        ([3.1, -3.1, 3.1], 3.0, [3.1, math.tau - 3.1, 3.1]),
        ([-3.1, 3.1], 3.0, [math.tau - 3.1, 3.1]),
        ([3.0, 5.0, 7.0], 3.0, [3.0, 5.0, 7.0]),  # several turns, in steps below half a turn
        ([0.2], 20.0 * math.tau, [20.0 * math.tau + 0.2]),
        ([math.pi, 0.0, -math.pi], 0.0, [math.pi, 0.0, -math.pi]),  # half a turn as it is given
        ([], 1.0, []),
    ],
)
def test_each_angle_of_a_course_is_the_nearest_turn_from_the_one_before(angles, start, expected):
    assert se2.nearest_turns(np.array(angles), start) == pytest.approx(expected, abs=1e-12)


@given(ANGLE, SPEED, SPEED, SPEED)
def test_to_robot_and_to_world_equal_ccta_2017_equation_1_and_its_inverse(theta, x, y, w):
    vector = np.array([x, y, w])
    assert se2.rotation(theta).shape == (3, 3)
    np.testing.assert_allclose(se2.to_robot(theta, vector), se2.rotation(theta) @ vector)
    np.testing.assert_allclose(se2.to_world(theta, vector), se2.rotation(theta).T @ vector)
    np.testing.assert_allclose(
        se2.to_world(theta, se2.to_robot(theta, vector)), vector, atol=1e-14
    )


def test_robot_heading_left_has_the_left_of_the_world_ahead():
    left = math.pi / 2
    np.testing.assert_allclose(se2.to_robot(left, np.array([0.0, 1, 0])), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(se2.to_world(left, np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-15)


@given(SPEED, SPEED, st.one_of(SPEED, st.floats(-1e-3, 1e-3)))
def test_arc_equals_the_matrix_exponential(x, y, angle):
    expected = exponential(x, y, angle)
    np.testing.assert_allclose(matrix(se2.arc(np.array([x, y, angle]))), expected, atol=1e-13)


def test_arc_is_continuous_where_the_series_takes_over():
    below = np.array(se2.arc(np.array([1.0, 1, 1e-4 * (1 - 1e-12)])))
    above = np.array(se2.arc(np.array([1.0, 1, 1e-4 * (1 + 1e-12)])))
    np.testing.assert_allclose(below, above, atol=1e-12)


def test_arc_of_a_full_circle_returns_to_the_start():
    x, y, angle = se2.arc(np.array([math.tau * 0.7, 0, math.tau]))
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    assert angle == math.tau
