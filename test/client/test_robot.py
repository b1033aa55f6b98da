"""A client on nodes in this process, which it steps itself while it waits."""

import math

import pytest
from geometry_msgs.msg import Twist, TwistStamped

from omniman_ros.client import link
from omniman_ros.client.robot import Robot
from omniman_ros.client.state import NodesRefusedError, RobotError, RobotTimeoutError
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.nodes.path_interpolator import PathInterpolatorNode
from test.nodes.harness import PERIOD
from test.nodes.test_mpc_planner import PlannerWithRealController

DISCOVERY = 20.0  #: Longest time that a test gives the middleware [s]


def client_of(world, namespace=""):
    """Return a client on the probe of a world, which steps the world while it waits."""
    return Robot(namespace, world.probe, serve=lambda seconds: world.run(max(seconds, PERIOD)))


def twists_sent(world, kind):
    """Return the list of what is sent on `cmd_vel` from now on."""
    sent = []
    world.probe.create_subscription(kind, "cmd_vel", sent.append, 100)
    world._await(lambda: world.probe.count_subscribers("cmd_vel") == 2, "the subscription")
    return sent


def platform(**parameters):
    """Return a platform with its planner and its interpolator."""
    return PlannerWithRealController(PathInterpolatorNode, parameters=parameters)


@pytest.fixture(scope="module")
def world():
    with platform() as world:
        yield world


@pytest.fixture
def robot(world, monkeypatch):
    monkeypatch.setattr(link, "ANNOUNCEMENT_TIME", 0.2)  # all nodes have been there for long
    with client_of(world) as robot:
        robot.wait_until_ready(DISCOVERY)
        yield robot


# ---- state ------------------------------------------------------------------------------------


def test_the_state_is_known_with_its_age_once_the_robot_is_ready(world, robot):
    assert robot.pose.value == pytest.approx(world.true_pose(), abs=0.02)
    world.drive.drives.ground_truth()
    assert 0.0 <= robot.pose.age < 0.02 + 1e-9
    assert robot.twist.value == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert robot.active_source.value == "none"
    assert robot.stop_reason.value == ""
    assert not robot.joints.is_known and not robot.tool.is_known


def test_what_is_missing_is_named(world):
    with client_of(world) as robot, pytest.raises(RobotTimeoutError) as raised:
        robot.wait_until_ready(0.5, needs=("drive", "tool"))
    assert "no path_interpolator or whole_body_planner with tool_pose" in str(raised.value)
    assert "ROS_DOMAIN_ID" in str(raised.value)


def test_a_robot_that_is_not_there_is_named(world):
    with client_of(world, "elsewhere") as robot, pytest.raises(RobotTimeoutError) as raised:
        robot.wait_until_ready(0.2)
    text = str(raised.value)
    assert "no platform_controller" in text and "no mpc_planner" in text
    assert "no path_interpolator" in text


def test_an_unknown_ability_is_refused(world, robot):
    with pytest.raises(ParameterError, match="fly"):
        robot.wait_until_ready(needs=("fly",))


# ---- twists -----------------------------------------------------------------------------------


def test_a_twist_is_streamed_until_it_is_halted(world, robot):
    robot.drive(0.3, 0.0, 0.2)
    world.run(1.5)
    assert robot.twist.value == pytest.approx((0.3, 0.0, 0.2), abs=0.01)
    assert robot.active_source.value == "cmd_vel"
    robot.drive(0.0, 0.0, 0.0)
    world.run(1.5)
    assert robot.twist.value == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert robot.active_source.value == "none"


@pytest.mark.parametrize("stamped", [False, True])
def test_twists_are_of_the_type_that_the_controller_subscribes_to(stamped):
    with platform(cmd_vel_stamped=stamped) as world, client_of(world) as robot:
        robot.wait_until_ready(DISCOVERY)
        kind = TwistStamped if stamped else Twist
        sent = twists_sent(world, kind)
        robot.drive(0.2, 0.0, 0.0)
        world.run(1.0)
        assert robot.twist.value.vx == pytest.approx(0.2, abs=0.01)
        first = sent[0].twist if stamped else sent[0]
        assert first.linear.x == 0.0, "a zero marks the begin"
        assert len(sent) == pytest.approx(1.0 / 0.05, abs=1)


