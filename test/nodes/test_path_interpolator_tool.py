"""Paths of the tool over real topics, on simulated time: planned, corrected, refused."""

import math
import re
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path

from omniman_ros import arm_conversions, conversions
from omniman_ros.core.body.model import BodyModel, Mount
from omniman_ros.core.body.tool_planner import ToolPlanner
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import PathState
from omniman_ros.core.preview import Setpoint

from .harness import PERIOD
from .test_path_interpolator import BENT
from .test_path_interpolator_body import Body, trajectory

READY = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
MODEL = BodyModel(Mount())
START = MODEL.forward(np.concatenate([np.zeros(3), READY]))
CORNERS = [(0.0, 0.0, 0.0), (0.8, 0.0, 0.0), (1.2, 0.5, 0.05)]


def tool_path(offsets: Any, frame: str = "odom", orientation: bool = True) -> Path:
    """A path of poses with the first orientation, offsets from the first place."""
    message = Path()
    message.header.frame_id = frame
    for offset in offsets:
        pose = START.copy()
        pose[:3, 3] += offset
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        if not orientation:
            stamped.pose.orientation.w = stamped.pose.orientation.x = 0.0
            stamped.pose.orientation.y = stamped.pose.orientation.z = 0.0
        message.poses.append(stamped)
    return message


def turned_path(offsets: Any) -> Path:
    """A path for a robot that looks back."""
    message = tool_path(offsets, orientation=False)
    for stamped in message.poses:
        place = stamped.pose.position
        place.x, place.y = -place.x, -place.y
    return message


class Tool(Body):
    """As with the body; the platform may be off its reference.

    Attributes:
        off: (3,) platform measured less reference [m, m, rad], a function of time.
        poses: Of each odom message: time, x, y, theta.
    """

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        self.off = lambda time: np.zeros(3)
        self.poses: list[tuple[float, ...]] = []
        super().__init__(parameters)
        self.joints = READY.copy()
        self.tool_paths = self.publisher(Path, "tool_path")
        self.tool_references = self.listen(PoseStamped, "tool_reference")
        self.run(4 * PERIOD)

    def odom_message(self) -> Odometry:
        message = super().odom_message()
        off = self.off(self.time)
        place = message.pose.pose.position
        place.x, place.y = place.x + float(off[0]), place.y + float(off[1])
        theta = float(self.setpoint.pose[2] + off[2])
        message.pose.pose.orientation = conversions.quaternion(theta)
        self.poses.append((self.time, place.x, place.y, theta))
        return message

    def send_tool(self, offsets: Any, **options: Any) -> None:
        self.tool_paths.publish(tool_path(offsets, **options))
        self.run(2 * PERIOD)

    def planned(self) -> None:
        """Wait, in real time, for the thread that plans: a loop that never rests starves it."""
        self._await(lambda: not self.node.tool.planning, "the plan")
        self.run(0.1)

    def begins(self) -> None:
        self.planned()
        self.run_until(lambda: not self.node.body.idle, 1.0, "the begin")

    def ends(self, seconds: float = 60.0) -> None:
        self.run_until(lambda: self.node.body.idle, seconds, "the end")

    def errors(self) -> np.ndarray:
        """Distance (k,) [m] of the tool, from arm and odom, from the timed point of its path."""
        poses = np.array(self.poses)
        stamps = [conversions.time_seconds(m.header.stamp) for m in self.tool_references]
        times, keep = np.unique(np.round(stamps, 6), return_index=True)
        wanted = np.array(
            [
                [m.pose.position.x, m.pose.position.y, m.pose.position.z]
                for m in (self.tool_references[i] for i in keep)
            ]
        )
        arrivals = np.array([arrival for arrival, _, _ in self.joint_previews])
        latest = np.searchsorted(arrivals, times, side="right") - 1
        arm = [self.joint_previews[max(i, 0)][2].sample(t)[0] for i, t in
               zip(latest, times, strict=True)]  # fmt: skip
        platform = np.column_stack([np.interp(times, poses[:, 0], poses[:, k]) for k in (1, 2, 3)])
        tool = MODEL.forward(np.column_stack([platform, np.array(arm)]))[:, :3, 3]
        assert len(times) > 100
        return np.linalg.norm(tool - wanted, axis=1)


