"""Consistency tests of the nine-axis kinematics, also with those of the arm alone."""

import math

import numpy as np
import pytest

from omniman_ros.core.arm_model import ArmModel
from omniman_ros.motion.axes import AXES
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel, planar_transform

MOUNT = Mount(0.2, -0.1, 0.5, 0.3)
MODEL = WholeBodyModel(MOUNT)


@pytest.fixture(scope="module")
def random_axes():
    """Return random positions of the axes (500, 9)."""
    return np.random.default_rng(8).uniform(-math.pi, math.pi, (500, AXES))


def test_the_arm_is_stretched_forward_at_zero():
    pose = WholeBodyModel(Mount(0.2, 0.0, 0.5, 0.0)).forward(np.zeros(AXES))
    reach = 0.425 + 0.39225
    assert pose[:3, 3] == pytest.approx([0.2 + reach, 0.10915 + 0.0823, 0.5 + 0.089159 - 0.09465])


def test_the_tool_moves_with_the_platform(random_axes):
    still = random_axes.copy()
    still[:, :3] = 0.0
    assert np.allclose(
        MODEL.forward(random_axes), planar_transform(random_axes[:, :3]) @ MODEL.forward(still)
    )


def test_the_jacobian_is_the_derivative_of_the_tool_pose(random_axes):
    step = 1e-6
    jacobian, here = MODEL.jacobian(random_axes), MODEL.forward(random_axes)
    for axis in range(AXES):
        ahead, behind = random_axes.copy(), random_axes.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        change = (MODEL.forward(ahead) - MODEL.forward(behind)) / (2.0 * step)
        assert np.allclose(jacobian[:, :3, axis], change[:, :3, 3], atol=1e-7)
        turn = change[:, :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)
        rate = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.allclose(jacobian[:, 3:, axis], rate, atol=1e-7)


def test_the_inverse_kinematics_hold_the_tool_for_any_platform_pose(random_axes):
    tool = MODEL.forward(random_axes)
    for q, pose in zip(random_axes[:50], tool[:50], strict=True):
        branch = ArmModel().branch_of(q[3:])
        found = MODEL.arm_angles(q[None, :3], pose[None], branch, q[3:])
        assert np.allclose(found[0], q[3:], atol=1e-6)
    moved = random_axes[:1, :3] + [0.01, -0.02, 0.05]
    q = np.concatenate([random_axes[0, :3], [0.3, -1.1, 1.4, -0.9, 0.8, 0.2]])
    pose = MODEL.forward(q)
    moved = q[:3] + [0.01, -0.02, 0.05]
    branch = ArmModel().branch_of(q[3:])
    arm = MODEL.arm_angles(moved[None], pose[None], branch, q[3:])[0]
    assert np.allclose(MODEL.forward(np.concatenate([moved, arm])), pose, atol=1e-12)
