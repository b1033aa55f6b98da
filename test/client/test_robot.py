"""A client on nodes in this process, which it steps itself while it waits."""

import math
from contextlib import contextmanager

import pytest
from geometry_msgs.msg import Twist, TwistStamped

from omniman_ros.client import link
from omniman_ros.client.handle import MotionError, Outcome
from omniman_ros.client.robot import Robot
from omniman_ros.client.state import NodesRefusedError, RobotError, RobotTimeoutError
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.nodes.path_interpolator.node import PathInterpolatorNode
from test.nodes.harness import PERIOD
from test.nodes.test_mpc_planner import PlannerWithRealController

DISCOVERY = 20.0  #: Longest time that a test gives the middleware [s]


def serve(world):
    """Return a function that steps a world for a time [s], at least by its period."""
    return lambda seconds: world.run(max(seconds, PERIOD))


@contextmanager
def client_of(world, needs=("drive", "goal", "path")):
    """Yield a client on the probe of a world, which steps the world while it waits.

    All endpoints have discovered each other: messages take no time.
    """
    with Robot(node=world.probe, serve=serve(world)) as robot:
        robot.wait_until_ready(DISCOVERY, needs)
        world.match_endpoints(world.probe)
        yield robot


def twists_sent(world, kind):
    """Return the list of what is sent on `cmd_vel` from now on."""
    sent = []
    known = world.probe.count_subscribers("cmd_vel")
    world.probe.create_subscription(kind, "cmd_vel", sent.append, 100)
    world._await(lambda: world.probe.count_subscribers("cmd_vel") > known, "the subscription")
    return sent


def platform(**parameters):
    """Return a platform with its planner and its interpolator."""
    return PlannerWithRealController(PathInterpolatorNode, parameters=parameters)


@pytest.fixture(scope="module")
def world():
    with platform() as world:
        yield world


@pytest.fixture(scope="module")
def robot(world):
    with pytest.MonkeyPatch.context() as patch, client_of(world) as robot:
        patch.setattr(link, "ANNOUNCEMENT_TIME", 0.2)  # all nodes have been there for long
        yield robot


# ---- state ------------------------------------------------------------------------------------


def test_the_state_is_known_with_its_age_once_the_robot_is_ready(world, robot):
    assert robot.pose.value == pytest.approx(world.true_pose(), abs=0.02)
    world.drive.drives.ground_truth()
    assert 0.0 <= robot.pose.age < 5.0  # by the steady clock, which a busy machine lets run
    assert robot.twist.value == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert robot.active_source.value == "none"
    assert robot.stop_reason.value == ""
    assert not robot.joints.is_known and not robot.tool.is_known


def test_what_is_missing_is_named(robot):
    with pytest.raises(RobotTimeoutError) as raised:
        robot.wait_until_ready(0.5, needs=("drive", "tool"))
    assert "no path_interpolator or whole_body_planner with tool_pose" in str(raised.value)
    assert "ROS_DOMAIN_ID" not in str(raised.value), "the robot is there"


def test_a_robot_is_not_ready_before_it_has_said_what_is_stopped(robot, monkeypatch):
    heard = {k: v for k, v in robot._link._telemetry._heard.items() if k != "stop_state"}
    monkeypatch.setattr(robot._link._telemetry, "_heard", heard)
    with pytest.raises(RobotTimeoutError, match="no platform_controller with odom"):
        robot.wait_until_ready(0.2)


def test_a_robot_that_is_not_there_is_named(world):
    with (
        Robot("elsewhere", world.probe, serve=serve(world)) as robot,
        pytest.raises(RobotTimeoutError) as raised,
    ):
        robot.wait_until_ready(0.2)
    text = str(raised.value)
    assert "no platform_controller" in text and "no mpc_planner" in text
    assert "no path_interpolator" in text and "ROS_DOMAIN_ID" in text


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
        kind = TwistStamped if stamped else Twist
        sent = twists_sent(world, kind)
        robot.drive(0.2, 0.0, 0.0)
        world.run(1.0)
        assert robot.twist.value.vx == pytest.approx(0.2, abs=0.01)
        first = sent[0].twist if stamped else sent[0]
        assert first.linear.x == 0.0, "a zero marks the begin"
        assert len(sent) == pytest.approx(1.0 / 0.05, abs=1)


