"""The detector of a held robot, on wheels and torques that the tests make up."""

import math

import numpy as np
import pytest

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.held_robot import (
    MAX_REPORT_GAP,
    HeldRobotDetector,
    HeldRobotParameters,
    Persistence,
)
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.parameters import build
from test import robots
from test.control.rig import Rig

DT = 0.005
FORWARD, SIDEWAYS, TURN = np.eye(3)
OBLIQUE = np.array([0.6, -0.8, 0.0])


class Push:
    """A robot at a steady twist whose motors give more than the motion needs."""

    def __init__(self, name="omniman", **changes):
        robot = robots.robot(name)
        given = {f"held.{key}": value for key, value in changes.items()}
        self.parameters = build(HeldRobotParameters, given, "held.")
        self.kinematics = PlatformKinematics(robot.wheels)
        self.dynamics = PlatformDynamics(robot, self.kinematics)
        self.detector = HeldRobotDetector(self.parameters, self.kinematics, self.dynamics)
        self.time = 0.0

    def torque(self, twist, surplus):
        """Return the torques (n,) for a steady twist and a surplus wrench (3,)."""
        friction = self.dynamics.friction_torque(twist, self.kinematics.J @ twist)
        return friction + self.kinematics.J_pinv.T @ surplus

    def run(self, twist, surplus, seconds):
        """Return the time after which the robot counts as held, and why; or None and ''."""
        begin, torque = self.time, self.torque(twist, surplus)
        for _ in range(round(seconds / DT)):
            self.time += DT
            self.detector.update_wheels(self.time, self.kinematics.J @ twist, torque)
            reason = self.detector.check(DT)
            if reason:
                return self.time - begin, reason
        return None, ""


@pytest.mark.parametrize("direction", [FORWARD, -FORWARD, SIDEWAYS, OBLIQUE, TURN, -TURN])
@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_a_push_above_the_threshold_is_noticed_whether_the_wheels_turn_or_stand(direction, speed):
    push = Push()
    p = push.parameters
    twist, limit = speed * direction, p.torque if direction[2] else p.force
    assert push.run(twist, 0.9 * limit * direction, 2.0) == (None, "")
    found, reason = push.run(twist, 2.0 * limit * direction, 1.0)
    assert reason.startswith("the robot is held: its motors ")
    assert p.time < found < p.time + 0.3


def test_the_reason_says_what_the_motors_give_and_what_the_motion_explains():
    push = Push()
    friction = push.kinematics.J.T @ push.torque(0.3 * FORWARD, np.zeros(3))
    _, reason = push.run(0.3 * FORWARD, 400.0 * FORWARD, 1.0)
    words = reason.replace(",", "").split()
    given, explained = (float(word) for word in words if word.lstrip("-").isdigit())
    assert given == pytest.approx(explained + 390.0, abs=20.0)
    assert explained == pytest.approx(friction[0], abs=5.0)


def test_a_push_shorter_than_the_time_is_no_sign():
    push = Push(time=0.5)
    assert push.run(0.3 * FORWARD, 300.0 * FORWARD, 0.4) == (None, "")
    assert push.run(0.3 * FORWARD, np.zeros(3), 1.0) == (None, "")
    assert push.run(0.3 * FORWARD, 300.0 * FORWARD, 0.4) == (None, "")


def test_motors_that_give_less_than_the_motion_needs_hold_nothing():
    """On blocks, downhill or in a skid, the motion is harder to explain, but nobody holds it."""
    push = Push()
    assert push.run(0.3 * FORWARD, -30.0 * FORWARD, 2.0) == (None, "")
    decelerating = push.torque(0.3 * FORWARD, 10.0 * FORWARD)
    for k in range(200):
        push.time += DT
        speeds = push.kinematics.J @ ((1.2 - k * DT * 1.2) * FORWARD)
        push.detector.update_wheels(push.time, speeds, decelerating)
        assert push.detector.check(DT) == ""


def test_a_clear_lets_every_sign_last_anew():
    push = Push()
    push.run(0.3 * FORWARD, 200.0 * FORWARD, 0.3)
    push.detector.clear()
    found, _ = push.run(0.3 * FORWARD, 200.0 * FORWARD, 1.0)
    assert found >= push.parameters.time


@pytest.mark.parametrize("effort", [None, [math.nan] * 4, [1e300] * 4, [math.inf, 0.0, 0.0, 0.0]])
def test_without_torques_nothing_is_known_and_the_estimate_begins_anew(effort):
    push = Push()
    push.run(0.3 * FORWARD, 200.0 * FORWARD, 0.25)
    given = None if effort is None else np.array(effort)
    push.time += DT
    push.detector.update_wheels(push.time, push.kinematics.J @ (0.3 * FORWARD), given)
    assert not push.detector.torque_reported
    assert not push.detector.observer.external.any()
    assert push.run(0.3 * FORWARD, 200.0 * FORWARD, 1.0)[0] is not None


def test_the_estimate_begins_anew_after_a_gap():
    push = Push()
    push.run(0.0 * FORWARD, 300.0 * FORWARD, 0.2)
    push.time += 2.0 * MAX_REPORT_GAP
    push.detector.update_wheels(push.time, np.zeros(4), np.zeros(4))
    assert not push.detector.observer.motors.any()


def test_persistence_runs_backwards_while_the_condition_is_false():
    persistence = Persistence()
    assert persistence.update(True, 0.2) == pytest.approx(0.2)
    assert persistence.update(False, 0.05) == pytest.approx(0.15)
    assert persistence.update(False, 1.0) == 0.0
    persistence.update(True, 0.3)
    persistence.clear()
    assert persistence.update(True, 0.1) == pytest.approx(0.1)


