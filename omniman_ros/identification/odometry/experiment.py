"""The experiment that calibrates the odometry: all runs and the check, driven and measured."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.identification.odometry.campaign import CalibrationRun, Pose
from omniman_ros.identification.odometry.drive_plan import (
    CalibrationMotion,
    RunTarget,
    Speeds,
    check_shape,
    displacement_to,
    straight_shape,
)
from omniman_ros.identification.odometry.measured_pose import PoseSource, TopicPoses, floor_pose
from omniman_ros.identification.odometry.record import (
    CheckDrive,
    OdometryRecord,
    without_standstill,
)
from omniman_ros.identification.odometry.wheel_integration import forward_matrix, integrate
from omniman_ros.identification.robot_session import RobotSession

MAX_CANCELLED_RUNS = 3  #: Number of runs that may be cancelled before their ends


class OdometryExperiment:
    """Drives runs, and collects them with the measured poses.

    Args:
        reach: Distance of base_link from the middle to a side of the square [m].
    """

    def __init__(
        self,
        robot: RobotSession,
        progress: Progress,
        poses: PoseSource,
        speeds: Speeds,
        reach: float,
        record: OdometryRecord,
    ) -> None:
        self._robot = robot
        self._progress = progress
        self._poses = poses
        self._forward = forward_matrix(record.wheels, record.odometry)
        self._speeds = speeds
        self._reach = reach
        self._cancelled_runs = 0
        self.record = record  #: The record with the runs that were driven so far

    def drive_all(self, targets: Sequence[RunTarget]) -> None:
        """Drive all runs, then the check path; one that fails raises a CommandError."""
        pose = self._poses.start()
        self.record = replace(self.record, poses=(pose,))
        heading = 0.0
        for number, target in enumerate(targets, 1):
            pose = self._drive_run(f"{number} {target.corner}", pose, heading, target)
            heading += target.turn
        self._drive_check(pose, heading)

    def _drive_run(self, name: str, pose: Triple, heading: float, target: RunTarget) -> Triple:
        """Drive a run; return the pose at its end [m, m, rad], measured or by odometry."""
        self._progress.begin(name + " ")
        self._robot.start_recording()
        displacement = displacement_to(pose, heading, target.corner, self._reach)
        arrived = self._robot.drive(name, self._straight(displacement), (0.0, 0.6))
        rotation = (0.0, 0.0, target.turn)
        if not arrived or not self._robot.drive(name, self._straight(rotation), (0.6, 1.0)):
            self._count_cancelled(name)
        times, positions = self._wheels()
        end = self._expected_pose(positions, pose)
        measured = self._measure(name, end)
        run = CalibrationRun(name, without_standstill(times, positions)[1])
        self.record = self.record.with_run(run, measured)
        return measured or end

    def _drive_check(self, pose: Triple, heading: float) -> None:
        name = "check"
        if self.record.poses[-1] is None:
            say("  no check: the pose before it was not measured")
            return
        self._progress.begin(name)
        self._robot.start_recording()
        displacement = displacement_to(pose, heading, "middle", self._reach)
        arrived = self._robot.drive(name, self._straight(displacement), (0.0, 0.2))
        curve = CalibrationMotion(check_shape(self._reach), self._robot.pose, self._speeds)
        if not arrived or not self._robot.drive(name, curve, (0.2, 1.0)):
            self._count_cancelled(name)
        times, positions = self._wheels()
        end = self._measure(name, self._expected_pose(positions, pose))
        truth = [
            (row[0], *floor_pose(self._poses.origin, row[1:]))
            for row in self._robot.recording.truth
            if isinstance(self._poses, TopicPoses) and self._poses.origin is not None
        ]
        times, positions = without_standstill(times, positions)
        check = CheckDrive(times, positions, pose, end, np.array(truth).reshape(-1, 4))
        self.record = replace(self.record, check=check)

    def _count_cancelled(self, name: str) -> None:
        """Count a run that was cancelled on its way; its recorded wheel motion is valid."""
        self._cancelled_runs += 1
        if self._cancelled_runs > MAX_CANCELLED_RUNS:
            raise CommandError(
                f"run '{name}' and {MAX_CANCELLED_RUNS} before it were cancelled on the way"
            )

    def _straight(self, displacement: Triple) -> CalibrationMotion:
        return CalibrationMotion(straight_shape(displacement), self._robot.pose, self._speeds)

    def _wheels(self) -> tuple[Array, Array]:
        recording = self._robot.recording
        return np.array(recording.times), np.array(recording.positions)

    def _expected_pose(self, positions: Array, start: Triple) -> Triple:
        """Return the pose by the odometry after a drive from a pose on the floor."""
        x, y, theta = integrate(self._forward, positions, start)[-1].tolist()
        return x, y, theta

    def _measure(self, name: str, expected: Triple) -> Pose | None:
        self._progress.end("at rest")
        pose = self._poses.measure(name, expected)
        if pose is None:
            say("  skipped")
        return pose


def expected_duration(run_count: int, reach: float, speeds: Speeds) -> float:
    """Return the approximate duration of the runs and the check [s].

    Args:
        reach: Distance of base_link from the middle to a side of the square [m].
    """
    origin = (0.0, 0.0, 0.0)
    side = CalibrationMotion(straight_shape((2.0 * reach, 0.0, 0.0)), origin, speeds).duration
    rotation = CalibrationMotion(straight_shape((0.0, 0.0, math.pi)), origin, speeds).duration
    return (run_count + 1) * (side + rotation)
