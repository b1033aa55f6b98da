"""Goal, start, cases and restart: what the page asks for, and what robot and planner do."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import String

from omniman_ros import conversions
from omniman_ros.nodes.mpc_planner import MpcPlannerNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stopping import LATCHED
from omniman_ros.nodes.viewing.placing import QUIET
from omniman_ros.planning.cases import CASES
from omniman_ros.planning.planner import PlannerState
from omniman_ros.viewer.events import (
    CaseChosen,
    GoalDragged,
    ObstacleSent,
    StartDragged,
)
from test import robots

from .fake_page import Services, post, press, until, view

NAN = math.nan


class Field:
    """The viewer with a robot that the test plays.

    Attributes:
        goals: All that was sent, as poses.
        placed: All of `initialpose` and `set_pose`: topic, frame, pose.
    """

    def __init__(self, world):
        self.world = world
        self.picture = world.nodes[-1].picture
        probe = world.probe
        self.goals, self.placed = [], []
        self._odom = world.publisher(Odometry, "odom")
        self._truth = world.publisher(Odometry, "ground_truth/odom")
        self._status = world.publisher(DiagnosticStatus, "mpc/status")
        self._source = probe.create_publisher(String, "active_source", LATCHED)
        probe.create_subscription(PoseStamped, "goal_pose", self._hear_goal, 10)
        for topic in ("initialpose", "set_pose"):
            probe.create_subscription(
                PoseWithCovarianceStamped, topic,
                lambda message, topic=topic: self._hear_placing(topic, message), 10,
            )  # fmt: skip
        self.pose, self.speed, self.simulated, self.state = (0.5, 0.2, 0.1), 0.0, True, ""
        self.follows = True
        self._periods = 0
        world.hooks.append(self._report)
        matched = ("goal_pose", "initialpose", "set_pose")
        node = world.nodes[-1]
        until(world, lambda: all(node.count_subscribers(t) for t in matched), "the probe", 0.005)
        places = node._places
        for publisher, count in ((places._goals, 2), (places._plant, 1), (places._odometry, 1)):
            world._await(
                lambda p=publisher, n=count: p.get_subscription_count() == n, "the probe's ears"
            )
        world.run(0.2)

    def drives(self, source):
        """Have a source drive."""
        self._source.publish(String(data=source))
        until(self.world, lambda: self.picture.active_source == source, "the source", 0.01)

    def _report(self):
        self._periods += 1
        if self._periods % 4:
            return
        message = Odometry()
        message.header.frame_id = "odom"
        message.pose.pose.position.x, message.pose.pose.position.y = self.pose[:2]
        message.pose.pose.orientation = conversions.quaternion(self.pose[2])
        message.twist.twist.linear.x = self.speed
        self._odom.publish(message)
        if self.simulated:
            message.header.frame_id = "world"
            self._truth.publish(message)
        if self.state:
            values = [KeyValue(key="state", value=self.state)]
            self._status.publish(DiagnosticStatus(values=values))

    def _hear_goal(self, message):
        place = message.pose.position
        assert message.header.frame_id == "odom"
        self.goals.append((place.x, place.y, conversions.yaw(message.pose.orientation)))

    def _hear_placing(self, topic, message):
        place = message.pose.pose.position
        pose = place.x, place.y, conversions.yaw(message.pose.pose.orientation)
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


def test_a_goal_is_sent_when_it_is_let_go(field):
    post(field.world, GoalDragged((1.0, 2.0, 0.5), False))
    assert field.goals == [] and field.picture.goal == (1.0, 2.0, 0.5)
    post(field.world, GoalDragged((1.5, 2.0, 0.6), True))
    assert field.goals == poses((1.5, 2.0, 0.6))
    assert field.picture.goal == (1.5, 2.0, 0.6)


@pytest.mark.parametrize("state", ["driving", "blocked"])
def test_while_the_planner_drives_a_goal_is_sent_five_times_a_second(field, state):
    field.state = state
    field.world.run(0.2)
    for k in range(40):
        post(field.world, GoalDragged((0.1 * k, 0.0, 0.0), False), seconds=0.05)
        assert field.picture.goal == (0.1 * k, 0.0, 0.0), "the echo of an older one is not shown"
    assert len(field.goals) == pytest.approx(10, abs=1)
    post(field.world, GoalDragged((9.0, 0.0, 0.0), True))
    assert field.goals[-1] == pytest.approx((9.0, 0.0, 0.0))


def test_a_goal_that_comes_back_does_not_move_the_one_that_is_dragged_on(field):
    field.state = "driving"
    field.world.run(0.2)
    post(field.world, *(GoalDragged((x, 0.0, 0.0), False) for x in (1.0, 2.0)), seconds=0.2)
    assert field.goals == poses((1.0, 0.0, 0.0))
    assert field.picture.goal == (2.0, 0.0, 0.0)


def test_of_several_goals_the_last_wins(field):
    post(field.world, *(GoalDragged((x, 0.0, 0.0), True) for x in (1.0, 2.0, 3.0)))
    assert field.goals[-1] == pytest.approx((3.0, 0.0, 0.0))
    assert field.picture.goal == (3.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "pose", [(NAN, 0.0, 0.0), (0.0, -2e6, 0.0), (0.0, 0.0, math.inf), (0.0, 0.0, 1e9)]
)
@pytest.mark.parametrize("kind", [GoalDragged, StartDragged])
def test_a_pose_that_cannot_be_is_refused(field, kind, pose):
    post(field.world, kind(pose, True), seconds=0.3)
    assert "finite or beyond" in field.picture.note
    assert field.goals == [] and field.placed == []
    assert field.picture.goal is None and field.picture.start is None


def test_a_goal_of_others_is_shown(field):
    message = PoseStamped()
    message.header.frame_id = "odom"
    message.pose.position.x = 3.0
    message.pose.orientation.w = 1.0
    field.world.probe.create_publisher(PoseStamped, "goal_pose", 10).publish(message)
    world = field.world
    publisher = world.publisher(PoseStamped, "goal_pose")
    publisher.publish(message)
    until(world, lambda: field.picture.goal == (3.0, 0.0, 0.0), "the goal")
    assert field.picture.start == pytest.approx(field.pose)


def test_the_goal_stays_shown_when_it_is_reached(field):
    field.state = "driving"
    post(field.world, GoalDragged((1.0, 0.0, 0.0), True))
    field.state = "arrived"
    field.world.run(1.5)
    assert field.picture.goal == (1.0, 0.0, 0.0)


def test_the_start_is_where_the_robot_was_when_it_set_out(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.picture.start == pytest.approx((0.5, 0.2, 0.1))
    field.state, field.pose = "driving", (1.0, 0.0, 0.0)
    field.world.run(0.2)
    post(field.world, GoalDragged((6.0, 0.0, 0.0), True))
    assert field.picture.start == pytest.approx((0.5, 0.2, 0.1)), "still on its way"
    field.state = "arrived"
    field.world.run(0.2)
    post(field.world, GoalDragged((7.0, 0.0, 0.0), True))
    assert field.picture.start == pytest.approx((1.0, 0.0, 0.0))


def test_without_a_planner_the_goal_is_sent_and_that_is_told(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.picture.note == "goal sent; no mpc_planner is heard"
    field.state = "idle"
    field.world.run(0.2)
    post(field.world, GoalDragged((6.0, 0.0, 0.0), True))
    assert field.picture.note == "goal sent"


def test_go_without_a_goal_is_refused(field):
    press(field.world, "go")
    assert field.goals == [] and "no goal yet" in field.picture.note


# ---- start ------------------------------------------------------------------------------------


def test_a_dragged_start_puts_a_simulated_robot_there(field):
    post(field.world, StartDragged((2.0, 1.0, 0.3), False), seconds=0.3)
    assert field.placed == []
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.3)
    there = pytest.approx((2.0, 1.0, 0.3))
    assert field.placed == [("initialpose", "world", there), ("set_pose", "odom", there)]
    assert field.picture.start == (2.0, 1.0, 0.3)
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    assert field.goals == [], "the controller would not hear who drives to it"
    field.world.run(QUIET)
    assert field.goals == poses((5.0, 0.0, 0.0))
    assert field.picture.start == (2.0, 1.0, 0.3), "a goal does not move it"


def test_a_robot_that_is_no_simulation_is_not_put_anywhere(field):
    field.simulated = False
    field.world.run(1.1)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.3)
    assert field.placed == [] and field.picture.start is None
    assert field.picture.note == "the start stays: only a simulated robot can be put elsewhere"


@pytest.mark.parametrize("source", ["path", "mpc", "cmd_vel"])
def test_the_start_stays_while_something_drives(field, source):
    field.drives(source)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.5)
    assert field.placed == [] and field.picture.start is None
    assert field.picture.note == f"the start stays: {source} drives"


def test_the_start_stays_while_the_robot_still_moves(field):
    field.speed = 0.1
    field.world.run(0.2)
    post(field.world, StartDragged((2.0, 1.0, 0.3), True), seconds=0.5)
    assert field.placed == [] and field.picture.note == "the start stays: the robot moves"


def fitting(name):
    """A case for the robot of these tests."""
    body = robots.robot("omniman").body
    return CASES[name].fitting(body.length, body.width)


# ---- cases and restart ------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_a_case_puts_everything_and_holds_it_until_go(field, name):
    case, picture = fitting(name), field.picture
    post(field.world, CaseChosen(name), seconds=0.5)
    assert (picture.start, picture.goal, picture.case) == (case.start, case.goal, name)
    assert [pose for _, _, pose in field.placed] == poses(case.start, case.start)
    field.world.run(2.0)
    assert picture.holding and field.goals == []
    places = [way.place for way in case.ways]
    assert picture.crowd.centers.tolist() == [pytest.approx(place) for place in places]
    press(field.world, "go", 1.0)
    assert field.goals == poses(case.goal)
    assert not picture.holding and picture.start == case.start
    ways = [way(0.95) for way in case.ways]
    assert picture.crowd.centers == pytest.approx(np.array(ways).reshape(-1, 2), abs=0.05)


def test_a_case_without_a_simulation_leaves_the_robot_where_it_is(field):
    field.simulated = False
    field.world.run(1.1)
    post(field.world, CaseChosen("moving"), seconds=0.5)
    assert field.placed == [] and len(field.picture.crowd.numbers) == 4
    assert field.picture.goal == fitting("moving").goal
    assert "the robot stays: only a simulated robot" in field.picture.note


def test_a_case_that_nobody_knows_is_refused(field):
    post(field.world, CaseChosen("labyrinth"))
    assert field.picture.note == "there is no case 'labyrinth': free, corridor, moving"
    assert field.picture.case == "" and field.picture.goal is None


def test_a_goal_that_is_put_elsewhere_while_all_is_held_waits_for_go(field):
    post(field.world, CaseChosen("free"), seconds=0.5)
    post(field.world, GoalDragged((2.0, 2.0, 0.0), True), seconds=1.0)
    assert field.goals == [] and "Go sends it" in field.picture.note
    press(field.world, "go")
    assert field.goals == poses((2.0, 2.0, 0.0))


def test_a_restart_cancels_first_and_waits_until_the_robot_stands(field):
    services = Services(field.world, "mpc_planner", "cancel")
    names = {"mpc_planner/cancel"}
    until(field.world, lambda: field.picture.services == names, "the service")
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.drives("mpc")
    field.pose, field.speed = (2.0, 0.0, 0.0), 0.3
    press(field.world, "restart", 0.5)
    until(field.world, lambda: services.called == ["cancel"], "the call")
    assert field.placed == []
    field.drives("none")
    field.world.run(0.3)
    assert field.placed == [], "it still rolls"
    field.speed = 0.0
    field.world.run(0.5)
    start = (0.5, 0.2, 0.1)
    assert [pose for _, _, pose in field.placed] == poses(start, start)
    field.world.run(QUIET)
    assert len(field.picture.odom_trail.points) <= 1
    assert field.picture.holding


def test_a_robot_that_stands_is_not_put_elsewhere_before_the_planner_has_let_go(field):
    world = field.world
    services = Services(world, "mpc_planner", "cancel")
    until(world, lambda: len(field.picture.services) == 1, "the service")
    post(world, GoalDragged((5.0, 0.0, 0.0), True))
    world.executor.remove_node(world.probe)  # it takes its time
    press(world, "restart", 0.5)
    world.executor.add_node(world.probe)
    assert world.nodes[-1]._places._placing.placed_at is None
    until(world, lambda: services.called == ["cancel"] and field.placed, "the placing")


def test_a_robot_that_does_not_come_to_rest_is_not_put_anywhere(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.speed = 0.3
    field.world.run(0.1)
    press(field.world, "restart", 3.5)
    assert field.picture.note == "the robot is not at the start: it does not come to rest"
    field.speed = 0.0
    field.world.run(1.0)
    assert field.placed == []


def test_odometry_that_does_not_follow_is_told_and_nothing_is_sent(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.pose, field.follows = (3.0, 0.0, 0.0), False
    field.world.run(0.1)
    press(field.world, "restart", 0.1)
    press(field.world, "go", 2.5)
    assert field.picture.note == "the robot is not at the start: odometry does not follow"
    assert len(field.goals) == 1


def test_go_during_a_restart_is_done_when_the_robot_is_there(field):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.pose, field.speed = (3.0, 0.0, 0.0), 0.3
    field.world.run(0.1)
    press(field.world, "restart", 0.3)
    press(field.world, "go", 0.5)
    assert len(field.goals) == 1 and field.picture.holding
    field.speed = 0.0
    field.world.run(QUIET + 0.3)
    assert field.goals == poses((5.0, 0.0, 0.0), (5.0, 0.0, 0.0))
    assert not field.picture.holding


@pytest.mark.parametrize("action", ["stop", "cancel", "pause"])
def test_who_stops_meanwhile_is_not_driven_after_all(field, action):
    post(field.world, GoalDragged((5.0, 0.0, 0.0), True))
    field.speed = 0.3
    field.world.run(0.1)
    press(field.world, "restart", 0.2)
    press(field.world, "go", 0.2)
    press(field.world, action, 0.2)
    field.speed = 0.0
    field.world.run(1.0)
    assert len(field.goals) == 1 and field.placed == []


def test_a_restart_without_a_start_says_so(field):
    press(field.world, "restart")
    assert field.placed == [] and "there is no start yet" in field.picture.note


def test_pause_holds_the_obstacles_and_resume_lets_them_go_on(field):
    press(field.world, "add", 0.1)
    post(field.world, ObstacleSent(0, (0.5, 0.0)), seconds=0.5)
    press(field.world, "pause", 0.1)
    held = field.picture.crowd.centers[0].tolist()
    field.world.run(1.0)
    assert field.picture.crowd.centers[0].tolist() == held and field.picture.holding
    press(field.world, "resume", 1.0)
    assert field.picture.crowd.centers[0] == pytest.approx([held[0] + 0.5, held[1]], abs=0.06)
    assert not field.picture.holding


def test_a_restart_brings_obstacles_back_and_holds_them(field):
    press(field.world, "add", 0.1)
    begin = field.picture.crowd.centers[0].tolist()
    post(field.world, ObstacleSent(0, (0.5, 0.0)), seconds=1.0)
    press(field.world, "restart", 1.0)
    assert field.picture.crowd.centers[0].tolist() == begin and field.picture.holding


def test_resume_goes_to_a_goal_that_was_put_elsewhere_meanwhile(field):
    planner = Services(field.world, "mpc_planner", "resume")
    until(field.world, lambda: len(field.picture.services) == 1, "the service")
    field.state = "paused"
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
    """Planner, controller, plant and viewer; one for all tests: the planner takes long to make."""
    nodes = (MpcPlannerNode, PlatformControllerNode, SimulatedDriveNode)
    with view(*nodes, parameters={"horizon.steps": 5}) as world:
        picture = world.nodes[-1].picture
        until(world, lambda: picture.active_source == "none", "the controller")
        until(world, lambda: picture.is_fresh("planner", world.time), "the planner")
        until(world, lambda: len(picture.tunables) > 0, "its parameters")
        yield world


def test_a_dragged_goal_is_taken_by_the_planner_and_another_one_too(robot):
    planner, picture = robot.nodes[0], robot.nodes[-1].picture
    press(robot, "reset", 0.1)
    post(robot, GoalDragged((1.0, 0.0, 0.0), True), seconds=0.5)
    assert planner.core.state is PlannerState.DRIVING
    assert planner.core.goal.pose[:2] == pytest.approx([1.0, 0.0])
    assert picture.planner["state"] == "driving"
    until(robot, lambda: len(picture.plan.points) > 1, "the plan")
    post(robot, GoalDragged((0.5, 0.5, 0.0), False), seconds=0.3)
    assert planner.core.goal.pose[:2] == pytest.approx([0.5, 0.5])


def test_a_case_is_loaded_from_a_drive_and_driven(robot):
    planner, controller, plant, viewer = robot.nodes
    case = fitting("free")
    post(robot, GoalDragged((1.0, 0.0, 0.0), True), seconds=0.5)
    assert planner.core.active
    post(robot, CaseChosen("free"))
    until(robot, lambda: not viewer._places._placing, "the placing")
    truth, _ = plant.drives.ground_truth()
    assert truth[:2] == pytest.approx(case.start[:2], abs=0.01)
    assert truth[2] == pytest.approx(case.start[2], abs=0.01)
    assert viewer.picture.odom == pytest.approx(case.start, abs=0.01)
    assert planner.core.state is PlannerState.IDLE
    press(robot, "go", 1.0)
    assert planner.core.state is PlannerState.DRIVING
    assert planner.core.goal.pose == pytest.approx(case.goal)
    assert viewer.picture.odom[0] > 0.05
    press(robot, "pause", 0.3)
    until(robot, lambda: planner.core.state is PlannerState.PAUSED, "the pause")
    press(robot, "cancel", 0.3)
    until(robot, lambda: planner.core.state is PlannerState.IDLE, "the end")
