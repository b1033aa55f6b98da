"""The legs of the demo, driven on stepped time."""

import numpy as np
import pytest
from geometry_msgs.msg import Twist

from omniman_ros.console.errors import CommandError
from omniman_ros.demo.demo import Demo, judge
from omniman_ros.demo.report import report_lines
from test.demo.stepped_robot import NOTICE_TIME, SteppedRobot, stepped_driver


def drive(monkeypatch, robot, leg, has_arm=True):
    """Drive one leg of the demo with a robot that is ready."""
    driver = stepped_driver(monkeypatch, robot, has_arm=has_arm)
    driver.wait(lambda: bool(driver.recorder.recording.odom), 1.0)
    getattr(Demo("omniman"), leg).drive(driver)


@pytest.fixture(scope="module")
def driven():
    """A demo that has been driven, its recording and its result."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        driver = stepped_driver(monkeypatch, SteppedRobot())
        demo = Demo("omniman")
        driver.wait_until_ready()
        demo.drive(driver)
    recording = driver.recorder.recording
    return demo, recording, judge(recording, demo.legs, driver.arm_moves)


def test_all_legs_are_driven_and_measured(driven):
    demo, _, result = driven
    assert [twist["name"] for twist in result["twists"]] == ["diagonal", "spin", "circle + spin"]
    assert max(twist["linear_m_s"] for twist in result["twists"]) < 0.03
    assert len(demo.path.movements) == 5
    assert result["tracking"]["rms_mm"] < 5.0
    assert result["arm"]["moves"] == 6 and result["arm"]["final_mrad"] == pytest.approx(0.0)
    assert result["goal"]["position_mm"] < 40.0
    assert result["dead_wheel"]["wheel"] == "rear_right"
    assert NOTICE_TIME < result["dead_wheel"]["noticed_s"] < NOTICE_TIME + 0.1
    stop = result["emergency_stop"]
    assert stop["speed_m_s"] == pytest.approx(0.3)
    assert stop["rest_s"] < 0.1 and stop["moved_mm"] == 0.0
    assert result["tool"]["samples"] > 50


def test_the_report_has_a_row_for_every_leg(driven):
    _, _, result = driven
    text = "\n".join(report_lines(result))
    for row in (
        "tracking error in odom, RMS",
        "twist error, worst",
        "odometry error",
        "arm after 6 moves: error of the worst joint",
        "tool on a path of",
        "goal among obstacles",
        "wheel 'rear_right' without torque: detected after",
        "emergency stop at 0.30 m/s",
        "wheel_commands: rate, p50 / p99",
    ):
        assert row in text


def test_the_demo_is_drawn(driven, tmp_path):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    from omniman_ros.demo.figure import draw_demo

    demo, recording, _ = driven
    path = draw_demo(demo, recording, tmp_path / "new" / "demo.png")
    assert path == tmp_path / "new" / "demo.png"
    assert pyplot.imread(path).std() > 0.02, "the figure is not empty"
    assert pyplot.get_fignums() == []


def test_without_an_arm_only_the_platform_is_commanded(monkeypatch):
    robot = SteppedRobot()
    driver = stepped_driver(monkeypatch, robot, has_arm=False)
    demo = Demo("omniman", has_arm=False)
    driver.wait_until_ready()
    demo.drive(driver)
    assert "joint_trajectory" not in robot.received and "tool_path" not in robot.received
    assert driver.arm_moves == []


@pytest.mark.parametrize(
    ("leg", "defect", "message"),
    [
        ("path", "progress", "path: forwards did not reach its end, only 0%"),
        ("tool", "move_arm", "the arm did not reach the start"),
        ("goal", "plan", "the goal was not reached, .* mpc_planner reports: no way"),
        ("dead_wheel", "notice", "the controller did not notice that 'rear_right'"),
        ("dead_wheel", "repair", "wheel 'rear_right' is still reported as dead after the reset"),
        ("stop", "stop", "the emergency stop did not stop the robot"),
        ("stop", "reset", "the reset failed: not at rest"),
    ],
)
def test_a_robot_that_does_not_do_what_a_leg_asks_ends_the_demo(monkeypatch, leg, defect, message):
    with pytest.raises(CommandError, match=message):
        drive(monkeypatch, SteppedRobot(defect), leg)


def test_the_demo_does_not_begin_before_all_topics_are_there(monkeypatch):
    driver = stepped_driver(monkeypatch, SteppedRobot("publish"))
    with pytest.raises(CommandError, match="not ready within 15 s: odom, ground_truth/odom"):
        driver.wait_until_ready()


def test_a_stopped_robot_ends_the_demo_with_the_reason(monkeypatch):
    robot = SteppedRobot()
    robot.stopped = True
    with pytest.raises(
        CommandError, match="the robot stopped: /platform_controller is stopped: x"
    ):
        drive(monkeypatch, robot, "twists")


def test_a_platform_that_is_still_driven_does_not_get_a_path(monkeypatch):
    robot = SteppedRobot("progress")
    driver = stepped_driver(monkeypatch, robot)
    driver.robot.send_path(np.zeros((2, 3)))
    driver.wait(lambda: driver.recorder.active_source == "path", 1.0)
    with pytest.raises(CommandError, match="'path' still drives the platform, expected none"):
        Demo("omniman").path.drive(driver)


def test_a_halted_driver_sends_a_twist_of_zero(monkeypatch):
    robot = SteppedRobot()
    stepped_driver(monkeypatch, robot).halt()
    assert robot.received["cmd_vel"] == [Twist()]
