"""The leg of the demo that moves the tool along a path, with platform and arm synchronised."""

import math
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.demo.driver import Driver
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.robot_interface import FRAME
from omniman_ros.demo.tracking import rms
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform

START_ANGLES = (0.0, -1.9, 2.0, -1.7, -1.57, 0.0)
"""Joint angles at the start: the arm bent, the tool pointing down in front of the robot [rad]."""
START_TIMEOUT = 10.0
"""Time within which the arm must reach these angles [s]."""
START_TOLERANCE = 0.005
"""Deviation from these angles within which the arm has reached them [rad]."""
STRAIGHT = 1.2
"""Length of the straight at the start of the path [m]."""
RADIUS = 0.7
"""Radius of the left bend after the straight [m]."""
BEND = math.pi
"""Angle of the left bend [rad]."""
WAVE_HEIGHT = 0.06
"""Height between the highest and the lowest point of the path [m]."""
WAVES = 2.0
"""Number of waves of the path's height."""
SPACING = 0.02
"""Largest horizontal distance between two poses [m]."""


def tool_poses(start: Array, heading: float) -> Array:
    """Return the poses (k, 4, 4) of the tool in odom along the path.

    Args:
        start: Pose (4, 4) of the tool in odom. The tool keeps its orientation.
        heading: Direction of the straight in odom [rad].
    """
    length = STRAIGHT + RADIUS * BEND
    s = np.linspace(0.0, length, math.ceil(length / SPACING) + 1)
    angle = np.maximum(s - STRAIGHT, 0.0) / RADIUS
    x = np.minimum(s, STRAIGHT) + RADIUS * np.sin(angle)
    y = RADIUS * (1.0 - np.cos(angle))
    z = 0.5 * WAVE_HEIGHT * (1.0 - np.cos(WAVES * math.tau * s / length))
    poses = np.repeat(start[None], len(s), axis=0)
    cosine, sine = math.cos(heading), math.sin(heading)
    poses[:, 0, 3] += cosine * x - sine * y
    poses[:, 1, 3] += sine * x + cosine * y
    poses[:, 2, 3] += z
    return poses


def tool_path_message(poses: Array, frame: str) -> Path:
    """Return poses (k, 4, 4) in a frame as a path."""
    path = Path()
    path.header.frame_id = frame
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    return path


class ToolTrack:
    """Measured poses of the tool on its path, and its reference at the same times.

    There is one sample for each message on `arm/joint_states`.

    Args:
        recording: What the robot published.
        model: Model of platform and arm.
        interval: Interval in which the tool was moved.

    Attributes:
        times: ROS times (k,) [s].
        measured: Poses (k, 4, 4) of the tool in odom, from the arm's angles and odometry.
        reference: Positions (k, 3) on the path at these times in odom [m].
        true: Poses (k, 4, 4) of the tool from the ground truth, in the frame in which odometry
            and ground truth agreed when the path began.
        platform: Poses (k, 3) of the platform in odom [m, m, rad].
    """

    def __init__(self, recording: Recording, model: WholeBodyModel, interval: Interval) -> None:
        arm, odom = np.array(recording.arm), np.array(recording.odom)
        reference = np.array(recording.tool_reference)
        reference = reference[np.argsort(reference[:, 0], kind="stable")]
        first = max(interval.start, reference[0, 0], odom[0, 0])
        last = min(interval.end, reference[-1, 0], odom[-1, 0])
        rows = arm[(arm[:, 0] >= first) & (arm[:, 0] <= last)]
        self.times, joints = rows[:, 0], rows[:, 1:]
        self.platform = _poses_at(odom, self.times)
        truth = _poses_at(np.array(recording.truth), self.times)
        true_platform = (
            planar_transform(self.platform[:1])
            @ np.linalg.inv(planar_transform(truth[:1]))
            @ planar_transform(truth)
        )
        tool = np.linalg.inv(planar_transform(self.platform)) @ model.forward(
            np.hstack([self.platform, joints])
        )
        self.measured: Array = planar_transform(self.platform) @ tool
        self.true: Array = true_platform @ tool
        self.reference = np.column_stack(
            [np.interp(self.times, reference[:, 0], reference[:, k]) for k in (1, 2, 3)]
        )

    @property
    def errors(self) -> Array:
        """Distances (k,) of the tool from its reference at the same time [m]."""
        result: Array = np.linalg.norm(self.measured[:, :3, 3] - self.reference, axis=1)
        return result

    @property
    def true_errors(self) -> Array:
        """Distances (k,) by the ground truth, which include odometry's drift [m]."""
        result: Array = np.linalg.norm(self.true[:, :3, 3] - self.reference, axis=1)
        return result


