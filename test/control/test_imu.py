"""Measurements of an inertial sensor: validation, faults, and their use in the odometry."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.held_robot import MotionComparison
from omniman_ros.control.imu import FROZEN_TIME, NONE_YET, ImuFeedback, ImuParameters
from omniman_ros.control.odometry import Odometry, OdometryParameters, PoseCovariance
from omniman_ros.core.errors import InputError
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import build
from omniman_ros.simulation.plant.imu import (
    ImuSensorParameters,
    SimulatedImu,
    planar_motion,
)
from test import robots

DT = 0.005
UP = np.array([0.0, 0.0, 9.81])
STANDING, TURNING = np.zeros(4), np.full(4, 3.0)
IDEAL = {"gyro_noise": 0.0, "gyro_bias": 0.0, "gyro_drift": 0.0}
STILL = {"acceleration_noise": 0.0, "acceleration_bias": 0.0}


def parameters(**changes):
    return build(ImuParameters, {f"imu.{name}": value for name, value in changes.items()}, "imu.")


def yaw(rate):
    return np.array([0.0, 0.0, rate])


class Drive:
    """An odometry and a sensor that moves with a twist; the wheels report what the test says."""

    def __init__(self, sensor=None, mount=None, **changes):
        self.kinematics = robots.kinematics()
        self.odometry = Odometry(self.kinematics, OdometryParameters())
        place = build(ImuMount, {f"imu.{k}": v for k, v in (mount or {}).items()}, "imu.")
        self.feedback = ImuFeedback(parameters(**(mount or {}), **changes))
        given = {f"s.{name}": value for name, value in (sensor or {}).items()}
        self.sensor = SimulatedImu(place, build(ImuSensorParameters, given, "s."), 9.81, seed=2)
        self.comparison = MotionComparison()
        self.time = 0.0
        self.heading = 0.0

    def go(self, twist, seconds, wheels=None, rate=0.0):
        """Move with a twist (3,) that changes by `rate` per second; the wheels say `wheels`."""
        for k in range(1, round(seconds / DT) + 1):
            now = np.asarray(twist) + np.asarray(rate) * k * DT
            self.time += DT
            self.heading += DT * float(now[2])
            if k % 2 == 0:
                measured = self.sensor.measure(self.time, planar_motion(now))
                if measured is not None:
                    self.feedback.update(self.time, self.time, *measured)
            speeds = self.kinematics.J @ (now if wheels is None else np.asarray(wheels))
            inertial = self.feedback.take(self.time, self.time, speeds)
            self.odometry.update(speeds * DT, speeds, DT, inertial)
            self.comparison.update(DT, self.odometry, inertial)
        return self

    @property
    def error(self):
        return self.odometry.pose[2] - self.heading


# ---- fusion -----------------------------------------------------------------------------------


def test_the_heading_follows_the_yaw_rate_where_the_wheels_are_wrong():
    drive = Drive().go(np.zeros(3), 3.0)
    drive.go((0.2, 0.0, 0.5), 8.0, wheels=(0.2, 0.0, 0.53))
    assert abs(drive.error) < 0.01, "the wheels alone would be 0.24 rad off"
    assert drive.odometry.twist[2] == pytest.approx(0.5, abs=0.02)
    assert drive.odometry.wheel_twist[2] == pytest.approx(0.53)


def test_the_bias_is_learned_at_rest_only():
    drive = Drive({"gyro_bias": 0.03}).go(np.zeros(3), 4.0)
    assert drive.odometry.yaw_bias == pytest.approx(0.03, abs=1e-3)
    known = drive.odometry.yaw_bias
    drive.go((0.2, 0.0, 0.5), 5.0)
    assert drive.odometry.yaw_bias == known


def test_the_bias_is_not_drawn_to_zero():
    """Over many sensors, the mean error of the bias is that of the noise only."""
    errors = []
    for seed in range(12):
        drive = Drive({"gyro_bias": 0.005, "gyro_drift": 0.0})
        drive.sensor._random = np.random.default_rng(seed)
        errors.append(drive.go(np.zeros(3), 1.7).odometry.yaw_bias - 0.005)
    assert abs(np.mean(errors)) < 1.5e-4


def test_a_bias_that_is_found_later_corrects_the_heading_before():
    """The filter knows that heading and bias were wrong together."""
    drive = Drive({"gyro_bias": 0.01, "gyro_noise": 0.0, "gyro_drift": 0.0})
    drive.go((0.3, 0.0, 0.2), 10.0)
    assert drive.error == pytest.approx(0.1, abs=0.005)
    drive.go(np.zeros(3), 5.0)
    assert abs(drive.error) < 0.01


def test_the_covariance_covers_the_error():
    """Normalised errors of the heading over random drives have the variance that is claimed."""
    ratios = []
    for seed in range(12):
        drive = Drive({"gyro_bias": 0.0, "gyro_noise": 0.003, "gyro_drift": 2e-5})
        drive.sensor._random = np.random.default_rng(seed)
        drive.go(np.zeros(3), 1.0).go((0.2, 0.0, 0.3), 4.0)
        variance = drive.odometry.covariance[2, 2]
        ratios.append(drive.error**2 / variance)
    assert 0.02 < np.mean(ratios) < 2.0


def test_a_robot_that_is_turned_with_wheels_at_rest_turns():
    drive = Drive().go(np.zeros(3), 2.0)
    drive.go((0.0, 0.0, 0.4), 2.0, wheels=np.zeros(3))
    assert abs(drive.error) < 0.02


def test_the_wheels_take_over_without_the_sensor():
    drive = Drive(IDEAL).go(np.zeros(3), 2.0).go((0.2, 0.0, 0.3), 2.0)
    before = drive.odometry.covariance[2, 2]
    drive.sensor.configure(ImuMount(), replace(build(ImuSensorParameters, {}), silent=True), 9.81)
    drive.go((0.2, 0.0, 0.3), 2.0)
    assert drive.feedback.fault.startswith("imu silent for ")
    assert drive.error == pytest.approx(0.0, abs=0.002)
    assert drive.odometry.covariance[2, 2] > before + 5e-4, "that of the wheels"
    drive.sensor.configure(ImuMount(), build(ImuSensorParameters, {}), 9.81)
    drive.go((0.2, 0.0, 0.3), 1.0, wheels=(0.2, 0.0, 0.4))
    assert drive.feedback.fault == "" and abs(drive.error) < 0.05


def test_the_matrix_is_that_of_the_written_filter():
    """Prediction and update against matrices."""
    rng = np.random.default_rng(1)
    covariance = PoseCovariance()
    start = rng.normal(size=(3, 3))
    covariance.set_pose(start @ start.T)
    covariance.set_bias(0.04)
    expected = np.zeros((4, 4))
    expected[:3, :3], expected[3, 3] = start @ start.T, 0.04
    for _ in range(20):
        east, north, dt = rng.normal(size=2).tolist() + [0.1]
        step, rate = np.eye(4), np.eye(4)
        step[0, 2], step[1, 2], rate[2, 3] = -north, east, -dt
        expected = step @ expected @ step.T + np.diag([0.1, 0.1, 0.02, 0.0])
        expected = rate @ expected @ rate.T + np.diag([0.0, 0.0, 0.0, 1e-3])
        covariance.propagate(east, north, 0.1, 0.02)
        covariance.rotate_by_rate(dt)
        covariance.drift(1e-3)
        gain = expected[:, 3] / (expected[3, 3] + 0.5)
        np.testing.assert_allclose(covariance.measure_bias(0.3, 0.5), 0.3 * gain)
        expected = expected - np.outer(gain, expected[3])
        np.testing.assert_allclose(covariance.matrix, expected)
        assert np.linalg.eigvalsh(covariance.matrix).min() > 0.0


# ---- accelerations ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "mount", [{}, {"x": 0.4, "y": -0.2, "yaw": 0.7}, {"yaw": math.pi}], ids=str
)
def test_the_sensor_explains_a_free_motion_wherever_it_is_mounted(mount):
    drive = Drive(IDEAL | STILL, mount).go(np.zeros(3), 1.0)
    rate = np.array([0.4, 0.2, 0.6])
    drive.go(np.zeros(3), 1.0, rate=rate).go(rate, 1.0).go(rate, 1.0, rate=-rate)
    assert np.abs(drive.comparison.velocity).max() < 0.01
    assert abs(drive.comparison.yaw_rate) < 0.02


def test_a_collision_is_a_loss_of_speed_that_the_wheels_do_not_show():
    drive = Drive().go(np.zeros(3), 2.0).go(np.zeros(3), 1.0, rate=(0.4, 0.0, 0.0))
    drive.go((0.4, 0.0, 0.0), 1.0)
    assert np.hypot(*drive.comparison.velocity) < 0.05
    drive.go((0.4, 0.0, 0.0), 0.04, wheels=(0.4, 0.0, 0.0), rate=(-10.0, 0.0, 0.0))
    assert drive.comparison.velocity[0] == pytest.approx(0.4, abs=0.08)


def test_tilt_and_bias_are_learned_at_rest():
    drive = Drive({"acceleration_bias": 0.5, "acceleration_noise": 0.02}).go(np.zeros(3), 6.0)
    drive.go((0.3, 0.0, 0.0), 0.05)
    drive.comparison.velocity = np.zeros(2)
    drive.go((0.3, 0.0, 0.0), 2.0)
    assert np.hypot(*drive.comparison.velocity) < 0.03


# ---- input --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "acceleration", "words"),
    [
        (yaw(math.nan), UP, "angular velocity"),
        (yaw(math.inf), UP, "angular velocity"),
        (yaw(1e4), UP, "angular velocity"),
        (yaw(0.1), UP * math.nan, "linear acceleration"),
        (yaw(0.1), UP * 1e9, "linear acceleration"),
    ],
)
def test_implausible_measurements_are_refused_and_change_nothing(rate, acceleration, words):
    feedback = ImuFeedback(parameters())
    with pytest.raises(InputError, match=words):
        feedback.update(1.0, 1.0, rate, acceleration)
    assert not feedback.received and feedback.take(1.0, 1.0, STANDING) is None
    assert feedback.fault == NONE_YET


def test_measurements_out_of_order_are_refused():
    feedback = ImuFeedback(parameters())
    feedback.update(1.0, 1.0, yaw(0.1), UP)
    for time in (1.0, 0.9):
        with pytest.raises(InputError, match="out of order"):
            feedback.update(time, 1.01, yaw(0.1), UP)


def test_a_stamp_from_the_future_counts_as_now():
    feedback = ImuFeedback(parameters(timeout=0.1))
    feedback.update(5.0, 1.0, yaw(0.1), UP)
    feedback.update(5.0, 1.05, yaw(0.1), UP)
    feedback.take(1.1, 1.1, STANDING)
    assert feedback.fault == ""
    feedback.take(1.3, 1.3, STANDING)
    assert "silent" in feedback.fault


def test_nothing_is_lost_or_counted_twice_between_measurements():
    rng = np.random.default_rng(0)
    feedback = ImuFeedback(parameters(timeout=10.0))
    total, time = 0.0, 0.0
    feedback.update(0.001, 0.001, yaw(0.0), UP)
    feedback.take(0.001, 0.001, TURNING)
    for _ in range(400):
        time += rng.uniform(0.001, 0.02)
        if rng.random() < 0.5:
            feedback.update(time + 0.001, time + 0.001, yaw(math.sin(time)), UP)
        else:
            step = feedback.take(time + 0.001, time + 0.001, TURNING)
            total += step.rotation
    feedback.update(time + 0.01, time + 0.01, yaw(math.sin(time)), UP)
    total += feedback.take(time + 0.01, time + 0.01, TURNING).rotation
    assert total == pytest.approx(1.0 - math.cos(time), abs=0.02)


def test_a_frozen_sensor_shows_while_the_wheels_turn():
    feedback = ImuFeedback(parameters())
    for k in range(1, 101):
        feedback.update(0.01 * k, 0.01 * k, yaw(0.02), UP)
        feedback.take(0.01 * k, 0.01 * k, TURNING if k > 50 else STANDING)
        assert ("frozen" in feedback.fault) == (k > 50), k
    feedback.update(1.01, 1.01, yaw(0.0201), UP)
    feedback.take(1.01, 1.01, TURNING)
    assert feedback.fault == ""
    assert FROZEN_TIME < 0.5


def test_after_a_clock_that_went_back_the_next_measurement_is_the_first():
    feedback = ImuFeedback(parameters())
    feedback.update(10.0, 10.0, yaw(0.1), UP)
    feedback.forget()
    assert feedback.take(1.0, 1.0, STANDING) is None and feedback.fault == NONE_YET
    feedback.update(1.0, 1.0, yaw(0.1), UP)
    assert feedback.take(1.0, 1.0, STANDING) is None and feedback.fault == ""
    assert feedback.take(1.01, 1.01, STANDING).rotation == pytest.approx(0.001)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x", 0.5),
        ("y", 0.5),
        ("yaw", 0.5),
        ("timeout", 0.005),
        ("gyro_noise", 0.1),
        ("gyro_drift", 0.1),
        ("gyro_bias", 0.5),
        ("noise_rotation", 0.1),
    ],
)
def test_each_parameter_changes_what_is_known(name, value):
    def known(changes):
        drive = Drive()
        drive.feedback.configure(parameters(**changes))
        drive.go(np.zeros(3), 0.5).go(np.zeros(3), 0.5, rate=(0.3, 0.1, 0.5))
        return (
            *drive.odometry.pose,
            *drive.odometry.covariance.ravel(),
            *drive.comparison.velocity,
        )

    assert known({name: value}) != known({})
