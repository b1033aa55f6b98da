"""Tests of the `follow_joint_trajectory` action with a client and a fake motion interface.

Simulated time applies to the action; messages to the client are awaited in real time.
"""

import inspect
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import omniman_ros
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.trajectory_goal import ErrorCode, TrajectoryActionOptions
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.path_interpolator.node import (
    TrajectoryAction,
    serve_actions,
)
from test import ros_interfaces
from test.nodes.harness import World, free_domain

NAMES = ("odom_x", "odom_t", "elbow_joint")
NAME = "body_controller/follow_joint_trajectory"
OPTIONS = TrajectoryActionOptions()
GOAL = np.array([1.0, 2.0, -0.5])
Status = GoalStatus


class FakeInterface:
    """Accepts trajectories and reports the states that a test sets.

    Attributes:
        sent: Accepted messages.
        refusal: Reason for refusing every trajectory; empty to accept them.
        motions: Motions; the test sets their outcomes.
        cancelled: Cancelled motions, which stay active until the test sets their outcome.
        desired_state: Positions, velocities and accelerations of the axes (3, 3).
        actual_state: Measured positions and velocities of the axes (2, 3).
        query_count: Number of queries of the desired state.
    """

    names = NAMES

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.sent: list[JointTrajectory] = []
        self.refusal = ""
        self.motions: list[SimpleNamespace] = []
        self.cancelled: list[int] = []
        self.desired_state = np.zeros((3, 3))
        self.actual_state = np.zeros((2, 3))
        self.query_count = 0

    def normalise(self, message: JointTrajectory) -> None:
        pass

    def send(self, message: JointTrajectory) -> SimpleNamespace:
        if self.refusal:
            raise InputError(self.refusal)
        self.sent.append(message)
        self.motions.append(SimpleNamespace(outcome=None))
        return self.motions[-1]

    def cancel(self, motion: SimpleNamespace) -> None:
        self.cancelled.append(self.motions.index(motion))

    def desired(self) -> Any:
        self.query_count += 1
        return tuple(self.desired_state)

    def actual(self) -> Any:
        return tuple(self.actual_state)

    def arrive(self, at: Any = GOAL) -> None:
        """End the last motion with the axes at the given positions."""
        self.desired_state[:], self.actual_state[:] = 0.0, 0.0
        self.desired_state[0], self.actual_state[0] = GOAL, at
        self.motions[-1].outcome = ""


class ActionWorld(World):
    """A node that serves the action, and a client of the action."""

    def __init__(self, action_type: Any, interface: FakeInterface) -> None:
        super().__init__(lambda **options: OmnimanNode("mover", **options))
        self.action_type, self.interface, self.feedback = action_type, interface, []
        (self.action,) = serve_actions(self.nodes[0], {NAME: interface}, OPTIONS)
        self.client = ActionClient(self.probe, action_type, NAME)
        self._await(self.client.server_is_ready, f"action {NAME}")

    def close(self) -> None:
        self.client.destroy()
        self.action.destroy()
        super().close()

    def send_goal(self, goal: Any) -> Any:
        """Send a goal and return the client's handle."""
        future = self.client.send_goal_async(goal, feedback_callback=self.feedback.append)
        self._await(future.done, "an answer to a goal")
        return future.result()

    def send_accepted_goal(self, goal: Any) -> Any:
        """Send a goal that is accepted; return its handle and the future of its result."""
        handle = self.send_goal(goal)
        assert handle.accepted
        return handle, handle.get_result_async()

    def cancel(self, handle: Any) -> int:
        """Request to cancel a goal and return the number of goals being cancelled."""
        future = handle.cancel_goal_async()
        self._await(future.done, "an answer to a cancel request")
        return len(future.result().goals_canceling)

    def result(self, future: Any) -> tuple[int, int, str]:
        """Return the status, code and text of a result, waiting until it has arrived."""
        self._await(future.done, "a result")
        got = future.result()
        return got.status, got.result.error_code, got.result.error_string


@pytest.fixture(scope="module")
def action_type() -> Iterator[Any]:
    with ros_interfaces.installed("control_msgs"):
        yield import_module("control_msgs.action").FollowJointTrajectory


@pytest.fixture(scope="module")
def world(action_type: Any) -> Iterator[ActionWorld]:
    with ActionWorld(action_type, FakeInterface()) as served:
        yield served


