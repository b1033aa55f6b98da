"""The experiment with a fake robot, whose wheels turn as each motion demands."""

import io
import itertools
import math

import numpy as np
import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.identification.odometry.campaign import Accuracy
from omniman_ros.identification.odometry.drive_plan import TARGETS, Speeds
from omniman_ros.identification.odometry.experiment import (
    MAX_CANCELLED_RUNS,
    OdometryExperiment,
    expected_duration,
)
from omniman_ros.identification.odometry.factor_selection import identify
from omniman_ros.identification.odometry.measured_pose import TopicPoses
from omniman_ros.identification.odometry.record import OdometryRecord
from omniman_ros.identification.odometry.wheel_integration import forward_matrix, integrate
from omniman_ros.identification.robot_session import Recording
from test.robots import kinematics, robot

TRUE = OdometryParameters(scale_x=0.99, scale_y=1.015, scale_yaw=0.985, x_per_y=0.01)
PRESENT = OdometryParameters()
REACH = 0.8
SPEEDS = Speeds(0.4, 0.8, 1.0)
PERIOD = 0.05


class FakeRobot:
    """Stands in for a robot session; its odometry is exact with the parameters `TRUE`."""

    def __init__(self):
        self._model = kinematics("omniman")
        self._forward = {
            parameters: forward_matrix(robot("omniman").wheels, parameters)
            for parameters in (TRUE, PRESENT)
        }
        self._positions = np.zeros(4)
        self._time = 0.0
        self.true_pose = (1.0, 2.0, 0.5)
        self.pose = (0.0, 0.0, 0.0)
        self.cancels = lambda name: False
        self.recording = Recording()

    def start_recording(self):
        self.recording = Recording()
        self._append()

    def _append(self):
        self.recording.times.append(self._time)
        self.recording.positions.append(self._positions)
        self.recording.truth.append((self._time, *self.true_pose))

    def drive(self, name, motion, progress_range):
        if self.cancels(name):
            return False
        times = np.arange(0.0, motion.duration + PERIOD, PERIOD)
        poses = np.array([motion.sample(time).pose for time in times])
        for a, b in itertools.pairwise(poses):
            middle = 0.5 * (a[2] + b[2])
            c, s = math.cos(middle), math.sin(middle)
            dx, dy, turn = b - a
            step = self._model.J @ [c * dx + s * dy, -s * dx + c * dy, turn]
            positions = np.vstack([self._positions, self._positions + step])
            self.pose = tuple(integrate(self._forward[PRESENT], positions, self.pose)[-1])
            true = integrate(self._forward[TRUE], positions, self.true_pose)[-1]
            self.true_pose = tuple(true.tolist())
            self._positions, self._time = positions[-1], self._time + PERIOD
            self._append()
        return True


def make_experiment(fake, measure=None):
    record = OdometryRecord(robot("omniman").wheels, PRESENT, Accuracy())
    poses = TopicPoses("mocap", lambda: fake.true_pose)
    if measure is not None:
        poses.measure = measure
    return OdometryExperiment(fake, Progress(io.StringIO()), poses, SPEEDS, REACH, record)


def test_all_runs_and_the_check_are_recorded_and_can_be_fitted():
    experiment = make_experiment(FakeRobot())
    experiment.drive_all(TARGETS)
    record = experiment.record
    assert len(record.runs) == len(TARGETS) and None not in record.poses
    assert record.poses[-1] == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    found = identify(record.campaign, PRESENT).parameters
    np.testing.assert_allclose(found.correction, TRUE.correction, atol=1e-6)
    forward = forward_matrix(record.wheels, TRUE)
    end = integrate(forward, record.check.positions, record.check.start)[-1]
    assert record.check.end[:2] == pytest.approx(tuple(end[:2]), abs=1e-9)
    assert record.check.truth[-1, 1:] == pytest.approx(record.check.end)


def test_a_run_whose_pose_is_not_measured_goes_on_from_the_odometry(capsys):
    experiment = make_experiment(FakeRobot(), measure=lambda run, expected: None)
    experiment.drive_all(TARGETS[:2])
    assert experiment.record.poses == ((0.0, 0.0, 0.0), None, None)
    assert experiment.record.check is None
    text = capsys.readouterr().out
    assert text.count("skipped") == 2 and "no check" in text


def test_some_runs_may_be_cancelled_on_the_way():
    fake = FakeRobot()
    fake.cancels = lambda name: name.startswith("2 ")
    experiment = make_experiment(fake)
    experiment.drive_all(TARGETS[:3])
    assert len(experiment.record.runs) == 3 and experiment.record.check is not None


def test_too_many_cancelled_runs_end_it():
    fake = FakeRobot()
    fake.cancels = lambda name: True
    experiment = make_experiment(fake)
    with pytest.raises(CommandError, match=f"and {MAX_CANCELLED_RUNS} before it were cancelled"):
        experiment.drive_all(TARGETS)
    assert len(experiment.record.runs) == MAX_CANCELLED_RUNS


def test_the_expected_duration_grows_with_the_reach():
    short, long = (expected_duration(len(TARGETS), reach, SPEEDS) for reach in (0.5, 1.0))
    assert 60.0 < short < long
