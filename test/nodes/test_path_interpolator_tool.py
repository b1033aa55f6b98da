"""Tests of tool paths over real topics in simulated time: planning, correction, refusal."""

import math
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Setpoint
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator import BENT
from test.nodes.test_path_interpolator_whole_body import WholeBodyWorld, trajectory

READY = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
MODEL = WholeBodyModel(Mount())
START = MODEL.forward(np.concatenate([np.zeros(3), READY]))
CORNERS = [(0.0, 0.0, 0.0), (0.8, 0.0, 0.0), (1.2, 0.5, 0.05)]
SHORT = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)]


def tool_path(offsets: Any, frame: str = "odom", orientation: bool = True) -> Path:
    """Return a path at the given offsets from the first pose, with its orientation."""
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


def path_facing_backwards(offsets: Any) -> Path:
    """Return a path for a robot that faces backwards."""
    message = tool_path(offsets, orientation=False)
    for stamped in message.poses:
        place = stamped.pose.position
        place.x, place.y = -place.x, -place.y
    return message


class ToolWorld(WholeBodyWorld):
    """A whole-body world whose platform may deviate from its reference.

    Attributes:
        platform_error: Measured platform pose less reference (3,) [m, m, rad] over time.
        poses: Time, x, y and theta of each odom message.
    """

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        self.platform_error = lambda time: np.zeros(3)
        self.poses: list[tuple[float, ...]] = []
        super().__init__(parameters)
        self.joints = READY.copy()
        self.tool_paths = self.publisher(Path, "tool_path")
        self.tool_references = self.listen(PoseStamped, "tool_reference")
        self.run(4 * PERIOD)

    def odom_message(self) -> Odometry:
        message = super().odom_message()
        off = self.platform_error(self.time)
        place = message.pose.pose.position
        place.x, place.y = place.x + float(off[0]), place.y + float(off[1])
        theta = float(self.setpoint.pose[2] + off[2])
        message.pose.pose.orientation = quaternion_from_yaw(theta)
        self.poses.append((self.time, place.x, place.y, theta))
        return message

    def send_tool(self, offsets: Any, **options: Any) -> None:
        self.tool_paths.publish(tool_path(offsets, **options))
        self.run(2 * PERIOD)

    def wait_for_plan(self) -> None:
        """Wait in real time for the planning thread, which a loop without pauses would starve."""
        self._await(lambda: not self.node.motions.tool.is_planning, "the plan")
        self.run(0.1)

    def run_to_motion_start(self) -> None:
        self.wait_for_plan()
        self.run_until(lambda: not self.node.motions.whole_body.idle, 1.0, "the begin")

    def run_to_motion_end(self, seconds: float = 60.0) -> None:
        self.run_until(lambda: self.node.motions.whole_body.idle, seconds, "the end")

    def tool_errors(self) -> np.ndarray:
        """Return the distance (k,) [m] of the tool, from arm and odom, to its timed reference."""
        poses = np.array(self.poses)
        stamps = [time_seconds(m.header.stamp) for m in self.tool_references]
        times, keep = np.unique(np.round(stamps, 6), return_index=True)
        wanted = np.array(
            [
                [m.pose.position.x, m.pose.position.y, m.pose.position.z]
                for m in (self.tool_references[i] for i in keep)
            ]
        )
        arrivals = np.array([arrival for arrival, _, _ in self.joint_previews])
        latest = np.searchsorted(arrivals, times, side="right") - 1
        arm = [
            self.joint_previews[max(i, 0)][2].sample(t)[0]
            for i, t in zip(latest, times, strict=True)
        ]
        platform = np.column_stack([np.interp(times, poses[:, 0], poses[:, k]) for k in (1, 2, 3)])
        tool = MODEL.forward(np.column_stack([platform, np.array(arm)]))[:, :3, 3]
        assert len(times) > 100
        return np.linalg.norm(tool - wanted, axis=1)


@pytest.fixture
def world():
    with ToolWorld() as made:
        yield made


