"""Motions of arm and whole body that lead into something, judged by their true distances."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions.headers import duration_message
from omniman_ros.core.arm_parameters import UR_JOINTS

pytest.importorskip("mujoco")

from omniman_ros.collision.body_geometry import BodyGeometry
from test.collision.reference import description
from test.motion.whole_body.tool_support import MODEL
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator_arm import trajectory
from test.nodes.test_path_interpolator_tool import READY, tool_path
from test.nodes.whole_robot import GAP, Judge, Post, Wall, WholeRobot

#: Number of trials of each source
TRIALS = {"previews": 80, "joint_trajectory": 80, "tool_path": 40}
BODY = ["odom_x", "odom_y", "odom_t", *UR_JOINTS]
CLEAR = 0.15  #: Gap that a motion begins with, at least [m]
REST = 0.02  #: Speed at which the robot counts as standing [m/s, rad/s]
LATENCY, DECELERATION = 0.3, 0.8
"""What is assumed of the robot where something appears before it [s, m/s^2]."""
REACH, LEVERS = 1.3, np.array([0.95, 0.95, 0.55, 0.2, 0.1, 0.0])
"""Largest distances of the arm's points from base_link's z axis, and from each joint's [m]."""
SAMPLES = np.linspace(0.0, 1.0, 25)
PREVIEW = np.linspace(0.0, 0.4, 11)
ROBOT = BodyGeometry(description())


def leads_into(thing, line):
    """Return whether a straight line (k, 9) of x, y, t and joints leads into a thing."""
    judge = Judge([thing])
    if judge.gap(line[0, :3], line[0, 3:]) < CLEAR:
        return False
    return min(judge.gap(x[:3], x[3:]) for x in line) < 0.0


def thing_at(rng, place):
    """Return a post, a table or a wall that contains a place [m]."""
    x, y, z = place
    kind = rng.choice(["post", "table", "wall"])
    if kind == "post":
        return Post(x, y, rng.uniform(0.02, 0.15), (0.0, z + rng.uniform(0.05, 1.0)))
    if kind == "table":
        return Post(x, y, rng.uniform(0.1, 0.4), (z - rng.uniform(0.02, 0.3), z + 0.01))
    return Wall(math.hypot(x, y), math.atan2(y, x))


def motion_into_something(rng, platform=0.0):
    """Return the start (9,) of a motion, its goal, and a thing that it leads into.

    Args:
        platform: Largest travel of the platform along x and y, and about z [m, m, rad].
    """
    while True:
        start, goal = np.zeros(9), np.zeros(9)
        start[3:] = READY + rng.uniform(-0.4, 0.4, 6)
        goal[:3] = rng.uniform(-platform, platform, 3)
        goal[3:] = start[3:] + rng.uniform(-1, 1, 6) * (2.5, 1.0, 1.0, 0.7, 0.5, 1.0)
        line = start + SAMPLES[:, None] * (goal - start)
        if ROBOT.self_distances(line[:, 3:]).min() < 0.015:
            continue
        thing = thing_at(rng, MODEL.forward(line[rng.integers(15, len(line))])[:3, 3])
        if leads_into(thing, line):
            return start, goal, thing


def tool_path_into_something(rng):
    """Return the offsets (k, 3) of a path of the tool from its start, and a thing on its way."""
    start = np.concatenate([np.zeros(3), READY])
    while True:
        direction, length = rng.uniform(-1.0, 1.0), rng.uniform(0.6, 1.2)
        end = length * np.array([math.cos(direction), math.sin(direction), 0.0])
        end[2] = rng.uniform(-0.1, 0.1)
        thing = thing_at(rng, MODEL.forward(start)[:3, 3] + rng.uniform(0.5, 0.9) * end)
        if Judge([thing]).gap(start[:3], READY) > CLEAR:
            return [np.zeros(3), end], thing