@pytest.fixture
def world():
    with Tool() as made:
        yield made


def test_the_tool_goes_along_its_path_and_further_than_the_arm_reaches(world):
    world.send_tool(CORNERS)
    world.begins()
    world.ends()
    end = world.tool_references[-1].pose.position
    expected = START[:3, 3] + CORNERS[-1]
    assert [end.x, end.y, end.z] == pytest.approx(expected, abs=1e-6)
    assert world.errors().max() < 1e-4
    assert math.hypot(*world.whole()[1][-1, :2]) > 0.8
    world.assert_both_smooth()
    assert not world.warnings and world.status().level == DiagnosticStatus.OK


def test_the_arm_takes_the_error_of_the_platform_out(world):
    def off(time: float) -> np.ndarray:
        return np.array([0.004, 0.003, 0.004]) * math.sin(2.0 * time)

    world.send_tool(CORNERS)
    world.begins()
    began = world.time
    world.off = lambda time: off(time - began)
    world.ends()
    errors = world.errors()
    assert np.sqrt(np.mean(errors**2)) < 5e-4 and errors.max() < 2e-3


def test_without_correction_the_error_stays():
    with Tool({"tool_path.correction": False}) as world:
        world.send_tool(CORNERS)
        world.begins()
        began = world.time
        world.off = lambda time: np.array([0.0, 0.005, 0.0]) * min(time - began, 1.0)
        world.ends()
        assert world.errors().max() == pytest.approx(0.005, abs=5e-4)


def test_it_is_slowed_where_the_error_is_large_and_given_up_beyond(world):
    world.send_tool(CORNERS)
    world.begins()
    began = world.time
    world.off = lambda time: np.array([0.0, min(0.04, 0.02 * (time - began)), 0.0])
    world.run(3.0)
    assert world.node.together.pace.rate(world.time) == pytest.approx(0.4, abs=0.06)
    world.off = lambda time: np.array([0.0, 0.06, 0.0])
    world.run_until(lambda: world.node.body.idle, 2.0, "giving up")
    assert any("off its path" in text for text in world.warnings)
    world.run(0.5)
    assert world.preview(-1).end_speed == 0.0
    assert world.joint_previews[-1][2].end_speed == 0.0


def test_what_is_given_up_keeps_the_correction(world):
    world.send_tool(CORNERS)
    world.begins()
    began = world.time
    world.off = lambda time: np.array([0.0, min(0.02, 0.01 * (time - began)), 0.0])
    world.run(4.0)
    led = world.joint_previews[-1][2].sample(world.time + 1e-9)[0]
    world.takes = False
    world.say("cmd_vel")
    world.run_until(lambda: world.node.body.idle, 1.0, "giving up")
    world.run(0.1)
    stop = world.joint_previews[-1][2]
    assert np.abs(stop.sample(stop.start)[0] - led).max() < 0.01
    assert stop.end_speed == 0.0


def test_an_error_that_stays_large_does_not_hold_it_for_ever(world):
    world.send_tool(CORNERS)
    world.begins()
    began = world.time
    world.off = lambda time: np.array([0.0, min(0.0495, 0.02 * (time - began)), 0.0])
    world.run(5.0)
    here = world.tool_references[-1].pose.position.x
    world.run(3.0)
    assert not world.node.body.idle
    assert world.tool_references[-1].pose.position.x > here + 0.01


def test_a_tool_that_cannot_follow_on_the_way_is_told(world, monkeypatch):
    world.send_tool(CORNERS)
    world.begins()
    world.run(1.0)

    def unreachable(*_: Any) -> Any:
        raise InputError("out of the arm's reach")

    monkeypatch.setattr(world.node.body._tool, "window", unreachable)
    world.run(0.2)
    assert world.node.body.idle and "given up: out of the arm's reach" in world.node.body.last
    assert world.status().level == DiagnosticStatus.WARN


