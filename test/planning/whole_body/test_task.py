"""The whole body on the path of its tool, past posts and walkers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.load_box import LoadBox
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.parameters import LoadShape
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.model import HALF_TURN, WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.task import ToolHold, WholeBodyTask
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism
from test.planning.whole_body.support import START, posts, setup, straight

SETUP = setup()
POST = (1.3, -0.25)  #: A post in the platform's way, if it kept its place relative to the tool


def drive(task, around, duration, sample=0.02):
    """Return times, axes and outcomes of a task that is executed exactly."""
    times, axes, outcomes, now = [], [], [], 0.0
    while now < duration and not task.is_completed(now):
        outcomes.append(task.cycle(now, around(now)))
        ticks = now + np.arange(0.0, PERIOD - 1e-9, sample)
        times.append(ticks)
        axes.append(task.axes(ticks))
        now += PERIOD
    return np.concatenate(times), np.vstack(axes), outcomes, now


def test_the_body_dodges_a_post_while_the_tool_stays_on_its_path():
    task = WholeBodyTask(SETUP, straight(0.8), START, 0.0, posts(POST))
    _, axes, outcomes, end = drive(task, lambda now: posts(POST), 20.0)
    assert task.is_completed(end)
    assert all(outcome.verdict.is_clear for outcome in outcomes)
    model = WholeBodyModel(SETUP.description.mount)
    start = model.forward(START)
    tool = model.forward(axes)
    assert np.abs(tool[:, 1:3, 3] - start[1:3, 3]).max() < 1e-6
    assert np.abs(tool[:, :3, :3] - start[:3, :3]).max() < 1e-6
    assert tool[-1, 0, 3] - start[0, 3] == pytest.approx(0.8, abs=1e-3)
    assert true_gaps(axes, (0.0, 1.2), 0.1, POST).min() > SETUP.dodge.least_clearance
    joints = np.diff(axes[:, 3:], axis=0) / 0.02
    assert (np.abs(joints) < SETUP.limits.velocity[3:]).all()


def true_gaps(axes, heights, radius, place):
    """Return the gaps of the robot without its load to an upright cylinder, by the engine."""
    judge = ConfigurationDistances(SETUP.description, [Prism((radius, radius), 0.0, heights)])
    gaps = []
    for q in axes[::5]:
        judge.place(q[:3], q[3:], np.array([place]))
        gaps.append(judge.distances(2.0)[0])
    return np.array(gaps)


def test_the_platform_drives_below_a_table_that_the_arm_stays_beside():
    place, heights = (1.1, -0.5), (0.57, 0.6)
    table = UprightObstacles.cylinder(*place, 0.3, heights)
    narrow = posts((0.8, 0.56), (1.1, 0.56), (1.4, 0.56)).standing
    around = ObstacleSnapshot(standing=UprightObstacles.join([narrow, table]))
    task = WholeBodyTask(SETUP, straight(1.0), START, 0.0, around)
    _, axes, _, end = drive(task, lambda now: around, 20.0)
    assert task.is_completed(end)
    assert true_gaps(axes, heights, 0.3, place).min() > SETUP.dodge.least_clearance
    assert true_gaps(axes, (0.4, 0.5), 0.3, place).min() <= 0.0, "nothing of it is below"


@pytest.mark.parametrize("top", [0.42, 0.5], ids=["below the load", "as high as the load"])
def test_the_load_keeps_its_gap_to_what_the_tool_alone_would_pass(top):
    box = UprightObstacles.box((1.1, 0.28, 0.4), 0.2, 0.2, (0.0, top))
    block = ObstacleSnapshot(standing=box)
    WholeBodyTask(SETUP, straight(0.8), START, 0.0, block)  # does not raise
    shape = LoadShape(length=0.1, width=0.1, height=0.1, distance=0.02)
    loaded = replace(SETUP, load=shape)
    if top == 0.5:
        with pytest.raises(NoPathError) as error:
            WholeBodyTask(loaded, straight(0.8), START, 0.0, block)
        assert error.value.obstruction.part == "load"
        return
    task = WholeBodyTask(loaded, straight(0.8), START, 0.0, block)
    _, axes, _, end = drive(task, lambda now: block, 20.0)
    assert task.is_completed(end)
    flange = WholeBodyModel(SETUP.description.mount).forward(axes[::5])
    gaps = LoadBox(shape).distances_from_obstacles(flange, block.standing, 1.0)
    assert SETUP.dodge.least_clearance < gaps.min() < 0.15


def test_accelerations_leave_the_tip_over_margin():
    """Of a robot whose platform is as heavy at a height of 1.5 m, while it drives sideways."""
    robot = SETUP.description.robot
    tall = replace(robot, body=replace(robot.body, com_z=1.5))
    description = replace(SETUP.description, robot=tall)
    poses = straight(1.0)
    poses[:, 1, 3] += poses[:, 0, 3] - poses[0, 0, 3] + 0.1
    poses[:, 0, 3] = poses[0, 0, 3] - 0.1
    balance, least, times = BodyBalance(description), [], []
    base = description.mount.pose @ HALF_TURN
    for margin in (0.05, 0.23):
        dodge = replace(SETUP.dodge, tip_over_margin=margin)
        task = WholeBodyTask(
            replace(SETUP, description=description, dodge=dodge), poses, START, 0.0, posts()
        )
        at, axes, outcomes, end = drive(task, lambda now: posts(), 20.0, sample=0.025)
        assert task.is_completed(end)
        assert all(outcome.verdict.is_clear for outcome in outcomes)
        frames = base @ task.redundancy.model.arm.frames(axes[:, 3:])
        least.append(balance.margins(at, axes[:, :3], balance.arm_centres(frames)).min())
        times.append(end)
    assert least[0] < 0.225 and least[1] > 0.23
    assert times[1] < 1.3 * times[0], "it slows down by its accelerations only"


@pytest.mark.parametrize("corner", [0.4, None], ids=["corner", "straight"])
def test_a_free_path_is_as_fast_as_its_limits_and_keeps_them_in_corners(corner):
    poses = straight(0.8)
    if corner is not None:
        beyond = poses[:, 0, 3] - poses[0, 0, 3] > corner
        poses[beyond, 1, 3] += poses[beyond, 0, 3] - poses[beyond, 0, 3].min() + 0.08
        poses[beyond, 0, 3] = poses[~beyond, 0, 3].max()
    model = WholeBodyModel(SETUP.description.mount)
    planner = ToolPlanner(model, SETUP.limits, SETUP.path)
    task = WholeBodyTask(SETUP, poses, START, 0.0, ObstacleSnapshot())
    _, axes, _, end = drive(task, lambda now: ObstacleSnapshot(), 20.0, sample=0.01)
    assert end - PERIOD <= 1.05 * planner.plan(poses, START).curve.duration
    tool = model.forward(axes)[:, :3, 3]
    hardest = np.linalg.norm(np.diff(tool, 2, axis=0), axis=1).max() / 0.01**2
    assert hardest < 1.3 * SETUP.path.linear_acceleration
    joints = np.abs(np.diff(axes[:, 3:], 2, axis=0)).max(axis=0) / 0.01**2
    assert (joints < SETUP.limits.acceleration[3:]).all()


def test_an_evasion_is_planned_only_where_the_robot_followed_no_plan_and_moves(monkeypatch):
    task = WholeBodyTask(SETUP, straight(0.8), START, 0.0, ObstacleSnapshot())
    line, guesses = task.controller._linearisation, []
    improved = line.improved

    def improve(*arguments):
        guesses.append(arguments[1])
        if len(guesses) == 21:
            raise SolverError("once")
        return improved(*arguments)

    monkeypatch.setattr(line, "improved", improve)
    drive(task, lambda now: ObstacleSnapshot(), 1.0)
    assert len(guesses) == 20
    task.cycle(1.0, ObstacleSnapshot())
    assert len(guesses) == 21
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    near = posts((x + 0.34, y))  # nearer than the robot can brake
    assert task.cycle(1.0 + PERIOD, near).choice.is_braking
    assert len(guesses) == 23
    assert np.abs(guesses[22]).sum() < np.abs(guesses[21]).sum(), "the second one brakes"
    task.cycle(1.0 + 2.0 * PERIOD, near)
    assert len(guesses) == 24, "both would improve on the same motion that brakes"


def test_the_robot_waits_for_a_walker_and_goes_on():
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    task = WholeBodyTask(SETUP, straight(0.6), START, 0.0, ObstacleSnapshot())

    def around(now):
        # A person crosses the tool's path where the tool would be.
        obstacle = UprightObstacles.cylinder(x + 0.45, y + 2.5 - 0.8 * now, 0.25, (0.0, 1.8))
        moving = MovingObstacles(obstacle, np.array([[0.0], [-0.8]]))
        return ObstacleSnapshot(time=now, moving=moving, growth=np.array([0.05]))

    times, axes, outcomes, end = drive(task, around, 15.0, sample=0.05)
    assert task.is_completed(end)
    met = outcomes[round(2.6 / PERIOD)].verdict.nearest  # the person is at the tool's path
    assert (met.cause, met.other) == (Cause.MOVING, "moving solid 0")
    assert met.part != "platform" and 0.0 <= met.path_parameter < 0.6
    unhindered = 0.6 / SETUP.path.linear_velocity
    assert end > unhindered
    judge = ConfigurationDistances(SETUP.description, [Prism((0.25, 0.25), 0.0, (0.0, 1.8))])
    for now, q in zip(times[::2], axes[::2], strict=True):
        judge.place(q[:3], q[3:], around(now).moving.obstacles.centre.T)
        assert judge.distances(2.0)[0] > 0.0


def test_what_appears_in_the_way_stops_the_robot_before_contact():
    task = WholeBodyTask(SETUP, straight(0.8), START, 0.0, ObstacleSnapshot())
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    late = posts((x + 0.5, y))  # on the path of the tool
    _, axes, outcomes, end = drive(
        task, lambda now: late if now > 1.5 else ObstacleSnapshot(), 8.0
    )
    assert not task.is_completed(end)
    assert np.abs(np.diff(axes[-3:], axis=0)).max() < 1e-3
    assert outcomes[-1].verdict.gap > 0.0
    with pytest.raises(NoPathError, match="has no room beside standing solid 0"):
        task.search(end, late)


def test_the_cycle_after_something_comes_or_goes_tells_what_is_in_the_way():
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    far, near = (9.0, 9.0), (x + 0.5, y)
    late = replace(posts(far, near), names=("the far post", "the near post"))
    task = WholeBodyTask(SETUP, straight(0.8), START, 0.0, ObstacleSnapshot())
    drive(task, lambda now: ObstacleSnapshot(), 1.0)
    found = task.cycle(1.0, late).obstruction
    assert (found.cause, found.other) == (Cause.STANDING, "the near post")
    assert found.part in ("wrist_3_link", "wrist_2_link", "wrist_1_link", "forearm_link")
    assert 0.0 < found.path_parameter < 0.5
    assert str(found).endswith(f"{found.part} has no room beside the near post")
    outcome = task.cycle(1.05, ObstacleSnapshot())
    assert outcome.obstruction is None and outcome.verdict.nearest is None


def test_a_walker_in_the_way_is_told_from_a_post():
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    task = WholeBodyTask(SETUP, straight(0.8), START, 0.0, ObstacleSnapshot())
    drive(task, lambda now: ObstacleSnapshot(), 1.0)
    walker = UprightObstacles.cylinder(x + 0.9, y, 0.25, (0.0, 1.8))
    moving = MovingObstacles(walker, np.array([[-0.5], [0.0]]))
    around = replace(posts((9.0, 9.0)), time=1.0, moving=moving, growth=np.zeros(1))
    found = task.cycle(1.0, around).obstruction
    assert (found.cause, found.other) == (Cause.MOVING, "moving solid 0")


def test_a_held_tool_stays_at_its_place_while_the_body_gives_way_and_comes_back():
    task = ToolHold(SETUP, START, 0.0)
    model = WholeBodyModel(SETUP.description.mount)

    def around(now):
        # A person walks past, where the platform's right side is.
        obstacle = UprightObstacles.cylinder(-1.7 + 0.9 * now, -0.55, 0.25, (0.0, 1.8))
        moving = MovingObstacles(obstacle, np.array([[0.9], [0.0]]))
        return ObstacleSnapshot(time=now, moving=moving, growth=np.array([0.05]))

    times, axes, _, _ = drive(task, around, 5.5, sample=0.05)
    tool, begin = model.forward(axes), model.forward(START)
    assert np.abs(tool[:, :3] - begin[:3]).max() < 1e-6
    assert np.abs(axes[-1, :3] - START[:3]).max() < 0.01, "it did not come back"
    judge = ConfigurationDistances(SETUP.description, [Prism((0.25, 0.25), 0.0, (0.0, 1.8))])
    gaps = []
    for now, q in zip(times, axes, strict=True):
        for each in (q, START):
            judge.place(each[:3], each[3:], around(now).moving.obstacles.centre.T)
            gaps.append(judge.distances(2.0)[0])
    assert min(gaps[1::2]) < 0.0, "a robot at rest would not be touched"
    assert min(gaps[::2]) > SETUP.dodge.least_clearance
    assert not task.is_completed(5.5)


@pytest.mark.parametrize("start", [np.full(9, math.nan), START[:8]])
def test_a_hold_from_nowhere_is_refused(start):
    with pytest.raises(InputError, match="finite positions"):
        ToolHold(SETUP, start, 0.0)


def test_as_many_names_as_solids_are_accepted():
    with pytest.raises(InputError, match="1 names for 2 solids"):
        replace(posts((1.0, 0.0), (2.0, 0.0)), names=("one",))


def test_a_path_through_a_post_is_refused_with_the_place_the_part_and_the_solid():
    model = WholeBodyModel(SETUP.description.mount)
    x, y = model.forward(START)[:2, 3].tolist()
    with pytest.raises(NoPathError, match="has no room beside standing solid 1") as refused:
        WholeBodyTask(SETUP, straight(1.0), START, 0.0, posts((9.0, 9.0), (x + 0.6, y)))
    found = refused.value.obstruction
    assert (found.cause, found.other) == (Cause.STANDING, "standing solid 1")
    assert found.part
    assert 0.2 < found.path_parameter < 0.6


def test_a_path_out_of_reach_is_refused_with_the_place():
    poses = straight(1.0)
    poses[:, 2, 3] += np.linspace(0.1, 1.2, len(poses))
    with pytest.raises(NoPathError, match="no place from which the arm reaches") as refused:
        WholeBodyTask(SETUP, poses, START, 0.0, ObstacleSnapshot())
    assert refused.value.obstruction.cause is Cause.REACH


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_invalid_input_is_refused(value):
    poses = straight(1.0)
    poses[3, 0, 3] = value
    with pytest.raises(InputError):
        WholeBodyTask(SETUP, poses, START, 0.0, ObstacleSnapshot())
    with pytest.raises(InputError):
        WholeBodyTask(SETUP, straight(1.0), np.full(9, value), 0.0, ObstacleSnapshot())
    if value != 1e9:
        with pytest.raises(InputError, match="finite"):
            posts((value, 0.0))
