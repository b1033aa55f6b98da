"""Trajectories of platform and arm on one time base over real topics, on simulated time."""

import math
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros import conversions
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.path.interpolator import PathState
from omniman_ros.core.path.parameters import TICK

from .harness import PERIOD
from .test_path_interpolator import BENT
from .test_path_interpolator_arm import FAR, HOME, WithArm, trajectory

BODY = ("odom_x", "odom_y", "odom_t", *UR_JOINTS)
START = np.concatenate([np.zeros(3), HOME])
GOAL = np.concatenate([[0.6, -0.3, 0.5], FAR])
WAY = GOAL - START
MOVES = np.flatnonzero(WAY)
NAN = math.nan


class Body(WithArm):
    """As with the arm; both are moved by one trajectory."""

    @property
    def body(self) -> Any:
        return self.node.body.core

    def send_body(self, rows: Any, times: Any = None, names: Any = BODY, **more: Any) -> None:
        self.trajectories.publish(trajectory(rows, times, names, **more))
        self.run(2 * PERIOD)

    def body_arrives(self, seconds: float = 20.0) -> float:
        return self.run_until(
            lambda: self.body.state is PathState.IDLE and not self.node.body.waiting,
            seconds, "the body's end",
        )  # fmt: skip

    def assert_both_smooth(self) -> None:
        """Limits hold for platform and arm, and nothing jumps."""
        times, x, v, a = self.followed()
        limits, own = self.body.planner.limits, self.node.options.core.limits
        assert np.hypot(*v[:, :2].T).max() <= limits.velocity[0] * (1 + 1e-4)
        assert np.hypot(*a[:, :2].T).max() <= own.linear_acceleration
        assert np.abs(v[:, 2]).max() <= limits.velocity[2] * (1 + 1e-4)
        assert np.abs(a[:, 2]).max() <= own.angular_acceleration
        step = np.diff(times)[:, None]
        assert np.abs(np.diff(x, axis=0) / step - 0.5 * (v[1:] + v[:-1])).max() < 2e-3
        self.assert_arm_smooth()

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (k,) and all nine axes (k, 9) as the receivers of both streams have them."""
        times, x, _, _ = self.followed(step=0.004)
        _, joints, _, _ = self.driven()
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
    with Body() as made:
        yield made


def test_platform_and_arm_go_together_and_arrive_together(world):
    world.send_body([GOAL])
    world.body_arrives()
    times, x = world.whole()
    assert x[-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()
    # A straight way in nine axes: each has gone the same share of it at each instant.
    share = (x - START)[:, MOVES] / WAY[MOVES]
    assert np.ptp(share, axis=1).max() < 1e-3
    assert np.diff(share[:, 0]).min() > -1e-9


def test_both_previews_begin_at_the_same_instant(world):
    world.send_body([GOAL])
    world.run(0.5)
    assert len(world.references) == len(world.joint_previews) > 5
    for i, (_, start, _) in enumerate(world.joint_previews):
        stamp = conversions.time_seconds(world.message(i).header.stamp)
        assert stamp == pytest.approx(start, abs=1e-9)


def test_given_times_are_kept_by_all_axes(world):
    middle = 0.5 * (START + GOAL)
    begin = world.time
    world.send_body([middle, GOAL], [2.0, 4.0])
    world.body_arrives()
    times, x = world.whole()
    k = int(np.abs(x - middle).sum(axis=1).argmin())
    assert x[k] == pytest.approx(middle, abs=3e-3)
    assert times[k] - begin == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("names", "goal"),
    [(["odom_x"], [0.4]), (["odom_t", "elbow_joint"], [0.7, 1.0]), (["odom_y"], [-0.2])],
)
def test_axes_that_are_not_named_keep_their_place(world, names, goal):
    world.send_body([goal], names=names)
    world.body_arrives()
    expected = START.copy()
    expected[[BODY.index(name) for name in names]] = goal
    assert world.whole()[1][-1] == pytest.approx(expected, abs=1e-6)


def test_a_heading_counts_from_where_the_robot_looks(world):
    world.send_body([[math.tau + 0.3]], names=["odom_t"])
    took = world.body_arrives()
    assert world.whole()[1][-1, 2] == pytest.approx(0.3, abs=1e-6)
    assert took < 4.0


def test_a_heading_may_turn_more_than_once(world):
    world.send_body([[3.0], [7.0]], names=["odom_t"])
    world.body_arrives(30.0)
    assert world.whole()[1][-1, 2] == pytest.approx(7.0, abs=1e-6)


REFUSED = {
    "too fast for the platform": ({"rows": [GOAL], "times": [0.5]}, "odom_x: velocity"),
    "too fast together": (
        {"rows": [[0.45, 0.45]], "times": [2.0], "names": ["odom_x", "odom_y"]}, "platform: ",
    ),
    "unknown": ({"rows": [[1.0, 0.0]], "names": ["odom_x", "odom_z"]}, "no joint odom_z"),
    "not finite": ({"rows": [[NAN]], "names": ["odom_x"]}, "not finite"),
    "huge": ({"rows": [[1e9]], "names": ["odom_x"]}, "not finite or beyond"),
    "joint limit": ({"rows": [[0.3, 4.0]], "names": ["odom_x", "elbow_joint"]}, "elbow_joint"),
    "elsewhere": ({"rows": [[0.5], [1.0]], "times": [0.0, 3.0], "names": ["odom_x"]},
                  "0.5 m from where it is"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_driven_is_refused_by_name_and_nothing_moves(world, case):
    given, words = REFUSED[case]
    world.send_body(**given)
    world.run(0.3)
    assert any(words in text for text in world.warnings), world.warnings
    assert not world.references and not world.joint_previews
    status = world.status()
    assert status.level == DiagnosticStatus.WARN and words in status.message


def test_pause_and_resume_hold_both_on_the_way(world):
    world.send_body([GOAL])
    world.run(1.0)
    assert world.ask("pause").success
    world.run_until(lambda: world.body.state is PathState.PAUSED, 3.0, "the pause")
    here = world.whole()[1][-1]
    share = (here - START)[MOVES] / WAY[MOVES]
    assert 0.05 < share[0] < 0.95 and np.ptp(share) < 1e-3
    world.run(1.0)
    assert world.whole()[1][-1] == pytest.approx(here, abs=1e-9)
    assert world.ask("resume").success
    world.body_arrives()
    assert world.whole()[1][-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()


def test_cancel_ends_both_on_the_way(world):
    world.send_body([GOAL])
    world.run(1.0)
    assert world.ask("cancel").success
    world.body_arrives(3.0)
    share = (world.whole()[1][-1] - START)[MOVES] / WAY[MOVES]
    assert 0.05 < share[0] < 0.95 and np.ptp(share) < 1e-3
    world.assert_both_smooth()


def test_the_speed_scaling_slows_both_on_the_way(world):
    world.send_body([GOAL])
    world.run(0.5)
    world.scaling = 0.5
    world.body_arrives(30.0)
    _, x = world.whole()
    assert np.ptp((x - START)[:, MOVES] / WAY[MOVES], axis=1).max() < 2e-3
    assert x[-1] == pytest.approx(GOAL, abs=1e-6)
    world.assert_both_smooth()


def test_when_the_platform_is_taken_over_the_arm_brakes_too(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.takes = False
    world.say("cmd_vel")
    world.run(2 * PERIOD)
    assert world.body.state is PathState.IDLE and world.arm.state is PathState.IDLE
    before = len(world.references)
    world.run(1.5)
    assert len(world.references) <= before + 1
    _, _, v, _ = world.assert_arm_smooth()
    assert not v[-1].any()


def test_when_the_arm_falls_silent_the_platform_brakes_too(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.arm_alive = False
    world.run_until(lambda: world.body.state is PathState.IDLE, 1.0, "giving up")
    world.run(0.5)
    assert world.preview(-1).end_speed == 0.0
    assert world.joint_previews[-1][2].end_speed == 0.0
    assert any("no arm/joint_states" in text for text in world.warnings)


@pytest.mark.parametrize("scaling", [0.25, 0.5])
def test_what_is_given_up_while_it_is_slowed_does_not_become_faster(world, scaling):
    world.scaling = scaling
    world.run(0.2)
    world.send_body([GOAL])
    world.run(3.5)
    world.arm_alive = False
    world.run_until(lambda: world.body.state is PathState.IDLE, 1.0, "giving up")
    world.run(0.5)
    stop = world.preview(-1)
    fastest = np.hypot(*world.preview(-2).sample(stop.start).velocity[:2])
    times = np.arange(stop.start, stop.end, 0.004)
    moves = np.array([stop.sample(t).velocity for t in times])
    places = np.array([stop.sample(t).pose for t in times])
    assert np.hypot(*moves[:, :2].T).max() <= 1.001 * fastest
    # What it says of speeds is what its places do.
    assert np.abs(np.diff(places, axis=0) / 0.004 - moves[:-1]).max() < 0.02
    assert stop.end_speed == 0.0 and fastest > 0.05


def test_a_bad_report_of_the_arm_does_not_end_what_waits_nor_the_node(world):
    world.takes = False
    world.send(BENT)
    world.run(0.6)
    world.takes = True
    world.send_body([GOAL])
    assert "waits" in world.node.body.last
    world.joints, good = np.full(6, NAN), world.joints
    world.run(0.3)
    assert "waits: arm/joint_states: " in world.node.body.last
    world.joints = good
    world.run_until(lambda: world.body.state is PathState.FOLLOWING, 3.0, "the begin")
    world.body_arrives()


def test_what_waits_is_dropped_by_a_trajectory_without_points(world):
    world.takes = False
    world.send(BENT)
    world.run(0.6)
    world.takes = True
    world.send_body([GOAL])
    assert world.node.body.waiting
    world.trajectories.publish(trajectory(np.empty((0, 6))))
    before = len(world.references)
    world.run(3.0)
    assert len(world.references) == before and not world.node.body.waiting


def test_time_that_goes_back_forgets_where_the_arm_was(world):
    world.run(0.2)
    assert world.node.arm_feed.position is not None or world.node.arm_feed._states is not None
    world.arm_alive = False
    world.time -= 500.0
    world.run(0.1)
    world.send_body([GOAL])
    world.run(0.3)
    assert "arm/joint_states" in world.node.body.last and not world.joint_previews


def test_a_stop_ends_both_at_once(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.takes = False
    world.say("stop")
    world.run(2 * PERIOD)
    assert world.body.state is PathState.IDLE
    count = len(world.references), len(world.joint_previews)
    world.run(1.0)
    assert (len(world.references), len(world.joint_previews)) == count


def test_a_path_is_refused_while_the_whole_body_moves(world):
    world.send_body([GOAL])
    world.run(0.5)
    world.send(BENT)
    world.run(0.2)
    assert any("a motion of the whole body is under way" in text for text in world.warnings)
    world.body_arrives()
    assert world.whole()[1][-1] == pytest.approx(GOAL, abs=1e-6)


def test_the_whole_body_is_refused_while_a_path_is_driven(world):
    world.send(BENT)
    world.run(0.5)
    world.send_body([GOAL])
    world.run(0.2)
    assert any("a path is under way" in text for text in world.warnings)
    world.arrive()


def test_joints_alone_on_the_move_bring_the_platform_to_rest(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.move([FAR])
    world.body_arrives()
    _, x = world.whole()
    assert x[-1, 3:] == pytest.approx(FAR, abs=1e-6) and 0.02 < x[-1, 0] < 0.58
    world.assert_both_smooth()


def test_a_new_motion_of_the_body_replaces_the_one_under_way(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.send_body([[0.2, 0.2]], names=["odom_x", "odom_y"])
    world.body_arrives()
    assert world.whole()[1][-1, :2] == pytest.approx([0.2, 0.2], abs=1e-6)
    world.assert_both_smooth()


def test_an_empty_trajectory_stops_the_body(world):
    world.send_body([GOAL])
    world.run(1.0)
    world.trajectories.publish(trajectory(np.empty((0, 6))))
    world.run_until(lambda: world.body.state is PathState.IDLE, 3.0, "the stop")
    assert world.whole()[1][-1, 0] < 0.55


def test_it_waits_for_the_silence_after_control_was_lost(world):
    world.takes = False
    world.send(BENT)
    world.run(0.6)
    assert "does not take it" in world.warnings[-1]
    sent = world.arrivals[-1]
    world.takes = True
    world.send_body([GOAL])
    assert "waits: control was lost" in world.node.body.last
    world.run_until(lambda: world.body.state is PathState.FOLLOWING, 3.0, "the begin")
    world.body_arrives()
    assert min(t for t in world.arrivals if t > sent) - sent > 1.0


def test_progress_is_told(world):
    world.send_body([GOAL])
    world.body_arrives()
    steps = [message.data for message in world.progress]
    assert steps[0] == 0.0 and steps[-1] == 1.0 and (np.diff(steps) >= 0.0).all()


def test_ticks_of_both_are_the_same(world):
    world.send_body([GOAL])
    world.run(0.3)
    for _, start, _ in world.joint_previews:
        assert start / TICK == pytest.approx(round(start / TICK), abs=1e-3)
