"""Action `follow_joint_trajectory` against a client, on simulated time, with a port of the test's.

Reactions are timed where the action is; what the client hears is waited for.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control_msgs_here
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
from omniman_ros.core.path.trajectory_goal import ErrorCode, TrajectoryActionOptions
from omniman_ros.nodes import trajectory_action
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.trajectory_action import TrajectoryAction, serve_actions

from .harness import World, free_domain

NAMES = ("odom_x", "odom_t", "elbow_joint")
NAME = "body_controller/follow_joint_trajectory"
OPTIONS = TrajectoryActionOptions()
GOAL = np.array([1.0, 2.0, -0.5])
STATUS = GoalStatus


class Port:
    """Takes trajectories and does what the test says.

    Attributes:
        sent: Messages.
        refusal: Why none is taken, or nothing.
        outcomes: How each motion goes on.
        cancelled: Motions that were cancelled; they go on until the test says otherwise.
        wanted, measured: What it says of the axes: rows position, velocity, acceleration.
        asked: How often it was asked where the axes are.
    """

    names = NAMES

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.sent: list[JointTrajectory] = []
        self.refusal = ""
        self.outcomes: list[str | None] = []
        self.cancelled: list[int] = []
        self.wanted = np.zeros((3, 3))
        self.measured = np.zeros((2, 3))
        self.asked = 0

    def send(self, message: JointTrajectory) -> int:
        if self.refusal:
            raise InputError(self.refusal)
        self.sent.append(message)
        self.outcomes.append(None)
        return len(self.outcomes) - 1

    def outcome(self, motion: int) -> str | None:
        return self.outcomes[motion]

    def cancel(self, motion: int) -> None:
        self.cancelled.append(motion)

    def desired(self) -> Any:
        self.asked += 1
        return tuple(self.wanted)

    def actual(self) -> Any:
        return tuple(self.measured)

    def arrive(self, at: Any = GOAL) -> None:
        """The last motion comes to its end, the axes at a place."""
        self.wanted[:], self.measured[:] = 0.0, 0.0
        self.wanted[0], self.measured[0] = GOAL, at
        self.outcomes[-1] = ""


class Served(World):
    """A node with the action, and a client of it."""

    def __init__(self, kind: Any, port: Port) -> None:
        super().__init__(lambda **options: OmnimanNode("mover", **options))
        self.kind, self.port, self.feedback = kind, port, []
        (self.action,) = serve_actions(self.nodes[0], {NAME: port}, OPTIONS)
        self.client = ActionClient(self.probe, kind, NAME)
        self._await(self.client.server_is_ready, f"action {NAME}")

    def close(self) -> None:
        self.client.destroy()
        self.action.destroy()
        super().close()

    def ask(self, goal: Any) -> Any:
        """Send a goal; the client's handle of it."""
        future = self.client.send_goal_async(goal, feedback_callback=self.feedback.append)
        self._await(future.done, "an answer to a goal")
        return future.result()

    def begin(self, goal: Any) -> Any:
        """Send a goal that is accepted; the future of its result."""
        handle = self.ask(goal)
        assert handle.accepted
        return handle, handle.get_result_async()

    def cancel(self, handle: Any) -> int:
        """Ask to cancel a goal; how many are cancelled."""
        future = handle.cancel_goal_async()
        self._await(future.done, "an answer to a cancel request")
        return len(future.result().goals_canceling)

    def result(self, future: Any) -> tuple[int, int, str]:
        """Status, code and text of a result that is there or on its way."""
        self._await(future.done, "a result")
        got = future.result()
        return got.status, got.result.error_code, got.result.error_string


@pytest.fixture(scope="module")
def kind() -> Iterator[Any]:
    with control_msgs_here.installed() as found:
        yield found


@pytest.fixture(scope="module")
def world(kind: Any) -> Iterator[Served]:
    with Served(kind, Port()) as served:
        yield served


@pytest.fixture
def served(world: Served) -> Iterator[Served]:
    """The world with a port that knows nothing; goals of the test before have ended."""
    port = world.port
    port.reset()
    world.feedback.clear()
    yield world
    port.outcomes = ["the test has ended"] * len(port.outcomes)
    world.run(2 * OPTIONS.period)
    assert world.action.idle


