"""Drives at obstacles on the simulated drives, judged by their true pose.

The judge knows the corners of the body and the posts, and none of the monitor's geometry.
"""

import math
from collections import deque

import numpy as np
import pytest

from omniman_ros.collision.monitor import (
    CollisionMonitor,
    MonitorParameters,
    RobotMotion,
    SpeedLimit,
)
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.core.se2 import arc
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots

GAP = 0.02  #: Gap that must remain [m]
EVERY = 5  #: Number of ticks from one limit to the next: 40 Hz
LATE = 4  #: Number of ticks from an observation until its limit arrives
DRIVES = 200
SAMPLE = 1
#: Joint angles at which the arm stays above the platform [rad]
FOLDED = np.array([0.0, -2.5, 2.6, -1.7, 0.0, 0.0])


class Drive(ClosedLoop):
    """A platform among posts (n, 3), each x, y and radius [m], that may move."""

    def __init__(self, posts, velocities=None, changes=None):
        changes = {"collision_monitor.use": True, "held.stop": False} | (changes or {})
        super().__init__(robots.parameters("omniman", changes), build(SimulationParameters, {}))
        given = build(CollisionMonitorParameters, robots.values())
        self.monitor = CollisionMonitor(
            given.geometry(with_arm=True), given.speed_limits, MonitorParameters()
        )
        body = self.controller.parameters.robot.body
        self.half = 0.5 * np.array((body.length, body.width))
        self.posts = np.array(posts, dtype=float)
        self.velocities = np.zeros((len(posts), 2)) if velocities is None else velocities
        self.waiting = deque()
        self.gaps, self.twists, self.fractions = [], [], []

    def surroundings(self):
        n = len(self.posts)
        still = np.zeros(n)
        obstacles = UprightObstacles(
            self.posts[:, :2].T, still, np.zeros((2, n)), self.posts[:, 2], still, still + 2.0
        )
        return MovingObstacles(obstacles, self.velocities.T)

    def look(self):
        """Let the monitor judge what the controller knows and does."""
        core = self.controller
        robot = RobotMotion(
            np.array(core.odometry.pose), FOLDED, np.append(core.odometry.twist, np.zeros(6))
        )
        demands = [np.append(core.demand, np.zeros(6))]
        fraction = self.monitor.limit(robot, demands, self.surroundings()).platform
        self.fractions.append(fraction)
        self.waiting.append((self.tick + LATE, fraction))

    def step(self):
        if hasattr(self, "monitor"):
            self.posts[:, :2] += PERIOD * self.velocities
            if self.tick % EVERY == 0:
                self.look()
            while self.waiting and self.waiting[0][0] <= self.tick:
                self.controller.motion_limit.update(self.waiting.popleft()[1], self.now, self.now)
        super().step()
        if hasattr(self, "monitor"):
            self.gaps.append(self.gap())
            self.twists.append(self.controller.setpoint)

    def gap(self):
        """Return the distance of the true body from the nearest post [m]."""
        x, y, theta = self.truth
        c, s = math.cos(theta), math.sin(theta)
        local = np.abs((self.posts[:, :2] - (x, y)) @ np.array([[c, -s], [s, c]]))
        outside = np.linalg.norm(np.maximum(local - self.half, 0.0), axis=1)
        return float((outside - self.posts[:, 2]).min())

    def run(self, seconds, feed=lambda: None):
        for i in range(round(seconds / PERIOD)):
            if i % 4 == 0:
                feed()
            self.step()

    def teleop(self, twist):
        return lambda: self.controller.set_twist(np.array(twist, dtype=float), self.now)

    def assert_decelerates_within_limits(self):
        limits = self.controller.parameters.limits
        twists = np.array(self.twists)
        speeds = np.column_stack((np.linalg.norm(twists[:, :2], axis=1), abs(twists[:, 2])))
        falls = -np.diff(speeds, axis=0)
        assert (falls <= np.array(limits.deceleration) * PERIOD + 1e-9).all()


def random_drive(rng, is_curved):
    """Return a twist, a post that the body meets on its way, and the time when it does [s]."""
    while True:
        heading, speed = rng.uniform(-math.pi, math.pi), rng.uniform(0.4, 1.0)
        turn = rng.uniform(-0.6, 0.6)
        twist = speed * math.cos(heading), speed * math.sin(heading), turn
        time, radius = rng.uniform(1.3, 2.0) / speed, rng.uniform(0.03, 0.4)
        if is_curved:
            x, y, _ = arc(time * np.array(twist))
        else:
            x, y = time * twist[0], time * twist[1]
        x, y = np.array((x, y)) + rng.uniform(-0.2, 0.2, 2)
        if math.hypot(x, y) > 0.75 + radius:
            return twist, (x, y, radius), time


