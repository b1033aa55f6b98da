"""Tests of goal, start, cases and restart: page events and the resulting messages."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from omniman_ros.conversions.geometry import quaternion_from_yaw, yaw_from_quaternion
from omniman_ros.nodes.mpc_planner.node import MpcPlannerNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.cases import CASES
from omniman_ros.planning.planner import PlannerState
from omniman_ros.viewer.events import (
    CaseSelected,
    GoalDragged,
    ObstacleVelocitySet,
    StartDragged,
)
from omniman_ros.viewer.ros.relocation import SOURCE_TIMEOUT
from test import robots
from test.viewer.ros.fake_page import Services, post, press, until, view

NAN = math.nan


class Field:
    """The viewer with a robot that the test simulates.

    Attributes:
        goals: All goals that were sent, as poses.
        placed: Topic, frame and pose of each message on `initialpose` and `set_pose`.
    """

    def __init__(self, world):
        self.world = world
        self.state = world.nodes[-1].state
        probe = world.probe
        self.goals, self.placed = [], []
        self._odom = world.publisher(Odometry, "odom")
        self._truth = world.publisher(Odometry, "ground_truth/odom")
        self._status = world.publisher(DiagnosticStatus, "mpc/status")
        self._source = probe.create_publisher(String, "active_source", LATCHED)
        probe.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)
        for topic in ("initialpose", "set_pose"):
            probe.create_subscription(
                PoseWithCovarianceStamped,
                topic,
                lambda message, topic=topic: self._on_relocation(topic, message),
                10,
            )
        self.pose, self.speed, self.simulated, self.planner_state = (0.5, 0.2, 0.1), 0.0, True, ""
        self.follows = True
        self._periods = 0
        world.hooks.append(self._report)
        matched = ("goal_pose", "initialpose", "set_pose")
        node = world.nodes[-1]
        until(world, lambda: all(node.count_subscribers(t) for t in matched), "the probe", 0.005)
        poses = node._poses
        relocator = poses._relocator
        for publisher, count in (
            (poses._goals, 2),
            (relocator._plant, 1),
            (relocator._odometry, 1),
        ):
            world._await(
                lambda p=publisher, n=count: p.get_subscription_count() == n,
                "the probe's subscriptions",
            )
        world.run(0.2)

    def publish_source(self, source):
        """Publish the active source."""
        self._source.publish(String(data=source))
        until(self.world, lambda: self.state.active_source == source, "the source", 0.01)

    def _report(self):
        self._periods += 1
        if self._periods % 4:
            return
        message = Odometry()
        message.header.frame_id = "odom"
        message.pose.pose.position.x, message.pose.pose.position.y = self.pose[:2]
        message.pose.pose.orientation = quaternion_from_yaw(self.pose[2])
        message.twist.twist.linear.x = self.speed
        self._odom.publish(message)
        if self.simulated:
            message.header.frame_id = "world"
            self._truth.publish(message)
        if self.planner_state:
            values = [KeyValue(key="state", value=self.planner_state)]
            self._status.publish(DiagnosticStatus(values=values))

    def _on_goal(self, message):
        place = message.pose.position
        assert message.header.frame_id == "odom"
        self.goals.append((place.x, place.y, yaw_from_quaternion(message.pose.orientation)))

    def _on_relocation(self, topic, message):
        place = message.pose.pose.position
        pose = place.x, place.y, yaw_from_quaternion(message.pose.pose.orientation)
        self.placed.append((topic, message.header.frame_id, pose))
        if topic == "set_pose" and self.follows:
            self.pose = pose


@pytest.fixture
def field():
    with view() as world:
        world.run(0.1)
        yield Field(world)


def poses(*given):
    return [pytest.approx(pose) for pose in given]


# ---- goal -------------------------------------------------------------------------------------


def test_a_goal_is_sent_when_it_is_released(field):
    post(field.world, GoalDragged((1.0, 2.0, 0.5), False))
    assert field.goals == [] and field.state.goal == (1.0, 2.0, 0.5)
    post(field.world, GoalDragged((1.5, 2.0, 0.6), True))
    assert field.goals == poses((1.5, 2.0, 0.6))
    assert field.state.goal == (1.5, 2.0, 0.6)


@pytest.mark.parametrize("state", ["driving", "blocked"])
def test_while_the_planner_drives_a_goal_is_sent_five_times_a_second(field, state):
    field.planner_state = state
    field.world.run(0.2)
    for k in range(40):
        post(field.world, GoalDragged((0.1 * k, 0.0, 0.0), False), seconds=0.05)
        assert field.state.goal == (0.1 * k, 0.0, 0.0), "the echo of an older one is not shown"
    assert len(field.goals) == pytest.approx(10, abs=1)
    post(field.world, GoalDragged((9.0, 0.0, 0.0), True))
    assert field.goals[-1] == pytest.approx((9.0, 0.0, 0.0))


def test_the_echo_of_a_goal_does_not_move_the_dragged_goal(field):
    field.planner_state = "driving"
    field.world.run(0.2)
    post(field.world, *(GoalDragged((x, 0.0, 0.0), False) for x in (1.0, 2.0)), seconds=0.2)
    assert field.goals == poses((1.0, 0.0, 0.0))
    assert field.state.goal == (2.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "pose", [(NAN, 0.0, 0.0), (0.0, -2e6, 0.0), (0.0, 0.0, math.inf), (0.0, 0.0, 1e9)]
)
@pytest.mark.parametrize("kind", [GoalDragged, StartDragged])
def test_an_invalid_pose_is_refused(field, kind, pose):
    post(field.world, kind(pose, True), seconds=0.3)
    assert "finite or beyond" in field.state.note
    assert field.goals == [] and field.placed == []
    assert field.state.goal is None and field.state.start is None


def test_a_goal_of_another_node_is_displayed(field):
    message = PoseStamped()
    message.header.frame_id = "odom"
    message.pose.position.x = 3.0
    message.pose.orientation.w = 1.0
    field.world.probe.create_publisher(PoseStamped, "goal_pose", 10).publish(message)
    world = field.world
    publisher = world.publisher(PoseStamped, "goal_pose")
    publisher.publish(message)
    until(world, lambda: field.state.goal == (3.0, 0.0, 0.0), "the goal")
    assert field.state.start == pytest.approx(field.pose)


def test_the_goal_stays_shown_when_it_is_reached(field):
    field.planner_state = "driving"
    post(field.world, GoalDragged((1.0, 0.0, 0.0), True))
    field.planner_state = "arrived"
    field.world.run(1.5)
    assert field.state.goal == (1.0, 0.0, 0.0)


def test_the_start_is_the_pose_where_the_robot_departed(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.state.start == pytest.approx((0.5, 0.2, 0.1))
    field.planner_state, field.pose = "driving", (1.0, 0.0, 0.0)
    field.world.run(0.2)
    post(field.world, GoalDragged((6.0, 0.0, 0.0), True))
    assert field.state.start == pytest.approx((0.5, 0.2, 0.1)), "still on its way"
    field.planner_state = "arrived"
    field.world.run(0.2)
    post(field.world, GoalDragged((7.0, 0.0, 0.0), True))
    assert field.state.start == pytest.approx((1.0, 0.0, 0.0))


def test_without_a_planner_the_goal_is_sent_with_a_note(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.state.note == "goal sent; no mpc_planner reports"
    field.planner_state = "idle"
    field.world.run(0.2)
    post(field.world, GoalDragged((6.0, 0.0, 0.0), True))
    assert field.state.note == "goal sent"


def test_go_without_a_goal_is_refused(field):
    press(field.world, "go")
    assert field.goals == [] and "no goal yet" in field.state.note


# ---- start ------------------------------------------------------------------------------------


def test_a_dragged_start_puts_a_simulated_robot_there(field):
    post(field.world, StartDragged((2.0, 1.0, 0.3), False), seconds=0.3)
    assert field.placed == []
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.3)
    there = pytest.approx((2.0, 1.0, 0.3))
    assert field.placed == [("initialpose", "odom", there), ("set_pose", "odom", there)]
    assert field.state.start == (2.0, 1.0, 0.3)
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.goals == [], "the controller would not accept a source yet"
    field.world.run(SOURCE_TIMEOUT)
    assert field.goals == poses((5.0, 0.0, 0.0))
    assert field.state.start == (2.0, 1.0, 0.3), "a goal does not move it"


def test_a_real_robot_is_not_relocated(field):
    field.simulated = False
    field.world.run(1.1)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.3)
    assert field.placed == [] and field.state.start is None
    assert field.state.note == "the start stays: only a simulated robot can be relocated"


@pytest.mark.parametrize("source", ["path", "mpc", "cmd_vel"])
def test_the_start_is_unchanged_while_a_source_is_active(field, source):
    field.publish_source(source)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.5)
    assert field.placed == [] and field.state.start is None
    assert field.state.note == f"the start stays: {source} drives"


def test_the_start_is_unchanged_while_the_robot_still_moves(field):
    field.speed = 0.1
    field.world.run(0.2)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.5)
    assert field.placed == [] and field.state.note == "the start stays: the robot moves"


def scaled_case(name):
    """Return a case scaled to the robot of these tests."""
    body = robots.robot("omniman").body
    return CASES[name].fitting(body.length, body.width)


# ---- cases and restart ------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_a_case_places_robot_goal_and_obstacles_and_waits_for_go(field, name):
    case, state = scaled_case(name), field.state
    post(field.world, CaseSelected(name), seconds=0.5)
    assert (state.start, state.goal, state.case) == (case.start, case.goal, name)
    assert [pose for _, _, pose in field.placed] == poses(case.start, case.start)
    field.world.run(2.0)
    assert state.obstacles_paused and field.goals == []
    places = [way.position for way in case.paths]
    assert state.obstacles.centers.tolist() == [pytest.approx(place) for place in places]
    press(field.world, "go", 1.0)
    assert field.goals == poses(case.goal)
    assert not state.obstacles_paused and state.start == case.start
    paths = [way(0.95) for way in case.paths]
    assert state.obstacles.centers == pytest.approx(np.array(paths).reshape(-1, 2), abs=0.05)


def test_a_case_without_a_simulation_leaves_the_robot_where_it_is(field):
    field.simulated = False
    field.world.run(1.1)
    post(field.world, CaseSelected("moving"), seconds=0.5)
    assert field.placed == [] and len(field.state.obstacles.numbers) == 4
    assert field.state.goal == scaled_case("moving").goal
    assert "the robot stays: only a simulated robot" in field.state.note


def test_an_unknown_case_is_refused(field):
    post(field.world, CaseSelected("labyrinth"))
    assert field.state.note == "there is no case 'labyrinth': free, corridor, moving"
    assert field.state.case == "" and field.state.goal is None


def test_a_goal_moved_during_a_pause_waits_for_go(field):
    post(field.world, CaseSelected("free"), seconds=0.5)
    post(field.world, GoalDragged((2.0, 2.0, 0.0), True), seconds=1.0)
    assert field.goals == [] and "Go sends it" in field.state.note
    press(field.world, "go")
    assert field.goals == poses((2.0, 2.0, 0.0))


def test_a_restart_cancels_first_and_waits_until_the_robot_is_at_rest(field):
    services = Services(field.world, "mpc_planner", "cancel")
    names = {"mpc_planner/cancel"}
    until(field.world, lambda: field.state.services == names, "the service")
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.publish_source("mpc")
    field.pose, field.speed = (2.0, 0.0, 0.0), 0.3
    press(field.world, "restart", 0.5)
    until(field.world, lambda: services.called == ["cancel"], "the call")
    assert field.placed == []
    field.publish_source("none")
    field.world.run(0.3)
    assert field.placed == [], "it still rolls"
    field.speed = 0.0
    field.world.run(0.5)
    start = (0.5, 0.2, 0.1)
    assert [pose for _, _, pose in field.placed] == poses(start, start)
    field.world.run(SOURCE_TIMEOUT)
    assert len(field.state.odom_trail.points) <= 1
    assert field.state.obstacles_paused


def test_a_robot_at_rest_is_not_relocated_before_the_planner_has_answered(field):
    world = field.world
    services = Services(world, "mpc_planner", "cancel")
    until(world, lambda: len(field.state.services) == 1, "the service")
    post(world, GoalDragged((5.0, 0.0, 0.0), True))
    world.executor.remove_node(world.probe)  # the planner does not answer yet
    press(world, "restart", 0.5)
    world.executor.add_node(world.probe)
    assert world.nodes[-1]._poses._relocator._relocation.moved_at is None
    until(world, lambda: services.called == ["cancel"] and field.placed, "the placing")


def test_a_robot_that_does_not_come_to_rest_is_not_relocated(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.speed = 0.3
    field.world.run(0.1)
    press(field.world, "restart", 3.5)
    assert field.state.note == "the robot is not at the start: the robot does not come to rest"
    field.speed = 0.0
    field.world.run(1.0)
    assert field.placed == []


def test_go_during_a_restart_takes_effect_at_the_start(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.pose, field.speed = (3.0, 0.0, 0.0), 0.3
    field.world.run(0.1)
    press(field.world, "restart", 0.3)
    press(field.world, "go", 0.5)
    assert len(field.goals) == 1 and field.state.obstacles_paused
    field.speed = 0.0
    field.world.run(SOURCE_TIMEOUT + 0.3)
    assert field.goals == poses((5.0, 0.0, 0.0), (5.0, 0.0, 0.0))
    assert not field.state.obstacles_paused


@pytest.mark.parametrize("action", ["stop", "cancel", "pause"])
def test_a_stop_during_a_restart_discards_a_pending_go(field, action):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.speed = 0.3
    field.world.run(0.1)
    press(field.world, "restart", 0.2)
    press(field.world, "go", 0.2)
    press(field.world, action, 0.2)
    field.speed = 0.0
    field.world.run(1.0)
    assert len(field.goals) == 1 and field.placed == []


def test_a_restart_without_a_start_is_noted(field):
    press(field.world, "restart")
    assert field.placed == [] and "there is no start yet" in field.state.note


def test_pause_and_resume_include_the_obstacles(field):
    press(field.world, "add", 0.1)
    post(field.world, ObstacleVelocitySet(0, (0.5, 0.0)), seconds=0.5)
    press(field.world, "pause", 0.1)
    held = field.state.obstacles.centers[0].tolist()
    field.world.run(1.0)
    assert field.state.obstacles.centers[0].tolist() == held and field.state.obstacles_paused
    press(field.world, "resume", 1.0)
    assert field.state.obstacles.centers[0] == pytest.approx([held[0] + 0.5, held[1]], abs=0.06)
    assert not field.state.obstacles_paused


def test_a_restart_brings_obstacles_back_and_pauses_them(field):
    press(field.world, "add", 0.1)
    begin = field.state.obstacles.centers[0].tolist()
    post(field.world, ObstacleVelocitySet(0, (0.5, 0.0)), seconds=1.0)
    press(field.world, "restart", 1.0)
    assert field.state.obstacles.centers[0].tolist() == begin and field.state.obstacles_paused


def test_resume_sends_a_goal_that_was_moved_during_the_pause(field):
    planner = Services(field.world, "mpc_planner", "resume")
    until(field.world, lambda: len(field.state.services) == 1, "the service")
    field.planner_state = "paused"
    press(field.world, "pause", 0.2)
    press(field.world, "resume", 0.2)
    until(field.world, lambda: planner.called == ["resume"], "the call")
    press(field.world, "pause", 0.2)
    post(field.world, GoalDragged((1.0, 1.0, 0.0), True))
    press(field.world, "resume", 0.3)
    assert field.goals == poses((1.0, 1.0, 0.0)) and planner.called == ["resume"]


# ---- with the real nodes ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot():
    """Planner, controller, plant and viewer, shared by the tests: the planner starts slowly."""
    nodes = (MpcPlannerNode, PlatformControllerNode, SimulatedDriveNode)
    with view(*nodes, parameters={"horizon.steps": 5}) as world:
        state = world.nodes[-1].state
        until(world, lambda: state.active_source == "none", "the controller")
        until(world, lambda: state.is_fresh("planner", world.time), "the planner")
        until(world, lambda: len(state.planner_parameters) > 0, "its parameters")
        yield world


def test_the_planner_accepts_successive_dragged_goals(robot):
    planner, state = robot.nodes[0], robot.nodes[-1].state
    press(robot, "reset", 0.1)
    post(robot, GoalDragged((1.0, 0.0, 0.0), True), seconds=0.5)
    assert planner.core.state is PlannerState.DRIVING
    assert planner.core.goal.pose[:2] == pytest.approx([1.0, 0.0])
    assert state.planner["state"] == "driving"
    until(robot, lambda: len(state.plan.points) > 1, "the plan")
    post(robot, GoalDragged((0.5, 0.5, 0.0), False), seconds=0.3)
    assert planner.core.goal.pose[:2] == pytest.approx([0.5, 0.5])
