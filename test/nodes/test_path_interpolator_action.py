"""Tests of the node's `follow_joint_trajectory` actions."""

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.motion.path.trajectory_goal import ErrorCode
from test import ros_interfaces
from test.nodes.test_path_interpolator import BENT
from test.nodes.test_path_interpolator_arm import FAR, trajectory
from test.nodes.test_path_interpolator_whole_body import BODY, GOAL, WholeBodyWorld

ARM_ACTION, BODY_ACTION = (
    f"{name}_controller/follow_joint_trajectory" for name in ("arm", "body")
)


@pytest.fixture(scope="module")
def action_type() -> Iterator[Any]:
    with ros_interfaces.installed("control_msgs"):
        yield import_module("control_msgs.action").FollowJointTrajectory


class ActionClientWorld(WholeBodyWorld):
    """A whole-body world with clients of both actions."""

    def __init__(self, action_type: Any) -> None:
        super().__init__()
        self.action_type = action_type
        self.feedback: list[Any] = []
        self.clients = {
            name: ActionClient(self.probe, action_type, name) for name in (ARM_ACTION, BODY_ACTION)
        }
        for name, client in self.clients.items():
            self._await(client.server_is_ready, f"action {name}")

    def close(self) -> None:
        for client in self.clients.values():
            client.destroy()
        for action in self.node.actions:
            action.destroy()
        super().close()

    def send_goal(self, name: str, message: Any, **fields: Any) -> tuple[Any, Any]:
        """Send a goal that is accepted; return its handle and the future of its result."""
        goal = self.action_type.Goal(trajectory=message, **fields)
        future = self.clients[name].send_goal_async(goal, feedback_callback=self.feedback.append)
        self._await(future.done, "an answer to a goal")
        handle = future.result()
        assert handle.accepted
        return handle, handle.get_result_async()

    def result(self, future: Any, seconds: float = 20.0) -> tuple[int, int, str]:
        """Return the status, code and text of a result."""
        self.run_until(lambda: all(action.idle for action in self.node.actions), seconds, "an end")
        self._await(future.done, "a result")
        got = future.result()
        return got.status, got.result.error_code, got.result.error_string


@pytest.fixture
def world(action_type):
    with ActionClientWorld(action_type) as made:
        yield made


def test_an_arm_goal_is_reached(world):
    _, future = world.send_goal(ARM_ACTION, trajectory([FAR]))
    assert world.result(future) == (GoalStatus.STATUS_SUCCEEDED, ErrorCode.SUCCESSFUL, "")
    assert world.joints == pytest.approx(FAR, abs=1e-6)
    errors = [np.abs(message.feedback.error.positions).max() for message in world.feedback]
    assert len(errors) > 30 and max(errors) < 0.01
    assert list(world.feedback[0].feedback.joint_names) == list(UR_JOINTS)


def test_a_whole_body_goal_is_reached(world):
    _, future = world.send_goal(BODY_ACTION, trajectory([GOAL], names=BODY))
    assert world.result(future)[:2] == (GoalStatus.STATUS_SUCCEEDED, ErrorCode.SUCCESSFUL)
    assert world.received_axes()[1][-1] == pytest.approx(GOAL, abs=1e-6)
    errors = [np.abs(message.feedback.error.positions).max() for message in world.feedback]
    assert len(errors) > 30 and max(errors) < 0.01


def test_a_cancel_brings_the_whole_body_to_rest_on_the_path(world):
    handle, future = world.send_goal(BODY_ACTION, trajectory([GOAL], names=BODY))
    world.run(1.0)
    cancelled = handle.cancel_goal_async()
    world._await(cancelled.done, "an answer")
    assert world.result(future, 3.0)[0] == GoalStatus.STATUS_CANCELED
    assert 0.02 < world.received_axes()[1][-1, 0] < 0.58
    world.assert_both_smooth()


def test_a_goal_that_violates_limits_is_aborted_with_the_reason(world):
    _, future = world.send_goal(BODY_ACTION, trajectory([GOAL], [0.2], BODY))
    status, code, text = world.result(future)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
    assert "odom_x: velocity" in text and not world.references


def test_a_goal_may_name_the_platforms_axes_as_moveit_does(world):
    names = ["platform/theta", "elbow_joint", "platform/x"]
    tolerance = import_module("control_msgs.msg").JointTolerance(name="platform/x", position=0.2)
    message = trajectory([[0.3, 1.2, 0.2]], names=names)
    _, future = world.send_goal(BODY_ACTION, message, path_tolerance=[tolerance])
    assert world.result(future)[0] == GoalStatus.STATUS_SUCCEEDED
    assert world.setpoint.pose == pytest.approx([0.2, 0.0, 0.3], abs=1e-6)
    assert world.joints[2] == pytest.approx(1.2, abs=1e-6)


def test_a_waiting_goal_can_be_cancelled(world):
    world.follows_stream = False
    world.send(BENT)
    world.run(0.6)
    world.follows_stream = True
    handle, future = world.send_goal(BODY_ACTION, trajectory([[0.2]], names=["odom_x"]))
    cancelled = handle.cancel_goal_async()
    world._await(cancelled.done, "an answer")
    assert world.result(future, 1.0)[0] == GoalStatus.STATUS_CANCELED
    before = len(world.references)
    world.run(2.0)
    assert len(world.references) == before


def test_a_shutdown_waits_until_the_client_has_the_result(world):
    _, future = world.send_goal(BODY_ACTION, trajectory([GOAL], names=BODY))
    world.run(1.0)
    world.node.begin_shutdown("SIGINT")
    world.run_until(lambda: world.node.finished, 3.0, "the end")
    world._await(future.done, "a result")
    assert future.result().status == GoalStatus.STATUS_ABORTED
