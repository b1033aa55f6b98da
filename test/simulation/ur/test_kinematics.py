"""Forward kinematics against values reported by a controller."""

import math
import struct

import numpy as np
import pytest

from omniman_ros.simulation.ur import kinematics
from omniman_ros.simulation.ur.kinematics import DhParameters

# First robot state of a UR5e from URSim 5.8, its joint data, Cartesian and kinematics info:
# Universal_Robots_Client_Library, tests/test_primary_parser.cpp, ROBOT_STATE.
UR5E = DhParameters(
    a=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0),
    d=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996),
    alpha=(math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0),
)
Q = struct.unpack(
    ">6d",
    bytes.fromhex(
        "bff99c779a6b50b0 bffba2339c0ebee0 c0019fbe76c8b438"
        "bfe9db22d0e56040 3ff9858793dd97f6 bf9fbe76c8b43900"
    ),
)
POSE = struct.unpack(
    ">6d",
    bytes.fromhex(
        "bfc26d90a01de777 bfdbe132f6a86644 3fc9dc1eb00331e6"
        "bf5402c0f8e6e679 4008ee226378fae0 3fa3e9a4237a7b0a"
    ),
)


def test_pose_equals_the_one_reported_by_a_controller():
    assert kinematics.pose(np.array(Q), UR5E) == pytest.approx(POSE, abs=1e-7)


def test_stretched_ur5_has_the_length_of_its_links():
    pose = kinematics.pose(np.zeros(6))
    assert pose[:3] == pytest.approx([-0.81725, -0.19145, -0.005491])
    assert pose[3:] == pytest.approx([math.pi / 2, 0, 0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, math.pi - 1e-9, math.pi])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0.6, -0.8), (-0.6, 0.0, 0.8)])
def test_rotation_vector_reproduces_its_rotation(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    found = kinematics.rotation_vector(rotation)
    sign = np.sign(found @ axis) if angle == math.pi else 1.0  # either sign
    assert found * sign == pytest.approx(np.array(axis) * angle, abs=1e-7)


@pytest.mark.parametrize("link", [kinematics.ELBOW, 6])
def test_twist_is_the_rate_of_the_frame(link):
    rng = np.random.default_rng(3)
    for _ in range(20):
        q, qd, h = rng.uniform(-3, 3, 6), rng.uniform(-2, 2, 6), 1e-6
        before, after = (kinematics.frames(q + s * h * qd)[link] for s in (-1, 1))
        twist = kinematics.twist(q, qd, link)
        assert twist[:3] == pytest.approx((after - before)[:3, 3] / (2 * h), abs=1e-6)
        turn = kinematics.rotation_vector(after[:3, :3] @ before[:3, :3].T)
        assert twist[3:] == pytest.approx(turn / (2 * h), abs=1e-5)