def test_a_new_twist_of_a_stream_does_not_wait_for_its_period(world, robot):
    sent = twists_sent(world, Twist)
    robot.drive(0.1, 0.0, 0.0)
    world.run(0.2)
    robot.drive(0.11, 0.0, 0.0)
    world._await(lambda: sent[-1].linear.x == 0.11, "the new twist, while time stands")
    robot.halt()
    world.run(1.5)


def test_an_exception_stops_the_robot_before_it_is_seen(world):
    with pytest.raises(ZeroDivisionError), client_of(world) as robot:
        robot.drive(0.3, 0.0, 0.0)
        world.run(1.0)
        raise ZeroDivisionError
    assert world.true_speed() < 0.01


def test_a_client_that_moves_nothing_sends_nothing_at_its_end(world):
    sent = twists_sent(world, Twist)
    with client_of(world):
        world.run(0.5)
    world.run(0.5)
    assert sent == []


def test_a_client_that_is_closed_says_so(world):
    with client_of(world) as robot:
        pass
    for call in (lambda: robot.go_to(0.0, 0.0, 0.0), lambda: robot.drive(0.1, 0.0, 0.0)):
        with pytest.raises(RobotError, match="closed"):
            call()


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


# ---- motions ----------------------------------------------------------------------------------


def relative(robot, x, y=0.0, turn=0.0):
    """Return a pose relative to the robot's, in odom."""
    here = robot.pose.value
    c, s = math.cos(here.heading), math.sin(here.heading)
    return here.x + c * x - s * y, here.y + s * x + c * y, here.heading + turn


def begin_far_goal(world, robot):
    """Send the robot to a far goal, and return the handle of the motion under way."""
    handle = robot.go_to(*relative(robot, 4.0))
    states = ("started", "paused")
    world.run_until(lambda: handle.feedback.state in states or handle.outcome, 5.0, "the begin")
    world.run(1.0)
    assert world.true_speed() > 0.1, handle
    return handle


def test_a_goal_arrives_and_its_feedback_leads_there(world, robot):
    goal = relative(robot, 0.4, 0.2, 0.3)
    handle = robot.go_to(*goal)
    assert handle.outcome is None
    seen = []
    world.run_until(lambda: seen.append(handle.feedback) or handle.outcome, 20.0, "the end")
    handle.wait()
    assert handle.outcome is Outcome.ARRIVED
    assert robot.pose.value == pytest.approx(goal, abs=0.05)
    states = [feedback.state for feedback in seen]
    assert states == sorted(states, key=["sent", "received", "started", "arrived"].index)
    progress = [f.progress for f in seen if f.progress is not None]
    assert progress[0] < 0.2 and progress[-1] > 0.9
    assert seen[-2].remaining < 0.1


def test_a_goal_without_a_heading_keeps_it(world, robot):
    heading = robot.pose.value.heading
    robot.go_to(*relative(robot, -0.3)[:2]).wait(timeout=20.0)
    assert robot.pose.value.heading == pytest.approx(heading, abs=0.05)


def test_a_goal_that_cannot_be_reached_is_refused_with_the_nodes_reason(robot):
    result = robot.go_to(9e5, 0.0, 0.0).result(timeout=5.0)
    assert result.outcome is Outcome.REFUSED and result.reason


def test_a_newer_goal_replaces_the_one_under_way(world, robot):
    first = begin_far_goal(world, robot)
    second = robot.go_to(*relative(robot, 0.5))
    assert first.result(timeout=5.0).outcome is Outcome.REPLACED
    assert second.result(timeout=20.0).outcome is Outcome.ARRIVED


