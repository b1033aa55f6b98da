import math

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.model import planar_transform
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from test.motion.whole_body.tool_support import (
    ARM,
    LIMITS,
    MODEL,
    OPTIONS,
    PLANNER,
    START,
    angle_between,
    body_limits,
    circle,
    corner,
    line,
    random_corners,
    tool_path,
    turn,
    waves,
)
from test.tiers import representative

PATHS = {
    "straight": line(),
    "sideways": tool_path([[0, 0, 0], [0, 4, 0]]),
    "circle with": circle(0.8, True),
    "circle wide": circle(1.5, True),
    "circle fixed": circle(1.2, False),
    "corner": corner(),
    "waves": waves(),
    "turn": turn(3.0),
    "there and back": tool_path([[0, 0, 0], [1, 0, 0], [0, 0, 0]]),
    "millimetre": tool_path([[0.001, 0, 0]]),
    "one pose": tool_path([[0.2, 0.1, 0.1]], yaw=0.5, pitch=0.2),
} | {f"random {seed}": random_corners(seed) for seed in range(6)}
CAP = 1.0 + 1e-4


@pytest.fixture(scope="module")
def plans():
    return {name: PLANNER.plan(poses, START) for name, poses in PATHS.items()}


@pytest.mark.parametrize("name", PATHS)
def test_the_tool_is_on_the_timed_path(plans, name):
    plan = plans[name]
    curve = plan.curve
    assert np.allclose(MODEL.forward(curve.positions), plan.tool(curve.times), atol=1e-9)
    # The axes are polynomials between ticks.
    times = np.arange(0.0, curve.duration, 0.0013)
    off = MODEL.forward(curve.sample(times)[0]) - plan.tool(times)
    assert np.abs(off).max() < 1e-6
    arm = MODEL.arm_angles(
        curve.positions[:, :3], plan.tool(curve.times), plan.branch, curve.positions[:, 3:]
    )
    assert np.allclose(arm, curve.positions[:, 3:], atol=1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_the_motion_leads_from_rest_at_the_start_to_rest_at_the_last_pose(plans, name):
    plan = plans[name]
    curve = plan.curve
    assert (curve.positions[0] == START).all()
    assert np.allclose(np.diff(curve.times), TICK, atol=1e-12)
    for rates in (curve.velocities, curve.accelerations):
        assert not rates[[0, -1]].any()
    ends = plan.tool(np.array([-1.0, 0.0, curve.duration, curve.duration + 1.0]))
    assert np.allclose(ends[:2], MODEL.forward(START), atol=1e-12)
    assert np.allclose(ends[2:], PATHS[name][-1], atol=1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_all_poses_are_passed_within_the_tolerances(plans, name):
    plan = plans[name]
    passed = plan.tool(np.arange(0.0, plan.curve.duration + 0.002, 0.002))
    for pose in PATHS[name][:: max(1, len(PATHS[name]) // 25)]:
        near = np.linalg.norm(passed[:, :3, 3] - pose[:3, 3], axis=1) <= 0.003
        place = np.linalg.norm(passed[near, :3, 3] - pose[:3, 3], axis=1) - 0.0002
        turned = angle_between(passed[near, :3, :3], pose[:3, :3]) - 0.0005
        off = np.maximum(place / OPTIONS.tolerance, turned / OPTIONS.angular_tolerance)
        assert off.min() <= 1.0


@pytest.mark.parametrize("name", PATHS)
def test_all_limits_hold(plans, name):
    plan = plans[name]
    times = np.arange(0.0, plan.curve.duration, 0.001)
    q, velocities, accelerations = plan.curve.sample(times)
    jerks = np.diff(accelerations, axis=0) / 0.001
    assert ((q >= LIMITS.lower) & (q <= LIMITS.upper)).all()
    for values, limit in (
        (velocities, LIMITS.velocity),
        (accelerations, LIMITS.acceleration),
        (jerks, LIMITS.jerk),
    ):
        assert (np.abs(values).max(axis=0) <= CAP * limit).all()
        assert np.hypot(*values[:, :2].T).max() <= CAP * limit[0]
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    x, y, w = velocities[:, :3].T
    wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ LIMITS.wheels.T
    assert np.abs(wheels).max() <= CAP * LIMITS.wheel_speed
    tool = plan.tool(times)
    assert np.linalg.norm(np.diff(tool[:, :3, 3], axis=0), axis=1).max() <= 0.0002 * 1.002
    turns = np.array(
        [
            angle_between(b[None], a)[0]
            for a, b in zip(tool[:-20:20, :3, :3], tool[20::20, :3, :3], strict=False)
        ]
    )
    assert turns.max() <= 0.02 * 0.5 * 1.002


@pytest.mark.parametrize("name", ["corner", "waves", "random 1", "there and back"])
def test_the_timed_path_has_a_continuous_acceleration(plans, name):
    plan = plans[name]
    change = []
    for step in (4e-4, 1e-4):
        times = np.arange(0.0, plan.curve.duration, step)
        places = plan.tool(times)[:, :3, 3]
        second = np.diff(places, 2, axis=0) / step**2
        change.append(np.abs(np.diff(second, axis=0)).max())
    assert change[1] < 0.4 * change[0]  # a jump would not shrink with the step


@pytest.mark.parametrize(
    "name", ["straight", "sideways", "circle with", "circle wide", "circle fixed", "waves"]
)
def test_the_tool_moves_at_its_permitted_speed(plans, name):
    plan = plans[name]
    assert plan.curve.duration <= 1.2 * plan.length / 0.2 + 0.8


def test_a_corner_costs_little_time(plans):
    assert plans["corner"].curve.duration < 3.0 / 0.2 + 2.5


def test_many_corners_cost_little_time(plans):
    together = sum(plans[f"random {seed}"].curve.duration for seed in range(6))
    assert together < 195.0  # 211 s if each whole motion were as slow as its corners require


@pytest.mark.parametrize("name", ["circle with", "corner", "random 2"])
def test_a_rotated_robot_and_path_give_the_rotated_plan(plans, name):
    plan = plans[name]
    move = np.array([3.0, -2.0, 2.2])
    start = START.copy()
    start[:3] = [
        *(planar_transform(move) @ [START[0], START[1], 0.0, 1.0])[:2],
        START[2] + move[2],
    ]
    other = PLANNER.plan(planar_transform(move) @ PATHS[name], start)
    assert other.curve.duration == pytest.approx(plan.curve.duration)
    assert np.allclose(other.curve.positions[:, 3:], plan.curve.positions[:, 3:], atol=1e-5)
    placed = planar_transform(move) @ planar_transform(plan.curve.positions[:, :3])
    assert np.allclose(planar_transform(other.curve.positions[:, :3]), placed, atol=1e-5)


def test_a_reversed_path_is_driven_back(plans):
    there = plans["waves"]
    start = there.curve.positions[-1]
    back = PLANNER.plan(PATHS["waves"][::-1], start)
    assert back.length == pytest.approx(there.length, rel=1e-3)
    end = back.tool(np.array([back.curve.duration]))[0]
    assert np.allclose(end, PATHS["waves"][0], atol=1e-9)


def test_a_dense_path_gives_the_same_motion_as_a_sparse_one():
    a = np.linspace(0.0, 10.0 / 1.2, 10000)
    offsets = np.column_stack([1.2 * np.sin(a), 1.2 * (1 - np.cos(a)), 0.1 * np.sin(1.2 * a)])
    many = PLANNER.plan(tool_path(offsets, yaw=a), START)
    some = np.linspace(0, 9999, 400).astype(int)
    few = PLANNER.plan(tool_path(offsets[some], yaw=a[some]), START)
    assert many.length == pytest.approx(few.length, rel=1e-3)
    assert many.curve.duration == pytest.approx(few.curve.duration, rel=0.02)


def test_slow_joints_slow_the_tool():
    arm = ArmParameters(velocity=(0.05,), acceleration=(0.3,), jerk=(3.0,))
    limits = body_limits(arm)
    plan = ToolPlanner(MODEL, limits, OPTIONS).plan(PATHS["waves"], START)
    _, velocities, accelerations = plan.curve.sample(np.arange(0, plan.curve.duration, 0.002))
    assert np.abs(velocities[:, 3:]).max() <= 0.05 * CAP
    assert np.abs(velocities[:, 3:]).max() > 0.035
    assert np.abs(accelerations[:, 3:]).max() <= 0.3 * CAP


def test_the_tool_moves_straight_to_the_first_pose():
    poses = tool_path([[0.3, 0, 0], [0.3, 0.5, 0]])
    plan = PLANNER.plan(poses, START)
    positions = plan.tool(np.arange(0.0, plan.curve.duration, 0.004))[:, :3, 3]
    assert np.linalg.norm(positions - poses[0, :3, 3], axis=1).min() <= OPTIONS.tolerance
    assert plan.length == pytest.approx(0.8, abs=0.002)


def test_a_path_that_takes_too_long_is_refused():
    slow = ToolPlanner(MODEL, LIMITS, ToolPathOptions(linear_velocity=0.001))
    with pytest.raises(InputError, match="at most 3600 s"):
        slow.plan(line(), START)


def test_a_path_that_begins_far_away_is_refused():
    with pytest.raises(InputError, match=r"starts 0\.600 m from the tool"):
        PLANNER.plan(tool_path([[0.6, 0, 0], [1, 0, 0]]), START)


def test_a_path_at_the_present_tool_pose_is_refused():
    with pytest.raises(InputError, match="nothing to do"):
        PLANNER.plan(tool_path(np.zeros((3, 3))), START)


def test_invalid_input_is_refused():
    poses = line()
    for change, words in (
        (lambda p: p[:, :3], "shape"),
        (lambda p: p[:0], "shape"),
        (lambda p: np.where(np.arange(100)[:, None, None] == 7, np.nan, p), "pose 7 .*not finite"),
        (lambda p: np.where(np.arange(100)[:, None, None] == 9, 2 * p, p), "pose 9 .*rotation"),
        (lambda p: p @ np.diag([1.0, 1.0, -1.0, 1.0]), "pose 0 .*rotation"),
    ):
        with pytest.raises(InputError, match=words):
            PLANNER.plan(change(poses), START)
    for start in (START[:6], np.full(9, np.nan), np.concatenate([START[:3], ARM + 7.0])):
        with pytest.raises(InputError):
            PLANNER.plan(poses, start)
    few = ToolPlanner(MODEL, LIMITS, ToolPathOptions(max_poses=99))
    with pytest.raises(InputError, match="100 poses, at most 99"):
        few.plan(poses, START)


@pytest.mark.parametrize("seed", representative(range(20), every=3))
def test_random_paths_are_planned_correctly_or_refused(seed):
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(3, 6)) * [[1.0], [0.8], [0.8]]
    offsets = rng.normal(size=(6, 3)) * [0.5, 0.5, 0.3]
    offsets[0], turns[:, 0] = 0.0, 0.0
    try:
        plan = PLANNER.plan(tool_path(offsets, *turns), START)
    except InputError as error:
        assert "of the path" in str(error)
        return
    curve = plan.curve
    for rows in (curve.positions, curve.velocities, curve.accelerations):
        assert np.isfinite(rows).all()
    assert np.allclose(MODEL.forward(curve.positions), plan.tool(curve.times), atol=1e-9)
    assert np.abs(np.sin(curve.positions[:, [5, 7]])).min() >= 0.99 * OPTIONS.singularity
    assert math.isfinite(plan.length)


def test_every_singular_start_is_refused_by_name():
    angles = [0.0, math.pi / 2, -math.pi / 2, math.pi, 0.1]
    rng = np.random.default_rng(4)
    for wrist in ("elbow", "wrist"):
        for _ in range(40):
            arm = np.concatenate([[0.0], rng.choice(angles, 4), [0.0]])
            arm[2 if wrist == "elbow" else 4] = rng.choice([0.0, 1e-9, 1e-5])
            start = np.concatenate([np.zeros(3), arm])
            poses = MODEL.forward(start)[None] + np.zeros((2, 1, 1))
            poses[1, 0, 3] += 0.3
            with pytest.raises(InputError, match=r"starts too close to the .* singularity"):
                PLANNER.plan(poses, start)


@pytest.mark.parametrize("displacement", [0.0, 1e-9, 1e-7, 1e-6, 5e-5])
def test_a_negligible_path_is_refused(displacement):
    poses = np.repeat(MODEL.forward(START)[None], 2, axis=0)
    poses[1, 0, 3] += displacement
    with pytest.raises(InputError, match="nothing to do"):
        PLANNER.plan(poses, START)


def test_an_overlong_path_is_refused_before_planning():
    poses = np.repeat(MODEL.forward(START)[None], 2, axis=0)
    poses[1, 0, 3] += 3000.0
    with pytest.raises(InputError, match="3000 m long, at most 100 m"):
        PLANNER.plan(poses, START)
