"""Goals of the joints with the platform: reached together, past what stands and walks."""

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.joint_goal import AT_GOAL, JointGoalTask
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.tool_goal import DETOUR_PERIOD
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism
from test.planning.whole_body.support import START, setup
from test.planning.whole_body.test_task import drive
from test.planning.whole_body.test_tool_goal import HEIGHTS, THICKNESS, walls

SETUP = setup()
FREE = ObstacleSnapshot()
AHEAD = (0.0, -1.2, 1.2, -1.6, -1.57, 0.0)  #: A posture of the arm that reaches ahead
ASIDE = (1.57, -0.8, 0.8, -1.6, -1.57, 0.0)  #: One that reaches to the left
TURNED = np.array([2.0, 0.6, 1.5, -1.0, -1.6, 2.2, -1.5, -1.2, 1.0])  #: A goal of all axes
DOOR = walls((2.0, -6.0, 0.3), (2.0, 1.3, 6.0))  #: A door 1 m wide, beside the straight line


def axes(x, y, heading, arm):
    return np.array([x, y, heading, *arm])


def least_gap(rows, discs):
    """Return the least gap of axes (k, 9) to discs (x, y, radius), by the physics engine [m]."""
    judge = ConfigurationDistances(
        SETUP.description, [Prism((radius, radius), 0.0, HEIGHTS) for _, _, radius in discs]
    )
    gaps = []
    for q in rows:
        judge.place(q[:3], q[3:], np.array(discs)[:, :2])
        gaps.append(judge.distances(2.0).min())
    return min(gaps)


def closed(x):
    return walls((x, -12.0, 12.0))


def wall_discs(x, low, high):
    half = 0.5 * THICKNESS
    return [(x, y, half) for y in np.arange(low + half, high - half + 1e-9, 0.05)]


def assert_arrives(task, goal, around, duration=30.0):
    """Drive a task to its goal within its limits, and return the axes (k, 9) on the way."""
    _, rows, outcomes, end = drive(task, lambda now: around, duration, sample=0.01)
    assert task.is_completed(end) and all(outcome.verdict.is_clear for outcome in outcomes)
    off = rows[-1] - goal
    off[2] = math.remainder(off[2], math.tau)
    assert np.abs(off[:3]).max() < 2.0 * AT_GOAL and np.abs(off[3:]).max() < 1e-3
    speeds = np.diff(rows, axis=0) / 0.01
    limits = SETUP.limits
    assert (np.abs(speeds) < limits.velocity).all()
    assert (np.abs(np.diff(speeds, axis=0)) / 0.01 < 1.05 * limits.acceleration).all()
    return rows


@pytest.mark.parametrize(
    "goal",
    [TURNED, axes(1.0, -0.5, -3.0, START[3:]), axes(0.0, 0.0, 0.0, TURNED[3:])],
    ids=["both", "platform alone", "arm alone"],
)
def test_platform_and_arm_arrive_at_rest_together_and_the_joints_keep_their_line(goal):
    task = JointGoalTask(SETUP, goal, START, 0.0, FREE)
    rows = assert_arrives(task, goal, FREE)
    change = goal[3:] - START[3:]
    part = (rows[:, 3:] - START[3:]) @ change / max(change @ change, 1e-9)
    line = START[3:] + part[:, None] * change
    assert np.abs(rows[:, 3:] - line).max() < 1e-9
    driven = np.hypot(*(rows[:, :2] - START[:2]).T)
    if np.abs(change).max() and goal[0]:
        half = int(np.searchsorted(part, 0.5))
        assert 0.3 < driven[half] / driven[-1] < 0.7, "the arm moves on the way"


def test_the_arm_may_begin_and_pass_at_singularities():
    start = axes(0.0, 0.0, 0.0, (0.0, -1.57, 0.0, -1.57, 0.0, 0.0))
    goal = axes(0.5, 0.0, 0.0, (0.5, -1.57, -0.8, -1.57, 0.4, 0.0))
    assert_arrives(JointGoalTask(SETUP, goal, start, 0.0, FREE), goal, FREE)


@pytest.mark.parametrize(("begin", "end"), [(AHEAD, ASIDE), (ASIDE, AHEAD)])
def test_where_the_posture_of_one_end_alone_fits_through_a_door_the_arm_moves_there(begin, end):
    start, goal = axes(0.0, 0.0, 0.0, begin), axes(4.0, 0.0, 0.0, end)
    rows = assert_arrives(JointGoalTask(SETUP, goal, start, 0.0, DOOR), goal, DOOR)
    discs = [*wall_discs(2.0, -2.0, 0.3), *wall_discs(2.0, 1.3, 3.0)]
    assert least_gap(rows[::10], discs) > SETUP.dodge.least_clearance