def goal_of(kind: Any, names: Any = NAMES, place: Any = GOAL, **fields: Any) -> Any:
    """A goal of one point after 2 s."""
    point = JointTrajectoryPoint(positions=[*map(float, place)], time_from_start=Duration(sec=2))
    trajectory = JointTrajectory(joint_names=list(names), points=[point])
    return kind.Goal(trajectory=trajectory, **fields)


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> Any:
    from control_msgs.msg import JointTolerance

    return JointTolerance(name=name, position=position, velocity=velocity)


def test_a_goal_that_is_reached_succeeds_and_says_where_the_axes_are_on_the_way(served):
    handle, future = served.begin(goal_of(served.kind))
    assert [m.points[0].positions[2] for m in served.port.sent] == [-0.5]
    served.port.wanted[:] = [[0.5, 4.0, -0.25], [0.1, 0.2, 0.3], [1, 2, 3]]
    served.port.measured[:] = [[0.4, 4.1 - 2 * np.pi, -0.25], [0.1, 0.0, 0.3]]
    served.run(0.1)
    served._await(lambda: len(served.feedback) >= 3, "feedback")
    said = served.feedback[-1].feedback
    assert said.joint_names == list(NAMES)
    assert list(said.desired.positions) == [0.5, 4.0, -0.25]
    assert list(said.desired.accelerations) == [1, 2, 3]
    assert list(said.actual.velocities) == [0.1, 0.0, 0.3]
    assert np.allclose(said.error.positions, [0.1, -0.1, 0.0])
    assert np.allclose(said.error.velocities, [0.0, 0.2, 0.0])
    stamp = said.header.stamp.sec + 1e-9 * said.header.stamp.nanosec
    assert abs(stamp - served.time) < 0.1 and not future.done()
    served.port.arrive()
    served.run(2 * OPTIONS.period)
    assert served.action.idle
    assert served.result(future) == (STATUS.STATUS_SUCCEEDED, ErrorCode.SUCCESSFUL, "")


def test_an_idle_action_asks_nothing_of_its_port(served):
    _, future = served.begin(goal_of(served.kind))
    served.port.arrive()
    served.run(0.2)
    assert served.result(future)[0] == STATUS.STATUS_SUCCEEDED
    asked = served.port.asked
    assert asked > 0
    served.run(0.5)
    assert served.port.asked == asked


def test_a_result_can_be_fetched_after_its_end(served):
    handle = served.ask(goal_of(served.kind))
    served.port.arrive()
    served.run(0.5)
    assert served.action.idle
    assert served.result(handle.get_result_async())[0] == STATUS.STATUS_SUCCEEDED


@pytest.mark.parametrize(
    ("reason", "spoil"),
    [
        ("no joint knee", lambda g: setattr(g.trajectory, "joint_names", ["knee"])),
        ("twice", lambda g: setattr(g.trajectory, "joint_names", [*NAMES[:2], "odom_x"])),
        ("among the names", lambda g: setattr(g.trajectory, "joint_names", [])),
        ("without points", lambda g: g.trajectory.points.clear()),
        ("2 positions for 3", lambda g: setattr(g.trajectory.points[0], "positions", [1.0, 2.0])),
        ("not finite", lambda g: setattr(g.trajectory.points[0], "positions", [np.nan] * 3)),
        ("multi_dof", lambda g: setattr(g.multi_dof_trajectory, "joint_names", ["base"])),
        ("tolerances of a multi", lambda g: g.component_goal_tolerance.append(component())),
        ("ended", lambda g: setattr(g.trajectory.header.stamp, "sec", 900)),
        ("no axis", lambda g: g.path_tolerance.append(tolerance("knee", 0.1))),
        ("odom_t: position -0.5", lambda g: g.goal_tolerance.append(tolerance("odom_t", -0.5))),
        ("time_tolerance -2", lambda g: setattr(g.goal_time_tolerance, "sec", -2)),
    ],
)
def test_a_goal_that_cannot_be_read_is_rejected_with_a_warning(served, reason, spoil):
    warned: list[str] = []
    served.nodes[0].warn, usual = lambda subject, text: warned.append(text), served.nodes[0].warn
    goal = goal_of(served.kind)
    spoil(goal)
    try:
        assert not served.ask(goal).accepted
    finally:
        served.nodes[0].warn = usual
    assert not served.port.sent and served.action.idle
    assert len(warned) == 1 and reason in warned[0], warned