def tool_figures(track: ToolTrack) -> dict[str, Any]:
    """Return the errors of the tool, and the lengths of the paths of tool and platform."""
    errors, true_errors = 1e3 * track.errors, 1e3 * track.true_errors
    steps = np.linalg.norm(np.diff(track.reference, axis=0), axis=1)
    platform_steps = np.hypot(*np.diff(track.platform[:, :2], axis=0).T)
    return {
        "rms_mm": rms(errors),
        "max_mm": float(errors.max()),
        "true_rms_mm": rms(true_errors),
        "true_max_mm": float(true_errors.max()),
        "length_m": float(steps.sum()),
        "platform_m": float(platform_steps.sum()),
        "time_s": float(track.times[-1] - track.times[0]),
        "samples": len(errors),
    }


class ToolLeg(Leg):
    """Moves the tool along a path of several metres, with platform and arm synchronised.

    Args:
        model: Model of platform and arm.

    Attributes:
        interval: Interval in which the tool was moved.
        track: Measured path of the tool; None before `measure`.
    """

    limits = (
        Limit("tool.rms_mm", "tool off its path RMS, mm", 2.0),
        Limit("tool.max_mm", "tool off its path max, mm", 5.0),
    )

    def __init__(self, model: WholeBodyModel) -> None:
        self._model = model
        self.interval = Interval()
        self.track: ToolTrack | None = None

    def drive(self, driver: Driver) -> None:
        """Move the arm to its start angles, and the tool along the path from there.

        Raises:
            CommandError: The arm did not reach the start, or the path was not completed.
        """
        self._prepare_arm(driver)
        x, y, heading = driver.pose
        start = self._model.forward(np.array([x, y, heading, *driver.arm_angles]))
        poses = tool_poses(start, heading)
        length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
        path = tool_path_message(poses, FRAME)
        self.interval = driver.follow(
            "tool path", lambda: driver.robot.send_tool_path(path), length
        )

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the errors of the tool under `tool`."""
        self.track = ToolTrack(recording, self._model, self.interval)
        return {"tool": tool_figures(self.track)}

    @staticmethod
    def _prepare_arm(driver: Driver) -> None:
        """Move the arm to the angles at which the tool's path starts."""

        def has_arrived() -> bool:
            deviation = driver.arm_angles - np.array(START_ANGLES)
            return float(np.abs(deviation).max()) < START_TOLERANCE

        driver.progress.begin("arm to start pose")
        driver.begin_arm_move(np.array(START_ANGLES))
        if not driver.wait(has_arrived, START_TIMEOUT):
            raise CommandError("the arm did not reach the start of the tool's path")
        driver.rest()
        driver.end_arm_move(driver.now)
        driver.progress.end(driver.note)


def _poses_at(rows: Array, times: Array) -> Array:
    """Return the poses (k, 3) at times (k,) of rows that begin with stamp, x, y, theta."""
    heading = np.unwrap(rows[:, 3])
    columns = [np.interp(times, rows[:, 0], column) for column in (rows[:, 1], rows[:, 2])]
    return np.column_stack([*columns, np.interp(times, rows[:, 0], heading)])