def test_the_tool_follows_a_path_beyond_the_reach_of_the_arm(world):
    world.send_tool(CORNERS)
    world.run_to_motion_start()
    world.run_to_motion_end()
    end = world.tool_references[-1].pose.position
    expected = START[:3, 3] + CORNERS[-1]
    assert [end.x, end.y, end.z] == pytest.approx(expected, abs=1e-6)
    assert world.tool_errors().max() < 1e-4
    assert math.hypot(*world.received_axes()[1][-1, :2]) > 0.8
    world.assert_both_smooth()
    assert not world.warnings and world.status().level == DiagnosticStatus.OK


def test_the_arm_compensates_the_platform_error(world):
    def platform_error(time: float) -> np.ndarray:
        return np.array([0.004, 0.003, 0.004]) * math.sin(2.0 * time)

    world.send_tool(CORNERS[:2])
    world.run_to_motion_start()
    began = world.time
    world.platform_error = lambda time: platform_error(time - began)
    world.run_to_motion_end()
    errors = world.tool_errors()
    assert np.sqrt(np.mean(errors**2)) < 5e-4 and errors.max() < 2e-3


def test_a_large_error_slows_the_motion_and_a_larger_one_ends_it(world):
    world.send_tool(CORNERS)
    world.run_to_motion_start()
    began = world.time
    world.platform_error = lambda time: np.array([0.0, min(0.04, 0.02 * (time - began)), 0.0])
    world.run(3.0)
    assert world.node.motions.time_base.pace.rate(world.time) == pytest.approx(0.4, abs=0.06)
    world.platform_error = lambda time: np.array([0.0, 0.06, 0.0])
    world.run_until(lambda: world.node.motions.whole_body.idle, 2.0, "giving up")
    assert any("off its path" in text for text in world.warnings)
    world.run(0.5)
    assert world.preview(-1).end_speed == 0.0
    assert world.joint_previews[-1][2].end_speed == 0.0


def test_a_tool_that_becomes_unreachable_is_reported(world, monkeypatch):
    world.send_tool(CORNERS)
    world.run_to_motion_start()
    world.run(1.0)

    def unreachable(*_: Any) -> Any:
        raise InputError("out of the arm's reach")

    monkeypatch.setattr(world.node.motions.whole_body._tool, "corrected", unreachable)
    world.run(0.2)
    assert (
        world.node.motions.whole_body.idle
        and "given up: out of the arm's reach" in world.node.motions.whole_body.log.text
    )
    assert world.status().level == DiagnosticStatus.WARN


def test_a_stop_discards_a_path_that_is_being_planned(world):
    world.tool_paths.publish(tool_path(CORNERS))
    world.run_until(
        lambda: world.node.motions.tool.is_planning or not world.node.motions.whole_body.idle,
        1.0,
        "planning",
    )
    assert world.node.motions.whole_body.idle, "planning ended before the stop"
    world.follows_stream = False
    world.publish_source("stop")
    world.run(4 * PERIOD)
    world.publish_source("none")
    world.follows_stream = True
    world.wait_for_plan()
    world.run(3.0)
    assert world.node.motions.whole_body.idle and not world.references
    assert any("not used: the platform is stopped" in text for text in world.warnings)


@pytest.mark.parametrize("displacement", [1e-9, 1e-7, 1e-6, 1e-5])
def test_a_negligible_path_is_refused(world, displacement):
    world.send_tool([(0, 0, 0), (displacement, 0, 0)])
    world.wait_for_plan()
    assert "nothing to do" in world.warnings[0]


def test_an_exception_in_the_planner_is_reported_and_the_node_continues(world, monkeypatch):
    def broken(*_: Any) -> Any:
        raise ZeroDivisionError("injected failure")

    monkeypatch.setattr(ToolPlanner, "plan", broken)
    world.send_tool(CORNERS)
    world.wait_for_plan()
    assert "ZeroDivisionError: injected failure" in world.warnings[0]
    monkeypatch.undo()
    world.send_tool(CORNERS)
    world.run_to_motion_start()


def test_a_heading_that_wraps_during_planning_is_not_a_motion(world):
    def stand(theta: float) -> None:
        world.setpoint = Setpoint(np.array([0.0, 0.0, theta]), np.zeros(3), np.zeros(3))

    stand(math.pi - 1e-7)
    world.run(0.1)
    world.tool_paths.publish(path_facing_backwards([(0, 0, 0), (0.3, 0, 0)]))
    world.run_until(lambda: world.node.motions.tool.is_planning, 1.0, "planning")
    stand(math.pi + 1e-7)
    world.run_to_motion_start()
    world.run_to_motion_end()
    assert not world.warnings and world.tool_errors().max() < 1e-4