@pytest.fixture
def served(world: ActionWorld) -> Iterator[ActionWorld]:
    """Return the world with a reset interface, and end all goals after the test."""
    interface = world.interface
    interface.reset()
    world.feedback.clear()
    yield world
    for motion in interface.motions:
        motion.outcome = "the test has ended"
    world.run(2 * OPTIONS.period)
    assert world.action.idle


def goal_of(action_type: Any, names: Any = NAMES, place: Any = GOAL, **fields: Any) -> Any:
    """Return a goal of one point after 2 s."""
    point = JointTrajectoryPoint(positions=[*map(float, place)], time_from_start=Duration(sec=2))
    trajectory = JointTrajectory(joint_names=list(names), points=[point])
    return action_type.Goal(trajectory=trajectory, **fields)


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> Any:
    from control_msgs.msg import JointTolerance

    return JointTolerance(name=name, position=position, velocity=velocity)


def test_a_reached_goal_succeeds_after_feedback_on_the_axes(served):
    _handle, future = served.send_accepted_goal(goal_of(served.action_type))
    assert [m.points[0].positions[2] for m in served.interface.sent] == [-0.5]
    served.interface.desired_state[:] = [[0.5, 4.0, -0.25], [0.1, 0.2, 0.3], [1, 2, 3]]
    served.interface.actual_state[:] = [[0.4, 4.1 - 2 * np.pi, -0.25], [0.1, 0.0, 0.3]]
    served.run(0.1)
    served._await(lambda: len(served.feedback) >= 3, "feedback")
    received = served.feedback[-1].feedback
    assert received.joint_names == list(NAMES)
    assert list(received.desired.positions) == [0.5, 4.0, -0.25]
    assert list(received.desired.accelerations) == [1, 2, 3]
    assert list(received.actual.velocities) == [0.1, 0.0, 0.3]
    assert np.allclose(received.error.positions, [0.1, -0.1, 0.0])
    assert np.allclose(received.error.velocities, [0.0, 0.2, 0.0])
    stamp = received.header.stamp.sec + 1e-9 * received.header.stamp.nanosec
    assert abs(stamp - served.time) < 0.1 and not future.done()
    served.interface.arrive()
    served.run(2 * OPTIONS.period)
    assert served.action.idle
    assert served.result(future) == (Status.STATUS_SUCCEEDED, ErrorCode.SUCCESSFUL, "")


def test_an_idle_action_does_not_query_its_interface(served):
    _, future = served.send_accepted_goal(goal_of(served.action_type))
    served.interface.arrive()
    served.run(0.2)
    assert served.result(future)[0] == Status.STATUS_SUCCEEDED
    query_count = served.interface.query_count
    assert query_count > 0
    served.run(0.5)
    assert served.interface.query_count == query_count


def test_a_result_can_be_fetched_after_the_goal_has_ended(served):
    handle = served.send_goal(goal_of(served.action_type))
    served.interface.arrive()
    served.run(0.5)
    assert served.action.idle
    assert served.result(handle.get_result_async())[0] == Status.STATUS_SUCCEEDED


@pytest.mark.parametrize(
    ("reason", "spoil"),
    [
        ("no joint knee", lambda g: setattr(g.trajectory, "joint_names", ["knee"])),
        ("once each", lambda g: setattr(g.trajectory, "joint_names", [*NAMES[:2], "odom_x"])),
        ("once each", lambda g: setattr(g.trajectory, "joint_names", [])),
        ("has no points", lambda g: g.trajectory.points.clear()),
        ("2 positions for 3", lambda g: setattr(g.trajectory.points[0], "positions", [1.0, 2.0])),
        ("not finite", lambda g: setattr(g.trajectory.points[0], "positions", [np.nan] * 3)),
        ("multi_dof", lambda g: setattr(g.multi_dof_trajectory, "joint_names", ["base"])),
        ("component tolerances", lambda g: g.component_goal_tolerance.append(component())),
        ("ended", lambda g: setattr(g.trajectory.header.stamp, "sec", 900)),
        ("unknown axis", lambda g: g.path_tolerance.append(tolerance("knee", 0.1))),
        ("odom_t: position -0.5", lambda g: g.goal_tolerance.append(tolerance("odom_t", -0.5))),
        ("time_tolerance -2", lambda g: setattr(g.goal_time_tolerance, "sec", -2)),
    ],
)
def test_an_invalid_goal_is_rejected_with_a_warning(served, reason, spoil):
    warnings: list[str] = []
    served.nodes[0].warn, usual = lambda subject, text: warnings.append(text), served.nodes[0].warn
    goal = goal_of(served.action_type)
    spoil(goal)
    try:
        assert not served.send_goal(goal).accepted
    finally:
        served.nodes[0].warn = usual
    assert not served.interface.sent and served.action.idle
    assert len(warnings) == 1 and reason in warnings[0], warnings


