"""Rotations of the tool that its path leaves free, and the whole body on such a path."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_curve import ToolCurve, tilted, upright
from omniman_ros.planning.whole_body import platform_path_search
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.free_orientation import USED, FreeOrientation
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import OrientationFreedom
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER, ToolRedundancy
from omniman_ros.planning.whole_body.task import ToolHold, WholeBodyTask, path_search
from omniman_ros.planning.whole_body.tool_goal import tool_goal_task
from test.planning.whole_body.support import START, posts, setup, straight

SETUP = setup()
MODEL = WholeBodyModel(SETUP.description.mount)
TOOL = MODEL.forward(START)
AXES = "xyz"
FREEDOMS = [
    OrientationFreedom(axis, cone, pivot)
    for axis, cone, pivot in (("x", 0.0, 0.0), ("y", 0.3, 0.1), ("z", 0.0, 0.2), ("z", 0.26, -0.1))
]


def rotated(poses, turns):
    """Return poses (k, 4, 4) of the tool turned by angles (k,) about its z axis."""
    result = poses.copy()
    result[:, :3, :3] = poses[:, :3, :3] @ upright(np.asarray(turns))
    return result


def bent():
    """Return a path of the tool that tilts and turns it."""
    poses = rotated(straight(0.6), 0.1 * np.arange(10.0))
    tilts = np.column_stack([0.03 * np.arange(10.0), np.full(10, 0.05)])
    poses[:, :3, :3] = tilted(tilts) @ poses[:, :3, :3]
    return poses


def held_point(freedom, poses):
    """Return where (k, 3) the point is that is held, for poses (k, 4, 4) of the tool."""
    return poses[:, :3, 3] + freedom.pivot * axis_of(freedom, poses)


def axis_of(freedom, poses):
    """Return the directions (k, 3) of the free axis."""
    return poses[:, :3, AXES.index(freedom.free_axis)]


def angle(a, b):
    """Return the angles (k,) between unit vectors (k, 3) [rad]."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_no_coordinates_move_the_point_that_is_held_or_leave_the_cone(freedom):
    free, rng = FreeOrientation(freedom), np.random.default_rng(2)
    f = rng.normal(size=(200, len(free.bound))) * rng.uniform(0.0, 3.0, (200, 1))
    path = bent()[rng.integers(0, 10, 200)]
    tool = free.turned(path, f)
    assert np.abs(held_point(freedom, tool) - held_point(freedom, path)).max() < 1e-12
    off = angle(axis_of(freedom, tool), axis_of(freedom, path))
    assert off.max() <= USED * freedom.cone + 1e-7
    assert off.max() >= 0.9 * USED * freedom.cone, "all of the cone is used"
    about = FreeOrientation(replace(freedom, cone=0.0)).turned(path, f[:, :1])
    across = (AXES.index(freedom.free_axis) + 1) % 3
    found = angle(about[:, :3, across], path[:, :3, across])
    assert found == pytest.approx(np.abs((f[:, 0] + math.pi) % math.tau - math.pi), abs=1e-7)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_rates_and_accelerations_of_the_joints_are_those_of_differences(freedom):
    free, rng, step = FreeOrientation(freedom), np.random.default_rng(3), 1e-4
    path, begin = free.path_of(TOOL, bent())
    r = ToolRedundancy(MODEL, ToolCurve(path, SETUP.path), START[3:], free)
    d = 4 + len(begin)
    z, v = 0.1 * rng.normal(size=(5, d)), rng.normal(size=(5, d))
    z[:, PATH_PARAMETER] = rng.uniform(0.1, 0.5, 5)
    z[:, 0] += z[:, PATH_PARAMETER]
    at = r.configurations(z)
    before, after = r.axes(z - step * v)[:, 3:], r.axes(z + step * v)[:, 3:]
    rates = (at.rates @ v[:, :, None])[:, :, 0]
    assert (after - before) / (2 * step) == pytest.approx(rates, abs=1e-4)
    assert (after - 2 * at.arm + before) / step**2 == pytest.approx(r.drift(at, v), abs=1e-3)
    assert MODEL.forward(at.q) == pytest.approx(r.tool(z), abs=1e-9)