def line(drive, twist, seconds):
    """Return a preview in odom at constant velocity, that ends in motion."""
    times = np.linspace(0.0, seconds, 41)
    rise = np.minimum(times, 1.5)
    way = times - rise + 0.5 * rise * rise / 1.5
    fraction = rise / 1.5
    pose = np.array(drive.controller.odometry.pose)
    return Preview(drive.now + times, pose + np.outer(way, twist), np.outer(fraction, twist), None)


@pytest.mark.parametrize("source", [source.value for source in Source])
@pytest.mark.parametrize(
    "seeds",
    [range(SAMPLE), pytest.param(range(SAMPLE, DRIVES), marks=pytest.mark.exhaustive)],
    ids=["sample", "all"],
)
def test_every_source_is_stopped_before_a_post(source, seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        twist, post, time = random_drive(rng, source == "cmd_vel")
        drive = Drive([post])
        if source == "cmd_vel":
            drive.run(time + 2.0, drive.teleop(twist))
        else:
            preview = line(drive, twist, time + 3.0)
            assert drive.controller.set_preview(Source(source), preview, drive.now) == ""
            drive.run(time + 2.0)
        assert min(drive.gaps) >= GAP, seed
        if source == "cmd_vel":
            assert min(drive.gaps) < 0.3, f"drive {seed} was stopped too early"
            assert min(drive.fractions) < 0.2, seed
        else:  # held back, it loses its reference
            assert drive.controller.at_rest, seed
            assert min(drive.fractions) < 0.5, seed
        drive.assert_decelerates_within_limits()


def test_voltages_above_the_limit_are_cancelled_and_the_robot_ramps_to_rest():
    drive = Drive([(9.0, 0.0, 0.1)])
    volts = np.full(4, 12.0)
    drive.run(0.1)
    drive.run(0.5, lambda: drive.controller.set_voltages(volts, drive.now))
    assert drive.controller.setpoint[0] > 0.1
    drive.monitor.limit = lambda *_: SpeedLimit(platform=0.0)
    drive.run(0.1, lambda: drive.controller.set_voltages(volts, drive.now))
    assert drive.controller.arbiter.active is None
    drive.run(0.8)
    assert drive.controller.at_rest


def test_a_limit_that_opens_lets_teleop_go_on_within_its_acceleration():
    drive = Drive([(1.0, 0.0, 0.1)])
    drive.run(1.5, drive.teleop((0.5, 0.0, 0.0)))
    assert drive.controller.setpoint[0] < 0.2
    drive.posts[:, 0] = 9.0
    drive.run(1.5, drive.teleop((0.5, 0.0, 0.0)))
    assert drive.controller.setpoint[0] == pytest.approx(0.5, abs=1e-6)
    rises = np.diff(np.array(drive.twists)[:, 0])
    assert rises.max() <= drive.controller.parameters.limits.linear_acceleration * PERIOD + 1e-9


@pytest.mark.exhaustive
def test_a_robot_between_people_never_drives_into_one():
    """Contacts of a robot that is at rest are none of its own; it only has to be at rest then."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        posts = np.column_stack((rng.uniform(-4, 4, (6, 2)), np.full(6, 0.25)))
        posts = posts[np.linalg.norm(posts[:, :2], axis=1) > 1.2]
        velocities = rng.uniform(-0.8, 0.8, (len(posts), 2))
        drive = Drive(posts, velocities)
        twist = random_drive(rng, True)[0]
        drive.run(4.0, drive.teleop(twist))
        for gap, each in zip(drive.gaps, drive.twists, strict=True):
            assert gap > 0.0 or np.linalg.norm(each) < 0.15, seed
        drive.assert_decelerates_within_limits()


@pytest.mark.exhaustive
def test_half_an_hour_of_free_driving_and_parking_has_no_false_stop():
    """Where nothing is near the margin on the way, the robot becomes as fast as it is asked to."""
    rng = np.random.default_rng(1)
    drive = Drive([(6.0, y, 0.1) for y in np.arange(-6.0, 6.1, 0.2)])
    while drive.now < 1800.0:
        x, y, theta = drive.truth
        goal = rng.uniform((-4.0, -3.0), (5.3, 3.0))
        offset = goal - (x, y)
        c, s = math.cos(theta), math.sin(theta)
        way = np.array((c * offset[0] + s * offset[1], c * offset[1] - s * offset[0]))
        time = max(np.linalg.norm(way) / 0.6, 1.0)
        turn = 0.0
        drive.twists.clear()
        drive.run(time + 0.3, drive.teleop((*(way / time), turn)))
        asked = np.linalg.norm(way) / time
        assert np.linalg.norm(np.array(drive.twists)[:, :2], axis=1).max() > 0.95 * asked
        drive.run(1.0)
    assert min(drive.gaps) >= GAP