def test_a_goal_whose_points_have_no_times_may_have_a_stamp_that_has_just_passed(served):
    goal = goal_of(served.action_type)
    goal.trajectory.header.stamp = served.stamp(-0.03)
    goal.trajectory.points[-1].time_from_start = Duration()
    served.send_accepted_goal(goal)


def component() -> Any:
    from control_msgs.msg import JointComponentTolerance

    return JointComponentTolerance(joint_name="base")


def test_a_refused_goal_is_aborted_and_the_active_one_continues(served):
    _, first = served.send_accepted_goal(goal_of(served.action_type))
    served.interface.refusal = "elbow_joint: speed 9 rad/s at 1 s, the limit is 3 rad/s"
    _, second = served.send_accepted_goal(goal_of(served.action_type))
    expected = (Status.STATUS_ABORTED, ErrorCode.INVALID_GOAL, served.interface.refusal)
    assert served.result(second) == expected
    served.run(0.2)
    assert not first.done() and not served.action.idle
    served.interface.arrive()
    served.run(0.2)
    assert served.result(first)[0] == Status.STATUS_SUCCEEDED


def test_a_new_goal_replaces_the_active_one_which_is_aborted(served):
    _, first = served.send_accepted_goal(goal_of(served.action_type))
    _, second = served.send_accepted_goal(goal_of(served.action_type))
    status, code, text = served.result(first)
    assert (status, code) == (Status.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
    assert text == "replaced by a new goal"
    served.interface.motions[0].outcome = "replaced"
    served.run(0.2)
    assert not second.done() and not served.interface.cancelled
    served.interface.arrive()
    served.run(0.2)
    assert served.result(second)[0] == Status.STATUS_SUCCEEDED


def test_a_cancelled_goal_ends_when_the_axes_have_come_to_rest(served):
    handle, future = served.send_accepted_goal(goal_of(served.action_type))
    served.run(0.1)
    assert served.cancel(handle) == 1
    assert served.interface.cancelled == [0]
    served.run(0.5)
    assert not served.action.idle and not future.done()
    served.interface.motions[0].outcome = "cancelled"
    served.run(2 * OPTIONS.period)
    assert served.action.idle
    status, code, _ = served.result(future)
    assert (status, code) == (Status.STATUS_CANCELED, ErrorCode.SUCCESSFUL)
    assert served.interface.cancelled == [0]
    assert served.cancel(handle) == 0, "a goal that has ended is cancelled"


def test_a_goal_can_be_replaced_while_being_cancelled(served):
    handle, first = served.send_accepted_goal(goal_of(served.action_type))
    assert served.cancel(handle) == 1
    _, second = served.send_accepted_goal(goal_of(served.action_type))
    assert served.result(first)[0] == Status.STATUS_CANCELED
    served.interface.arrive()
    served.run(0.2)
    assert served.result(second)[0] == Status.STATUS_SUCCEEDED


def test_a_path_tolerance_violation_stops_the_motion_before_ending_the_goal(served):
    goal = goal_of(served.action_type, path_tolerance=[tolerance("elbow_joint", 0.05)])
    _, future = served.send_accepted_goal(goal)
    served.interface.actual_state[0] = [0.0, 0.0, 0.04]
    served.run(0.2)
    assert not served.interface.cancelled
    served.interface.actual_state[0] = [0.0, 0.0, 0.06]
    served.run(2 * OPTIONS.period)
    assert served.interface.cancelled == [0]
    served.interface.actual_state[0] = 0.0
    served.run(0.5)
    assert not served.action.idle and served.interface.cancelled == [0]
    served.interface.motions[0].outcome = "cancelled"
    served.run(2 * OPTIONS.period)
    status, code, text = served.result(future)
    assert (status, code) == (Status.STATUS_ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED)
    assert "elbow_joint" in text and "0.06" in text and "0.05" in text


def test_a_goal_not_reached_in_time_is_aborted(served):
    goal = goal_of(
        served.action_type,
        goal_tolerance=[tolerance("odom_x", 0.1)],
        goal_time_tolerance=Duration(sec=0, nanosec=500_000_000),
    )
    _, future = served.send_accepted_goal(goal)
    served.interface.arrive(GOAL + [0.2, 0.0, 0.0])
    served.run(0.45)
    assert not served.action.idle
    served.run(0.15)
    assert served.action.idle
    status, code, text = served.result(future)
    assert (status, code) == (Status.STATUS_ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED)
    assert "odom_x" in text


def test_a_given_up_motion_aborts_its_goal_with_the_reason(served):
    _, future = served.send_accepted_goal(goal_of(served.action_type))
    served.interface.motions[0].outcome = "given up: emergency_stop is true"
    served.run(2 * OPTIONS.period)
    status, code, text = served.result(future)
    assert (status, code) == (Status.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
    assert text == "given up: emergency_stop is true"


def test_error_codes_are_those_of_control_msgs(action_type):
    assert {code.name: code.value for code in ErrorCode} == {
        name: getattr(action_type.Result, name) for name in ErrorCode.__members__
    }


def test_a_log_line_reports_missing_control_msgs(monkeypatch):
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    monkeypatch.setitem(sys.modules, "control_msgs.action", None)
    received: list[str] = []
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=received.append))
    assert serve_actions(node, {NAME: FakeInterface()}, OPTIONS) == ()
    assert received == ["no follow_joint_trajectory action: control_msgs is not installed"]


