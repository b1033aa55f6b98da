"""The odometry without a controller, against the controller's own and by itself."""

import math

import numpy as np
import pytest

from omniman_ros.control.wheel_feedback import MAX_GAP
from omniman_ros.control.wheel_odometry import (
    REST_TIME,
    WheelOdometry,
    WheelOdometryParameters,
)
from omniman_ros.core import se2
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build, flatten, specs
from test import robots
from test.control.rig import DT, START, Rig
from test.tiers import representative

CALIBRATION = {"odometry.scale_y": 0.97, "odometry.yaw_per_x": 0.01}
TURNING = (2.0, 3.0, 1.0, 5.0)  #: Speeds of wheels that slip [rad/s]
GAP = MAX_GAP + 0.2


def parameters(robot="omniman", changes=None):
    return build(WheelOdometryParameters, robots.values(robot, changes))


def odometry(robot="omniman", changes=None):
    return WheelOdometry(parameters(robot, changes))


class Twin(Rig):
    """A controller whose reports go to an odometry of its own, too."""

    def __init__(self, robot="omniman", changes=None):
        super().__init__(robot, changes)
        self.apart = odometry(robot, changes)
        self.apart.leave_out(self.core.cascade.kinematics.idle)
        self.equal = []

    def report(self):
        told = super().report()
        effort = self.effort()
        self.apart.update_wheels(self.now, self.now, self.position.copy(), self.speed, effort)
        ours, theirs = self.apart.odometry, self.core.odometry
        self.equal.append(
            ours.pose == theirs.pose
            and np.array_equal(ours.twist, theirs.twist)
            and np.array_equal(ours.covariance, theirs.covariance)
            and np.array_equal(ours.constraint_rate, theirs.constraint_rate)
            and ours.slipping == theirs.slipping
        )
        return told


def uneven(command):
    """Return the speeds of drives that follow with errors of their own, so that wheels slip."""
    speeds = np.array(command.velocity)
    return speeds * (1.0 + 0.05 * np.sin(np.arange(len(speeds)) + 1.0))


def feed(core, seconds=0.5, speeds=TURNING, start=START, now=None, position=0.0):
    """Feed reports of wheels at constant speeds; return the time of the last one."""
    speeds = np.array(speeds, dtype=float)
    offset = 0.0 if now is None else now - start
    count = round(seconds / DT)
    for k in range(count + 1):
        time = start + k * DT
        core.update_wheels(time, time + offset, position + k * DT * speeds, speeds)
    return start + count * DT


def test_random_drives_give_the_odometry_of_the_controller_bit_for_bit():
    rng = np.random.default_rng(11)
    for robot in ("omniman", "omni3", "mecanum6"):
        n = robots.robot(robot).wheel_count
        changes = CALIBRATION | {"odometry.wheel_scale": rng.uniform(0.95, 1.05, n).tolist()}
        twin = Twin(robot, changes)
        twin.drive = uneven
        for _ in range(8):
            twin.cruise(*(0.4 * rng.uniform(-1, 1, 3)), seconds=0.4)
        assert len(twin.equal) == 640 and all(twin.equal), robot
        assert math.hypot(*twin.core.odometry.pose[:2]) > 0.01


def test_coupling_error_is_that_of_the_controller_from_a_start_through_a_reversal():
    twin = Twin()
    twin.drive = uneven
    twin.run(0.1)
    twin.cruise(0.4, 0.1, 0.1, seconds=1.5).cruise(-0.4, -0.1, -0.1, seconds=2.0)
    assert np.abs(twin.core.coupling_error).max() > 1e-3
    assert twin.apart.coupling_error == pytest.approx(twin.core.coupling_error, abs=1e-4)


def test_coupling_error_starts_from_zero_again_once_the_wheels_rest():
    core = odometry()
    end = feed(core)
    assert np.abs(core.coupling_error).max() > 0.1
    position = 0.5 * np.array(TURNING)
    rest = {"speeds": np.zeros(4), "position": position}
    end = feed(core, REST_TIME - 4 * DT, start=end + DT, **rest)
    assert core.coupling_error.any(), "reset before the wheels had rested"
    feed(core, 8 * DT, start=end + DT, **rest)
    assert not core.coupling_error.any()


@pytest.mark.parametrize("wheel", representative(range(4), every=2))
def test_without_a_dead_wheel_it_agrees_with_the_controller(wheel):
    name = robots.robot().wheels.names[wheel]
    twin = Twin(changes={"drive.dead": (name,)})

    def dead(command):
        speeds = uneven(command)
        speeds[wheel] = 0.3  # the floor rotates it somehow
        return speeds

    twin.drive = dead
    twin.cruise(0.3, 0.1, 0.2, seconds=1.0)
    assert twin.apart.idle == (wheel,) and all(twin.equal)
    whole = odometry()
    twin.apart.leave_out(())
    assert twin.apart.idle == whole.idle == ()


def test_leaving_wheels_out_that_are_needed_is_refused_and_changes_nothing():
    core = odometry("omni3")
    speeds = (1.0, 2.0, 3.0)
    end = feed(core, speeds=speeds)
    pose = core.odometry.pose
    with pytest.raises(InputError, match="do not determine the twist"):
        core.leave_out((1,))
    assert core.idle == () and core.odometry.pose == pose
    other = odometry("omni3")
    feed(other, speeds=speeds)
    for each in (core, other):
        feed(each, speeds=speeds, start=end + DT, position=0.5 * np.array(speeds))
    assert core.odometry.pose == other.odometry.pose


