"""Motion commands, their target trajectories, and the joints that follow the target."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.motion import MoveJ, ServoJ, SpeedJ, StopJ, Target
from omniman_ros.simulation.ur.safety_checks import SafetyChecks

DT = 0.008


def run(motion, target, seconds=10.0):
    """Return positions and speeds of joint 0 until the command ends."""
    track = []
    for _ in range(round(seconds / DT)):
        if motion.over:
            break
        motion.advance(target, DT)
        track.append((float(target.q[0]), float(target.w[0])))
    return np.array(track)


def joint(value):
    return np.array([value, 0, 0, 0, 0, 0], dtype=float)


@pytest.mark.parametrize(
    ("lookahead", "gain"), [(0.03, 2000), (0.1, 300), (0.2, 100), (0.2, 2000)]
)
def test_servoj_lags_by_its_lookahead_time(lookahead, gain):
    target, speed = Target(np.zeros(6)), 0.5
    for k in range(500):
        ServoJ(joint(speed * DT * (k + 1)), DT, lookahead, gain).advance(target, DT)
    assert target.w[0] == pytest.approx(speed, rel=1e-3)
    assert speed * DT * 500 - target.q[0] == pytest.approx(speed * lookahead, rel=1e-3)


def test_higher_gain_follows_faster():
    def after(gain):
        target = Target(np.zeros(6))
        for _ in range(10):
            ServoJ(joint(0.1), DT, 0.1, gain).advance(target, DT)
        return target.q[0]

    assert 0.0 < after(100) < after(300) < after(2000) < 0.1


def test_servoj_lasts_for_its_time():
    assert len(run(ServoJ(joint(0.1), 0.04, 0.1, 300), Target(np.zeros(6)))) == 5


def test_stopj_decelerates_all_joints_in_proportion():
    target = Target(np.zeros(6), np.array([1.0, -0.5, 0, 0, 0, 0]))
    motion = StopJ(2.0)
    track = run(motion, target)
    assert len(track) * DT == pytest.approx(0.5, abs=2 * DT)
    assert np.all(np.abs(np.diff(track[:, 1])) <= 2.0 * DT + 1e-9)
    assert target.q[0] == pytest.approx(0.25, abs=0.01)
    assert target.q[1] == pytest.approx(-0.5 * target.q[0])


def test_speedj_accelerates_and_lasts_its_time():
    target = Target(np.zeros(6))
    track = run(SpeedJ(joint(0.4), 1.0, 1.0), target)
    assert len(track) == 125
    assert np.all(np.diff(track[:, 1]) <= 1.0 * DT + 1e-9)
    assert track[49, 1] == pytest.approx(0.4) and track[-1, 1] == pytest.approx(0.4)


def test_speedj_without_a_time_ends_at_the_target_speed():
    track = run(SpeedJ(joint(0.4), 1.0, 0.0), Target(np.zeros(6)))
    assert len(track) == 50


@pytest.mark.parametrize(("way", "peak"), [(1.0, 0.5), (-1.0, -0.5), (0.1, 0.3162)])
def test_movej_has_a_trapezoidal_speed_profile(way, peak):
    target = Target(np.zeros(6))
    track = run(MoveJ(joint(way), 1.0, 0.5, 0.0), target)
    assert target.q[0] == pytest.approx(way, abs=1e-9)
    assert not target.w.any()
    fastest = track[np.argmax(np.abs(track[:, 1])), 1]
    assert fastest == pytest.approx(peak, abs=0.01)
    assert np.all(np.abs(np.diff(track[:-1, 1], prepend=0.0)) <= 1.0 * DT + 1e-9)
    assert abs(track[-2, 1]) <= 1.6 * DT  # the last cycle covers the remainder
    time = 2 * math.sqrt(0.1) if abs(way) == 0.1 else 2.5
    assert len(track) * DT == pytest.approx(time, abs=0.06)


@pytest.mark.parametrize("t", [1.0, 3.0])
def test_movej_takes_the_given_time(t):
    track = run(MoveJ(joint(1.0), 2.0, 9.0, t), Target(np.zeros(6)))
    assert len(track) * DT == pytest.approx(t, abs=0.06)


def test_all_joints_of_a_movej_arrive_together():
    target = Target(np.zeros(6))
    motion = MoveJ(np.array([1.0, 0.5, 0, 0, 0, -0.2]), 1.0, 0.5, 0.0)
    while not motion.over:
        motion.advance(target, DT)
        assert target.q[1] == pytest.approx(target.q[0] / 2)
        assert target.q[5] == pytest.approx(-target.q[0] / 5)


def test_movej_of_a_moving_arm_stops_it_first():
    target = Target(np.zeros(6), joint(-0.5))
    track = run(MoveJ(joint(0.2), 1.0, 0.5, 0.0), target)
    assert np.all(np.abs(np.diff(track[:-1, 1], prepend=-0.5)) <= 1.0 * DT + 1e-9)
    assert target.q[0] == pytest.approx(0.2)


def test_movej_continues_after_an_interruption():
    target, motion = Target(np.zeros(6)), MoveJ(joint(1.0), 1.0, 0.5, 0.0)
    run(motion, target, 0.8)
    target.w = np.zeros(6)
    motion.restart()
    track = run(motion, target)
    assert track[0, 1] <= 1.0 * DT * 1.01
    assert target.q[0] == pytest.approx(1.0)


def arm(**changes):
    return SimulatedArm(UrArmParameters(initial=(0.0,) * 6, **changes))


def test_joints_lag_behind_their_target():
    joints, speed = arm(), 1.0
    for k in range(250):
        joints.follow(joint(speed * DT * (k + 1)), DT)
    assert joints.qd[0] == pytest.approx(speed, rel=1e-3)
    assert speed * DT * 250 - joints.q[0] == pytest.approx(speed * 0.01, rel=0.01)


def test_joints_accelerate_within_their_capability():
    joints = arm()
    speeds = [0.0]
    for _ in range(300):
        joints.follow(joint(0.5), DT)
        speeds.append(float(joints.qd[0]))
    assert np.max(np.abs(np.diff(speeds))) <= 40.0 * DT + 1e-9
    assert joints.q[0] == pytest.approx(0.5, abs=1e-3)


def test_joints_brake_on_their_path():
    joints = arm()
    joints.qd = np.array([3.0, -1.5, 0, 0, 0, 0])
    took = 0
    while not joints.still:
        before = joints.qd
        joints.brake(DT)
        assert np.max(np.abs(joints.qd - before)) <= 15.0 * DT + 1e-9
        took += 1
    assert took * DT == pytest.approx(0.2, abs=2 * DT)
    assert joints.q[1] == pytest.approx(-joints.q[0] / 2)


@pytest.mark.parametrize(
    ("q", "qd", "off", "name"),
    [
        (6.34, 0.1, 0, "position"),
        (-6.34, -0.1, 0, "position"),
        (0, 3.35, 0, "speed"),
        (0, -3.35, 0, "speed"),
        (0, 0, 0.11, "deviation"),
        (0, 0, -0.11, "deviation"),
        (0, 0, math.nan, "deviation"),
    ],
)
def test_violation_of_a_joint_limit_is_reported(q, qd, off, name):
    joints = arm()
    joints.q, joints.qd = joint(q), joint(qd)
    violation = SafetyChecks(joints.parameters).violation(joints, joints.q + joint(off))
    assert violation.reason.startswith(f"{name} of joint 0")
    assert violation.is_hindered == (name == "deviation")


@pytest.mark.parametrize(("q", "qd", "off"), [(6.33, 3.33, 0.09), (6.34, -0.1, 0), (6.34, 0, 0)])
def test_joint_within_its_limits_or_returning_is_no_violation(q, qd, off):
    joints = arm()
    joints.q, joints.qd = joint(q), joint(qd)
    assert SafetyChecks(joints.parameters).violation(joints, joints.q + joint(off)) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"initial": (0.0,) * 5},
        {"initial": (6.0,) * 6, "range": 5.0},
        {"protective_deceleration": 40.0, "acceleration": 30.0},
        {"collision_torque": (40.0,)},
    ],
)
def test_invalid_parameters_are_rejected(changes):
    with pytest.raises(ParameterError):
        UrArmParameters(**changes)
