"""The demo's path of the tool, and how its errors are measured."""

import math

import numpy as np
import pytest

from omniman_ros.demo import tool_leg
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.tool_leg import ToolTrack, tool_figures, tool_path_message, tool_poses
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel, planar_transform

MODEL = WholeBodyModel(Mount())
START_ANGLES = np.array(tool_leg.START_ANGLES)
LENGTH = tool_leg.STRAIGHT + tool_leg.RADIUS * tool_leg.BEND
LED = Interval("tool path", 1.0, 3.0)


def test_the_path_begins_at_the_tool_and_keeps_its_orientation():
    start = MODEL.forward(np.concatenate([[0.3, -0.2, 0.7], START_ANGLES]))
    poses = tool_poses(start, 0.7)
    assert poses[0] == pytest.approx(start)
    assert np.abs(poses[:, :3, :3] - start[:3, :3]).max() == 0.0
    steps = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    assert steps.sum() == pytest.approx(LENGTH, rel=1e-3) and steps.max() < 0.021
    assert np.ptp(poses[:, 2, 3]) == pytest.approx(tool_leg.WAVE_HEIGHT, rel=1e-3)
    ahead = poses[10, :2, 3] - poses[0, :2, 3]
    assert math.atan2(ahead[1], ahead[0]) == pytest.approx(0.7)


def test_the_message_has_every_pose_in_its_frame():
    start = MODEL.forward(np.concatenate([np.zeros(3), START_ANGLES]))
    poses = tool_poses(start, 0.0)
    path = tool_path_message(poses, "odom")
    assert path.header.frame_id == "odom" and len(path.poses) > 100
    position = path.poses[-1].pose.position
    assert [position.x, position.y, position.z] == pytest.approx(poses[-1, :3, 3])


def led_tool(offset=(0.0, 0.0, 0.0), drift=0.0):
    """Recording of a platform on a straight with a resting arm.

    Args:
        offset: Position of the reference relative to the tool [m].
        drift: Drift of odometry [m/s].
    """
    recording = Recording()
    for t in np.arange(0.0, 4.0, 0.01):
        pose = np.array([0.2 * t, 0.1 * t, 0.05 * t + math.pi - 0.1])
        heading = math.remainder(pose[2], math.tau)
        recording.odom.append((t, pose[0], pose[1], heading, 0.0, 0.0, 0.0))
        true = planar_transform(np.array([5.0, 1.0, 0.4])) @ planar_transform(pose)
        angle = math.atan2(true[1, 0], true[0, 0])
        recording.truth.append((t, true[0, 3] + drift * t, true[1, 3], angle))
        recording.arm.append((t + 0.003, *START_ANGLES))
        tool = MODEL.forward(np.concatenate([pose, START_ANGLES]))[:3, 3] + offset
        recording.tool_reference.append((t, *tool))
    return recording


def test_a_tool_on_its_path_has_no_error():
    track = ToolTrack(led_tool(), MODEL, LED)
    assert track.errors.max() < 1e-4 and track.true_errors.max() < 1e-4
    assert track.times[0] >= 1.0 and track.times[-1] <= 3.0
    figures = tool_figures(track)
    assert figures["platform_m"] == pytest.approx(2.0 * math.hypot(0.2, 0.1), rel=0.02)
    assert figures["time_s"] == pytest.approx(2.0, abs=0.05)


def test_only_the_error_by_the_ground_truth_includes_the_drift():
    offset = tool_figures(ToolTrack(led_tool((0.003, 0.0, 0.004), drift=0.002), MODEL, LED))
    assert offset["rms_mm"] == pytest.approx(5.0, abs=0.1)
    assert offset["max_mm"] == pytest.approx(5.0, abs=0.1)
    drifted = tool_figures(ToolTrack(led_tool(drift=0.002), MODEL, LED))
    assert drifted["max_mm"] < 0.1 and drifted["true_max_mm"] == pytest.approx(4.0, abs=0.2)