# ---- time ---------------------------------------------------------------------------------------


def test_a_single_report_from_the_past_is_refused():
    core = odometry()
    end = feed(core)
    pose = core.odometry.pose
    with pytest.raises(InputError, match="out of order"):
        core.update_wheels(end - 3.0, end + DT, np.zeros(4), np.zeros(4))
    assert core.odometry.pose == pose and core.feedback.time == end


def test_where_time_goes_back_the_pose_continues():
    core = odometry()
    feed(core)
    once = core.odometry.pose
    begin = START - 900.0
    told = core.update_wheels(begin, begin, np.zeros(4), np.array(TURNING))
    assert "time went back" in told
    assert core.odometry.pose == once and not core.coupling_error.any()
    feed(core, 0.5 - DT, start=begin + DT, position=DT * np.array(TURNING))
    x, y, theta = once
    twice = np.array(once) + se2.to_world(theta, np.array([x, y, theta]))
    assert core.odometry.pose == pytest.approx(twice, abs=1e-9)


def test_stamps_that_go_back_on_a_clock_that_does_not_are_accepted_after_the_largest_gap():
    """A recording that is played in a loop on the steady clock."""
    core = odometry()
    end = feed(core, 4.0 * MAX_GAP)
    pose = core.odometry.pose
    refused = 0
    for k in range(round(2.0 * MAX_GAP / DT)):
        try:
            core.update_wheels(START + k * DT, end + (k + 1) * DT, np.full(4, k * DT), np.ones(4))
        except InputError:
            refused += 1
    assert refused * DT == pytest.approx(MAX_GAP, abs=2 * DT)
    moved = np.linalg.norm(np.array(core.odometry.pose) - pose)
    assert 0.0 < moved < 0.5 * 0.2


def test_a_gap_in_a_steady_motion_leaves_the_pose_right_and_its_way_uncertain():
    begun, whole = odometry(), odometry()
    end = feed(begun)
    feed(whole, end - START + GAP)
    speeds = np.array(TURNING)
    told = begun.update_wheels(end + GAP, end + GAP, (end + GAP - START) * speeds, speeds)
    assert "no report" in told
    assert begun.odometry.pose == pytest.approx(whole.odometry.pose, abs=1e-9)
    more = begun.odometry.covariance - whole.odometry.covariance
    assert more[0, 0] > 1e-4 and more[1, 1] > 1e-4


def test_motion_in_a_gap_that_is_ignored_is_in_the_covariance():
    core = odometry()
    end = feed(core)
    pose, before = core.odometry.pose, core.odometry.covariance
    late = end + GAP
    told = core.update_wheels(late, late, np.full(4, 50.0), np.array(TURNING))
    assert "ignored" in told and core.odometry.pose == pose
    more = np.sqrt(np.diag(core.odometry.covariance - before))
    twist = core.odometry.twist
    assert (more >= 0.99 * GAP * np.abs([np.hypot(*twist[:2]) / 2**0.5] * 2 + [twist[2]])).all()


# ---- parameters ---------------------------------------------------------------------------------

OTHERS = ("body.", "arm.", "motor.", "friction.", "wheels.inertia", "wheels.names", "imu.")
CHANGED = {
    "odometry.encoder_span": 0.5,
    "odometry.slip_threshold": 10.0,
    "motor.max_speed": 0.02,
    "wheels.roller_angle": (-0.7, 0.7, 0.7, -0.7),
    "wheels.heading": (0.1,) * 4,
}
OURS = [
    s
    for s in specs(WheelOdometryParameters)
    if s.name == "motor.max_speed" or not s.name.startswith(OTHERS)
]


def tour(changes):
    """Return all that the odometry knows after a drive with slip and a large last step."""
    core = odometry(changes=changes)
    end = feed(core)
    speeds = np.array(TURNING)
    core.update_wheels(end + DT, end + DT, 0.5 * speeds + 0.35, speeds)
    o = core.odometry
    return (*o.pose, *o.covariance.ravel(), *o.twist, *core.coupling_error, o.slipping)


@pytest.mark.parametrize("spec", representative(OURS, every=4), ids=lambda s: s.name)
def test_each_parameter_changes_the_odometry(spec):
    value = flatten(parameters())[spec.name]
    if spec.name in CHANGED:
        other = CHANGED[spec.name]
    elif spec.kind is tuple:
        other = tuple(1.1 * v + 0.01 * (i + 1) for i, v in enumerate(value))
    else:
        other = 1.3 * value + 0.02
    assert tour({spec.name: other}) != tour({})


def test_a_new_calibration_counts_from_then_on():
    core = odometry()
    end = feed(core)
    x, y, theta = core.odometry.pose
    changes = {"odometry.scale_yaw": 2.0, "odometry.wheel_scale": (1.1,)}
    core.configure(parameters(changes=changes))
    assert core.odometry.pose == (x, y, theta)
    feed(core, start=end + DT, position=(0.5 + DT) * np.array(TURNING))
    gained = core.odometry.pose[2] - theta
    assert gained == pytest.approx(2.2 * theta * 101 / 100, rel=1e-9)


def test_the_number_of_wheel_scales_is_checked():
    with pytest.raises(ParameterError, match=r"odometry.wheel_scale.*2 values, 4 wheels"):
        parameters(changes={"odometry.wheel_scale": (1.0, 1.0)})
