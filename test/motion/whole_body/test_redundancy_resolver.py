import math

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.redundancy_resolver import (
    RedundancyResolver,
    solve_block_tridiagonal,
)
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_timing import PlatformSpline, WholeBodyPath
from test.motion.whole_body.tool_support import (
    ARM,
    LIMITS,
    MODEL,
    OPTIONS,
    START,
    body_limits,
    circle,
    line,
    random_corners,
    tool_path,
    turn,
    waves,
)

RESOLVER = RedundancyResolver(MODEL, LIMITS, OPTIONS)


def resolved(poses, start=START, resolver=RESOLVER):
    now = MODEL.forward(start)[None]
    return resolver.resolve(ToolCurve(np.concatenate([now, poses]), OPTIONS), start)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 8, 33])
def test_cyclic_reduction_solves_a_block_tridiagonal_system(count):
    rng = np.random.default_rng(count)
    lower = np.zeros((3 * count, 3 * count))
    for k in range(count):
        rows = slice(3 * k, 3 * k + 3)
        lower[rows, rows] = rng.normal(size=(3, 3)) + 5.0 * np.eye(3)
        if k:
            lower[rows, 3 * k - 3 : 3 * k] = rng.normal(size=(3, 3))
    whole, right = lower @ lower.T, rng.normal(size=3 * count)
    blocks = whole.reshape(count, 3, count, 3).swapaxes(1, 2)
    i = np.arange(count)
    found = solve_block_tridiagonal(blocks[i, i], blocks[i[:-1], i[1:]], right.reshape(count, 3))
    assert np.allclose(whole @ found.ravel(), right, atol=1e-9)


@pytest.mark.parametrize(
    "poses", [line(), circle(0.8, True), circle(1.0, False), waves(), random_corners(3)]
)
def test_postures_hold_the_tool_and_keep_their_margins(poses):
    found = resolved(poses)
    tool = ToolCurve(np.concatenate([MODEL.forward(START)[None], poses]), OPTIONS)
    assert (found.platform[0] == START[:3]).all()
    assert np.allclose(MODEL.forward(np.hstack([found.platform, found.arm])), tool.pose(found.at))
    assert np.abs(np.diff(found.arm, axis=0)).max() < 0.5
    margins, _ = RESOLVER.margins(found.arm, RESOLVER.signs(ARM))
    assert margins.min() >= OPTIONS.singularity


