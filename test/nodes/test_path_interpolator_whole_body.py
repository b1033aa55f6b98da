"""Tests of whole-body trajectories over real topics in simulated time."""

import math
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.preview import Setpoint
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.parameters import TICK
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator import BENT, suspend_node
from test.nodes.test_path_interpolator_arm import FAR, HOME, ArmWorld, trajectory
from test.tiers import exhaustive

BODY = ("odom_x", "odom_y", "odom_t", *UR_JOINTS)
START = np.concatenate([np.zeros(3), HOME])
GOAL = np.concatenate([[0.6, -0.3, 0.5], FAR])
DISPLACEMENT = GOAL - START
MOVING = np.flatnonzero(DISPLACEMENT)
NAN = math.nan


class WholeBodyWorld(ArmWorld):
    """An arm world in which one trajectory moves both platform and arm."""

    @property
    def body(self) -> Any:
        return self.node.motions.whole_body.core

    def send_body(self, rows: Any, times: Any = None, names: Any = BODY, **more: Any) -> None:
        self.trajectories.publish(trajectory(rows, times, names, **more))
        self.run(2 * PERIOD)

    def run_to_body_end(self, seconds: float = 20.0) -> float:
        return self.run_until(
            lambda: self.body.state is PathState.IDLE and not self.node.motions.whole_body.pending,
            seconds,
            "the body's end",
        )

    def assert_both_smooth(self) -> None:
        """Assert that limits and continuity hold for platform and arm."""
        times, x, v, a = self.received_motion()
        limits, own = self.body.planner.limits, self.node.settings.value.core.limits
        assert np.hypot(*v[:, :2].T).max() <= limits.velocity[0] * (1 + 1e-4)
        assert np.hypot(*a[:, :2].T).max() <= own.linear_acceleration
        assert np.abs(v[:, 2]).max() <= limits.velocity[2] * (1 + 1e-4)
        assert np.abs(a[:, 2]).max() <= own.angular_acceleration
        step = np.diff(times)[:, None]
        assert np.abs(np.diff(x, axis=0) / step - 0.5 * (v[1:] + v[:-1])).max() < 2e-3
        self.assert_arm_smooth()

    def received_axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times (k,) and all axes (k, 9) as the receivers of both streams sample them."""
        times, x, _, _ = self.received_motion(step=0.004)
        _, joints, _, _ = self.received_joint_motion()
        assert len(times) and len(joints)
        arrivals = np.array([arrival for arrival, _, _ in self.joint_previews])
        latest = np.searchsorted(arrivals, times, side="right") - 1
        arm = [
            self.joint_previews[i][2].sample(now + 1e-9)[0]
            for i, now in zip(latest, times, strict=True)
        ]
        return times, np.column_stack([x, np.array(arm)])


@pytest.fixture
def world():
    with WholeBodyWorld() as made:
        yield made


def test_platform_and_arm_move_and_arrive_together(world):
    world.send_body([GOAL])
    world.run_to_body_end()
    _times, x = world.received_axes()
    assert x[-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()
    # On a straight line in nine axes, all axes have covered the same fraction at each instant.
    fraction = (x - START)[:, MOVING] / DISPLACEMENT[MOVING]
    assert np.ptp(fraction, axis=1).max() < 1e-3
    assert np.diff(fraction[:, 0]).min() > -1e-9


def test_both_previews_begin_at_the_same_instant(world):
    world.send_body([GOAL])
    world.run(0.5)
    assert len(world.references) == len(world.joint_previews) > 5
    for i, (_, start, _) in enumerate(world.joint_previews):
        stamp = time_seconds(world.message(i).header.stamp)
        assert stamp == pytest.approx(start, abs=1e-9)


@pytest.mark.parametrize(
    ("names", "goal"),
    [
        exhaustive(["odom_x"], [0.4]),
        (["odom_t", "elbow_joint"], [0.7, 1.0]),
        exhaustive(["odom_y"], [-0.2]),
    ],
)
def test_omitted_axes_keep_their_position(world, names, goal):
    world.send_body([goal], names=names)
    world.run_to_body_end()
    expected = START.copy()
    expected[[BODY.index(name) for name in names]] = goal
    assert world.received_axes()[1][-1] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", ["odom_t", exhaustive("platform/theta")])
def test_between_two_points_the_nearest_turn_counts(name):
    with WholeBodyWorld() as world:
        world.setpoint = Setpoint(np.array([0.0, 0.0, 3.0]), np.zeros(3), np.zeros(3))
        world.run(4 * PERIOD)
        world.send_body([[3.05], [3.1], [-3.1]], [1.0, 2.0, 3.0], names=[name])
        world.run_to_body_end()
        times, x = world.received_axes()
        assert np.abs(np.diff(x[:, 2]) / np.diff(times)).max() < 0.5
        assert math.remainder(x[-1, 2] + 3.1, math.tau) == pytest.approx(0.0, abs=1e-6)


REFUSED = {
    "too fast in combination": (
        {"rows": [[0.45, 0.45]], "times": [2.0], "names": ["odom_x", "odom_y"]},
        "platform: ",
    ),
    "unknown": ({"rows": [[1.0, 0.0]], "names": ["odom_x", "odom_z"]}, "no joint odom_z"),
    "joint limit": ({"rows": [[0.3, 4.0]], "names": ["odom_x", "elbow_joint"]}, "elbow_joint"),
    "elsewhere": (
        {"rows": [[0.5], [1.0]], "times": [0.0, 3.0], "names": ["odom_x"]},
        "0.5 m from its present position",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_infeasible_trajectory_is_refused_by_name_and_nothing_moves(world, case):
    given, words = REFUSED[case]
    world.send_body(**given)
    world.run(0.3)
    assert any(words in text for text in world.warnings), world.warnings
    assert not world.references and not world.joint_previews
    status = world.status()
    assert status.level == DiagnosticStatus.WARN and words in status.message


def test_pause_and_resume_keep_both_on_the_path(world):
    world.send_body([GOAL])
    world.run(1.0)
    assert world.call_service("pause").success
    world.run_until(lambda: world.body.state is PathState.PAUSED, 3.0, "the pause")
    here = world.received_axes()[1][-1]
    fraction = (here - START)[MOVING] / DISPLACEMENT[MOVING]
    assert 0.05 < fraction[0] < 0.95 and np.ptp(fraction) < 1e-3
    world.run(1.0)
    assert world.received_axes()[1][-1] == pytest.approx(here, abs=1e-9)
    assert world.call_service("resume").success
    world.run_to_body_end()
    assert world.received_axes()[1][-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()


def test_speed_scaling_keeps_both_on_the_path(world):
    world.send_body([GOAL])
    world.run(0.5)
    world.scaling = 0.5
    world.run_to_body_end(30.0)
    _, x = world.received_axes()
    assert np.ptp((x - START)[:, MOVING] / DISPLACEMENT[MOVING], axis=1).max() < 2e-3
    assert x[-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()


def test_the_arm_brakes_when_the_platform_is_taken_over(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.follows_stream = False
    world.publish_source("cmd_vel")
    world.run(2 * PERIOD)
    assert world.body.state is PathState.IDLE and world.arm.state is PathState.IDLE
    before = len(world.references)
    world.run(1.5)
    assert len(world.references) <= before + 1
    _, _, v, _ = world.assert_arm_smooth()
    assert not v[-1].any()


def test_the_platform_brakes_when_the_arm_falls_silent(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.arm_reports = False
    world.run_until(lambda: world.body.state is PathState.IDLE, 1.0, "giving up")
    world.run(0.5)
    assert world.preview(-1).end_speed == 0.0
    assert world.joint_previews[-1][2].end_speed == 0.0
    assert any("no arm/joint_states" in text for text in world.warnings)


def arm_speed(world) -> float:
    """Return the speed of the fastest joint by the newest preview of the arm [rad/s]."""
    return float(np.abs(world.joint_previews[-1][2].sample(world.time + 1e-9)[1]).max())


def test_the_arm_begins_to_brake_within_a_tenth_of_a_second_of_late_odometry(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.odometry = None
    speed, pause = arm_speed(world), world.node.settings.value.odom_pause
    took = world.run_until(lambda: arm_speed(world) < 0.95 * speed, 1.0, "the arm brakes")
    assert pause < took <= pause + 0.08
    world.run_until(lambda: world.body.state is PathState.IDLE, 1.0, "giving up")
    world.run(0.5)
    assert world.joint_previews[-1][2].end_speed == 0.0
    assert any("no odom" in text for text in world.warnings)
    assert np.abs(world.received_joint_motion()[3]).max() <= 5.0 * (1 + 1e-6)


@pytest.mark.parametrize("gap", [0.09, exhaustive(0.11), 0.35])
def test_a_motion_goes_on_after_a_gap_in_odometry_that_is_short(world, gap):
    world.send_body([GOAL])
    world.run(1.0)
    odometry, world.odometry = world.odometry, None
    world.run(gap)
    is_slowed = not world.node.motions.time_base.pace.plain
    assert is_slowed == (gap > world.node.settings.value.odom_pause)
    world.odometry = odometry
    world.run_to_body_end()
    assert world.received_axes()[1][-1] == pytest.approx(GOAL, abs=1e-6)
    assert not world.warnings
    world.assert_arm_smooth()


def test_a_suspended_node_starts_nothing_again_when_the_arm_reports_first(world):
    world.send_body([GOAL])
    world.run(1.0)
    suspend_node(world, 1.0)
    world.joint_offset = HOME - world.joints  # the streamer has stopped the arm
    for timer in world.node.timers:
        timer.reset()  # messages wake the node up before its tick is due
    sent = len(world.references), len(world.joint_previews)
    world.run(0.3)
    assert world.body.state is PathState.IDLE
    assert (len(world.references), len(world.joint_previews)) == sent
    assert "shoulder_pan_joint" in world.warnings[0]


@pytest.mark.parametrize("scaling", [0.25, exhaustive(0.5)])
def test_a_slowed_motion_that_is_given_up_does_not_speed_up(world, scaling):
    world.scaling = scaling
    world.run(0.2)
    world.send_body([GOAL])
    world.run(3.5)
    world.arm_reports = False
    world.run_until(lambda: world.body.state is PathState.IDLE, 1.0, "giving up")
    world.run(0.5)
    stop = world.preview(-1)
    fastest = np.hypot(*world.preview(-2).sample(stop.start).velocity[:2])
    times = np.arange(stop.start, stop.end, 0.004)
    speeds_sampled = np.array([stop.sample(t).velocity for t in times])
    places = np.array([stop.sample(t).pose for t in times])
    assert np.hypot(*speeds_sampled[:, :2].T).max() <= 1.001 * fastest
    # The velocities are the derivatives of the poses.
    assert np.abs(np.diff(places, axis=0) / 0.004 - speeds_sampled[:-1]).max() < 0.02
    assert stop.end_speed == 0.0 and fastest > 0.05


def test_invalid_joint_states_do_not_end_a_waiting_motion(world):
    world.follows_stream = False
    world.send(BENT)
    world.run(0.6)
    world.follows_stream = True
    world.send_body([GOAL])
    assert "is waiting" in world.node.motions.whole_body.log.text
    world.joints, good = np.full(6, NAN), world.joints
    world.run(0.3)
    assert "is waiting: arm/joint_states: " in world.node.motions.whole_body.log.text
    world.joints = good
    world.run_until(lambda: world.body.state is PathState.FOLLOWING, 3.0, "the begin")
    world.run_to_body_end()


def test_an_empty_trajectory_discards_a_waiting_motion(world):
    world.follows_stream = False
    world.send(BENT)
    world.run(0.6)
    world.follows_stream = True
    world.send_body([GOAL])
    assert world.node.motions.whole_body.pending
    world.trajectories.publish(trajectory(np.empty((0, 6))))
    before = len(world.references)
    world.run(3.0)
    assert len(world.references) == before and not world.node.motions.whole_body.pending


def test_a_jump_back_in_time_discards_the_joint_states(world):
    world.run(0.2)
    assert (
        world.node.motions.arm_feed.position is not None
        or world.node.motions.arm_feed._reader._data is not None
    )
    world.arm_reports = False
    world.time -= 500.0
    world.run(0.1)
    world.send_body([GOAL])
    world.run(0.3)
    assert (
        "arm/joint_states" in world.node.motions.whole_body.log.text and not world.joint_previews
    )


def test_a_stop_ends_both_motions_at_once(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.follows_stream = False
    world.publish_source("stop")
    world.run(2 * PERIOD)
    assert world.body.state is PathState.IDLE
    count = len(world.references), len(world.joint_previews)
    world.run(1.0)
    assert (len(world.references), len(world.joint_previews)) == count


def test_a_path_is_refused_during_a_whole_body_motion(world):
    world.send_body([GOAL])
    world.run(0.5)
    world.send(BENT)
    world.run(0.2)
    assert any("a motion of the whole body is under way" in text for text in world.warnings)
    world.run_to_body_end()
    assert world.received_axes()[1][-1] == pytest.approx(GOAL, abs=1e-6)


def test_a_whole_body_motion_is_refused_during_a_path(world):
    world.send(BENT)
    world.run(0.5)
    world.send_body([GOAL])
    world.run(0.2)
    assert any("a path is under way" in text for text in world.warnings)
    world.run_to_end()


def test_an_arm_trajectory_during_a_whole_body_motion_stops_the_platform(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.move([FAR])
    world.run_to_body_end()
    _, x = world.received_axes()
    assert x[-1, 3:] == pytest.approx(FAR, abs=1e-6) and 0.02 < x[-1, 0] < 0.58
    world.assert_both_smooth()


def test_an_empty_trajectory_stops_a_whole_body_motion(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.trajectories.publish(trajectory(np.empty((0, 6))))
    world.run_until(lambda: world.body.state is PathState.IDLE, 3.0, "the stop")
    assert world.received_axes()[1][-1, 0] < 0.55


def test_progress_is_published(world):
    world.send_body([GOAL])
    world.run_to_body_end()
    steps = [message.data for message in world.progress]
    assert steps[0] == 0.0 and steps[-1] == 1.0 and (np.diff(steps) >= 0.0).all()


def test_platform_and_arm_share_their_ticks(world):
    world.send_body([GOAL])
    world.run(0.3)
    for _, start, _ in world.joint_previews:
        assert start / TICK == pytest.approx(round(start / TICK), abs=1e-3)
