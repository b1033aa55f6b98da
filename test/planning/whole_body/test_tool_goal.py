"""Goals of the tool: straight, or around what stands, or refused with what is in the way."""

import contextlib
import math

import numpy as np
import pytest

from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
from omniman_ros.planning.whole_body.carried_route import covering_discs
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.tool_goal import tool_goal_task
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism
from test.planning.whole_body.support import START, posts, setup

SETUP = setup()
TOOL = WholeBodyModel(SETUP.description.mount).forward(START)
HEIGHTS = (0.0, 1.2)
WALL = (2.0, -1.5, 1.0)  #: A wall between start and goal: x, and from where to where in y [m]
THICKNESS = 0.1  #: Of walls [m]


def goal(x, y, z=0.0, yaw=0.0):
    """Return a pose of the tool at an offset from its start, turned about the vertical."""
    pose = planar_transform(np.array([0.0, 0.0, yaw])) @ TOOL
    pose[:3, 3] = TOOL[:3, 3] + [x, y, z]
    return pose


def walls(*places):
    """Return walls across x, each (x, from y, to y) [m]."""
    return ObstacleSnapshot(
        standing=UprightObstacles.join(
            [
                UprightObstacles.box((x, 0.5 * (low + high), 0.0), THICKNESS, high - low, HEIGHTS)
                for x, low, high in places
            ]
        ),
        names=tuple(f"obstacle wall/{k}" for k in range(len(places))),
    )


def least_gap(task, discs):
    """Return the least gap on the whole way to discs (x, y, radius), by the physics engine [m]."""
    prisms = [Prism((radius, radius), 0.0, HEIGHTS) for _, _, radius in discs]
    judge = ConfigurationDistances(SETUP.description, prisms)
    places = np.arange(0.0, task.redundancy.path.end, 0.03)
    gaps = []
    for q in task.redundancy.axes(np.column_stack([task.way.at(places)[0], places])):
        judge.place(q[:3], q[3:], np.array(discs)[:, :2])
        gaps.append(judge.distances(2.0).min())
    return min(gaps)


def assert_arrives(task, target):
    path = task.redundancy.path
    assert path.pose(np.array([path.end]))[0] == pytest.approx(target, abs=1e-9)


def test_a_free_way_is_straight_and_ends_at_the_goal():
    target = goal(3.0, 1.0, 0.1, 2.0)
    task = tool_goal_task(SETUP, target, START, 0.0, ObstacleSnapshot())
    assert_arrives(task, target)
    assert task.redundancy.path.length() == pytest.approx(math.hypot(3.0, 1.0, 0.1), abs=1e-3)


def test_a_wall_is_passed_at_its_end():
    target, around = goal(3.0, 0.0, 0.1, 1.0), walls(WALL)
    task = tool_goal_task(SETUP, target, START, 0.0, around)
    assert_arrives(task, target)
    x, low, high = WALL
    half = 0.5 * THICKNESS
    discs = [(x, y, half) for y in np.arange(low + half, high - half + 1e-9, 0.05)]
    assert least_gap(task, discs) > SETUP.dodge.least_clearance
    places = np.linspace(0.0, task.redundancy.path.end, 1000)
    tool = task.redundancy.path.pose(places)[:, :3, 3]
    beside = tool[np.abs(tool[:, 0] - x) < THICKNESS, 1]
    assert len(beside) and (beside > high).all(), "the nearer end"


def test_a_goal_above_a_table_behind_a_wall_is_reached_from_before_the_table():
    table = UprightObstacles.box((4.85, 0.27, 0.0), 0.8, 1.2, (0.0, 0.6))
    around = ObstacleSnapshot(standing=UprightObstacles.join([walls(WALL).standing, table]))
    target = goal(4.0, 0.0, 0.25)
    assert_arrives(tool_goal_task(SETUP, target, START, 0.0, around), target)