@pytest.mark.parametrize("freedom", [FREEDOMS[1], OrientationFreedom("z", 1.5, 2.0)])
def test_twists_and_accelerations_in_all_of_a_cone_are_those_of_differences(freedom):
    free, rng, step = FreeOrientation(freedom), np.random.default_rng(5), 1e-4
    curve = ToolCurve(free.path_of(TOOL, bent())[0], SETUP.path)
    f, speed, rates = rng.normal(size=(30, 3)), rng.uniform(0.1, 0.5, 30), rng.normal(size=(30, 3))
    direction = f[:, 1:] / np.linalg.norm(f[:, 1:], axis=1)[:, None]
    f[:, 1:] = np.linspace(0.0, 1.8, 30)[:, None] * free.cone * direction  # to its border, and on
    place = rng.uniform(0.1, 0.5, 30)

    def motion(dt):
        """Return poses and velocities (k, 6) of the tool after a time [s]."""
        pose, twist, _ = curve.motion(place + dt * speed)
        tool, twists = free.motion(pose, twist, f + dt * rates)
        along = np.column_stack([speed, rates])
        return tool, (twists @ along[:, :, None])[:, :, 0]

    (before, slower), (tool, velocity), (after, faster) = map(motion, (-step, 0.0, step))
    assert free.tilt(f).max() > 0.9 * free.cone
    moved = (after - before)[:, :3] / (2.0 * step)
    assert moved[:, :, 3] == pytest.approx(velocity[:, :3], abs=1e-6)
    spin = moved[:, :, :3] @ np.swapaxes(tool[:, :3, :3], 1, 2)
    found = np.column_stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    assert found == pytest.approx(velocity[:, 3:], abs=1e-6)
    acceleration = free.change(*curve.motion(place), f, speed, rates)
    assert (faster - slower) / (2.0 * step) == pytest.approx(acceleration, abs=1e-5)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_a_path_keeps_its_axis_but_no_rotation_about_it(freedom):
    free = FreeOrientation(freedom)
    path, begin = free.path_of(TOOL, bent())
    assert axis_of(freedom, path[1:]) == pytest.approx(axis_of(freedom, bent()), abs=1e-9)
    assert held_point(freedom, path[1:]) == pytest.approx(held_point(freedom, bent()), abs=1e-9)
    assert free.turned(path[:1], begin[None])[0] == pytest.approx(TOOL, abs=1e-9)
    z = "xyz"[(AXES.index(freedom.free_axis) + 1) % 3]
    spun = OrientationFreedom(z)
    change = angle(axis_of(spun, path[:-1]), axis_of(spun, path[1:]))
    moved = angle(axis_of(freedom, path[:-1]), axis_of(freedom, path[1:]))
    assert (change <= moved + 1e-9).all(), "it turns about the axis"


@pytest.mark.parametrize("tilt", [0.1, 0.25, 0.5, math.pi])
def test_a_path_begins_with_the_axis_of_its_first_pose_as_far_as_the_cone_allows(tilt):
    free, freedom = FreeOrientation(FREEDOMS[3]), FREEDOMS[3]
    poses = straight(0.6)
    poses[:, :3, :3] = poses[:, :3, :3] @ tilted(np.array([[tilt, 0.0]]))
    path, begin = free.path_of(TOOL, poses)
    left = angle(axis_of(freedom, path[:1]), axis_of(freedom, poses[:1]))
    assert left == pytest.approx(max(tilt - USED * freedom.cone, 0.0), abs=1e-7)
    assert free.turned(path[:1], begin[None])[0] == pytest.approx(TOOL, abs=1e-9)


def test_a_cone_without_an_axis_is_refused():
    with pytest.raises(ParameterError, match=r"cone.*needs a free_axis"):
        OrientationFreedom(cone=0.2)


def drive(task, around, duration=20.0):
    """Return z and axes every 10 ms of a task that is executed exactly."""
    z, axes, now = [], [], 0.0
    while now < duration and not task.is_completed(now):
        assert task.cycle(now, around).verdict.is_clear
        times = now + np.arange(0.0, PERIOD - 1e-9, 0.01)
        z.append(task.controller.motion.at(times)[0])
        axes.append(task.axes(times))
        now += PERIOD
    return np.vstack(z), np.vstack(axes), now


def risen(height):
    """Return a path of the tool that rises."""
    poses = straight(0.8)
    poses[:, 2, 3] += np.linspace(0.05, height, 10)
    return poses


@pytest.mark.parametrize("freedom", [OrientationFreedom("x"), OrientationFreedom("z", 0.5, 0.1)])
def test_a_free_orientation_does_what_a_held_one_cannot(freedom):
    nothing, poses = posts((9.0, 9.0)), risen(0.7)
    with pytest.raises(NoPathError, match="from which the arm reaches"):
        WholeBodyTask(SETUP, poses, START, 0.0, nothing)
    task = WholeBodyTask(replace(SETUP, freedom=freedom), poses, START, 0.0, nothing)
    z, axes, end = drive(task, nothing)
    assert task.is_completed(end)
    tool = MODEL.forward(axes)
    path = task.redundancy.path.pose(z[:, PATH_PARAMETER])
    assert np.abs(held_point(freedom, tool) - held_point(freedom, path)).max() < 1e-9
    off = angle(axis_of(freedom, tool), np.broadcast_to(axis_of(freedom, TOOL[None]), (len(z), 3)))
    assert off.max() <= freedom.cone + 1e-6
    assert held_point(freedom, tool[-1:])[0] == pytest.approx(
        held_point(freedom, poses[-1:])[0], abs=1e-3
    )
    rates = np.abs(np.diff(axes[:, 3:], axis=0)).max(axis=0) / 0.01
    assert (rates < SETUP.limits.velocity[3:]).all()


