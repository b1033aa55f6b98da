"""Reference of a robot that keeps a station."""

import math

import numpy as np
import pytest

from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.motion.path.pace import LEAD
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.motion.station.parameters import StationParameters
from omniman_ros.robots import robot_parameters

PERIOD = 0.04
HORIZON = 0.4
OFFSET = (0.0, -1.3, 0.0)


class Rig:
    """A keeper whose robot follows its reference exactly, and a leader.

    Attributes:
        rows: Time, pose, velocity and acceleration of the reference, a tick each.
        distances: Distance of the two robots at these ticks [m].
    """

    def __init__(self, leader=(0.0, 0.0, 0.0), robot=(-2.0, -2.0, 0.0), noise=0.0, **changes):
        self.parameters = build(StationParameters, {**robot_parameters("omniman"), **changes})
        self.keeper = StationKeeper(self.parameters)
        self.time, self.leader, self.robot = 0.0, leader, robot
        self.noise, self.random = noise, np.random.default_rng(1)
        self.rows, self.distances = [], []
        self.report((0.0, 0.0, 0.0))

    def report(self, twist):
        pose, rate = (
            tuple((np.array(value) + self.random.normal(0.0, self.noise, 3)).tolist())
            for value in (self.leader, twist)
        )
        self.keeper.update_leader(self.time, pose, np.array(rate))

    def keep(self, offset=OFFSET):
        self.keeper.keep(offset, self.robot, self.time)
        return self

    def run(self, seconds, twist=(0.0, 0.0, 0.0), silent=False):
        for _ in range(round(seconds / PERIOD)):
            self.keeper.update(self.robot, self.time, self.time)
            window = self.keeper.window(self.time, HORIZON)
            for i in range(round(PERIOD / TICK)):
                if window is not None:
                    parts = window.positions, window.velocities, window.accelerations
                    self.rows.append((self.time, *(part[i] for part in parts)))
                    self.robot = tuple(window.positions[i + 1].tolist())
                self.distances.append(math.dist(self.robot[:2], self.leader[:2]))
                self.leader = se2.compose(self.leader, se2.arc(np.array(twist) * TICK))
                self.time += TICK
                if not silent:
                    self.report(twist)
        return self

    @property
    def error(self):
        station = se2.compose(self.leader, OFFSET)
        return np.array(self.robot) - station

    @property
    def state(self):
        return self.keeper.state

    @property
    def speed(self):
        return math.hypot(*self.rows[-1][2][:2])


@pytest.mark.parametrize(
    "twist", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.0, 0.2), (0.0, 0.2, -0.1)]
)
def test_station_is_met_and_kept_beside_a_leader_that_drives_steadily(twist):
    rig = Rig().keep().run(12.0, twist)
    assert rig.state is StationState.KEEPING
    rig.run(1.0, twist)
    assert np.abs(rig.error).max() < 2e-3
    assert np.abs(rig.keeper.error).max() < 2e-3


@pytest.mark.parametrize("robot", [(-2.0, -2.0, 0.0), (3.0, 2.0, 3.0), (0.5, 1.5, -1.0)])
def test_reference_keeps_the_limits_and_is_the_integral_of_its_rates(robot):
    rig = Rig(robot=robot).keep().run(4.0, (0.3, 0.0, 0.2)).run(4.0, (0.0, 0.0, -0.3)).run(3.0)
    limits = rig.parameters.usable_limits(1.0)
    _, x, v, a = (np.array(column) for column in zip(*rig.rows, strict=True))
    hardest = [max(pair) for pair in zip(limits.acceleration, limits.deceleration, strict=True)]
    jerk = np.diff(a, axis=0) / TICK
    # At the velocity limits, the jerk takes a little of the reserve.
    bounds = (v, limits.velocity), (a, hardest), (jerk, rig.parameters.limits.jerk)
    for part, (linear, angular) in bounds:
        assert np.hypot(part[:, 0], part[:, 1]).max() <= linear * (1.0 + 1e-6)
        assert np.abs(part[:, 2]).max() <= angular * (1.0 + 1e-6)
    np.testing.assert_allclose(np.diff(x, axis=0), 0.5 * TICK * (v[1:] + v[:-1]), atol=1e-9)
    np.testing.assert_allclose(np.diff(v, axis=0), TICK * a[1:], atol=1e-9)


def test_noisy_odometry_of_the_leader_is_smoothed():
    rig = Rig(noise=1e-3).keep().run(10.0, (0.3, 0.0, 0.0))
    first = len(rig.rows)
    rig.run(4.0, (0.3, 0.0, 0.0))
    velocities = np.array([row[2] for row in rig.rows[first:]])
    assert np.abs(velocities - [0.3, 0.0, 0.0]).max() < 0.02
    assert np.hypot(*rig.error[:2]) < 5e-3


@pytest.mark.parametrize(
    ("robot", "twist"),
    [
        ((0.0, 2.5, 0.0), (0.0, 0.0, 0.0)),
        ((-2.0, 1.0, 0.0), (0.2, 0.0, 0.1)),
        ((2.0, 1.5, 1.0), (0.2, 0.0, 0.1)),
    ],
)
def test_approach_from_the_other_side_goes_around_the_leader(robot, twist):
    rig = Rig(robot=robot).keep().run(15.0, twist)
    assert rig.state is StationState.KEEPING
    assert min(rig.distances) > rig.parameters.least_distance - 0.01


def test_robot_at_its_station_stops_with_its_leader():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0)).run(3.0)
    assert rig.state is StationState.KEEPING
    assert np.abs(rig.error).max() < 2e-3 and rig.speed < 2e-3