@pytest.mark.parametrize("seed", range(3))
def test_every_place_of_a_way_among_posts_is_clear(seed):
    rng = np.random.default_rng(seed)
    places = [(1.6, TOOL[1, 3]), *rng.uniform([1.0, -2.0], [3.5, 2.0], (6, 2)).tolist()]
    around = posts(*places)
    target = goal(4.5, rng.uniform(-1.0, 1.0), 0.0, rng.uniform(-3.0, 3.0))
    task = tool_goal_task(SETUP, target, START, 0.0, around)
    assert_arrives(task, target)
    assert least_gap(task, [(x, y, 0.1) for x, y in places]) > SETUP.dodge.least_clearance


def test_a_goal_without_a_way_is_refused_with_place_part_and_obstacle():
    with pytest.raises(
        NoPathError, match=r"_link has .* obstacle wall/0, .* no way around"
    ) as got:
        tool_goal_task(SETUP, goal(3.0, 0.0), START, 0.0, walls((2.0, -12.0, 12.0)))
    assert got.value.obstruction.cause is Cause.STANDING
    assert 0.5 < got.value.obstruction.path_parameter < 1.5


@pytest.mark.parametrize(
    ("target", "around", "words"),
    [
        (goal(3.0, 0.0, 1.5), ObstacleSnapshot(), "at the end of the path, the platform finds no"),
        (goal(3.0, 0.0), walls((3.7, -1.0, 1.0)), "no room beside obstacle wall/0"),
        (goal(math.nan, 0.0), ObstacleSnapshot(), "not finite"),
        (np.diag([2.0, 1.0, 1.0, 1.0]), ObstacleSnapshot(), "no rotation matrix"),
        (TOOL, ObstacleSnapshot(), "already there"),
    ],
    ids=["too high", "occupied", "not finite", "no rotation", "there already"],
)
def test_a_goal_that_cannot_be_is_refused(target, around, words):
    with pytest.raises(InputError, match=words):
        tool_goal_task(SETUP, target, START, 0.0, around)


def test_discs_cover_what_they_stand_for():
    rng = np.random.default_rng(0)
    box = UprightObstacles.box((1.0, 2.0, 0.7), 0.1, 2.3, HEIGHTS)
    discs = covering_discs(box)
    along, across = rng.uniform(-1.15, 1.15, 500), rng.uniform(-0.05, 0.05, 500)
    c, s = math.cos(0.7), math.sin(0.7)
    points = np.stack([1.0 + c * across - s * along, 2.0 + s * across + c * along], axis=1)
    apart = np.linalg.norm(points[:, None] - discs.centers, axis=2) - discs.semi_axes[:, 0]
    assert (apart.min(axis=1) <= 0.0).all() and discs.semi_axes.max() < 0.2
    post = covering_discs(UprightObstacles.cylinder(1.0, 2.0, 0.3, HEIGHTS))
    assert len(post) == 1 and post.semi_axes[0, 0] == pytest.approx(0.3)


def test_a_goal_whose_path_is_blocked_later_gets_another_one_from_where_the_robot_rests():
    target, wall = goal(1.5, 0.0), walls((1.4, -1.2, 0.6))
    motion = AvoidanceMotion(SETUP.limits)
    motion.follow(tool_goal_task(SETUP, target, START, 0.0, ObstacleSnapshot()))
    for k in range(400):
        now = k * PERIOD
        motion.cycle(now, 1.0, wall)
        with contextlib.suppress(NoPathError):
            if k % 20 == 19:
                motion.task.search(now, wall)
        before = motion.sample(np.array([now]))[0]
        if motion.take_detour(now):
            break
    assert motion.sample(np.array([now]))[0] == pytest.approx(before, abs=1e-4)
    assert_arrives(motion.task, target)
    assert motion.task.redundancy.path.length() > 2.0, "around the end of the wall"
    assert motion.cycle(now, 1.0, wall).verdict.is_clear


def test_a_detour_is_dropped_while_the_robot_moves():
    motion = AvoidanceMotion(SETUP.limits)
    motion.follow(tool_goal_task(SETUP, goal(0.5, 0.0), START, 0.0, ObstacleSnapshot()))
    for k in range(20):
        motion.cycle(k * PERIOD, 1.0, ObstacleSnapshot())
    motion.task.detour = motion.task
    assert not motion.take_detour(1.0) and motion.task.detour is None
