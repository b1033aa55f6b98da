"""Kinematics of the UR5 against known poses, its own inverse and an independent library."""

import math

import numpy as np
import pytest

from omniman_ros.core.arm_model import DH_TWISTS, JOINTS, UR5, ArmModel

MODEL = ArmModel()
LOWER, UPPER = np.full(JOINTS, -math.tau), np.full(JOINTS, math.tau)


@pytest.fixture(scope="module")
def many():
    """Return joint angles (10000, 6) [rad] and their poses."""
    q = np.random.default_rng(5).uniform(-math.pi, math.pi, (10_000, JOINTS))
    return q, MODEL.forward(q)


def wrapped(angle):
    return np.remainder(angle + math.pi, math.tau) - math.pi


def test_stretched_arm_has_the_length_of_its_dh_table():
    pose = MODEL.forward(np.zeros(JOINTS))
    t = UR5
    assert pose[:3, 3] == pytest.approx([t.a2 + t.a3, -t.d4 - t.d6, t.d1 - t.d5])
    upright = MODEL.forward(np.array([0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0]))
    assert upright[2, 3] == pytest.approx(t.d1 - t.a2 - t.a3 + t.d5)


def test_poses_are_rigid_transforms(many):
    turned = many[1][:, :3, :3]
    assert np.allclose(turned @ np.swapaxes(turned, 1, 2), np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)


def test_every_solution_reaches_the_pose_and_one_equals_the_original_angles(many):
    q, poses = many
    found = MODEL.inverse(poses)
    there = np.isfinite(found).all(axis=2)
    assert set(there.sum(axis=1).tolist()) <= {2, 4, 6, 8}
    back = MODEL.forward(np.where(there[..., None], found, 0.0))
    assert np.abs(back - poses[:, None])[there].max() < 1e-9
    assert (np.abs(found[there]) <= math.pi).all()
    apart = np.abs(wrapped(found - q[:, None])).max(axis=2)
    assert np.nanmin(apart, axis=1).max() < 1e-8


def test_eight_solutions_differ():
    q = np.array([0.3, -1.1, 1.4, -0.9, 0.8, 0.2])
    found = MODEL.inverse(MODEL.forward(q))
    assert np.isfinite(found).all()
    for i in range(8):
        for j in range(i):
            assert np.abs(wrapped(found[i] - found[j])).max() > 0.1


@pytest.mark.parametrize("place", [[1.2, 0.0, 0.3], [0.0, 0.05, 0.3], [0.0, 0.0, 1.3]])
def test_poses_out_of_reach_are_nan(place):
    pose = np.eye(4)
    pose[:3, 3] = place
    assert np.isnan(MODEL.inverse(pose)).any(axis=1).all()
    assert MODEL.nearest(pose, np.zeros(JOINTS), LOWER, UPPER) is None


def test_stretched_wrist_still_has_solutions():
    q = np.array([0.3, -1.1, 1.4, -0.9, 0.0, 0.4])
    found = MODEL.inverse(MODEL.forward(q))
    there = np.isfinite(found).all(axis=1)
    assert there.any()
    assert np.abs(MODEL.forward(found[there]) - MODEL.forward(q)).max() < 1e-6


def test_nearest_solution_is_on_the_same_branch_and_turn(many):
    rng = np.random.default_rng(6)
    for q in many[0][:200]:
        if np.linalg.svd(MODEL.jacobian(q), compute_uv=False)[-1] < 0.02:
            continue
        near = 1.9 * q + rng.uniform(-0.01, 0.01, JOINTS)
        assert (
            MODEL.nearest(MODEL.forward(1.9 * q), near, LOWER, UPPER)
            == pytest.approx(1.9 * q, abs=1e-7)
            or np.linalg.svd(MODEL.jacobian(1.9 * q), compute_uv=False)[-1] < 0.02
        )


def test_nearest_solution_stays_within_the_limits():
    q = np.array([0.3, -1.1, 1.4, -0.9, 0.8, 3.1])
    pose = MODEL.forward(q + np.array([0, 0, 0, 0, 0, 0.2]))
    upper = UPPER.copy()
    upper[5] = 3.2
    found = MODEL.nearest(pose, q, LOWER, upper)
    assert found[5] <= 3.2
    assert np.abs(MODEL.forward(found) - pose).max() < 1e-9
    upper[5], lower = 3.2, LOWER.copy()
    lower[5] = 3.15
    assert MODEL.nearest(pose, q, lower, upper) is None


def test_jacobian_is_the_derivative_of_the_pose(many):
    q, step = many[0][:300], 1e-6
    jacobian = MODEL.jacobian(q)
    for i in range(JOINTS):
        change = np.zeros(JOINTS)
        change[i] = step
        ahead, behind = MODEL.forward(q + change), MODEL.forward(q - change)
        moved = (ahead - behind) / (2.0 * step)
        spin = moved[:, :3, :3] @ np.swapaxes(many[1][:300, :3, :3], 1, 2)
        turn = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.abs(jacobian[:, :3, i] - moved[:, :3, 3]).max() < 1e-8
        assert np.abs(jacobian[:, 3:, i] - turn).max() < 1e-8


def at_shoulder():
    """Return angles (6,) for which the wrist is above the first joint."""
    t, q = UR5, np.array([0.4, 0.0, 1.2, -0.7, 0.9, 0.1])
    lifts = np.linspace(-math.pi, math.pi, 200_001)
    fore = lifts + q[2]
    reach = t.a2 * np.cos(lifts) + t.a3 * np.cos(fore) + t.d5 * np.sin(fore + q[3])
    q[1] = lifts[np.abs(reach).argmin()]
    return q


@pytest.mark.parametrize(
    ("q", "name"),
    [
        (np.array([0.3, -1.1, 1.4, -0.9, 0.0, 0.2]), "wrist"),
        (np.array([0.3, -1.1, 1.4, -0.9, math.pi, 0.2]), "wrist"),
        (np.array([0.3, -1.1, 0.0, -0.9, 0.8, 0.2]), "elbow"),
        (at_shoulder(), "shoulder"),
        (np.array([0.3, -1.1, 1.4, -0.9, 0.8, 0.2]), ""),
    ],
)
def test_singularities_are_reported_where_the_jacobian_loses_rank(q, name):
    assert MODEL.singularity(q) == name
    least = np.linalg.svd(MODEL.jacobian(q), compute_uv=False)[-1]
    assert least < 1e-3 if name else least > 0.02


def test_forward_kinematics_agree_with_an_independent_library(many):
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.Model()
    place = pinocchio.SE3.Identity()
    joint = 0
    for i, (d, a) in enumerate(zip(MODEL._d, MODEL._a, strict=True)):
        joint = model.addJoint(joint, pinocchio.JointModelRZ(), place, f"joint_{i}")
        turned = pinocchio.utils.rotate("x", DH_TWISTS[i])
        place = pinocchio.SE3(turned, np.array([a, 0.0, d]))
    tool = model.addFrame(pinocchio.Frame("tool0", joint, place, pinocchio.FrameType.OP_FRAME))
    data = model.createData()
    q, poses = many
    jacobians = MODEL.jacobian(q)
    reference = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for angles, pose, jacobian in zip(q, poses, jacobians, strict=True):
        pinocchio.computeJointJacobians(model, data, angles)
        pinocchio.updateFramePlacements(model, data)
        assert np.abs(data.oMf[tool].homogeneous - pose).max() < 1e-9
        theirs = pinocchio.getFrameJacobian(model, data, tool, reference)
        assert np.abs(theirs - jacobian).max() < 1e-9