# ---- in the controller ----------------------------------------------------------------------


def held_rig(**changes):
    """Return a rig in motion whose motors have begun to push with 300 N more than needed."""
    rig = Rig(changes={f"held.{key}": value for key, value in changes.items()})
    rig.run(0.1)
    rig.effort = rig.torques
    rig.cruise(0.3, 0.0, 0.0)
    surplus = rig.core.cascade.kinematics.J_pinv.T @ (300.0 * FORWARD)
    rig.effort = lambda: rig.torques() + surplus
    return rig


def test_a_held_robot_stops_latched_within_the_deceleration_limit():
    rig = held_rig()
    rig.run(1.0, lambda: rig.twist(0.3, 0.0, 0.0))
    status = rig.core.latch.status
    assert rig.core.held
    assert status.reason.startswith("the robot is held: its motors push with 3")
    assert status.reason.endswith("; all wheels turn")
    speeds = np.array(rig.setpoints)[:, 0]
    assert speeds[-1] == 0.0 and rig.still
    limit = rig.core.parameters.limits.linear_deceleration
    assert np.diff(speeds).min() >= -limit * DT * 1.001
    rig.effort = rig.torques
    rig.run(2.0, lambda: rig.twist(0.3, 0.0, 0.0))
    assert rig.still, "nothing restarts by itself"
    rig.run(1.5)  # the stream is silent
    rig.core.reset(rig.now)
    assert rig.still and not rig.core.held
    rig.cruise(0.3, 0.0, 0.0)
    assert rig.core.latch.released and not rig.still


def test_a_robot_that_need_not_stop_drives_on_and_shows_the_force():
    rig = held_rig(stop=False)
    rig.cruise(0.3, 0.0, 0.0, seconds=1.0)
    assert rig.core.latch.released and rig.core.held
    assert rig.core.held_robot.observer.external[0] == pytest.approx(-300.0, abs=10.0)


def test_who_leans_against_a_resting_robot_stops_nothing():
    rig = held_rig()
    rig.core.latch.stop("test")
    rig.run(1.5)
    rig.core.reset(rig.now)
    rig.run(1.0, lambda: rig.twist(0.0, 0.0, 0.0))
    assert rig.core.latch.released
    assert rig.core.held_robot.observer.external[0] < -200.0


# ---- by an inertial sensor --------------------------------------------------------------------


class Sensed(Rig):
    """A rig with a sensor that shows the motion of the wheels, or less of it."""

    def __init__(self, **changes):
        super().__init__(changes={f"held.{key}": value for key, value in changes.items()})
        self.fraction = np.ones(3)
        self._velocity = np.zeros(3)
        self.hooked = self.drive
        self.drive = self.measured

    def measured(self, command):
        """Return the wheels' speeds; the sensor measures the platform's motion with them."""
        speeds = self.hooked(command)
        velocity = self.fraction * (self.core.cascade.kinematics.J_pinv @ speeds)
        vx, vy, w = velocity
        change = (velocity - self._velocity)[:2] / DT + [-w * vy, w * vx]
        self._velocity = velocity
        force = np.array([*change, 9.81]) + 1e-6 * math.sin(self.now)
        self.core.imu.update(self.now + DT, self.now + DT, np.array([0.0, 0.0, w]), force)
        return speeds


def test_a_sensor_that_agrees_with_the_wheels_is_no_alarm():
    rig = Sensed().cruise(0.8, 0.0, 0.5).cruise(-0.5, 0.3, -1.0)
    assert rig.core.latch.released, rig.core.latch.status


def test_wheels_that_turn_a_robot_that_stands_are_noticed_without_torques():
    rig = Sensed().cruise(0.0, 0.0, 0.4)
    rig.fraction = np.zeros(3)
    begin = rig.now
    while rig.core.latch.released and rig.now < begin + 1.0:
        rig.run(DT, lambda: rig.twist(0.0, 0.0, 0.4))
    assert rig.core.latch.status.reason == (
        "the robot is held: its wheels turn it by 0.39 rad/s that imu does not show; "
        "all wheels turn"
    )
    assert rig.now - begin < 0.6


def test_a_collision_is_noticed_at_once_without_torques():
    rig = Sensed().cruise(0.5, 0.0, 0.0)
    rig.fraction = np.zeros(3)
    rig.run(0.1, lambda: rig.twist(0.5, 0.0, 0.0))
    assert "it has lost 0.49 m/s" in rig.core.latch.status.reason, "0.5 m/s, 15 ms ago"


@pytest.mark.parametrize(
    ("name", "twist"), [("yaw_rate", (0.0, 0.0, 0.4)), ("speed", (0.5, 0.0, 0.0))]
)
def test_each_threshold_of_the_sensor_counts(name, twist):
    rig = Sensed(**{name: 1.0}).cruise(*twist)
    rig.fraction = np.zeros(3)
    rig.run(1.0, lambda: rig.twist(*twist))
    assert rig.core.latch.released, rig.core.latch.status


def test_a_slip_of_a_few_milliseconds_is_no_collision():
    """Rollers that slip while the robot reverses show as 0.2 m/s for a tick."""
    detector = Sensed().core.held_robot
    detector.comparison.velocity = np.array([0.3, 0.0])
    assert detector.check(0.005) == detector.check(0.005) == ""
    detector.comparison.velocity = np.zeros(2)
    assert detector.check(0.005) == ""
    detector.comparison.velocity = np.array([0.3, 0.0])
    assert detector.check(0.005) == ""
    assert "it has lost 0.30 m/s" in [detector.check(0.005) for _ in range(3)][-1]