def test_poses_without_orientation_keep_that_of_the_tool(world):
    world.send_tool(SHORT, orientation=False)
    world.run_to_motion_start()
    world.run_to_motion_end()
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
def test_an_infeasible_path_is_refused_before_anything_moves(world, case):
    offsets, options, words = REFUSED[case]
    world.send_tool(offsets, **options)
    world.wait_for_plan()
    assert any(words in text for text in world.warnings), world.warnings
    world.run(0.5)
    assert not world.references and not world.joint_previews and world.node.motions.whole_body.idle
    status = world.status()
    assert status.level == DiagnosticStatus.WARN and words in status.message


def test_pause_resume_and_cancel_keep_the_tool_on_its_path(world):
    world.send_tool(CORNERS)
    world.run_to_motion_start()
    world.run(2.0)
    assert world.call_service("pause").success
    world.run_until(lambda: world.body.state is PathState.PAUSED, 3.0, "the pause")
    here = world.tool_references[-1].pose.position.x
    world.run(1.0)
    assert world.tool_references[-1].pose.position.x == pytest.approx(here, abs=1e-9)
    assert world.call_service("resume").success
    world.run(1.0)
    assert world.tool_references[-1].pose.position.x > here + 0.05
    assert world.call_service("cancel").success
    world.run_to_motion_end(3.0)
    assert world.tool_errors().max() < 1e-4
    world.assert_both_smooth()


def test_a_cancel_also_ends_planning(world):
    world.send_tool(CORNERS)
    assert world.call_service("cancel").success
    world.wait_for_plan()
    world.run(1.0)
    assert world.node.motions.whole_body.idle and not world.references


def test_other_motions_are_refused_during_a_tool_path(world):
    world.send_tool(SHORT)
    world.run_to_motion_start()
    world.run(1.0)
    world.send(BENT)
    world.trajectories.publish(trajectory([READY]))
    world.run(0.1)
    assert sum("is under way" in text for text in world.warnings) == 2
    world.send_tool(CORNERS)
    world.run(0.1)
    assert sum("is under way" in text for text in world.warnings) == 3
    world.run_to_motion_end()
    assert world.tool_errors().max() < 1e-4


def test_the_tool_pose_is_published(world):
    poses = world.listen(PoseStamped, "tool_pose")
    world.run(0.5)
    assert len(poses) == 5 and poses[-1].header.frame_id == "odom"
    place = poses[-1].pose.position
    assert [place.x, place.y, place.z] == pytest.approx(START[:3, 3], abs=1e-9)
    world.arm_reports = False
    world.run(0.8)
    before = len(poses)
    world.run(0.5)
    assert len(poses) == before


def test_invalid_joint_states_end_the_tool_pose(world):
    poses = world.listen(PoseStamped, "tool_pose")
    world.joints = np.full(6, math.nan)
    world.run(0.8)
    before = len(poses)
    world.run(0.5)
    assert len(poses) == before
    assert any("arm/joint_states ignored" in text for text in world.warnings)


def test_arm_previews_are_published_at_twice_the_rate_of_platform_previews(world):
    world.send_tool(CORNERS)
    world.run_to_motion_start()
    world.run(2.0)
    before, count = len(world.joint_previews), len(world.references)
    world.run(1.0)
    assert len(world.joint_previews) - before > 45 and len(world.references) - count < 30
    assert min(p.end - start for _, start, p in world.joint_previews) >= 0.39


def test_the_diagnostics_report_the_latest_event(world):
    world.trajectories.publish(trajectory([[1.0]], names=["nobody"]))
    world.run(0.1)
    assert "nobody" in world.status().message
    world.send_tool([(0, 0, 0), (0.1, 0, 0)])
    world.run_to_motion_start()
    world.run_to_motion_end()
    status = world.status()
    assert status.level == DiagnosticStatus.OK and status.message == "idle"
    world.send([(9.0, 9.0, 0.0)])
    assert "a path was refused" in world.status().message
    world.trajectories.publish(trajectory([READY + 0.1]))
    world.run(3.0)
    assert world.status().level == DiagnosticStatus.OK
