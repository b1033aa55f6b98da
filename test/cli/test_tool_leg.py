"""The demo's path of the tool, and how its figures are had from what was heard."""

import math

import numpy as np
import pytest

from omniman_ros.cli import tool_leg
from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.tool_leg import DrivenTool, ToolTrack, figures, way
from omniman_ros.core.body.model import BodyModel, Mount, planar

MODEL = BodyModel(Mount())
READY = np.array(tool_leg.READY)
LENGTH = tool_leg.STRAIGHT + tool_leg.RADIUS * tool_leg.BEND


def test_the_way_begins_where_the_tool_is_and_keeps_its_orientation():
    start = MODEL.forward(np.concatenate([[0.3, -0.2, 0.7], READY]))
    poses = way(start, 0.7)
    assert poses[0] == pytest.approx(start)
    assert np.abs(poses[:, :3, :3] - start[:3, :3]).max() == 0.0
    steps = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    assert steps.sum() == pytest.approx(LENGTH, rel=1e-3) and steps.max() < 0.021
    assert np.ptp(poses[:, 2, 3]) == pytest.approx(tool_leg.WAVE, rel=1e-3)
    ahead = poses[10, :2, 3] - poses[0, :2, 3]
    assert math.atan2(ahead[1], ahead[0]) == pytest.approx(0.7)


def test_the_message_has_every_pose_in_its_frame():
    start = MODEL.forward(np.concatenate([np.zeros(3), READY]))
    path = tool_leg.message(way(start, 0.0), "odom")
    assert path.header.frame_id == "odom" and len(path.poses) > 100
    place = path.poses[-1].pose.position
    assert [place.x, place.y, place.z] == pytest.approx(way(start, 0.0)[-1, :3, 3])


def recording(off=(0.0, 0.0, 0.0), drift=0.0):
    """A platform on a straight with a resting arm; the reference is off the tool by some way."""
    said = Recording()
    for t in np.arange(0.0, 4.0, 0.01):
        pose = np.array([0.2 * t, 0.1 * t, 0.05 * t + math.pi - 0.1])
        heading = math.remainder(pose[2], math.tau)
        said.odom.append((t, pose[0], pose[1], heading, 0.0, 0.0, 0.0))
        true = planar(np.array([5.0, 1.0, 0.4])) @ planar(pose)
        angle = math.atan2(true[1, 0], true[0, 0])
        said.truth.append((t, true[0, 3] + drift * t, true[1, 3], angle))
        said.arm.append((t + 0.003, *READY))
        tool = MODEL.forward(np.concatenate([pose, READY]))[:3, 3] + off
        said.tool_reference.append((t, *tool))
    return said


def test_a_tool_that_is_on_its_path_is_off_by_nothing():
    track = ToolTrack(recording(), MODEL, DrivenTool(1.0, 3.0))
    assert track.errors.max() < 1e-4 and track.true_errors.max() < 1e-4
    assert track.times[0] >= 1.0 and track.times[-1] <= 3.0
    result = figures(track)
    assert result["platform_m"] == pytest.approx(2.0 * math.hypot(0.2, 0.1), rel=0.02)
    assert result["time_s"] == pytest.approx(2.0, abs=0.05)


def test_what_it_is_off_by_is_told_and_the_drift_of_odometry_beside_it():
    said = recording((0.003, 0.0, 0.004), drift=0.002)
    result = figures(ToolTrack(said, MODEL, DrivenTool(1.0, 3.0)))
    assert result["rms_mm"] == pytest.approx(5.0, abs=0.1)
    assert result["max_mm"] == pytest.approx(5.0, abs=0.1)
    true = figures(ToolTrack(recording(drift=0.002), MODEL, DrivenTool(1.0, 3.0)))
    assert true["max_mm"] < 0.1 and true["true_max_mm"] == pytest.approx(4.0, abs=0.2)
