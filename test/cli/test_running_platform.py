"""`omniman goal`, `teleop`, `stop`, `reset` and `status` on one platform that the tests share.

Each test leaves the robot at rest, neither stopped nor with a goal.
"""

import math
import re
import signal

import pytest
from nav_msgs.msg import Odometry

from omniman_ros.planning.cycle import PlannerState
from test.cli.stepped_robot import SteppedRobot
from test.cli.teleop_terminal import hold, terminal
from test.nodes.test_mpc_planner import PlannerWithRealController

pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def robot():
    with PlannerWithRealController() as world:
        yield SteppedRobot(world)


def test_goal_succeeds_when_the_robot_has_reached_it(robot):
    x, y, _ = robot.world.true_pose()
    with robot.start("goal", "0.4", "0", "10", "--relative") as goal:
        assert robot.finish(goal) == 0, goal.output
    assert "arrived" in goal.output
    assert robot.world.core.state is PlannerState.ARRIVED
    assert robot.world.true_pose() == pytest.approx([x + 0.4, y, math.radians(10.0)], abs=0.04)


def test_goal_fails_when_the_planner_refuses_it(robot):
    with robot.start("goal", "1e9", "0") as goal:
        assert robot.finish(goal) == 1
    assert "refused" in goal.output


def test_ctrl_c_cancels_the_goal_and_the_next_one_is_reached(robot):
    with robot.start("goal", "30", "0") as far:
        assert robot.wait(lambda: robot.world.core.state is PlannerState.DRIVING), far.output
        far.process.send_signal(signal.SIGINT)
        assert robot.finish(far) == 130
    assert "The motion is cancelled: the robot brakes and stands." in far.output
    assert robot.world.core.state is not PlannerState.DRIVING
    with robot.start("goal", "0.8", "0.1") as near:
        assert robot.finish(near) == 0, near.output


def test_teleop_drives_stops_and_resets_the_robot(robot):
    truth = []
    session = robot
    with terminal(robot.world.domain) as teleop:
        session.node.create_subscription(Odometry, "ground_truth/odom", truth.append, 10)

        def is_at_rest():
            speed = truth[-1].twist.twist
            return abs(speed.linear.x) < 1e-3 and abs(speed.angular.z) < 1e-3

        teleop.wait(session, lambda: truth and "free" in teleop.line, "robot")
        teleop.wait(
            session,
            lambda: "none" in teleop.line and re.search(r"x [+-]\d", teleop.line),
            "source and pose in the status line",
        )
        start = truth[-1].pose.pose.position

        hold(teleop, session, "w", lambda: truth[-1].twist.twist.linear.x > 0.29)
        teleop.wait(session, is_at_rest, "rest after the release")
        end = truth[-1].pose.pose.position
        assert math.hypot(end.x - start.x, end.y - start.y) > 0.1

        hold(teleop, session, "\x1b[D", lambda: truth[-1].twist.twist.angular.z > 0.55)
        teleop.type(" ")
        teleop.wait(session, lambda: "stopped: ~/stop" in teleop.line, "latched stop")
        teleop.wait(session, is_at_rest, "rest after the stop")
        count = len(truth)
        hold(teleop, session, "w", lambda: len(truth) > count + 60)
        assert is_at_rest(), "the robot moves before the reset"

        teleop.wait(session, lambda: "+0.00 +0.00 m/s" in teleop.line, "release")
        session.spin(0.3)
        teleop.type("r")
        teleop.wait(session, lambda: "free" in teleop.line, "reset")
        hold(teleop, session, "s", lambda: truth[-1].twist.twist.linear.x < -0.29)

        teleop.type("++-")
        teleop.wait(session, lambda: "keys 0.33 m/s" in teleop.line, "higher speed")
        teleop.type("x")
        assert teleop.finish() == 0
    assert re.search(r"heading +[+-]?\d+ deg", teleop.screen)


def test_stop_and_reset_print_a_line_about_each_node(robot):
    with robot.start("stop") as stop:
        assert robot.finish(stop) == 0, stop.output
    lines = [f"/{name}: stop done (~/stop)" for name in ("platform_controller", "simulated_drive")]
    assert sorted(stop.output.splitlines()) == lines
    assert not robot.world.controller.core.latch.released
    with robot.start("reset") as reset:
        assert robot.finish(reset) == 0, reset.output
    assert robot.wait(lambda: robot.world.controller.core.latch.released)


def test_status_tells_of_a_stop_and_what_releases_it(robot):
    with robot.start("status") as status:
        assert robot.finish(status) == 0, status.output
    assert re.search(r"/simulated_drive +running", status.output)
    assert "driven by   none" in status.output
    with robot.start("stop") as stop:
        assert robot.finish(stop) == 0, stop.output
    with robot.start("status") as status:
        assert robot.finish(status) == 1, status.output
    assert re.search(r"/simulated_drive +STOPPED: ~/stop", status.output)
    assert "driven by   stop" in status.output
    assert "`omniman reset`" in status.output.splitlines()[-1]
    with robot.start("reset") as reset:
        assert robot.finish(reset) == 0, reset.output
    assert robot.wait(lambda: robot.world.controller.core.latch.released)


def test_a_watched_status_changes_with_the_robot_until_ctrl_c(robot):
    with robot.start("status", "--watch") as status:

        def tells(text):
            status.skip_output()
            return text in status.output

        assert robot.wait(lambda: tells("driven by   none")), status.output
        with robot.start("stop") as stop:
            assert robot.finish(stop) == 0, stop.output
        assert robot.wait(lambda: tells("STOPPED: ~/stop")), status.output
        status.process.send_signal(signal.SIGINT)
        assert robot.finish(status) == 0, status.output
    with robot.start("reset") as reset:
        assert robot.finish(reset) == 0, reset.output
    assert robot.wait(lambda: robot.world.controller.core.latch.released)
