import math

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.viewer.tool_goal import MOST_POSES, ToolGoal, ToolPose

HERE = ToolPose((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))


def at(x):
    return ToolPose((x, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0))


def test_rotations_of_any_length_become_those_of_unit_length():
    pose = ToolPose.checked((1, 2, 3), (0.0, 3.0, 0.0, 4.0))
    assert pose == ToolPose((1.0, 2.0, 3.0), (0.0, pytest.approx(0.6), 0.0, pytest.approx(0.8)))


@pytest.mark.parametrize(
    ("position", "rotation", "message"),
    [
        ((math.nan, 0.0, 0.0), HERE.rotation, "position"),
        ((0.0, 0.0, 1e300), HERE.rotation, "position"),
        (HERE.position, (math.inf, 0.0, 0.0, 0.0), "rotation"),
        (HERE.position, (0.0, 0.0, 0.0, 0.0), "no length"),
    ],
)
def test_poses_that_are_none_are_refused(position, rotation, message):
    with pytest.raises(InputError, match=message):
        ToolPose.checked(position, rotation)


@pytest.mark.parametrize("action", ["add", "move", "path"])
def test_without_a_handle_nothing_can_be_done(action):
    goal = ToolGoal()
    with pytest.raises(InputError, match="there is no handle yet"):
        {"add": goal.add, "move": lambda: goal.move(HERE), "path": lambda: goal.path}[action]()


def test_a_path_leads_through_the_added_poses_to_the_handle():
    goal = ToolGoal()
    goal.place(at(1.0))
    assert goal.path == (at(1.0),)
    for x in (2.0, 3.0):
        goal.move(at(x))
        goal.add()
    assert goal.path == (at(2.0), at(3.0))
    goal.move(at(4.0))
    assert goal.path == (at(2.0), at(3.0), at(4.0))
    goal.place(HERE)
    assert goal.path == (HERE,)
    goal.remove()
    assert (goal.handle, goal.poses) == (None, ())


def test_a_pose_is_added_once_and_not_beyond_the_limit():
    goal = ToolGoal()
    goal.place(at(0.0))
    goal.add()
    with pytest.raises(InputError, match="move the handle first"):
        goal.add()
    for x in range(1, MOST_POSES - 1):
        goal.move(at(float(x)))
        goal.add()
    goal.move(at(99.0))
    with pytest.raises(InputError, match="at most 50 poses"):
        goal.add()
    assert len(goal.path) == MOST_POSES
