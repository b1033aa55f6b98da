"""The legs of the demo, driven on stepped time."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.client.handle import MotionError
from omniman_ros.console.errors import CommandError
from omniman_ros.control.limits import TwistLimits
from omniman_ros.conversions.maps import map_message
from omniman_ros.core.parameters import build
from omniman_ros.demo import legs
from omniman_ros.demo.demo import drive, judge, load_demo
from omniman_ros.demo.legs import DemoSpeeds, twist_phases
from omniman_ros.demo.moving_obstacles import DEMO_OBSTACLES, DemoObstacles
from omniman_ros.demo.perception import record_perception
from omniman_ros.demo.report import ROWS, report_lines
from test import robots
from test.demo.stepped_robot import NOTICE_TIME, SteppedRobot, stepped_driver

LEGS = {
    "twists": lambda driver: legs.drive_twists(driver, DemoSpeeds()),
    "path": legs.drive_path,
    "tool": legs.drive_tool,
    "goal": lambda driver: legs.drive_to_goal(driver, by_scanner=False),
    "dead_wheel": lambda driver: legs.drive_with_dead_wheel(driver, "rear_right"),
    "stop": lambda driver: legs.drive_and_stop(driver, 0.3),
}


def drive_leg(monkeypatch, robot, leg):
    """Drive one leg of the demo with a robot that is ready."""
    driver = stepped_driver(monkeypatch, robot)
    driver.wait(lambda: bool(driver.recorder.recording.odom), 1.0)
    LEGS[leg](driver)


@pytest.fixture(scope="module")
def driven():
    """A demo that has been driven, its recording and its result."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        driver = stepped_driver(monkeypatch, SteppedRobot())
        demo = load_demo("omniman")
        driver.wait_until_ready()
        drive(demo, driver)
    recording = driver.recorder.recording
    return demo, recording, judge(demo, recording)


def test_all_legs_are_driven_and_measured(driven):
    demo, _, result = driven
    assert [twist["name"] for twist in result["twists"]] == ["diagonal", "spin", "circle + spin"]
    assert max(twist["linear_m_s"] for twist in result["twists"]) < 0.03
    assert len(demo.movements) == 5
    assert result["tracking"]["rms_mm"] < 5.0
    assert result["arm"]["moves"] == 6 and result["arm"]["final_mrad"] == pytest.approx(0.0)
    assert result["goal"]["position_mm"] < 40.0
    assert result["dead_wheel"]["wheel"] == "rear_right"
    assert NOTICE_TIME < result["dead_wheel"]["noticed_s"] < NOTICE_TIME + 0.1
    stop = result["emergency_stop"]
    assert stop["speed_m_s"] == pytest.approx(0.3)
    assert stop["rest_s"] < 0.1 and stop["moved_mm"] == 0.0
    assert result["tool"]["samples"] > 50


def test_the_report_has_all_rows_of_a_robot_in_a_world_and_those_that_there_are(driven):
    _, _, result = driven
    rows = len(ROWS.splitlines())
    contacts = {"count": 1, "with": ["base_link, pallet"]}
    among = result["tool"] | {"clearance_m": 0.05}
    lines = report_lines(result | {"contacts": contacts, "tool": among})
    assert len(lines) == 2 + rows
    assert any("1: base_link, pallet" in line for line in lines)
    without = {key: value for key, value in result.items() if key not in ("arm", "goal")}
    assert len(report_lines(without)) == 2 + rows - 7, "nor is it in a world"


def test_the_demo_is_drawn(driven, tmp_path):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    from omniman_ros.demo.picture import draw_demo

    demo, recording, _ = driven
    path = draw_demo(demo, recording, tmp_path / "new" / "demo.png")
    assert path == tmp_path / "new" / "demo.png"
    assert pyplot.imread(path).std() > 0.02, "the figure is not empty"
    assert pyplot.get_fignums() == []


def test_without_an_arm_only_the_platform_is_commanded(monkeypatch):
    robot = SteppedRobot()
    driver = stepped_driver(monkeypatch, robot, has_arm=False)
    demo = load_demo("omniman", has_arm=False)
    driver.wait_until_ready()
    drive(demo, driver)
    assert robot.needs == ("drive", "goal", "path")
    assert set(robot.asked) == {"path", "obstacle", "goal"}
    assert demo.arm_moves == [] and demo.tool is None


@pytest.mark.parametrize(
    ("leg", "defect", "message"),
    [
        ("path", "progress", "path: forwards did not reach its end, only 0%: started"),
        ("tool", "move_arm", "motion of the arm: refused: no way"),
        ("goal", "plan", "goal, obstacles did not reach its end, only 0%: refused, no way"),
        ("dead_wheel", "notice", "the controller did not notice that 'rear_right'"),
        ("dead_wheel", "repair", "wheel 'rear_right' is still reported as dead after the reset"),
        ("stop", "stop", "the emergency stop did not stop the robot"),
        ("stop", "reset", "reset failed: /robot: not at rest"),
    ],
)
def test_a_robot_that_does_not_do_what_a_leg_asks_ends_the_demo(monkeypatch, leg, defect, message):
    with pytest.raises((CommandError, MotionError), match=message):
        drive_leg(monkeypatch, SteppedRobot(defect), leg)


def test_the_demo_does_not_begin_before_all_topics_are_there(monkeypatch):
    driver = stepped_driver(monkeypatch, SteppedRobot("publish"))
    with pytest.raises(CommandError, match="not ready within 15 s: odom, ground_truth/odom"):
        driver.wait_until_ready()