@pytest.mark.parametrize("seed", range(3))
def test_every_place_of_the_motion_among_posts_is_clear(seed):
    rng = np.random.default_rng(seed)
    places = [(1.5, 0.0), *rng.uniform([1.2, -2.0], [3.0, 2.0], (6, 2)).tolist()]
    around = ObstacleSnapshot(
        standing=UprightObstacles.join(
            [UprightObstacles.cylinder(x, y, 0.1, HEIGHTS) for x, y in places]
        )
    )
    goal = axes(4.5, rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0), TURNED[3:])
    rows = assert_arrives(JointGoalTask(SETUP, goal, START, 0.0, around), goal, around)
    gap = least_gap(rows[::10], [(x, y, 0.1) for x, y in places])
    assert gap > SETUP.dodge.least_clearance


def test_a_walker_on_the_way_is_evaded():
    task = JointGoalTask(SETUP, axes(2.5, 0.0, 0.0, AHEAD), START, 0.0, FREE)

    def walker(now):
        return UprightObstacles.cylinder(1.3, 2.4 - 0.7 * now, 0.25, (0.0, 1.8))

    def around(now):
        moving = MovingObstacles(walker(now), np.array([[0.0], [-0.7]]))
        return ObstacleSnapshot(time=now, moving=moving, growth=np.array([0.05]))

    times, rows, _, end = drive(task, around, 25.0, sample=0.05)
    assert task.is_completed(end)
    judge = ConfigurationDistances(SETUP.description, [Prism((0.25, 0.25), 0.0, (0.0, 1.8))])
    gaps = []
    for now, q in zip(times, rows, strict=True):
        judge.place(q[:3], q[3:], walker(now).centre.T)
        gaps.append(judge.distances(2.0)[0])
    assert min(gaps) > SETUP.dodge.least_clearance


WALL = walls((2.0, -1.2, 0.9))  #: A wall across the straight way, with an end to pass
NARROW = ObstacleSnapshot(
    standing=UprightObstacles.join(
        [UprightObstacles.cylinder(1.5, y, 0.1, (0.0, 0.2)) for y in (-0.5, 0.5)]
    )
)  #: Low posts that leave 5 cm on each side of the platform: less than plans keep


@pytest.mark.parametrize("late", [WALL, NARROW], ids=["wall", "less room than plans keep"])
def test_what_comes_to_stand_in_the_way_is_passed_from_where_the_robot_rests(late):
    goal = axes(3.0, 0.0, 0.0, AHEAD)
    first = JointGoalTask(SETUP, goal, START, 0.0, FREE)
    first.search(0.0, FREE)
    assert first.detour is None, "nothing is in its way"
    motion = AvoidanceMotion(SETUP.limits)
    motion.follow(first)
    now = 0.0
    while not motion.task.is_completed(now) and now < 60.0:
        motion.cycle(now, 1.0, late if now > 0.5 else FREE)
        if round(now / PERIOD) % 20 == 19 and motion.task is first:
            with contextlib.suppress(NoPathError):
                first.search(now, late)
            motion.take_detour(now)
        now += PERIOD
    assert motion.task is not first and motion.task.is_completed(now)
    assert np.abs(motion.sample(np.array([now]))[0][0] - goal).max() < 2.0 * AT_GOAL


def test_a_robot_that_has_left_its_way_without_another_one_says_why():
    task = JointGoalTask(SETUP, axes(3.0, 0.0, 0.0, AHEAD), START, 0.0, FREE)
    aside = np.array([0.0, 1.5, 0.0, 0.0])
    task.controller.begin(0.0, aside)
    task.search(0.0, FREE)
    assert task.detour is not None and task.detour.begin[:3] == pytest.approx(aside[:3])
    task.controller.begin(DETOUR_PERIOD, aside)
    between = UprightObstacles.box((2.0, 0.75, 0.0), 20.0, THICKNESS, HEIGHTS)
    with pytest.raises(NoPathError, match="standing solid 0, and there is no way around"):
        task.search(DETOUR_PERIOD, ObstacleSnapshot(standing=between))


def test_a_detour_is_paused_and_cancelled_and_none_is_taken_meanwhile():
    goal = axes(3.0, 0.0, 0.0, AHEAD)
    motion = AvoidanceMotion(SETUP.limits)
    motion.follow(JointGoalTask(SETUP, goal, START, 0.0, FREE))
    motion.task.search(0.0, WALL)
    assert motion.take_detour(0.0)
    task, now = motion.task, 0.0

    def run(duration):
        nonlocal now
        for _ in range(round(duration / PERIOD)):
            motion.cycle(now, 1.0, WALL)
            motion.update(now)
            now += PERIOD
        return motion.sample(np.array([now]))[0][0]

    run(2.0)
    motion.pause(now)
    here = run(2.0)
    assert motion.state is PathState.PAUSED
    task.detour = JointGoalTask(SETUP, goal, here, now, WALL)
    assert not motion.take_detour(now) and motion.task is task
    assert run(1.0) == pytest.approx(here, abs=1e-9)
    motion.resume(now)
    assert np.abs(run(1.0) - here).max() > 0.02
    motion.cancel(now)
    assert motion.state is PathState.CANCELLING
    while motion.state is not PathState.IDLE:
        motion.update(now)
        now += PERIOD
    assert now < 10.0


