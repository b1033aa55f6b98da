"""Kinematics of nine axes, against itself and the arm's."""

import math

import numpy as np
import pytest

from omniman_ros.core.arm_model import ArmModel
from omniman_ros.core.body.model import AXES, BodyModel, Mount, planar

MOUNT = Mount(0.2, -0.1, 0.5, 0.3)
MODEL = BodyModel(MOUNT)


@pytest.fixture(scope="module")
def many():
    """Axes (500, 9)."""
    return np.random.default_rng(8).uniform(-math.pi, math.pi, (500, AXES))


def test_an_arm_stretched_at_zero_points_forward():
    pose = BodyModel(Mount(0.2, 0.0, 0.5, 0.0)).forward(np.zeros(AXES))
    reach = 0.425 + 0.39225
    assert pose[:3, 3] == pytest.approx([0.2 + reach, 0.10915 + 0.0823, 0.5 + 0.089159 - 0.09465])


def test_the_tool_moves_with_the_platform(many):
    still = many.copy()
    still[:, :3] = 0.0
    assert np.allclose(MODEL.forward(many), planar(many[:, :3]) @ MODEL.forward(still))


def test_the_jacobian_is_the_derivative(many):
    step = 1e-6
    jacobian, here = MODEL.jacobian(many), MODEL.forward(many)
    for axis in range(AXES):
        ahead, behind = many.copy(), many.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        change = (MODEL.forward(ahead) - MODEL.forward(behind)) / (2.0 * step)
        assert np.allclose(jacobian[:, :3, axis], change[:, :3, 3], atol=1e-7)
        turn = change[:, :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)
        rate = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.allclose(jacobian[:, 3:, axis], rate, atol=1e-7)


def test_the_arm_holds_the_tool_wherever_the_platform_is(many):
    tool = MODEL.forward(many)
    for q, pose in zip(many[:50], tool[:50], strict=True):
        branch = ArmModel().branch_of(q[3:])
        found = MODEL.arm_angles(q[None, :3], pose[None], branch, q[3:])
        assert np.allclose(found[0], q[3:], atol=1e-6)
    moved = many[:1, :3] + [0.01, -0.02, 0.05]
    q = np.concatenate([many[0, :3], [0.3, -1.1, 1.4, -0.9, 0.8, 0.2]])
    pose = MODEL.forward(q)
    moved = q[:3] + [0.01, -0.02, 0.05]
    branch = ArmModel().branch_of(q[3:])
    arm = MODEL.arm_angles(moved[None], pose[None], branch, q[3:])[0]
    assert np.allclose(MODEL.forward(np.concatenate([moved, arm])), pose, atol=1e-12)