@pytest.mark.parametrize("rate", [0.8, 1.2])
def test_robot_lags_behind_a_leader_that_changes_its_speed_and_catches_up(rate):
    rig = Rig().keep().run(11.0, (0.3, 0.0, 0.0))
    for speeds in (np.arange(0.3, 0.0, -rate * PERIOD), np.arange(0.0, 0.3, rate * PERIOD)):
        lags = [np.hypot(*rig.run(PERIOD, (speed, 0.0, 0.0)).error[:2]) for speed in speeds]
        assert max(lags) < 0.07
        rig.run(2.0, (speeds[-1], 0.0, 0.0))
        assert np.abs(rig.error).max() < 2e-3


def test_limits_that_are_left_without_a_wheel_apply_from_the_next_tick_on():
    rig = Rig(robot=(-4.0, -2.0, 0.0)).keep().run(2.0, (0.3, 0.0, 0.0))
    rig.keeper.scale_limits(0.5)
    rig.run(1.5, (0.3, 0.0, 0.0))
    assert rig.speed <= 0.45 + 1e-9


def test_silent_leader_lets_the_robot_brake_until_it_is_heard_again():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0)).run(1.5, silent=True)
    assert rig.state is StationState.WAITING and rig.speed == 0.0
    rig.run(3.0)
    assert rig.state is StationState.KEEPING and np.abs(rig.error).max() < 2e-3


@pytest.mark.parametrize("jump", [(0.2, 0.0, 0.0), (0.0, 0.0, -0.2)])
def test_jump_of_the_leaders_pose_ends_station_keeping(jump):
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0))
    rig.leader = tuple(np.array(rig.leader) + jump)
    rig.run(0.08, (0.3, 0.0, 0.0))
    assert rig.state is StationState.BRAKING and "jumped" in rig.keeper.reason
    rig.run(1.5, (0.3, 0.0, 0.0))
    assert rig.state is StationState.IDLE and rig.speed == 0.0
    assert rig.keeper.window(rig.time, HORIZON) is None


def test_step_below_the_bound_is_followed_within_the_limits():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0))
    rig.leader = tuple(np.array(rig.leader) + [0.05, -0.05, 0.05])
    rig.run(3.0, (0.3, 0.0, 0.0))
    assert rig.state is StationState.KEEPING and np.abs(rig.error).max() < 2e-3


def test_leader_that_gets_away_is_given_up():
    rig = Rig(**{"station.max_distance": 3.0}).keep().run(10.0, (1.5, 0.0, 0.0))
    assert rig.state is StationState.IDLE and "away" in rig.keeper.reason


def test_odometry_that_is_not_newer_is_ignored():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0))
    rig.keeper.update_leader(rig.time, (9.0, 9.0, 0.0), np.zeros(3))
    rig.keeper.update_leader(rig.time - 1.0, (9.0, 9.0, 0.0), np.zeros(3))
    assert rig.state is StationState.KEEPING


def test_station_is_refused_without_a_recent_leader_and_far_away():
    rig = Rig(robot=(-6.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"6\.14 m away, at most 5 m"):
        rig.keep()
    rig.time += 1.0
    with pytest.raises(InputError, match="no recent leader/odom"):
        rig.keep()
    rig.keeper.forget_leader()
    with pytest.raises(InputError, match="no recent leader/odom"):
        rig.keep()
    assert rig.state is StationState.IDLE and rig.keeper.window(rig.time, HORIZON) is None


def test_station_that_is_moved_is_approached_from_the_motion():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0)).keep((-0.5, -2.0, 0.3)).run(5.0, (0.3, 0.0, 0.0))
    assert rig.state is StationState.KEEPING
    gap = np.array(rig.robot) - se2.compose(rig.leader, (-0.5, -2.0, 0.3))
    assert np.abs(gap).max() < 2e-3


def test_release_brings_the_robot_to_rest_and_a_new_station_takes_it_from_there():
    rig = Rig().keep().run(10.0, (0.3, 0.0, 0.0))
    rig.keeper.release()
    rig.run(0.2, (0.3, 0.0, 0.0))
    assert rig.state is StationState.BRAKING
    rig.keep().run(5.0, (0.3, 0.0, 0.0))
    assert rig.state is StationState.KEEPING
    rig.keeper.release()
    rig.run(1.5, (0.3, 0.0, 0.0))
    assert rig.state is StationState.IDLE and not rig.keeper.reason


def test_odom_of_the_leader_may_be_elsewhere():
    places = {"leader.odom_x": 1.0, "leader.odom_y": 2.0, "leader.odom_heading": 0.5}
    rig = Rig(robot=(1.0, 0.0, 0.0), **places).keep().run(10.0, (0.3, 0.0, 0.1))
    station = se2.compose((1.0, 2.0, 0.5), se2.compose(rig.leader, OFFSET))
    assert np.array(rig.robot) == pytest.approx(np.array(station), abs=2e-3)


def test_previews_follow_each_other_without_a_jump_and_change_nothing_that_is_due():
    rig = Rig().keep()
    before = None
    for cycle in range(100):
        window = rig.keeper.window(rig.time, HORIZON)
        assert len(window.times) == round(HORIZON / TICK) + 1
        preview = Preview(window.times, window.positions, window.velocities, window.accelerations)
        if before is not None:
            for time in (rig.time, rig.time + LEAD * TICK):
                old, new = before.sample(time), preview.sample(time)
                assert new.pose == pytest.approx(old.pose, abs=1e-9)
                assert new.velocity == pytest.approx(old.velocity, abs=1e-9)
        before = preview
        rig.run(PERIOD, (0.3 if cycle % 2 else 0.2, 0.0, 0.2))