def component() -> Any:
    from control_msgs.msg import JointComponentTolerance

    return JointComponentTolerance(joint_name="base")


def test_a_goal_that_the_port_refuses_is_aborted_with_the_reason_and_the_last_goes_on(served):
    _, first = served.begin(goal_of(served.kind))
    served.port.refusal = "elbow_joint: speed 9 rad/s at 1 s, the limit is 3 rad/s"
    _, second = served.begin(goal_of(served.kind))
    expected = (STATUS.STATUS_ABORTED, ErrorCode.INVALID_GOAL, served.port.refusal)
    assert served.result(second) == expected
    served.run(0.2)
    assert not first.done() and not served.action.idle
    served.port.arrive()
    served.run(0.2)
    assert served.result(first)[0] == STATUS.STATUS_SUCCEEDED


def test_a_new_goal_takes_the_place_of_the_last_which_is_aborted(served):
    _, first = served.begin(goal_of(served.kind))
    _, second = served.begin(goal_of(served.kind))
    status, code, text = served.result(first)
    assert (status, code) == (STATUS.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
    assert text == "replaced by a new goal"
    served.port.outcomes[0] = "replaced"
    served.run(0.2)
    assert not second.done() and not served.port.cancelled
    served.port.arrive()
    served.run(0.2)
    assert served.result(second)[0] == STATUS.STATUS_SUCCEEDED


def test_a_goal_that_is_cancelled_ends_when_the_axes_have_come_to_rest(served):
    handle, future = served.begin(goal_of(served.kind))
    served.run(0.1)
    assert served.cancel(handle) == 1
    assert served.port.cancelled == [0]
    served.run(0.5)
    assert not served.action.idle and not future.done()
    served.port.outcomes[0] = "cancelled"
    served.run(2 * OPTIONS.period)
    assert served.action.idle
    status, code, _ = served.result(future)
    assert (status, code) == (STATUS.STATUS_CANCELED, ErrorCode.SUCCESSFUL)
    assert served.port.cancelled == [0]
    assert served.cancel(handle) == 0, "a goal that has ended is cancelled"


def test_a_goal_that_is_being_cancelled_can_be_replaced(served):
    handle, first = served.begin(goal_of(served.kind))
    assert served.cancel(handle) == 1
    _, second = served.begin(goal_of(served.kind))
    assert served.result(first)[0] == STATUS.STATUS_CANCELED
    served.port.arrive()
    served.run(0.2)
    assert served.result(second)[0] == STATUS.STATUS_SUCCEEDED


def test_an_axis_beyond_its_path_tolerance_stops_the_motion_and_then_ends_the_goal(served):
    goal = goal_of(served.kind, path_tolerance=[tolerance("elbow_joint", 0.05)])
    _, future = served.begin(goal)
    served.port.measured[0] = [0.0, 0.0, 0.04]
    served.run(0.2)
    assert not served.port.cancelled
    served.port.measured[0] = [0.0, 0.0, 0.06]
    served.run(2 * OPTIONS.period)
    assert served.port.cancelled == [0]
    served.port.measured[0] = 0.0
    served.run(0.5)
    assert not served.action.idle and served.port.cancelled == [0]
    served.port.outcomes[0] = "cancelled"
    served.run(2 * OPTIONS.period)
    status, code, text = served.result(future)
    assert (status, code) == (STATUS.STATUS_ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED)
    assert "elbow_joint" in text and "0.06" in text and "0.05" in text


def test_axes_that_do_not_come_to_the_goal_in_time_abort_it(served):
    goal = goal_of(
        served.kind,
        goal_tolerance=[tolerance("odom_x", 0.1)],
        goal_time_tolerance=Duration(sec=0, nanosec=500_000_000),
    )
    _, future = served.begin(goal)
    served.port.arrive(GOAL + [0.2, 0.0, 0.0])
    served.run(0.45)
    assert not served.action.idle
    served.run(0.15)
    assert served.action.idle
    status, code, text = served.result(future)
    assert (status, code) == (STATUS.STATUS_ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED)
    assert "odom_x" in text


def test_axes_that_come_to_the_goal_in_time_succeed(served):
    _, future = served.begin(goal_of(served.kind))
    served.port.arrive(GOAL + [0.2, 0.0, 0.0])
    served.run(1.0)
    assert not served.action.idle
    served.port.arrive(GOAL + [0.009, 0.0, 0.0])
    served.run(2 * OPTIONS.period)
    assert served.result(future)[0] == STATUS.STATUS_SUCCEEDED


def test_a_motion_that_is_given_up_aborts_its_goal_with_the_reason(served):
    _, future = served.begin(goal_of(served.kind))
    served.port.outcomes[0] = "given up: emergency_stop is true"
    served.run(2 * OPTIONS.period)
    status, code, text = served.result(future)
    assert (status, code) == (STATUS.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
    assert text == "given up: emergency_stop is true"


def test_axes_that_a_goal_does_not_name_may_be_anywhere(served):
    _, future = served.begin(goal_of(served.kind, ["elbow_joint"], [-0.5]))
    served.port.arrive([7.0, 8.0, -0.5])
    served.run(2 * OPTIONS.period)
    assert served.result(future)[0] == STATUS.STATUS_SUCCEEDED


def test_error_codes_are_those_of_control_msgs(kind):
    assert {code.name: code.value for code in ErrorCode} == {
        name: getattr(kind.Result, name) for name in ErrorCode.__members__
    }


def test_without_control_msgs_a_line_says_that_there_is_no_action(monkeypatch):
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    monkeypatch.setitem(sys.modules, "control_msgs.action", None)
    said: list[str] = []
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=said.append))
    assert serve_actions(node, {NAME: Port()}, OPTIONS) == ()
    assert said == ["no control_msgs: no follow_joint_trajectory action"]


