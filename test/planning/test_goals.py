import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview
from omniman_ros.planning.goals import PoseGoal, StateGoal, TrajectoryGoal, goal_of_state

TIMES = np.array([1.0, 2.0, 2.5, 9.0])


def a_trajectory(headings=(0.0, 0.5, 1.0)):
    times = np.array([1.0, 2.0, 3.0])
    poses = np.column_stack([times - 1.0, 2.0 * (times - 1.0), headings])
    velocities = np.tile([1.0, 2.0, headings[1] - headings[0]], (3, 1))
    return TrajectoryGoal(Preview(times, poses, velocities))


def test_pose_goal_is_constant_in_time():
    goal = PoseGoal(np.array([1.0, 2.0, 0.3]))
    poses, velocities = goal.targets(TIMES)
    np.testing.assert_array_equal(poses, np.tile([1.0, 2.0, 0.3], (4, 1)))
    np.testing.assert_array_equal(velocities, np.zeros((4, 3)))
    assert not goal.moves and goal.until == -math.inf


def test_goal_copies_its_arrays():
    pose = np.array([1.0, 2.0, 0.3])
    goal = PoseGoal(pose)
    pose[0] = 9.0
    goal.targets(TIMES)[0][0, 0] = 7.0
    assert goal.targets(TIMES)[0][0, 0] == 1.0


def test_pose_with_velocity_moves_along_the_line_of_that_velocity():
    goal = StateGoal(np.array([1.0, 2.0, 0.3]), np.array([0.5, -0.2, 0.1]))
    poses, velocities = goal.targets(TIMES)
    np.testing.assert_array_equal(poses, np.tile([1.0, 2.0, 0.3], (4, 1)))
    assert not goal.moves and goal.until == math.inf and not velocities.any()
    goal = goal.arriving(2.0)
    poses, velocities = goal.targets(TIMES)
    np.testing.assert_allclose(poses[1], [1.0, 2.0, 0.3])
    np.testing.assert_allclose(poses[0], [0.5, 2.2, 0.2])
    np.testing.assert_allclose(poses[2], [1.25, 1.9, 0.35])
    np.testing.assert_allclose(velocities, np.tile([0.5, -0.2, 0.1], (4, 1)))
    assert goal.moves and goal.until == 2.0


def test_trajectory_is_followed_and_rests_at_its_end():
    goal = a_trajectory()
    poses, velocities = goal.targets(TIMES)
    np.testing.assert_allclose(poses[:, 0], [0.0, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(poses[2], [1.5, 3.0, 0.75])
    np.testing.assert_allclose(velocities[1:3], np.tile([1.0, 2.0, 0.5], (2, 1)))
    np.testing.assert_array_equal(velocities[3], np.zeros(3))
    assert goal.moves and goal.until == 3.0


@pytest.mark.parametrize("heading", [0.0, 3.1, -3.1, 6.0, -20.0, 50.0])
@pytest.mark.parametrize("wanted", [0.0, 3.1, -3.1, 1.0])
def test_heading_is_on_the_branch_nearest_to_the_robot(heading, wanted):
    for goal in (
        PoseGoal(np.array([1.0, 2.0, wanted])),
        StateGoal(np.array([1.0, 2.0, wanted]), np.array([0.1, 0.2, 0.0]), 1.0),
        a_trajectory((wanted, wanted + 0.5, wanted + 1.0)),
    ):
        near = goal.near(heading, 1.0)
        poses, _ = near.targets(np.array([1.0]))
        before, _ = goal.targets(np.array([1.0]))
        assert abs(poses[0, 2] - heading) <= math.pi + 1e-9
        turns = (poses[0, 2] - before[0, 2]) / math.tau
        assert turns == pytest.approx(round(turns))
        np.testing.assert_allclose(poses[0, :2], before[0, :2])
        assert near.until == goal.until and near.moves == goal.moves


def test_trajectory_of_several_turns_keeps_its_turns():
    goal = a_trajectory((3.0, 6.0, 9.0)).near(-3.2, 0.0)
    poses, _ = goal.targets(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(np.diff(poses[:, 2]), 3.0)
    assert poses[0, 2] == pytest.approx(3.0 - math.tau)


def test_a_trajectory_under_way_is_on_the_branch_nearest_to_the_robot_now():
    # Two seconds after its start it has turned by 6 rad; odometry wraps the robot's heading.
    goal = a_trajectory((0.0, 3.0, 6.0)).near(6.0 - math.tau, 3.0)
    poses, _ = goal.targets(np.array([1.0, 2.0, 3.0]))
    assert poses[:, 2] == pytest.approx(np.array([0.0, 3.0, 6.0]) - math.tau)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e7])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_invalid_poses_are_refused(bad, index):
    pose = np.zeros(3)
    pose[index] = bad
    with pytest.raises(InputError, match=r"goal: (position|heading)|pose\["):
        PoseGoal(pose)
    with pytest.raises(InputError, match=r"goal: (position|heading)|pose\["):
        StateGoal(pose, np.zeros(3))
    velocity = np.zeros(3)
    velocity[index] = bad
    with pytest.raises(InputError, match=r"goal: velocity|velocity\["):
        StateGoal(np.zeros(3), velocity)


@pytest.mark.parametrize(("speed", "kind"), [(0.0, PoseGoal), (5e-5, PoseGoal), (0.1, StateGoal)])
def test_a_goal_whose_velocity_is_round_off_is_one_to_rest_at(speed, kind):
    assert isinstance(goal_of_state(np.zeros(3), np.array([0.0, speed, 0.0])), kind)


def test_wrong_sizes_are_refused():
    with pytest.raises(InputError, match=r"pose\.shape = \(2,\)"):
        PoseGoal(np.zeros(2))
    with pytest.raises(InputError, match=r"velocity\.shape = \(4,\)"):
        StateGoal(np.zeros(3), np.zeros(4))


@pytest.mark.parametrize(
    "goal",
    [
        PoseGoal(np.array([1.0, 2.0, 0.3])),
        StateGoal(np.array([1.0, 2.0, 0.3]), np.array([0.5, -0.2, 0.1])).arriving(2.0),
        a_trajectory(),
    ],
)
def test_a_displaced_goal_is_the_goal_seen_from_another_frame(goal):
    frame = (0.5, -1.0, 2.0)
    c, s = math.cos(2.0), math.sin(2.0)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    poses, velocities = goal.targets(TIMES)
    moved = goal.displaced(frame)
    found, speeds = moved.targets(TIMES)
    np.testing.assert_allclose(found, poses @ turn.T + frame)
    np.testing.assert_allclose(speeds, velocities @ turn.T)
    twice, _ = moved.displaced(frame).targets(TIMES)
    np.testing.assert_allclose(twice, found @ turn.T + frame)
    assert (moved.until, moved.moves) == (goal.until, goal.moves)
    near, _ = moved.near(9.0, 1.0).targets(TIMES)
    assert abs(near[0, 2] - 9.0) <= math.pi
