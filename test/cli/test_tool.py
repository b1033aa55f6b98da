"""`omniman tool` without a robot, and on one robot that the tests share."""

import signal
from contextlib import contextmanager

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped

from omniman_ros.cli import motion
from omniman_ros.cli.main import main
from omniman_ros.nodes.motion_log import MotionEvent
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from test.cli.stepped_robot import SteppedRobot
from test.nodes.test_path_interpolator_tool import ToolWorld
from test.nodes.test_whole_body_planner import DodgeWorld


@contextmanager
def running(make):
    """Yield a robot of the nodes of a world."""
    with make() as world:
        states = world.publisher(DiagnosticStatus, "stop_state", ALL_LATCHED)
        states.publish(DiagnosticStatus(name="/platform_controller"))
        world.listen(PoseStamped, "tool_pose")
        yield SteppedRobot(world)


@pytest.fixture(scope="module")
def robot():
    with running(ToolWorld) as robot:
        yield robot


def tool_position(robot):
    """Return the last position of the tool (x, y, z) [m] in odom."""
    position = robot.world.received["tool_pose"][-1].pose.position
    return [position.x, position.y, position.z]


@pytest.mark.processes
@pytest.mark.parametrize(
    ("option", "node"), [((), "no path_interpolator"), (("--around",), "no whole_body_planner")]
)
def test_without_its_node_it_fails_and_names_it(option, node, own_domain, monkeypatch, capfd):
    monkeypatch.setattr(motion, "READY_TIMEOUT", 0.2)
    assert main(["tool", "1", "0", "0.5", *option]) == 1
    assert node in capfd.readouterr().err


@pytest.mark.parametrize("arguments", [["tool"], ["tool", "1", "2"], ["tool", "a", "b", "c"]])
def test_a_position_needs_three_numbers(arguments, capfd):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2


@pytest.mark.processes
def test_tool_succeeds_when_the_tool_has_arrived(robot):
    robot.wait(lambda: robot.world.received["tool_pose"])
    x, y, z = tool_position(robot)
    with robot.start("tool", "1.2", "0.2", "0.05", "--relative") as moved:
        assert robot.finish(moved) == 0, moved.output
    assert "arrived after" in moved.output
    assert tool_position(robot) == pytest.approx([x + 1.2, y + 0.2, z + 0.05], abs=2e-3)


@pytest.mark.processes
def test_tool_fails_when_a_position_out_of_reach_is_refused(robot):
    with robot.start("tool", "0", "0", "3", "--relative") as refused:
        assert robot.finish(refused) == 1
    assert "reach" in refused.output


@pytest.mark.processes
def test_ctrl_c_cancels_the_path_of_the_tool(robot):
    motions = robot.world.node.motions
    with robot.start("tool", "5", "0", "0", "--relative") as far:
        assert robot.wait(lambda: not motions.whole_body.idle), far.output
        far.process.send_signal(signal.SIGINT)
        assert robot.finish(far) == 130
    assert robot.wait(lambda: motions.whole_body.idle)
    values = {item.key: item.value for item in robot.world.status().values}
    assert values["body_event"] == MotionEvent.CANCELLED.value


@pytest.mark.processes
def test_around_obstacles_and_with_the_joints_goals_are_those_of_the_whole_body_planner():
    with running(DodgeWorld) as robot:
        robot.wait(lambda: robot.world.received["tool_pose"])
        x, y, z = tool_position(robot)
        with robot.start("tool", "0.2", "0.1", "0.05", "--relative", "--around") as moved:
            assert robot.finish(moved) == 0, moved.output
        assert robot.world.node.motions.tool.log.text == "arrived"
        assert tool_position(robot) == pytest.approx([x + 0.2, y + 0.1, z + 0.05], abs=2e-3)
        angles = ("0", "-100", "120", "-100", "-90", "10")
        with robot.start("goal", "0.2", "0.1", "15", "--joints", *angles) as moved:
            assert robot.finish(moved) == 0, moved.output
        assert np.degrees(robot.world.joints) == pytest.approx([*map(float, angles)], abs=0.2)