def test_a_rotation_about_the_free_axis_takes_no_time():
    nothing, lengths = posts((9.0, 9.0)), []
    free = replace(SETUP, freedom=OrientationFreedom("z"))
    turned = rotated(straight(0.8), -0.35 * np.arange(1.0, 11.0))
    for setup_of, poses in ((SETUP, turned), (free, turned), (SETUP, straight(0.8))):
        task = WholeBodyTask(setup_of, poses, START, 0.0, nothing)
        lengths.append(task.redundancy.path.end)
    assert lengths[1] == pytest.approx(lengths[2], abs=1e-6)
    assert lengths[0] > 1.5 * lengths[1]


def free_search():
    """Return a search for a tool whose x axis is free, and the coordinates of its start."""
    free = replace(SETUP, freedom=OrientationFreedom("x"))
    search, begin = path_search(free, straight(0.4), START)
    return search, np.concatenate([START[:3], [0.0], begin])


def test_a_way_on_which_a_joint_would_jump_is_not_taken(monkeypatch):
    search, start = free_search()
    search.find(start, posts((9.0, 9.0)))  # does not raise
    monkeypatch.setattr(platform_path_search, "JUMP", 0.0)
    with pytest.raises(NoPathError, match="from which the arm reaches"):
        search.find(start, posts((9.0, 9.0)))


def test_a_way_from_the_middle_of_a_path_goes_on_from_the_posture_there(monkeypatch):
    about_z = replace(SETUP, freedom=OrientationFreedom("z"))
    search, _ = path_search(about_z, straight(0.4), START)
    start = np.array([0.1, 0.0, 0.0, 0.1, 2.7])
    monkeypatch.setattr(platform_path_search, "JUMP", 1.0)
    way = search.find(start, posts((9.0, 9.0)))
    places = np.linspace(start[PATH_PARAMETER], way.end, len(way.poses))
    axes = search.redundancy.axes(np.insert(way.poses, PATH_PARAMETER, places, axis=1))
    assert np.abs(np.diff(axes[:, 3:], axis=0)).max() <= 1.0


@pytest.mark.parametrize("counts", [(8, 4), (24, 8)])
def test_free_rotations_are_tried_all_around(counts):
    search, _ = free_search()
    about = search._free_rotations(np.array([0.3]), counts)[:, 0]
    assert len(about) == counts[0] and 0.3 in about
    assert np.diff(np.sort(about)) == pytest.approx(math.tau / counts[0])


def test_where_no_free_orientations_go_on_the_way_is_sought_with_it_held(monkeypatch):
    search, start = free_search()
    tried, chosen = [], search._orientations

    def first_fails(*arguments):
        tried.append(len(search._rotations))
        if len(tried) == 1:
            raise NoPathError("none", Obstruction(Cause.REACH, 0.0))
        return chosen(*arguments)

    monkeypatch.setattr(search, "_orientations", first_fails)
    assert search.find(start, posts((9.0, 9.0))).poses.shape[1] == len(start) - 1
    assert tried[0] > 1 and tried[1:] == [1]


def test_plans_keep_a_joint_that_turns_with_the_tool_within_half_a_revolution():
    task = ToolHold(replace(SETUP, freedom=OrientationFreedom("z")), START, 0.0)
    z, still = task.begin[None].copy(), np.zeros((1, 5))
    z[0, 4] = math.pi - 0.05
    at = task.redundancy.configurations(z)
    rows = task.controller._linearisation._arm_rows(at, still, still)
    assert rows.value[0, :6].min() == pytest.approx(-0.15, abs=1e-6)


def test_a_hold_may_turn_the_tool_about_its_point():
    freedom = OrientationFreedom("z", 0.2, 0.1)
    task = ToolHold(replace(SETUP, freedom=freedom), START, 0.0)
    z, axes, _ = drive(task, posts((0.0, -0.5)), 2.0)
    assert np.abs(z[:, 4:]).max() > 0.0
    tool = MODEL.forward(axes)
    assert np.abs(held_point(freedom, tool) - held_point(freedom, TOOL[None])).max() < 1e-9
    assert np.ptp(axes[:, :2], axis=0).max() > 0.01, "it does not give way"