def test_a_cancelled_goal_ends_at_rest(world, robot):
    handle = begin_far_goal(world, robot)
    assert handle.cancel().outcome is Outcome.CANCELLED
    assert world.true_speed() < 0.02


def test_a_stop_gives_the_motion_up_and_says_why(world, robot):
    handle = begin_far_goal(world, robot)
    robot.stop()
    with pytest.raises(MotionError, match="stop") as raised:
        handle.wait(timeout=5.0)
    assert raised.value.outcome is Outcome.GIVEN_UP
    world.run(2.0)  # from 0.8 m/s the ramp takes 0.8 s; the encoders tell of rest 0.3 s later
    robot.reset()
    world.run(1.0)


def test_an_exception_cancels_the_motion_and_the_robot_stands(world):
    with pytest.raises(KeyboardInterrupt), client_of(world) as robot:
        handle = begin_far_goal(world, robot)
        raise KeyboardInterrupt
    assert handle.outcome is Outcome.CANCELLED
    assert world.true_speed() < 0.02


def test_a_client_takes_the_platform_over_where_nobody_confirms_the_end(world, monkeypatch):
    with client_of(world) as robot:
        handle = begin_far_goal(world, robot)
        monkeypatch.setattr(link.RobotLink, "request_cancel", lambda self, handle: None)
    assert handle.outcome is Outcome.GIVEN_UP, handle.reason
    assert world.true_speed() < 0.02
    world.run(1.0)


def test_a_path_arrives_at_its_last_pose(world, robot):
    path = [relative(robot, 0.3), relative(robot, 0.3, 0.3, 0.5)]
    handle = robot.follow(path)
    world.run_until(lambda: (handle.feedback.progress or 0.0) > 0.5, 10.0, "progress")
    assert handle.feedback.remaining is None
    handle.wait(timeout=20.0)
    assert robot.pose.value == pytest.approx(path[-1], abs=0.02)


def test_two_clients_know_their_own_motions(world, robot):
    with client_of(world) as other:
        first = begin_far_goal(world, robot)
        second = other.go_to(*relative(other, 0.3))
        assert first.result(timeout=5.0).outcome is Outcome.REPLACED
        assert second.result(timeout=20.0).outcome is Outcome.ARRIVED


def test_a_motion_is_lost_when_its_node_ends():
    with platform() as world, client_of(world) as robot:
        handle = begin_far_goal(world, robot)
        world.executor.remove_node(world.node)
        world.nodes.remove(world.node)
        world.node.destroy_node()
        result = handle.result(timeout=20.0)
        assert (result.outcome, result.reason) == (Outcome.LOST, "/mpc_planner has ended")


# ---- obstacles --------------------------------------------------------------------------------


def test_an_obstacle_is_seen_where_it_moves_to_until_it_is_removed(world):
    obstacles = world.node.inputs.surroundings.obstacles
    with client_of(world) as robot:
        robot.add_obstacle("cart", 3.0, 1.0, 0.25, velocity=(0.1, 0.0))
        robot.add_obstacle("post", 4.0, 1.0, 0.25)
        world.run_until(lambda: len(obstacles) == 2, DISCOVERY, "the obstacles")
        world.run(1.0)
        seen = obstacles.ellipses()
        assert seen.semi_axes.tolist() == [[0.25, 0.25]] * 2
        assert seen.velocities[0].tolist() == pytest.approx([0.1, 0.0], abs=0.02)
        robot.remove_obstacle("cart")
        world.run_until(lambda: len(obstacles) == 1, 1.0, "the removal")
        with pytest.raises(RobotError, match="cart"):
            robot.remove_obstacle("cart")
    world.run_until(lambda: len(obstacles) == 0, 0.5, "the removal of the rest at the end")