def test_a_robot_that_waits_looks_for_a_detour_at_times_and_says_what_is_in_its_way():
    task = JointGoalTask(SETUP, axes(3.0, 0.0, 0.0, AHEAD), START, 0.0, FREE)
    for time, around in ((0.0, closed(2.0)), (DETOUR_PERIOD - 0.1, WALL)):
        with pytest.raises(NoPathError, match="no room beside obstacle wall/0"):
            task.search(time, around)
        assert task.detour is None
    task.search(DETOUR_PERIOD, WALL)
    assert task.detour is not None


def test_what_is_in_the_way_is_named_while_the_robot_moves():
    task = JointGoalTask(SETUP, axes(3.0, 0.0, 0.0, AHEAD), START, 0.0, FREE)
    drive(task, lambda now: FREE, 2.0)
    with pytest.raises(NoPathError, match="no room beside obstacle wall/0"):
        task.search(2.0, WALL)
    assert task.detour is None and not task.rests(2.0)


UNMOVED = {
    "a joint near its limit": (
        axes(0.0, 0.0, 0.0, (*AHEAD[:5], 6.25)),
        axes(0.5, 0.0, 0.0, (*AHEAD[:5], 6.25)),
        FREE,
    ),
    "a platform near a post": (
        START,
        axes(0.0, 0.0, 0.0, TURNED[3:]),
        ObstacleSnapshot(standing=UprightObstacles.cylinder(-0.655, 0.0, 0.1, HEIGHTS)),
    ),
}


@pytest.mark.parametrize("case", UNMOVED)
def test_what_does_not_move_may_stay_closer_than_plans_lead(case):
    start, goal, around = UNMOVED[case]
    assert_arrives(JointGoalTask(SETUP, goal, start, 0.0, around), goal, around)


def test_a_route_that_is_too_long_is_refused_with_its_length():
    goal = axes(3.0, 0.0, 0.0, START[3:])
    short = replace(SETUP, path=replace(SETUP.path, max_length=3.1))
    JointGoalTask(short, goal, START, 0.0, FREE)  # does not raise
    with pytest.raises(InputError, match=r"the way is [45]\.\d* m long, at most 3.1 m are "):
        JointGoalTask(short, goal, START, 0.0, WALL)


def test_joints_whose_straight_line_leads_through_the_robot_are_refused():
    start = axes(0.0, 0.0, 0.0, (-1.4, -1.0, 2.0, -1.5, 0.9, -2.2))
    goal = axes(0.0, 0.0, 0.0, (-1.3, -1.2, 2.4, 2.0, 0.3, 0.0))
    with pytest.raises(NoPathError, match=r"% of the joints' line, .* too near to") as refused:
        JointGoalTask(SETUP, goal, start, 0.0, FREE)
    assert refused.value.obstruction.cause is Cause.SELF


BAD = {
    "not finite": (axes(math.nan, 0.0, 0.0, AHEAD), FREE, "the goal must be 9 finite"),
    "too few": (TURNED[:8], FREE, "the goal must be 9 finite"),
    "far beyond": (axes(1e7, 0.0, 0.0, AHEAD), FREE, "goal: position"),
    "too far": (axes(3e3, 3e3, 0.0, AHEAD), WALL, "the way is 4243 m long, at most 100 m"),
    "joint limit": (axes(1.0, 0.0, 0.0, (0.0, -1.2, 3.2, 0.0, 0.0, 0.0)), FREE, "elbow_joint = 3"),
    "in itself": (
        axes(1.0, 0.0, 0.0, (0.0, 0.5, 1.2, 0.0, -1.57, 0.0)),
        FREE,
        "at the goal, .* near to platform",
    ),
    "occupied": (TURNED, closed(2.3), "at the goal, platform has no room beside obstacle wall/0"),
    "nearer than plans may end": (
        axes(0.0, 0.0, 0.0, TURNED[3:]),
        walls((-0.58, -1.0, 1.0)),
        "at the goal, platform has no room beside obstacle wall/0",
    ),
    "no way": (axes(4.0, 0.0, 0.0, AHEAD), closed(2.0), "along the path, .* wall/0, .* no way"),
    "there already": (START, FREE, "already there"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_goal_that_cannot_be_is_refused_with_the_reason(case):
    goal, around, words = BAD[case]
    with pytest.raises(InputError, match=words) as refused:
        JointGoalTask(SETUP, goal, START, 0.0, around)
    if isinstance(refused.value, NoPathError):
        found = refused.value.obstruction
        assert found.cause is (Cause.SELF if "itself" in case else Cause.STANDING)
        assert found.part and found.other
