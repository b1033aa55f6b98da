"""Topic `motion_events` of each node: each kind of end, told to who knows the request's stamp."""

from collections.abc import Callable
from itertools import count
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from std_srvs.srv import Trigger

from omniman_ros.conversions.headers import duration_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from test.nodes.harness import PERIOD, World
from test.nodes.test_mpc_planner import PlannerWithFakeController, goal
from test.nodes.test_path_interpolator import BENT, path
from test.nodes.test_path_interpolator_arm import FAR
from test.nodes.test_path_interpolator_tool import READY, SHORT, ToolWorld, tool_path
from test.nodes.test_path_interpolator_whole_body import trajectory
from test.nodes.test_whole_body_planner import DodgeWorld, tool_goal

ARM = UR_JOINTS
LATE = 0.03  #: Age of the requests on their arrival [s]
ENDS = {"refused", "replaced", "given_up", "cancelled", "arrived"}


class Told:
    """What a node has told of requests on `motion_events`."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.messages = world.listen(DiagnosticStatus, "motion_events")

    def send(self, publisher: Any, message: Any, age: float = LATE) -> str:
        """Publish a request with a stamp, and return how its events name it."""
        stamp = message.header.stamp = self.world.stamp(-age)
        publisher.publish(message)
        self.world.run(8 * PERIOD)
        return f"{stamp.sec}.{stamp.nanosec:09d}"

    def of(self, request: str) -> list[dict[str, Any]]:
        """Return level, message and values of the events of a request."""
        found = [
            {pair.key: pair.value for pair in told.values}
            | {"level": told.level, "message": told.message, "name": told.name}
            for told in self.messages
        ]
        return [values for values in found if values["request"] == request]

    def events(self, request: str) -> list[str]:
        return [values["event"] for values in self.of(request)]

    def wait(self, request: str, event: str, seconds: float = 20.0) -> None:
        self.world.run_until(lambda: event in self.events(request), seconds, event)


class Planner:
    """Goals of mpc_planner; `far` makes one that takes some seconds."""

    name, kind = "mpc_planner", "goal"

    def __init__(self) -> None:
        self.world = PlannerWithFakeController()
        self.publisher = self.world.goals

    def far(self) -> Any:
        return goal(self.world.true_pose()[0] + 1.0, 0.0)

    def near(self) -> Any:
        return goal(self.world.true_pose()[0] + 0.2, 0.0)

    def wrong(self) -> Any:
        return goal(0.2, 0.0, frame="nowhere")

    def wait_for_start(self) -> None:
        pass

    def speed(self) -> float:
        return self.world.true_speed()

    def take_away(self) -> None:
        self.world.follows_stream = False
        self.world.publish_source("cmd_vel")


class Paths:
    """Paths of path_interpolator."""

    name, kind = "path_interpolator", "path"

    def __init__(self) -> None:
        self.world = ToolWorld()
        self.publisher = self.world.paths

    def far(self) -> Any:
        return path(BENT)

    def near(self) -> Any:
        return path([(0.1, 0, 0)])

    def wrong(self) -> Any:
        return Path(header=path(BENT).header)

    def wait_for_start(self) -> None:
        pass

    def speed(self) -> float:
        return float(abs(self.world.setpoint.velocity).max())

    def take_away(self) -> None:
        self.world.follows_stream = False
        self.world.publish_source("cmd_vel")


class Tool(Paths):
    """Paths of the tool of whole_body_planner."""

    name, kind = "whole_body_planner", "tool_path"

    def __init__(self) -> None:
        self.world = DodgeWorld()
        self.publisher = self.world.tool_paths

    def far(self) -> Any:
        return tool_path(SHORT)

    def near(self) -> Any:
        return tool_path([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])

    def wrong(self) -> Any:
        return tool_path(SHORT, frame="nowhere")

    def wait_for_start(self) -> None:
        tool = self.world.node.motions.tool  # a discarded path may still be being planned
        self.world._await(lambda: tool._running is None or tool._running.done(), "the planner")
        self.world.run(0.2)
        self.world.run_to_motion_start()


class ToolGoals(Tool):
    """Goals of the tool of whole_body_planner."""

    kind = "tool_goal"

    def __init__(self) -> None:
        super().__init__()
        self.publisher = self.world.publisher(PoseStamped, "tool_goal")
        self._number = count()  # no goal is where the tool is already

    def _goal(self, x: float, side: float) -> Any:
        k = next(self._number)
        return tool_goal((x, side * (-1.0) ** k, 0.005 * k))

    def far(self) -> Any:
        return self._goal(0.2, 0.3)

    def near(self) -> Any:
        return self._goal(0.1, 0.0)

    def wrong(self) -> Any:
        return tool_goal((0.1, 0.0, 0.0), frame="nowhere")


@pytest.fixture(scope="module", params=[Planner, Paths, Tool, ToolGoals])
def robot(request):
    made = request.param()
    with made.world:
        yield made


@pytest.fixture(scope="module")
def told(robot):
    return Told(robot.world)


def test_a_motion_arrives_and_who_comes_late_is_told_too(robot, told):
    request = told.send(robot.publisher, robot.near())
    robot.wait_for_start()
    told.wait(request, "arrived")
    assert robot.speed() == 0.0
    values = told.of(request)
    events = [value["event"] for value in values if value["event"] != "planning"]
    assert events == ["received", "started", "arrived"]
    assert {value["kind"] for value in values} == {robot.kind}
    assert {value["name"] for value in values} == {f"/{robot.name}"}
    assert {value["level"] for value in values} == {DiagnosticStatus.OK}
    assert len({value["motion"] for value in values} - {"0"}) == 1
    late = robot.world.probe.create_subscription
    heard: list[DiagnosticStatus] = []
    late(DiagnosticStatus, "motion_events", heard.append, ALL_LATCHED)
    robot.world._await(lambda: len(heard) >= len(told.messages), "the events so far")
    assert heard == told.messages


def test_a_cancelled_motion_says_so_once_the_robot_is_at_rest(robot, told):
    request = told.send(robot.publisher, robot.far())
    robot.wait_for_start()
    robot.world.run_until(lambda: robot.speed() > 0.05, 5.0, "motion")
    assert robot.world.call(Trigger, f"{robot.name}/cancel").success
    robot.world.run(2 * PERIOD)
    assert robot.speed() > 0.0 and not ENDS & {*told.events(request)}
    told.wait(request, "cancelled")
    assert robot.speed() < 1e-3


def test_a_pause_is_told_and_is_no_trouble_as_it_was_asked_for(robot, told):
    request = told.send(robot.publisher, robot.far())
    robot.wait_for_start()
    robot.world.run_until(lambda: robot.speed() > 0.05, 5.0, "motion")
    for name in ("pause", "resume"):
        assert robot.world.call(Trigger, f"{robot.name}/{name}").success
        robot.world.run(2.0)
    told.wait(request, "arrived")
    assert told.events(request)[-4:] == ["started", "paused", "resumed", "arrived"]
    assert {value["level"] for value in told.of(request)} == {DiagnosticStatus.OK}


def test_a_newer_motion_replaces_an_older_one(robot, told):
    first, second = (told.send(robot.publisher, robot.far(), age) for age in (LATE, 0.0))
    assert told.events(first)[-1] == "replaced" and "replaced" not in told.events(second)
    robot.wait_for_start()
    told.wait(second, "started")
    assert robot.world.call(Trigger, f"{robot.name}/cancel").success
    told.wait(second, "cancelled")


def test_a_refused_motion_says_why(robot, told):
    request = told.send(robot.publisher, robot.wrong())
    assert told.events(request) == ["received", "refused"]
    assert told.of(request)[-1]["message"]
    assert told.of(request)[-1]["level"] == DiagnosticStatus.WARN


def test_a_motion_that_is_given_up_says_why(robot, told):
    request = told.send(robot.publisher, robot.far())
    robot.wait_for_start()
    robot.world.run_until(lambda: robot.speed() > 0.05, 5.0, "motion")
    robot.take_away()
    told.wait(request, "given_up", 2.0)
    robot.world.run(2.0)
    assert [event for event in told.events(request) if event in ENDS] == ["given_up"]
    assert told.of(request)[-1]["message"] == "cmd_vel drives"
    assert told.of(request)[-1]["level"] == DiagnosticStatus.WARN


# ---- inputs of path_interpolator ---------------------------------------------------------------


@pytest.fixture
def world():
    with ToolWorld() as made:
        yield made


@pytest.mark.parametrize(
    ("kind", "publisher", "make"),
    [
        ("arm", "trajectories", lambda: trajectory([FAR])),
        ("body", "trajectories", lambda: trajectory([(0.1, *READY)], names=("odom_x", *ARM))),
        ("tool_path", "tool_paths", lambda: tool_path(SHORT)),
    ],
)
def test_each_input_has_its_kind(world, kind: str, publisher: str, make: Callable[[], Any]):
    told = Told(world)
    request = told.send(getattr(world, publisher), make())
    if kind == "tool_path":
        world.wait_for_plan()
    told.wait(request, "arrived")
    assert {value["kind"] for value in told.of(request)} == {kind}


def test_a_path_that_is_too_large_to_be_read_is_refused_by_its_stamp(world):
    told = Told(world)
    request = told.send(world.paths, path([(0.0, 0.0, 0.0)] * 12_000))
    assert told.events(request) == ["received", "refused"]


def test_a_stamped_trajectory_that_waits_for_the_robot_starts_as_one_without_a_stamp(world):
    told = Told(world)
    world.arm_reports = False
    world.run(1.0)
    message = trajectory([(0.1, *READY)], names=("odom_x", *ARM))
    request = told.send(world.trajectories, message)
    world.run(2.0)
    assert told.events(request)[-1] == "waiting"
    world.arm_reports = True
    told.wait(request, "arrived")


def test_of_a_stream_of_points_only_its_begin_and_its_end_are_told(world):
    told, sent = Told(world), []
    for k in range(20):
        message = trajectory([READY + 0.002 * k])
        message.points[0].time_from_start = duration_message(0.1)
        sent.append(told.send(world.trajectories, message))
    told.wait(sent[0], "arrived")
    assert told.events(sent[0]) == ["received", "started", "arrived"]
    assert not any(told.events(request) for request in sent[1:])


def test_of_points_that_are_refused_only_the_first_is_told_until_there_is_a_pause(world):
    told, sent = Told(world), []
    for k in range(12):
        message = trajectory([READY + 9.0])
        message.points[0].time_from_start = duration_message(0.1)
        sent.append(told.send(world.trajectories, message))
        world.run(2.0 if k == 9 else 0.0)
    refused = [k for k, request in enumerate(sent) if told.events(request)]
    assert refused == [0, 10]
    assert told.events(sent[0]) == ["received", "refused"]