def test_a_path_that_is_planned_is_dropped_by_a_stop(world):
    world.tool_paths.publish(tool_path(CORNERS))
    world.run_until(lambda: world.node.tool.planning or not world.node.body.idle, 1.0, "planning")
    assert world.node.body.idle, "it was planned before it could be stopped"
    world.takes = False
    world.say("stop")
    world.run(4 * PERIOD)
    world.say("none")
    world.takes = True
    world.planned()
    world.run(3.0)
    assert world.node.body.idle and not world.references
    assert any("not used: the platform is stopped" in text for text in world.warnings)


@pytest.mark.parametrize("way", [1e-9, 1e-7, 1e-6, 1e-5])
def test_a_way_that_is_none_is_refused(world, way):
    world.send_tool([(0, 0, 0), (way, 0, 0)])
    world.planned()
    assert "nothing to do" in world.warnings[0]


def test_an_error_of_the_planner_is_told_and_the_node_lives(world, monkeypatch):
    def broken(*_: Any) -> Any:
        raise ZeroDivisionError("nobody thought of that")

    monkeypatch.setattr(ToolPlanner, "plan", broken)
    world.send_tool(CORNERS)
    world.planned()
    assert "ZeroDivisionError: nobody thought of that" in world.warnings[0]
    monkeypatch.undo()
    world.send_tool(CORNERS)
    world.begins()


def test_a_heading_that_wraps_while_it_is_planned_is_no_motion(world):
    def stand(theta: float) -> None:
        world.setpoint = Setpoint(np.array([0.0, 0.0, theta]), np.zeros(3), np.zeros(3))

    stand(math.pi - 1e-7)
    world.run(0.1)
    world.tool_paths.publish(turned_path([(0, 0, 0), (0.3, 0, 0)]))
    world.run_until(lambda: world.node.tool.planning, 1.0, "planning")
    stand(math.pi + 1e-7)
    world.begins()
    world.ends()
    assert not world.warnings and world.errors().max() < 1e-4


def test_poses_without_orientation_keep_the_tool_as_it_is(world):
    world.send_tool(CORNERS, orientation=False)
    world.begins()
    world.ends()
    q = world.tool_references[-1].pose.orientation
    turned = arm_conversions.rotations(np.array([[q.x, q.y, q.z, q.w]]))[0]
    assert turned == pytest.approx(START[:3, :3], abs=1e-6)


