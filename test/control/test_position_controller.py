import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.control.position_controller import PositionController, PositionGains, pose_error
from omniman_ros.core.preview import Setpoint

GAINS = PositionGains()
VECTOR = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)).map(np.array)


def setpoint(pose=(0, 0, 0), velocity=(0, 0, 0)):
    return Setpoint(np.array(pose, float), np.array(velocity, float), np.zeros(3))


@pytest.mark.parametrize(
    ("reference", "heading", "turn"),
    [
        (3.0, -3.0, 6.0 - math.tau),
        (-3.0, 3.0, math.tau - 6.0),
        (0.1, 0.0, 0.1),
        (50.1, 50, 0.1),
        (0.2, 8 * math.tau + 0.1, 0.1),
    ],
)
def test_heading_error_takes_the_shorter_direction(reference, heading, turn):
    error = pose_error(np.array([1.0, 2, reference]), (0.5, 2.5, heading))
    np.testing.assert_allclose(error, [0.5, -0.5, turn], atol=1e-12)


@given(VECTOR)
def test_correction_is_bounded_and_keeps_its_direction(error):
    velocity = PositionController(GAINS).velocity(setpoint(), error)
    wanted = error * [GAINS.k_xy, GAINS.k_xy, GAINS.k_theta]
    assert velocity.shape == (3,)
    assert math.hypot(*velocity[:2]) <= GAINS.max_linear_correction * (1 + 1e-9)
    assert abs(velocity[2]) <= GAINS.max_angular_correction * (1 + 1e-9)
    np.testing.assert_allclose(np.cross(velocity, wanted), 0, atol=1e-9)
    assert velocity @ wanted >= 0


@given(VECTOR)
def test_reference_velocity_is_fed_forward_unscaled(velocity):
    result = PositionController(GAINS).velocity(setpoint(velocity=velocity), np.zeros(3))
    np.testing.assert_array_equal(result, velocity)


def test_small_errors_decay_at_the_gains():
    controller, pose, dt = PositionController(GAINS), np.array([0.05, -0.03, 0.06]), 1e-4
    for _ in range(10000):
        error = pose_error(np.zeros(3), tuple(pose))
        pose = pose + dt * controller.velocity(setpoint(), error)
    np.testing.assert_allclose(pose, np.array([0.05, -0.03, 0.06]) * math.exp(-4.0), rtol=1e-2)


@given(VECTOR)
def test_pose_beside_a_moving_reference_converges_to_the_reference(offset):
    controller, dt = PositionController(GAINS), 0.005
    velocity = np.array([0.3, -0.2, 0.4])
    pose = offset.copy()
    for i in range(2000):
        reference = setpoint(velocity * i * dt, velocity)
        pose = pose + dt * controller.velocity(reference, pose_error(reference.pose, tuple(pose)))
    np.testing.assert_allclose(pose_error(velocity * 2000 * dt, tuple(pose)), 0, atol=1e-6)


@pytest.mark.parametrize(
    ("error", "lost"),
    [
        ((0.29, 0.39, 0), False),
        ((0.31, 0.41, 0), True),
        ((0, 0, 0.79), False),
        ((0, 0, -0.81), True),
    ],
)
def test_error_beyond_its_limits_counts_as_lost(error, lost):
    assert PositionController(GAINS).lost(np.array(error, float)) is lost


def test_gains_may_change_at_runtime():
    controller = PositionController(GAINS)
    controller.gains = replace(GAINS, k_xy=1.0)
    np.testing.assert_allclose(
        controller.velocity(setpoint(), np.array([0.1, 0, 0.01])), [0.1, 0, 0.04]
    )