class Trial(WholeRobot):
    """A robot that is sent into something."""

    def send_previews(self, start, goal):
        """Send previews for the arm, whatever its limit is."""
        previews = self.publisher(JointTrajectory, "arm/joint_reference")
        way, begin = (goal - start)[3:], self.time + 0.1
        seconds = 2.0 * np.abs(way).max() / 1.5

        def send():
            if round(self.time / 0.005) % 8:
                return
            message = JointTrajectory(joint_names=list(UR_JOINTS))
            message.header.stamp = self.stamp()
            for ahead in PREVIEW:
                s = min(max((self.time + ahead - begin) / seconds, 0.0), 1.0)
                place = start[3:] + way * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
                speed = way * 30.0 * s * s * (1.0 - s) ** 2 / seconds
                message.points.append(
                    JointTrajectoryPoint(
                        positions=place.tolist(),
                        velocities=speed.tolist(),
                        time_from_start=duration_message(float(ahead)),
                    )
                )
            previews.publish(message)

        self.hooks.append(send)

    def send_trajectory(self, start, goal):
        """Send a trajectory of the joints that move."""
        columns = [k for k in range(9) if k > 2 or goal[:3].any()]
        message = trajectory([goal[columns]], names=[BODY[k] for k in columns])
        self.publisher(JointTrajectory, "joint_trajectory").publish(message)

    def send_tool_path(self, offsets):
        """Send a path of the tool."""
        self.publisher(Path, "tool_path").publish(tool_path(offsets))

    def assert_stopped(self):
        """Wait for rest, to which the robot comes more and more slowly before the margin."""
        self.run_until(lambda: max(self.speeds) < REST, 20.0, "rest")
        assert min(self.gaps) >= GAP


def draw(source, seed, platform=0.0):
    """Return the start (9,) of a motion, what sends a trial on it, and a thing on its way."""
    rng = np.random.default_rng(seed)
    if source == "tool_path":
        offsets, thing = tool_path_into_something(rng)
        start = np.concatenate([np.zeros(3), READY])
        return start, lambda trial: trial.send_tool_path(offsets), thing
    start, goal, thing = motion_into_something(rng, platform)
    send = Trial.send_previews if source == "previews" else Trial.send_trajectory
    return start, lambda trial: send(trial, start, goal), thing


def stop_before(source, seed):
    """Send a robot into something, and return the trial when it stands before it."""
    start, send, thing = draw(source, seed)
    with Trial(start[3:], [thing]) as trial:
        send(trial)
        trial.run(2.0)
        trial.assert_stopped()
        return trial


def stop_before_what_appears(source, seed):
    """Have something appear on the way of a robot as late as it can be avoided, and wait for rest.

    The robot is in the physics world. What appears is as far as all its parts can come within
    `LATENCY` and while they brake by `DECELERATION` from the bound of their present speeds.
    """
    start, send, thing = draw(source, seed, platform=1.0)
    judge = Judge([thing])
    with Trial(start[3:], is_in_world=True) as trial:
        before = trial.angles

        def is_due():
            nonlocal before
            linear, angular, _ = trial.speeds
            rates = np.abs(trial.angles - before) / PERIOD
            before = trial.angles
            speed = linear + angular * REACH + float(rates @ LEVERS)
            way = LATENCY * speed + speed * speed / (2.0 * DECELERATION)
            return judge.gap(trial.pose, trial.angles) < way + 0.05

        send(trial)
        trial.run_until(is_due, 10.0, "the appearance")
        trial.show([thing])
        trial.run(0.5)
        trial.assert_stopped()
        return trial


def every(source, sample, count=0):
    """Mark all trials of a source but the first ones as exhaustive."""
    return [
        pytest.param(source, seed, marks=[pytest.mark.exhaustive] if seed >= sample else [])
        for seed in range(count or TRIALS[source])
    ]


@pytest.mark.parametrize(
    ("source", "seed"),
    [*every("previews", 1), *every("joint_trajectory", 0), *every("tool_path", 1)],
)
def test_a_motion_of_the_arm_into_something_is_stopped_before_it(source, seed):
    stop_before(source, seed)


@pytest.mark.parametrize(
    ("source", "seed"), [*every("joint_trajectory", 0, 30), *every("tool_path", 0, 30)]
)
def test_platform_and_arm_stop_before_what_appears_on_their_way(source, seed):
    stop_before_what_appears(source, seed)