REFUSED = {
    "too high": ([(0.1, 0, 0), (0.2, 0, 1.5)], {}, "reach"),
    "far away": ([(3.0, 0, 0), (4.0, 0, 0)], {}, "from the tool"),
    "no pose": ([], {}, "empty"),
    "wrong frame": (CORNERS, {"frame": "map"}, "frame 'map'"),
    "not finite": ([(0.1, math.nan, 0)], {}, "not finite"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_driven_is_refused_before_anything_moves(world, case):
    offsets, options, words = REFUSED[case]
    world.send_tool(offsets, **options)
    world.planned()
    assert any(words in text for text in world.warnings), world.warnings
    world.run(0.5)
    assert not world.references and not world.joint_previews and world.node.body.idle
    status = world.status()
    assert status.level == DiagnosticStatus.WARN and words in status.message


def test_the_place_that_cannot_be_reached_is_named(world):
    world.send_tool([(0.1, 0, 0), (0.2, 0, 0), (0.2, 0, 1.5)])
    world.planned()
    found = re.search(r"pose (\d) .*at \(([-.\d]+), ([-.\d]+), ([-.\d]+)\) m", world.warnings[0])
    assert found is not None, world.warnings
    x, y, z = START[:3, 3]
    assert found[1] in "12"
    assert [float(found[2]), float(found[3])] == pytest.approx([x + 0.2, y], abs=1e-3)
    assert z + 0.1 < float(found[4]) < z + 1.5


def test_pause_resume_and_cancel_keep_the_tool_on_its_path(world):
    world.send_tool(CORNERS)
    world.begins()
    world.run(2.0)
    assert world.ask("pause").success
    world.run_until(lambda: world.body.state is PathState.PAUSED, 3.0, "the pause")
    here = world.tool_references[-1].pose.position.x
    world.run(1.0)
    assert world.tool_references[-1].pose.position.x == pytest.approx(here, abs=1e-9)
    assert world.ask("resume").success
    world.run(1.0)
    assert world.tool_references[-1].pose.position.x > here + 0.05
    assert world.ask("cancel").success
    world.ends(3.0)
    assert world.errors().max() < 1e-4
    world.assert_both_smooth()


def test_cancel_ends_planning_too(world):
    world.send_tool(CORNERS)
    assert world.ask("cancel").success
    world.planned()
    world.run(1.0)
    assert world.node.body.idle and not world.references


def test_nothing_else_is_taken_while_the_tool_is_led(world):
    world.send_tool(CORNERS)
    world.begins()
    world.run(1.0)
    world.send(BENT)
    world.trajectories.publish(trajectory([READY]))
    world.run(0.1)
    assert sum("is under way" in text for text in world.warnings) == 2
    world.send_tool(CORNERS)
    world.run(0.1)
    assert sum("is under way" in text for text in world.warnings) == 3
    world.ends()
    assert world.errors().max() < 1e-4


def test_it_says_where_the_tool_is(world):
    poses = world.listen(PoseStamped, "tool_pose")
    world.run(0.5)
    assert len(poses) == 5 and poses[-1].header.frame_id == "odom"
    place = poses[-1].pose.position
    assert [place.x, place.y, place.z] == pytest.approx(START[:3, 3], abs=1e-9)
    world.arm_alive = False
    world.run(0.8)
    before = len(poses)
    world.run(0.5)
    assert len(poses) == before


def test_reports_of_the_arm_that_cannot_be_used_end_what_is_said_of_the_tool(world):
    poses = world.listen(PoseStamped, "tool_pose")
    world.joints = np.full(6, math.nan)
    world.run(0.8)
    before = len(poses)
    world.run(0.5)
    assert len(poses) == before
    assert any("arm/joint_states ignored" in text for text in world.warnings)


def test_previews_of_the_arm_come_at_twice_the_rate_of_the_platforms(world):
    world.send_tool(CORNERS)
    world.begins()
    world.run(2.0)
    before, count = len(world.joint_previews), len(world.references)
    world.run(1.0)
    assert len(world.joint_previews) - before > 45 and len(world.references) - count < 30
    assert min(p.end - start for _, start, p in world.joint_previews) >= 0.39


def test_the_diagnostics_tell_what_happened_last(world):
    world.trajectories.publish(trajectory([[1.0]], names=["nobody"]))
    world.run(0.1)
    assert "nobody" in world.status().message
    world.send_tool([(0, 0, 0), (0.1, 0, 0)])
    world.begins()
    world.ends()
    status = world.status()
    assert status.level == DiagnosticStatus.OK and status.message == "idle"
    world.send([(9.0, 9.0, 0.0)])
    assert "a path was refused" in world.status().message
    world.trajectories.publish(trajectory([READY + 0.1]))
    world.run(3.0)
    assert world.status().level == DiagnosticStatus.OK


def test_one_false_pose_of_the_platform_does_not_lead_the_arm_astray(world):
    world.send_tool(CORNERS)
    world.begins()
    world.run(2.0)
    count, world.off = len(world.joint_previews), lambda time: np.array([0.1, 0.0, 0.0])
    world.run(PERIOD)
    world.off = lambda time: np.zeros(3)
    world.run(0.5)
    assert any("odom ignored: the platform would be 0.100 m" in t for t in world.warnings)
    assert not world.node.body.idle and len(world.joint_previews) > count + 10
    _, _, v, a = world.driven(count - 5)
    assert np.abs(v).max() < 0.3 and np.abs(a).max() < 1.0
    world.ends()