def test_a_stopped_robot_ends_the_demo_with_the_reason(monkeypatch):
    robot = SteppedRobot()
    robot.stopped = True
    with pytest.raises(CommandError, match="the robot stopped: platform_controller stopped: x"):
        drive_leg(monkeypatch, robot, "twists")


def test_a_robot_that_is_being_closed_is_not_asked_for_its_state(monkeypatch):
    robot = SteppedRobot()
    robot.stopped, robot.is_open = True, False
    stepped_driver(monkeypatch, robot).pause(0.1)


def test_a_platform_that_is_still_driven_is_not_at_rest(monkeypatch):
    robot = SteppedRobot("progress")
    driver = stepped_driver(monkeypatch, robot)
    robot.follow(np.zeros((2, 3)))
    with pytest.raises(CommandError, match="'path' still drives the platform, expected none"):
        driver.rest()


def test_whoever_waits_for_the_robot_waits_no_more_after_an_end(monkeypatch):
    ends = [CommandError("a node ended")]

    def poll():
        if ends:
            raise ends.pop()

    driver = stepped_driver(monkeypatch, SteppedRobot(), poll)
    for _ in range(2):
        with pytest.raises(CommandError, match="a node ended"):
            driver.pause(1.0)


@pytest.mark.parametrize("name", robots.ALL)
def test_the_twists_are_within_the_limits_of_every_robot_and_short(name):
    bounds = build(TwistLimits, robots.values(name), "limits.")
    pace = DemoSpeeds.within(bounds)
    total = 0.0
    for phase in twist_phases(pace):
        total += phase.duration + 1.0
        for t in np.linspace(0.0, phase.duration, 200):
            x, y, turn = phase.twist(t)
            assert math.hypot(x, y) <= bounds.linear_velocity
            assert abs(turn) <= bounds.angular_velocity
    assert total < 20.0


def test_the_path_of_the_tool_begins_where_it_is_and_ahead_of_the_robot():
    positions = legs.tool_positions((0.3, -0.2, 0.7), 0.7)
    assert positions[0] == pytest.approx((0.3, -0.2, 0.7))
    steps = np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1)
    assert steps.sum() == pytest.approx(legs.LENGTH) and steps.max() < 0.021
    assert np.ptp(positions[:, 2]) == pytest.approx(legs.WAVE_HEIGHT, rel=1e-3)
    ahead = positions[-1, :2] - positions[0, :2]
    assert math.atan2(ahead[1], ahead[0]) == pytest.approx(0.7)


def test_obstacles_are_placed_and_move_relative_to_the_robot():
    obstacles = DemoObstacles.in_front_of((1.0, 2.0, math.pi / 2), 100.0)
    x, y, vx, vy, _ = DEMO_OBSTACLES[0]
    assert obstacles.at(100.0)[0] == pytest.approx([1.0 - y, 2.0 + x])
    moved = obstacles.at(102.0)[0] - obstacles.at(100.0)[0]
    assert moved == pytest.approx([-2.0 * vy, 2.0 * vx])


def test_the_robot_is_told_of_obstacles_where_they_are_judged():
    obstacles, told = DemoObstacles.in_front_of((1.0, 2.0, math.pi / 2), 100.0), {}
    robot = SimpleNamespace(
        add_obstacle=lambda name, *place: told.__setitem__(name, place), remove_obstacle=told.pop
    )
    obstacles.show_to(robot, 99.0)
    for (x, y, radius, velocity), now, then, row in zip(
        told.values(), obstacles.at(99.0), obstacles.at(100.0), DEMO_OBSTACLES, strict=True
    ):
        assert (x, y) == pytest.approx(now) and radius == row[4]
        assert (x, y) + velocity == pytest.approx(then)
    obstacles.hide_from(robot)
    assert told == {}


def test_what_is_perceived_is_recorded_until_the_goal():
    robot = SteppedRobot()
    hear = robot.callbacks
    with record_perception(robot) as seen:
        hear["scan"](
            LaserScan(angle_min=-0.5, angle_increment=0.5, range_max=9.0, ranges=[math.inf, 2.0])
        )
        cells = np.array([[0, 100]], dtype=np.int8)
        stamp = OccupancyGrid().header.stamp
        hear["map"](map_message(cells, 0.1, np.array([1.0, 2.0]), "odom", stamp))
        person, crate = Marker(type=Marker.CYLINDER), Marker(type=Marker.CUBE)
        person.pose.position.x, person.scale.x = 3.0, 0.5
        hear["ground_truth/obstacles"](MarkerArray(markers=[person, crate]))
    assert seen.scans[0][1] == pytest.approx(np.array([[0.55 + 2.0, 0.0]]))
    assert seen.map.values.tolist() == [[0, 100]]
    assert seen.people[0][1].tolist() == [[3.0, 0.0, 0.25]]
    assert set(robot.ended) == {"scan", "map", "obstacle_tracks", "ground_truth/obstacles"}


def test_by_the_scanner_the_robot_is_told_of_nobody(monkeypatch):
    robot = SteppedRobot()
    driver = stepped_driver(monkeypatch, robot)
    robot.spin(0.1)
    robot.drive(1.0, 0.0, 0.0)
    driver.pause(0.5)
    robot.halt()
    driven = legs.drive_to_goal(driver, by_scanner=True)
    assert robot.asked == ["goal"]
    assert driven.goal == pytest.approx(legs.GOAL_IN_WORLD), "wherever the robot was"
    assert driven.perception is not None
