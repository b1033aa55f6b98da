import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_curve import ToolCurve, coordinates
from test.motion.whole_body.tool_support import (
    angle_between,
    circle,
    line,
    random_corners,
    rotations_about,
    turn,
    waves,
)

OPTIONS = ToolPathOptions()
PATHS = [random_corners(1), random_corners(2), waves(), circle(0.8, True), turn(7.0)]


@pytest.mark.parametrize("poses", PATHS)
def test_the_curve_reproduces_the_end_poses(poses):
    curve = ToolCurve(poses, OPTIONS)
    assert np.allclose(curve.pose(np.zeros(1)), poses[0], atol=1e-12)
    assert np.allclose(curve.pose(np.array([curve.end])), poses[-1], atol=1e-12)
    straight = ToolCurve(np.stack([poses[0], poses[len(poses) // 2]]), OPTIONS)
    end = straight.pose(np.array([straight.end]))[0]
    assert np.allclose(end, poses[len(poses) // 2], atol=1e-12)


@pytest.mark.parametrize("poses", PATHS)
def test_all_poses_are_passed_in_order_within_the_tolerances(poses):
    curve = ToolCurve(poses, OPTIONS)
    poses_along = curve.pose(np.linspace(0.0, curve.end, 40000))
    last = 0
    for pose in poses:
        off = np.maximum(
            np.linalg.norm(poses_along[last:, :3, 3] - pose[:3, 3], axis=1) / OPTIONS.tolerance,
            angle_between(poses_along[last:, :3, :3], pose[:3, :3]) / OPTIONS.angular_tolerance,
        )
        assert off.min() <= 1.0
        last += int((off <= 1.0).argmax())


@pytest.mark.parametrize("poses", PATHS)
def test_two_derivatives_are_continuous_and_the_second_is_zero_at_both_ends(poses):
    curve = ToolCurve(poses, OPTIONS)
    knots = curve.knots[1:-1]
    before, after = (curve.derivatives(knots + step, 2) for step in (-1e-12, 1e-12))
    scale = np.abs(curve.derivatives(curve.knots, 2)[2]).max()
    for left, right, slack in zip(before, after, (1e-11, 1e-8, 1e-5 * scale), strict=True):
        assert np.abs(left - right).max() < slack + 1e-12
    ends = curve.derivatives(np.array([0.0, curve.end]), 2)[2]
    assert np.abs(ends).max() < 1e-9 * max(scale, 1.0)


@pytest.mark.parametrize("poses", PATHS)
def test_twist_and_its_change_are_derivatives_of_the_pose(poses):
    curve, step = ToolCurve(poses, OPTIONS), 1e-6
    u = 0.5 * (curve.knots[1:] + curve.knots[:-1])
    u = u[np.diff(curve.knots) > 10.0 * step]
    pose, twist, change = curve.motion(u)
    (ahead, twist_ahead, _), (behind, twist_behind, _) = (
        curve.motion(u + step),
        curve.motion(u - step),
    )
    turned = (ahead - behind)[:, :3, :3] @ np.swapaxes(pose[:, :3, :3], 1, 2) / (2.0 * step)
    rate = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
    assert np.allclose(twist[:, :3], (ahead - behind)[:, :3, 3] / (2.0 * step), atol=1e-6)
    assert np.allclose(twist[:, 3:], rate, atol=1e-6)
    slope = (twist_ahead - twist_behind) / (2.0 * step)
    assert np.allclose(change, slope, atol=1e-5, rtol=1e-6)


def test_turns_accumulate_beyond_one_revolution():
    assert coordinates(turn(20.0))[-1, 3] == pytest.approx(20.0)


def test_the_length_is_that_of_the_path_of_the_tool_origin():
    assert ToolCurve(line(4.0), OPTIONS).length() == pytest.approx(4.0, abs=1e-6)
    assert ToolCurve(circle(1.0, True), OPTIONS).length() == pytest.approx(math.tau, rel=1e-3)
    assert ToolCurve(turn(3.0), OPTIONS).length() == pytest.approx(0.0, abs=1e-9)


def test_an_upside_down_tool_is_refused_with_its_pose():
    poses = np.repeat(np.eye(4)[None], 4, axis=0)
    poses[2, :3, :3] = rotations_about(0, 3.1)[0]
    with pytest.raises(InputError, match=r"pose 1 of the path tilts .* 3\.1 rad"):
        ToolCurve(poses, OPTIONS)


def test_a_path_of_one_pose_is_refused():
    with pytest.raises(InputError, match="nothing to do"):
        ToolCurve(np.repeat(np.eye(4)[None], 3, axis=0), OPTIONS)


def test_noise_within_the_tolerance_is_removed():
    poses = line(4.0, 2000)
    poses[1:-1, :3, 3] += np.random.default_rng(4).uniform(-5e-5, 5e-5, (1998, 3))
    assert len(ToolCurve(poses, OPTIONS).knots) < 20
