"""The demo's path of the tool: platform and arm in step, and how exact they were."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray

from omniman_ros import arm_conversions
from omniman_ros.cli.recorder import Recording
from omniman_ros.core.body.model import BodyModel, planar

Array = NDArray[np.float64]

READY = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)
"""Joint angles from which the tool is led: the arm bent, the tool down and before the robot."""
STRAIGHT, RADIUS, BEND, WAVE = 1.2, 0.7, math.pi, 0.06
"""A straight, then a bend to the left [m, m, rad]; all the way up and down by so much [m]."""
SPACING = 0.02
"""Of the poses [m]."""
WAVES = 2.0
"""Up and down so often."""


@dataclass(frozen=True)
class DrivenTool:
    """A path of the tool, from when to when in ROS time [s]."""

    start: float
    end: float


def way(start: Array, heading: float) -> Array:
    """Poses (k, 4, 4) of the tool in odom.

    Args:
        start: (4, 4) where the tool is. It keeps its orientation.
        heading: Where straight ahead is [rad].
    """
    length = STRAIGHT + RADIUS * BEND
    s = np.linspace(0.0, length, math.ceil(length / SPACING) + 1)
    angle = np.maximum(s - STRAIGHT, 0.0) / RADIUS
    x = np.minimum(s, STRAIGHT) + RADIUS * np.sin(angle)
    y = RADIUS * (1.0 - np.cos(angle))
    z = 0.5 * WAVE * (1.0 - np.cos(WAVES * math.tau * s / length))
    poses = np.repeat(start[None], len(s), axis=0)
    ahead, aside = math.cos(heading), math.sin(heading)
    poses[:, 0, 3] += ahead * x - aside * y
    poses[:, 1, 3] += aside * x + ahead * y
    poses[:, 2, 3] += z
    return poses


def message(poses: Array, frame: str) -> Path:
    """Poses (k, 4, 4) as a path."""
    path = Path()
    path.header.frame_id = frame
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    return path


class ToolTrack:
    """The tool while it was led, at each of the arm's reports: where it was, where it was to be.

    Args:
        recording: What was heard.
        model: Of the robot.
        driven: When.

    Attributes:
        times: (k,) ROS time [s].
        measured: (k, 4, 4) tool in odom, from the arm's angles and odom at the same stamp.
        wanted: (k, 3) the timed point of the path in odom [m].
        true: (k, 4, 4) tool from the ground truth, seen as odom was when the path began.
        platform: (k, 3) in odom [m, m, rad].
    """

    def __init__(self, recording: Recording, model: BodyModel, driven: DrivenTool) -> None:
        arm, odom = np.array(recording.arm), np.array(recording.odom)
        reference = np.array(recording.tool_reference)
        reference = reference[np.argsort(reference[:, 0], kind="stable")]
        first = max(driven.start, reference[0, 0], odom[0, 0])
        last = min(driven.end, reference[-1, 0], odom[-1, 0])
        rows = arm[(arm[:, 0] >= first) & (arm[:, 0] <= last)]
        self.times, joints = rows[:, 0], rows[:, 1:]
        self.platform = _poses_at(odom, self.times)
        truth = _poses_at(np.array(recording.truth), self.times)
        seen = planar(self.platform[:1]) @ np.linalg.inv(planar(truth[:1])) @ planar(truth)
        tool = np.linalg.inv(planar(self.platform)) @ model.forward(
            np.hstack([self.platform, joints])
        )
        self.measured: Array = planar(self.platform) @ tool
        self.true: Array = seen @ tool
        self.wanted = np.column_stack(
            [np.interp(self.times, reference[:, 0], reference[:, k]) for k in (1, 2, 3)]
        )

    @property
    def errors(self) -> Array:
        """Distance (k,) of the tool from the timed point of its path [m]."""
        result: Array = np.linalg.norm(self.measured[:, :3, 3] - self.wanted, axis=1)
        return result

    @property
    def true_errors(self) -> Array:
        """The same by the ground truth [m]: odometry's drift is in it."""
        result: Array = np.linalg.norm(self.true[:, :3, 3] - self.wanted, axis=1)
        return result


def figures(track: ToolTrack) -> dict[str, Any]:
    """How exact the tool was, how far it went, and how far the platform."""
    errors, true = 1e3 * track.errors, 1e3 * track.true_errors
    steps = np.linalg.norm(np.diff(track.wanted, axis=0), axis=1)
    moved = np.hypot(*np.diff(track.platform[:, :2], axis=0).T)
    return {
        "rms_mm": float(np.sqrt(np.mean(errors**2))),
        "max_mm": float(errors.max()),
        "true_rms_mm": float(np.sqrt(np.mean(true**2))),
        "true_max_mm": float(true.max()),
        "length_m": float(steps.sum()),
        "platform_m": float(moved.sum()),
        "time_s": float(track.times[-1] - track.times[0]),
        "samples": len(errors),
    }


def _poses_at(rows: Array, times: Array) -> Array:
    """Poses (k, 3) at times (k,) of rows that begin with stamp, x, y, theta."""
    heading = np.unwrap(rows[:, 3])
    columns = [np.interp(times, rows[:, 0], column) for column in (rows[:, 1], rows[:, 2])]
    return np.column_stack([*columns, np.interp(times, rows[:, 0], heading)])