def test_the_arm_keeps_its_shape_on_a_straight_line():
    found = resolved(line())
    middle = found.arm[len(found.arm) // 2]
    assert np.abs(middle - ARM)[:5].max() < 0.35


def test_the_platform_derivative_is_the_derivative_of_the_angles():
    rng = np.random.default_rng(5)
    q = START + rng.normal(size=(20, 9)) * 0.2
    slope, tool = RESOLVER.platform_derivative(q), MODEL.forward(q)
    branch = MODEL.arm.branch_of(ARM)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        ahead, behind = (
            MODEL.arm_angles(q[:, :3] + side * step, tool, branch, q[:, 3:]) for side in (1, -1)
        )
        assert np.allclose((ahead - behind) / 2e-6, slope[:, :, axis], atol=1e-5)


@pytest.mark.parametrize("what", ["margins", "hinges"])
def test_the_slopes_of_margins_and_hinges_are_their_derivatives(what):
    rng = np.random.default_rng(6)
    arm, signs = rng.uniform(-6.4, 6.4, (200, 6)), np.array([1.0, -1.0, 1.0])
    call = getattr(RESOLVER, what)
    values, slopes = call(arm, signs)
    for joint in range(6):
        step = 1e-7 * np.eye(6)[joint]
        change = (call(arm + step, signs)[0] - call(arm - step, signs)[0]) / 2e-7
        smooth = np.abs(change - slopes[:, :, joint]) < 1e-4 * (1.0 + np.abs(change))
        assert smooth.mean() > 0.999  # the derivative jumps where a hinge becomes active
    assert (values != 0.0).any()


@pytest.mark.parametrize(
    ("joint", "angle", "name"), [(2, 0.05, "elbow"), (4, -0.02, "wrist"), (1, -0.9, "shoulder")]
)
def test_a_start_near_a_singularity_is_refused_by_name(joint, angle, name):
    start = START.copy()
    start[3 + joint] = angle
    if name == "shoulder":  # the wrist is above the base of the arm
        start[3:] = [0.0, -0.9, -2.0, -0.2, -1.57, 0.0]
        found = np.linspace(-1.6, -0.2, 4000)
        arms = np.repeat(start[None, 3:], 4000, axis=0)
        arms[:, 1] = found
        start[3:] = arms[np.abs(RESOLVER.margins(arms, np.ones(3))[0][:, 2]).argmin()]
    with pytest.raises(InputError, match=f"starts too close to the {name}'s singularity"):
        resolved(line(start=start), start)


@pytest.mark.parametrize("height", [1.2, -1.5])
def test_a_pose_out_of_reach_is_refused_with_its_position(height):
    poses = tool_path(np.outer(np.linspace(0, 1, 50), [0.5, 0.0, height]))
    with pytest.raises(
        InputError, match=r"near pose \d+ of the path, with the tool at \("
    ) as refused:
        resolved(poses)
    index = int(str(refused.value).split("pose ")[1].split()[0])
    assert 5 < index < 49
    place = [float(x) for x in str(refused.value).split("at (")[1].split(")")[0].split(",")]
    assert np.linalg.norm(poses[index, :3, 3] - place) < 0.03


def test_the_platform_turns_where_a_joint_reaches_its_limit():
    found = resolved(turn(6.0 * math.pi))
    assert np.abs(found.arm[:, 5]).max() <= 2.0 * math.pi
    assert abs(found.platform[-1, 2] - START[2]) > 2.0 * math.pi
    narrow = body_limits(
        ArmParameters(lower=(-6.28, -6.28, -3.14, -6.28, -6.28, -0.3), upper=(6.28,) * 5 + (0.3,))
    )
    for angle in (1.5, -1.5):
        found = resolved(turn(angle), resolver=RedundancyResolver(MODEL, narrow, OPTIONS))
        assert np.abs(found.arm[:, 5]).max() <= 0.3


@pytest.mark.parametrize(
    ("joint", "angle", "words"),
    [
        (2, 3.1, "close to the elbow's singularity, the sine of the elbow is 0.0416"),
        (4, -0.02, "close to the wrist's singularity, the sine of wrist_2 is 0.02"),
        (5, 6.5, "wrist_3_joint is at 6.5 rad, its limit is 6.283 rad"),
        (0, -6.5, "shoulder_pan_joint is at -6.5 rad, its limit is -6.283 rad"),
        (0, np.nan, "out of the arm's reach"),
    ],
)
def test_the_cause_of_an_impossible_posture_is_named(joint, angle, words):
    tool = ToolCurve(line(), OPTIONS)
    arms = np.repeat(ARM[None], 3, axis=0)
    RESOLVER.require_possible(tool, np.array([0.0, 1.0, 2.0]), arms, ARM)
    arms[1:, joint] = angle
    if np.isnan(angle):
        arms[1:] = np.nan
    with pytest.raises(InputError, match=r"near pose 2\d of the path.*" + words):
        RESOLVER.require_possible(tool, np.array([0.0, 1.0, 2.0]), arms, ARM)


def test_a_joint_at_its_limit_is_named():
    poses = tool_path(np.outer(np.linspace(0, 1, 30), [0.2, 0.0, 0.4]))
    arm = ArmParameters(
        lower=(-6.28, -1.95, 1.95, -1.75, -6.28, -6.28),
        upper=(6.28, -1.85, 2.05, -1.65, 6.28, 6.28),
    )
    stiff = body_limits(arm)
    with pytest.raises(InputError, match=r"_joint is at .* its limit is"):
        resolved(poses, resolver=RedundancyResolver(MODEL, stiff, OPTIONS))


def test_the_platform_spline_meets_its_end_points_and_is_smooth():
    points = np.cumsum(np.random.default_rng(7).normal(size=(20, 3)), axis=0)
    spline = PlatformSpline(points, 2.0)
    places, _, second_derivatives = spline.motion(np.array([0.0, 2.0]))
    assert np.allclose(places, points[[0, -1]]) and np.allclose(second_derivatives, 0.0, atol=1e-9)
    u = np.linspace(0.01, 1.99, 777)
    (_, slope, second_derivative), ahead, behind = (
        spline.motion(u + s) for s in (0.0, 1e-6, -1e-6)
    )
    assert np.allclose((ahead[0] - behind[0]) / 2e-6, slope, atol=1e-5)
    assert np.allclose((ahead[1] - behind[1]) / 2e-6, second_derivative, atol=1e-2)
    left, right = (spline.motion(2.0 / 19 * np.arange(1, 19) + s)[2] for s in (-1e-9, 1e-9))
    assert np.allclose(left, right, atol=1e-3)


@pytest.mark.parametrize("poses", [circle(0.8, True), waves(), random_corners(3)])
def test_derivatives_of_the_nine_axes_are_exact(poses):
    tool = ToolCurve(np.concatenate([MODEL.forward(START)[None], poses]), OPTIONS)
    motion_path = WholeBodyPath(
        MODEL, tool, RESOLVER.resolve(tool, START), MODEL.arm.branch_of(ARM)
    )
    u, step = 0.5 * (tool.knots[1:] + tool.knots[:-1]), 1e-6
    u = u[np.diff(tool.knots) > 10.0 * step]
    q, first, second, twist, _ = motion_path.motion(u)
    (ahead, rate_ahead, *_), (behind, rate_behind, *_) = (
        motion_path.motion(u + step),
        motion_path.motion(u - step),
    )
    assert np.allclose(first, (ahead - behind) / (2.0 * step), atol=1e-5, rtol=1e-5)
    slope = (rate_ahead - rate_behind) / (2.0 * step)
    assert np.allclose(second, slope, atol=1e-3, rtol=1e-4)
    assert np.allclose((MODEL.jacobian(q) @ first[:, :, None])[:, :, 0], twist, atol=1e-9)