@pytest.mark.processes
def test_only_the_action_imports_control_msgs_and_not_before_it_is_served():
    root = Path(omniman_ros.__file__).parent
    files = {f for f in root.rglob("*.py") if "import FollowJointTrajectory" in f.read_text()}
    assert files == {Path(trajectory_action.__file__)}
    code = "import sys, omniman_ros.nodes.trajectory_action; print('control_msgs' in sys.modules)"
    env = {**os.environ, "PYTHONPATH": str(control_msgs_here.folder() or "")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.strip() == "False", done.stderr


@pytest.mark.processes
@pytest.mark.parametrize("executor", ["EventsExecutor", "SingleThreadedExecutor"])
def test_both_executors_of_a_node_serve_goals(kind, executor):
    """In real time, which EventsExecutor cannot do without; the client is in the same process."""
    makers = {"EventsExecutor": EventsExecutor, "SingleThreadedExecutor": SingleThreadedExecutor}
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    context.init(domain_id=free_domain())
    spun = makers[executor](context=context)
    node, port = OmnimanNode("mover", context=context), Port()
    spun.add_node(node)
    action = TrajectoryAction(node, kind, NAME, port, OPTIONS)
    client = ActionClient(node, kind, NAME)
    feedback: list[Any] = []

    def wait(future: Any) -> Any:
        spun.spin_until_future_complete(future, timeout_sec=10.0)
        assert future.done(), f"no answer under {executor}"
        return future.result()

    def spin(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            spun.spin_until_future_complete(rclpy.Future(), timeout_sec=0.02)

    try:
        assert client.wait_for_server(10.0)
        for _ in range(2):
            handle = wait(client.send_goal_async(goal_of(kind), feedback_callback=feedback.append))
            result = handle.get_result_async()
            spin(0.2)
            assert handle.accepted and feedback and not result.done()
            port.arrive()
            assert wait(result).status == STATUS.STATUS_SUCCEEDED
            feedback.clear()
        handle = wait(client.send_goal_async(goal_of(kind)))
        assert len(wait(handle.cancel_goal_async()).goals_canceling) == 1
        port.outcomes[-1] = "cancelled"
        assert wait(handle.get_result_async()).status == STATUS.STATUS_CANCELED
        assert port.cancelled == [2]
    finally:
        client.destroy()
        action.destroy()
        spun.remove_node(node)
        node.destroy_node()
        spun.shutdown()
        context.try_shutdown()