@pytest.mark.processes
def test_only_the_action_imports_control_msgs_and_only_when_served():
    root = Path(omniman_ros.__file__).parent
    files = {f for f in root.rglob("*.py") if "import FollowJointTrajectory" in f.read_text()}
    assert files == {Path(inspect.getfile(TrajectoryAction))}
    module = "omniman_ros.nodes.path_interpolator.node"
    code = f"import sys, {module}; print('control_msgs' in sys.modules)"
    env = {**os.environ, "PYTHONPATH": str(ros_interfaces.folder("control_msgs") or "")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.strip() == "False", done.stderr


@pytest.mark.processes
@pytest.mark.parametrize("executor", ["EventsExecutor", "SingleThreadedExecutor"])
def test_both_executors_of_a_node_serve_goals(action_type, executor):
    """The test runs in real time, as EventsExecutor requires, with the client in its process."""
    makers = {"EventsExecutor": EventsExecutor, "SingleThreadedExecutor": SingleThreadedExecutor}
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    context.init(domain_id=free_domain())
    spun = makers[executor](context=context)
    node, interface = OmnimanNode("mover", context=context), FakeInterface()
    spun.add_node(node)
    action = TrajectoryAction(node, action_type, NAME, interface, OPTIONS)
    client = ActionClient(node, action_type, NAME)
    feedback: list[Any] = []

    def wait(future: Any) -> Any:
        spun.spin_until_future_complete(future, timeout_sec=10.0)
        assert future.done(), f"no response under {executor}"
        return future.result()

    def spin(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            spun.spin_until_future_complete(rclpy.Future(), timeout_sec=0.02)

    try:
        assert client.wait_for_server(10.0)
        for _ in range(2):
            handle = wait(
                client.send_goal_async(goal_of(action_type), feedback_callback=feedback.append)
            )
            result = handle.get_result_async()
            spin(0.2)
            assert handle.accepted and feedback and not result.done()
            interface.arrive()
            assert wait(result).status == Status.STATUS_SUCCEEDED
            feedback.clear()
        handle = wait(client.send_goal_async(goal_of(action_type)))
        assert len(wait(handle.cancel_goal_async()).goals_canceling) == 1
        interface.motions[-1].outcome = "cancelled"
        assert wait(handle.get_result_async()).status == Status.STATUS_CANCELED
        assert interface.cancelled == [2]
    finally:
        client.destroy()
        action.destroy()
        spun.remove_node(node)
        node.destroy_node()
        spun.shutdown()
        context.try_shutdown()