def test_an_exception_stops_the_robot_before_it_is_seen(world):
    with pytest.raises(ZeroDivisionError), client_of(world) as robot:
        robot.wait_until_ready(DISCOVERY)
        robot.drive(0.3, 0.0, 0.0)
        world.run(1.0)
        raise ZeroDivisionError
    assert world.true_speed() < 0.01


def test_a_client_that_moves_nothing_sends_nothing_at_its_end(world):
    sent = twists_sent(world, Twist)
    with client_of(world) as robot:
        robot.wait_until_ready(DISCOVERY)
    world.run(0.5)
    assert sent == []


# ---- numbers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9, "fast", None])
def test_nonsense_is_refused_before_anything_is_sent(robot, bad):
    calls = (
        lambda: robot.drive(bad, 0.0, 0.0),
        lambda: robot.go_to(0.0, bad or math.nan, 0.0),
        lambda: robot.follow([(0.0, 0.0, bad)]),
        lambda: robot.move_tool(0.0, 0.0, bad),
        lambda: robot.add_obstacle("post", 0.0, bad, 0.1),
    )
    for call in calls:
        with pytest.raises((ParameterError, InputError)):
            call()


@pytest.mark.parametrize("poses", [[], [(0.0, 0.0)], (0.0, 0.0, 0.0), [(0.0, 0.0, 0.0, 0.0)]])
def test_a_path_of_another_shape_is_refused(robot, poses):
    with pytest.raises(InputError, match="shape"):
        robot.follow(poses)


def test_a_goal_in_another_frame_needs_a_heading(robot):
    with pytest.raises(ParameterError, match="map"):
        robot.go_to(1.0, 0.0, frame="map")


# ---- stops ------------------------------------------------------------------------------------


def test_a_stop_latches_until_the_reset(world, robot):
    answers = robot.stop()
    names = {"/platform_controller", "/simulated_drive"}
    assert {answer.node for answer in answers} == names
    world.run(0.2)
    assert robot.active_source.value == "stop"
    assert "platform_controller stopped: ~/stop" in robot.stop_reason.value
    robot.drive(0.3, 0.0, 0.0)
    world.run(0.5)
    assert world.true_speed() < 1e-6
    robot.halt()
    world.run(0.5)
    robot.reset()
    world.run(0.2)
    assert robot.stop_reason.value == "" and robot.active_source.value == "none"


def test_a_refused_reset_is_an_error_with_the_answers_of_all_nodes(world, robot):
    heard = []
    robot.stop(report=heard.append)
    assert {answer.node for answer in heard} == {"/platform_controller", "/simulated_drive"}
    latch = world.controller.core.latch
    latch.set_emergency(True)
    with pytest.raises(NodesRefusedError, match="/platform_controller: emergency") as raised:
        robot.reset()
    assert [a.success for a in raised.value.answers] == [False, True]
    latch.set_emergency(False)
    robot.reset()


# ---- obstacles --------------------------------------------------------------------------------


def test_an_obstacle_is_seen_where_it_moves_to_until_it_is_removed(world, robot):
    obstacles = world.node.sensors.obstacles
    robot.add_obstacle("cart", 3.0, 1.0, 0.25, velocity=(0.1, 0.0))
    world.run_until(lambda: len(obstacles) == 1, DISCOVERY, "the obstacle")
    world.run(1.0)
    seen = obstacles.ellipses()
    assert seen.semi_axes.tolist() == [[0.25, 0.25]]
    assert seen.velocities[0].tolist() == pytest.approx([0.1, 0.0], abs=0.02)
    robot.remove_obstacle("cart")
    world.run_until(lambda: len(obstacles) == 0, 1.0, "the removal")
    with pytest.raises(RobotError, match="cart"):
        robot.remove_obstacle("cart")