def test_a_goal_is_reached_with_a_free_orientation_alone():
    goal, nothing = risen(0.7)[-1], posts((9.0, 9.0))
    with pytest.raises(InputError):
        tool_goal_task(SETUP, goal, START, 0.0, nothing)
    free = replace(SETUP, freedom=OrientationFreedom("x"))
    task = tool_goal_task(free, goal, START, 0.0, nothing)
    z = np.insert(task.way.poses[-1], PATH_PARAMETER, task.redundancy.path.end)
    reached = MODEL.forward(task.redundancy.axes(z[None]))[0]
    assert reached[:3, 3] == pytest.approx(goal[:3, 3], abs=1e-3)


CONE = OrientationFreedom("z", 0.26, 0.15)


def goal_of(length, yaw=0.0):
    """Return a pose ahead of the start [m], with the tool's axis as it is there."""
    return rotated(straight(length)[-1:], [yaw])[0]


def nominal_tilts(task, goal):
    """Return angles (k,) of the cone's middle from the goal's axis, along a path [rad]."""
    poses = task.redundancy.path.pose(np.linspace(0.0, task.redundancy.path.end, 200))
    return angle(axis_of(CONE, poses), axis_of(CONE, goal[None]))


def tilted_start(tilt):
    """Return axes (9,) of the start but for the tool, which is tilted about its point [rad]."""
    wide = FreeOrientation(replace(CONE, cone=2.0 * tilt / USED))
    pose = wide.turned(TOOL[None], np.array([[0.0, 2.0 * tilt * math.asin(0.5), 0.0]]))
    arm = MODEL.arm_angles(START[None, :3], pose, MODEL.arm.branch_of(START[3:]), START[3:])
    return np.append(START[:3], arm[0])


def test_tilts_do_not_add_up_from_detour_to_detour(monkeypatch):
    def blocked(task, time, around):
        raise NoPathError("blocked", Obstruction(Cause.STANDING, 0.0, "arm", "a post"))

    monkeypatch.setattr(WholeBodyTask, "search", blocked)
    goal, nothing = goal_of(1.0), posts((9.0, 9.0))
    task = tool_goal_task(replace(SETUP, freedom=CONE), goal, START, 0.0, nothing)
    for w in ((1.5, 0.3), (1.2, -1.2)):
        z = np.insert(task.way.at(np.array([0.1]))[0][0], PATH_PARAMETER, 0.1)
        z[5:] = USED * CONE.cone * np.array(w)
        task.controller.begin(0.0, z)
        axes = task.redundancy.axes(z[None])
        task.search(0.0, nothing)
        task = task.detour
        assert task.redundancy.axes(task.begin[None]) == pytest.approx(axes, abs=1e-6)
        assert nominal_tilts(task, goal).max() < 1e-6


@pytest.mark.parametrize("around", [posts((9.0, 9.0)), posts((1.0, 0.3), (1.0, 0.6))])
def test_a_goal_is_the_middle_of_the_cone_for_a_tool_that_starts_tilted_in_it(around):
    goal, start = goal_of(1.5, 1.0), tilted_start(0.24)
    off = angle(axis_of(CONE, MODEL.forward(start)[None]), axis_of(CONE, goal[None]))
    assert off == pytest.approx(0.24, abs=1e-6)
    task = tool_goal_task(replace(SETUP, freedom=CONE), goal, start, 0.0, around)
    assert task.redundancy.axes(task.begin[None])[0] == pytest.approx(start, abs=1e-6)
    assert nominal_tilts(task, goal).max() < 1e-6


def test_a_tool_that_starts_out_of_the_cone_of_its_goal_comes_into_it():
    goal, start, nothing = goal_of(0.5), tilted_start(0.4), posts((9.0, 9.0))
    task = tool_goal_task(replace(SETUP, freedom=CONE), goal, start, 0.0, nothing)
    tilts = nominal_tilts(task, goal)
    assert tilts[0] == pytest.approx(0.4 - USED * CONE.cone, abs=1e-6)
    assert (np.diff(tilts) < 1e-9).all() and tilts[-1] < 1e-6
    z, axes, end = drive(task, nothing)
    assert task.is_completed(end)
    tool = MODEL.forward(axes)
    off = angle(axis_of(CONE, tool), np.broadcast_to(axis_of(CONE, goal[None]), (len(z), 3)))
    assert off.max() == pytest.approx(0.4, abs=1e-3) and off[-1] <= CONE.cone
