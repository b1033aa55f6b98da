"""Trajectories of the arm and speed scaling over real topics, on simulated time."""

import math
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.hermite import Hermite
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator import BENT, FakeControllerWorld
from test.tiers import exhaustive, representative

NAN = math.nan
HOME = np.array([0.3, -1.2, 1.4, -0.5, 0.2, 0.1])
FAR = HOME + [0.8, 0.5, -0.6, 0.3, 0.0, -0.4]
LONG = [(0, 0, 0), (3.0, 0, 0)]
STEP = 0.004


def trajectory(rows: Any, times: Any = None, names: Any = UR_JOINTS, **more: Any) -> Any:
    """Return a message of rows (k, d), times [s], and optional velocities or accelerations."""
    message = JointTrajectory(joint_names=list(names))
    for i, row in enumerate(np.atleast_2d(rows)):
        point = JointTrajectoryPoint(positions=[float(x) for x in row])
        if times is not None:
            point.time_from_start = Duration(
                sec=math.floor(times[i]), nanosec=round(times[i] % 1 * 1e9)
            )
        for label, values in more.items():
            setattr(point, label, [float(x) for x in values[i]])
        message.points.append(point)
    return message


class ArmWorld(FakeControllerWorld):
    """The interpolator with a fake controller and an arm that follows without delay.

    Attributes:
        arm_reports: Whether the arm publishes its joint states.
        joint_offset: (6,) measured joints less their reference [rad].
        scaling: Speed scaling published every 50 ms, or None.
    """

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(parameters)
        self.arm_reports, self.scaling = True, None
        self.joints, self.joint_offset = HOME.copy(), np.zeros(6)
        self.joint_previews: list[tuple[float, float, Any]] = []
        self.probe.create_subscription(
            JointTrajectory, "arm/joint_reference", self._on_joint_reference, 100, raw=True
        )
        publisher = self.node.motions.arm_previews.publisher
        self._await(lambda: publisher.get_subscription_count() > 0, "arm/joint_reference")
        self._states = self.publisher(JointState, "arm/joint_states")
        self._scalings = self.publisher(Float64, "arm/speed_scaling")
        self._count = 0
        self.hooks.append(self._report)
        self.run(4 * PERIOD)

    def listen_to_requests(self) -> None:
        super().listen_to_requests()
        self.trajectories = self.publisher(JointTrajectory, "joint_trajectory")

    @property
    def arm(self) -> Any:
        return self.node.motions.arm.core

    def _on_joint_reference(self, data: bytes) -> None:
        message = deserialize_message(data, JointTrajectory)
        assert list(message.joint_names) == list(UR_JOINTS)
        start = time_seconds(message.header.stamp)
        times = [start + time_seconds(p.time_from_start) for p in message.points]
        arrays = (
            np.array([getattr(point, label) for point in message.points])
            for label in ("positions", "velocities", "accelerations")
        )
        self.joint_previews.append((self.time, start, Hermite(np.array(times), *arrays)))

    def _report(self) -> None:
        self._count += 1
        if self.joint_previews:
            self.joints = self.joint_previews[-1][2].sample(self.time + 1e-9)[0]
        if self.arm_reports:
            message = JointState(
                name=[*UR_JOINTS], position=[*map(float, self.joints + self.joint_offset)]
            )
            message.velocity = [0.0] * 6
            message.header.stamp = self.stamp()
            self._states.publish(message)
        if self.scaling is not None and self._count % 10 == 0:
            self.scale(self.scaling)

    def scale(self, value: float) -> None:
        self._scalings.publish(Float64(data=float(value)))

    def move(self, *args: Any, **more: Any) -> None:
        self.trajectories.publish(trajectory(*args, **more))
        self.run(2 * PERIOD)

    def run_to_arm_end(self, seconds: float = 20.0) -> float:
        return self.run_until(lambda: self.arm.state is PathState.IDLE, seconds, "the arm's end")

    def received_joint_motion(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Return times (k,) and x, x', x'' (k, 6), sampled by a receiver every 4 ms."""
        previews = self.joint_previews[since:]
        arrivals = np.array([arrival for arrival, _, _ in previews])
        end = max(previews[-1][0], previews[-1][2].end) + 0.05
        times = np.arange(arrivals[0] + 1e-3, end, STEP)
        latest = np.searchsorted(arrivals, times, side="right") - 1
        rows = [previews[i][2].sample(now) for i, now in zip(latest, times, strict=True)]
        x, v, a = (np.array(part) for part in zip(*rows, strict=True))
        return times, x, v, a

    def assert_arm_smooth(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Assert limits and continuity as a guard would check them."""
        times, x, v, a = self.received_joint_motion(since)
        assert np.abs(v).max() <= math.pi and np.abs(a).max() <= 5.0 * (1 + 1e-6)
        step = round(TICK / STEP)  # the step of the guard
        second = (x[2 * step :] - 2 * x[step:-step] + x[: -2 * step]) / TICK**2
        assert np.abs(second).max() <= 5.0 * (1 + 1e-6)
        assert np.abs(np.diff(x, axis=0) / STEP - 0.5 * (v[1:] + v[:-1])).max() < 2e-3
        return times, x, v, a


@pytest.fixture
def world():
    with ArmWorld() as made:
        yield made


# ---- trajectories -----------------------------------------------------------------------------


def test_a_trajectory_without_times_moves_all_joints_synchronously(world):
    world.move(FAR)
    assert world.arm.state is PathState.FOLLOWING
    world.run_to_arm_end()
    times, x, v, a = world.assert_arm_smooth()
    assert x[0] == pytest.approx(HOME, abs=1e-12) and x[-1] == pytest.approx(FAR, abs=1e-12)
    jerk = np.abs(np.diff(a, axis=0)).max() / STEP
    assert jerk <= 45.0 * (1 + 1e-4)
    moving = np.abs(v) > 1e-9
    used = np.flatnonzero(np.abs(FAR - HOME) > 0)
    ends = [times[np.flatnonzero(moving[:, k])[[0, -1]]] for k in used]
    assert np.ptp(np.array(ends), axis=0).max() < 0.02, "all joints begin and end together"
    _arrival, start, curve = world.joint_previews[1]
    assert curve.end - start == pytest.approx(0.4, abs=1e-9)
    assert np.diff([t for t, _, _ in world.joint_previews[2:]]) == pytest.approx(0.04)
    assert world.warnings == []


def test_omitted_joints_hold_their_position(world):
    world.move([[0.1, 0.6]], names=[UR_JOINTS[5], UR_JOINTS[0]])
    world.run_to_arm_end()
    _, x, _, _ = world.assert_arm_smooth()
    assert x[-1] == pytest.approx([0.6, *HOME[1:5], 0.1], abs=1e-12)
    assert (x[:, 1:5] == HOME[1:5]).all()


def test_a_stamp_ahead_delays_the_start(world):
    message = trajectory(FAR, [1.5])
    message.header.stamp = world.stamp(0.7)
    due = world.time + 0.7
    world.trajectories.publish(message)
    world.run(0.6)
    assert world.arm.state is PathState.FOLLOWING and (world.joints == HOME).all()
    world.run_to_arm_end()
    at, _x, v, _ = world.assert_arm_smooth()
    moving = at[np.abs(v).max(axis=1) > 1e-9]
    assert moving[0] == pytest.approx(due, abs=0.015)
    assert moving[-1] == pytest.approx(due + 1.5, abs=0.015)


INVALID_TRAJECTORIES: dict[str, Any] = {
    "unknown name": ({"names": [*UR_JOINTS[:5], "elbow"]}, "no joint elbow"),
    "NaN": ({"rows": FAR * NAN}, "positions.* not a finite number"),
    "beyond a limit": ({"rows": [[0, 0, 4, 0, 0, 0]]}, "elbow_joint: position 4 rad of point 0"),
    "too hard": ({"rows": FAR, "times": [0.7]}, "shoulder_pan_joint: acceleration .* limit is 5"),
    "times back": ({"rows": [FAR, HOME], "times": [2.0, 1.0]}, "do not increase: point 0 at 2 s"),
    "nowhere": ({"rows": HOME}, "is already there"),
}


def test_an_infeasible_trajectory_is_refused_by_name_and_nothing_moves(world):
    for what, (given, words) in INVALID_TRAJECTORIES.items():
        options = {"rows": FAR} | given
        world.move(options.pop("rows"), options.pop("times", None), **options)
        with pytest.raises(AssertionError, match=words):
            raise AssertionError(f"{what}: {world.warnings}")
        assert not world.joint_previews, what
        assert world.arm.state is PathState.IDLE
        world.warnings.clear()
    for ahead, words in ((100.0, "100.00 s ahead"), (-2.0, "s old")):
        message = trajectory(FAR)
        message.header.stamp = world.stamp(ahead)
        world.trajectories.publish(message)
        world.run(2 * PERIOD)
        assert words in world.warnings[-1] and not world.joint_previews
    status = world.status()
    assert status.level == DiagnosticStatus.WARN and "a trajectory was refused" in status.message


def test_a_trajectory_without_points_stops_on_the_path(world):
    world.move(FAR)
    world.run(0.5)
    world.trajectories.publish(JointTrajectory())
    assert world.run_to_arm_end() < 0.8
    _, x, v, _ = world.assert_arm_smooth()
    fraction = (x - HOME)[:, [0, 1, 2, 3, 5]] / (FAR - HOME)[[0, 1, 2, 3, 5]]
    assert 0.1 < fraction[-1].max() < 0.9 and np.ptp(fraction, axis=1).max() < 1e-9
    assert not v[-1].any()
    world.run(2 * PERIOD)
    before = len(world.joint_previews)
    world.run(0.3)
    assert len(world.joint_previews) == before
    world.move(FAR)
    world.run_to_arm_end()
    assert world.assert_arm_smooth(before)[1][-1] == pytest.approx(FAR, abs=1e-9)


def test_pause_resume_and_cancel_act_on_both_platform_and_arm(world):
    world.send(LONG)
    world.move(FAR, [4.0])
    world.run(1.0)
    assert world.call_service("pause").message == "pausing"
    world.run(1.5)
    assert world.core.state is PathState.PAUSED and world.arm.state is PathState.PAUSED
    place, joints = world.setpoint.pose.copy(), world.joints.copy()
    world.run(0.5)
    assert (world.joints == joints).all() and world.setpoint.pose == pytest.approx(
        place, abs=1e-12
    )
    assert world.call_service("resume").success
    world.run(0.5)
    assert world.call_service("cancel").success
    world.run_to_arm_end(2.0)
    world.run_to_end(2.0)
    world.assert_arm_smooth()
    world.assert_smooth()
    assert not world.call_service("resume").success


# ---- loss of control --------------------------------------------------------------------------


def test_twists_that_take_over_the_platform_do_not_affect_the_arm(world):
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(0.5)
    world.follows_stream = False
    world.publish_source("cmd_vel")
    world.run(2 * PERIOD)
    assert world.core.state is PathState.IDLE and world.arm.state is PathState.FOLLOWING
    world.run_to_arm_end()
    assert world.assert_arm_smooth()[1][-1] == pytest.approx(FAR, abs=1e-9)


def publish_emergency_stop(world: ArmWorld) -> None:
    world.publisher(Bool, "emergency_stop").publish(Bool(data=True))


def publish_stopped_peer(world: ArmWorld) -> None:
    world.probe.create_publisher(DiagnosticStatus, "stop_state", ALL_LATCHED).publish(
        DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/platform", message="stopped: ~/stop")
    )
    world.run(0.1)


@pytest.mark.parametrize("stop", [publish_emergency_stop, publish_stopped_peer])
def test_a_stop_ends_both_motions_and_refuses_new_ones(world, stop):
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(0.5)
    stop(world)
    world.run(2 * PERIOD)
    assert world.core.state is PathState.IDLE and world.arm.state is PathState.IDLE
    assert any("the trajectory was given up" in text for text in world.warnings)
    sent = len(world.joint_previews)
    world.move(FAR)
    assert "joint_trajectory not used" in world.warnings[-1]
    world.run(0.5)
    assert len(world.joint_previews) == sent


@pytest.mark.parametrize(
    ("fault", "why"), [("silent", "no arm/joint_states"), ("displaced", "rad from")]
)
def test_a_silent_or_displaced_arm_is_brought_to_rest_and_given_up(world, fault, why):
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.0)
    if fault == "silent":
        world.arm_reports = False
    else:
        world.joint_offset[3] = 0.3
    took = world.run_until(lambda: world.arm.state is PathState.IDLE, 1.0, "the end")
    assert took <= 0.26 and why in world.warnings[-1]
    world.run(1.0)
    _, x, _v, _ = world.assert_arm_smooth()
    assert world.joint_previews[-1][2].end_speed == 0.0
    assert np.abs(world.joint_previews[-1][2].sample(1e9)[0] - x[-1]).max() < 0.6
    assert world.core.state is PathState.FOLLOWING, "the platform continues"
    world.move(FAR)
    assert "joint_trajectory" in world.warnings[-1] if fault == "silent" else True


@pytest.mark.parametrize("late", [0.0, 3.0])
def test_no_trajectory_begins_without_joint_states(late):
    with ArmWorld() as world:
        world.arm_reports = late > 0.0
        if late == 0.0:
            world.node.motions.arm_feed.forget()
        world.run(late)
        world.arm_reports = False
        world.run(0.3)
        world.move(FAR)
        words = "no arm/joint_states" if late == 0.0 else "arm/joint_states are 0.3"
        assert words in world.warnings[-1] and not world.joint_previews


def test_a_shutdown_comes_to_rest_on_both_paths(world):
    world.send(LONG)
    world.move(FAR, [4.0])
    world.run(1.0)
    world.node.begin_shutdown("SIGINT")
    patience = world.node.stop_timeout
    took = world.run_until(lambda: world.node.finished, 5.0, "the end")
    assert took < patience
    assert not world.assert_arm_smooth()[2][-1].any()
    assert not world.assert_smooth()[2][-1].any()


# ---- speed scaling ----------------------------------------------------------------------------


def reaction_time(times: np.ndarray, speed: np.ndarray, since: float) -> float:
    """Return the delay from `since` until the speed changes [s]."""
    before = speed[times <= since][-1]
    return float(times[(times > since) & (np.abs(speed - before) > 1e-6)][0] - since)


def test_speed_scaling_slows_platform_and_arm_together(world):
    world.scaling = 1.0
    away = HOME + [1.5, 0, 0, 0, 0, 0]
    world.send(LONG)
    world.move(away, [5.0])
    world.run(2.0)
    world.run(3 * PERIOD)  # between two ticks
    world.scaling = 0.5
    world.scale(0.5)
    scaling_time = world.time
    world.run(1.5)
    slow = world.time
    world.scaling = 1.0
    world.run_to_end()
    world.run_to_arm_end()
    times, x, v, _ = world.assert_arm_smooth()
    at, place, speed, rate = world.received_motion()
    groups = world.core.parameters.groups()
    assert groups[0].norm(rate).max() <= groups[0].acceleration * (1 + 1e-3)
    assert reaction_time(at, speed[:, 0], scaling_time) <= 0.05
    assert speed[(at > slow - 0.2) & (at < slow), 0] == pytest.approx(0.25, abs=1e-4)
    assert place[-1] == pytest.approx(LONG[-1], abs=1e-9) and (place[:, 1] == 0.0).all()
    assert x[-1] == pytest.approx(away, abs=1e-9)
    duration = np.ptp(times[np.abs(v[:, 0]) > 1e-9])
    assert duration == pytest.approx(5.0 + 0.75, abs=0.15), "half the time was lost in 1.5 s"
    assert world.warnings == []


def test_a_pause_at_zero_scaling_lasts_until_resumed_and_a_cancel_ends_at_once(world):
    world.scaling = 1.0
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.0)
    world.scaling = 0.0
    world.run(1.5)
    assert world.call_service("pause").success
    world.scaling = 1.0
    joints = world.joints.copy()
    world.run(1.0)
    assert (world.joints == joints).all(), "an arm at rest does not move in order to pause"
    assert world.call_service("resume").success
    world.run(0.5)
    assert np.abs(world.joints - joints).max() > 0.01
    world.scaling = 0.0
    world.run(1.5)
    assert world.call_service("cancel").success
    world.run(0.05)
    assert world.core.state is PathState.IDLE and world.arm.state is PathState.IDLE
    world.assert_arm_smooth()


@pytest.mark.parametrize("value", representative([NAN, math.inf, -0.2, 1.2], every=3))
def test_an_invalid_speed_scaling_is_ignored_with_a_warning(world, value):
    world.send(BENT)
    world.run(0.5)
    world.scale(value)
    world.run(0.1)
    assert world.warnings and "arm/speed_scaling ignored" in world.warnings[0]
    world.run_to_end()
    world.assert_smooth()
    assert world.node.motions.time_base.pace.plain


def test_a_speed_scaling_near_an_end_of_its_range_is_exactly_that_end(world):
    for reported, used in ((0.5, 0.5), (0.99995, 1.0), (0.5, 0.5), (2e-5, 0.0)):
        world.scale(reported)
        world.run(4 * PERIOD)
        assert world.node.motions.scaling.value == used


def test_a_lost_speed_scaling_ends_the_arm_motion_and_later_paths_run_at_full_speed(world):
    world.scaling = 0.5
    world.run(0.1)
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.7)
    world.scaling = None
    world.run(0.7)
    assert world.arm.state is PathState.IDLE and "no arm/speed_scaling" in world.warnings[-1]
    assert world.core.state is PathState.FOLLOWING
    assert world.setpoint.velocity[0] == pytest.approx(0.25, abs=1e-6), "the last value is kept"
    world.call_service("cancel")
    world.run_to_end()
    since = len(world.references)
    world.send([world.setpoint.pose, (2.5, 0, 0)])
    world.run_to_end()
    assert np.abs(world.received_motion(since)[2][:, 0]).max() == pytest.approx(0.5, abs=1e-6)


def test_invalid_joint_states_do_not_count_as_fresh(world):
    """The tool pose publisher reads them first, which must not make an older position fresh."""
    world.run(0.2)
    good, world.joints = world.joints, np.full(6, NAN)
    world.run(0.5)
    world.arm_reports, world.joints = False, good
    world.run(0.15)
    world.move([FAR])
    world.run(0.2)
    assert not world.joint_previews
    assert (
        "arm/joint_states" in world.node.motions.arm.log.text
        and " old" in world.node.motions.arm.log.text
    )


def test_tool_paths_are_left_to_another_node_by_parameter():
    with ArmWorld({"takes_tool_paths": False}) as world:
        topics = {
            topic
            for topic, _ in world.node.get_subscriber_names_and_types_by_node(
                "path_interpolator", "/"
            )
        }
        assert "/tool_path" not in topics and "/path" in topics


def test_the_arm_is_not_moved_while_another_node_moves_the_body(world):
    world.follows_stream = False
    world.publish_source("body")
    world.run(0.1)
    world.move([FAR])
    assert any("whole_body_planner moves the arm" in text for text in world.warnings)
    assert not world.joint_previews


# ---- streams of single points -----------------------------------------------------------------

WRIST = np.array([0.0, 0.0, 0.0, 0.3, 0.2, -0.3])  #: Rate of the streams here [rad/s]


class Servo:
    """Sends a point each 20 ms, due 0.15 s later, as MoveIt Servo does."""

    def __init__(self, world: ArmWorld) -> None:
        self.world, self.sends, self.sent = world, True, 0
        self.begin, self.speeds = world.time, False
        world.hooks.append(self._send)

    def _send(self) -> None:
        if not self.sends or self.world.time < self.begin + 0.02 * self.sent:
            return
        self.sent += 1
        goal = self.goal(self.world.time + 0.15)
        more = {"velocities": [WRIST]} if self.speeds else {}
        self.world.trajectories.publish(trajectory(goal, [0.15], **more))

    def goal(self, time: float) -> np.ndarray:
        return HOME + WRIST * (time - self.begin)


@pytest.fixture
def servo(world):
    return Servo(world)


@pytest.mark.parametrize("speeds", [False, exhaustive(True)])
def test_a_stream_of_points_leads_the_arm_which_rests_when_it_falls_silent(world, servo, speeds):
    servo.speeds = speeds
    world.run(2.0)
    assert world.warnings == [] and servo.sent > 90
    assert np.abs(world.joints - servo.goal(world.time)).max() < 0.05
    servo.sends = False
    world.run_to_arm_end(1.0)
    rest = world.joints.copy()
    assert np.abs(rest - servo.goal(world.time)).max() < 0.3
    world.run(1.0)
    assert (world.joints == rest).all()
    world.assert_arm_smooth()
    servo.begin, servo.sent, servo.sends = world.time - 1.9, 95, True
    world.run(0.5)
    assert world.warnings == [] and np.abs(world.joints - rest).max() > 0.02


@pytest.mark.parametrize("ended", ["stop", exhaustive("cancel"), exhaustive("trajectory")])
def test_a_stream_that_lost_control_moves_the_arm_only_after_a_pause(world, servo, ended):
    world.run(0.5)
    if ended == "stop":
        stop = world.publisher(Bool, "emergency_stop", ALL_LATCHED)
        stop.publish(Bool(data=True))
        world.run(0.3)
        stop.publish(Bool(data=False))
    elif ended == "trajectory":
        world.move(HOME, [3.0])
    else:
        assert world.call_service(ended).success
    world.run(0.6 if ended != "trajectory" else 4.0)
    assert any("must pause for 1.2 s" in text for text in world.warnings)
    before = world.joints.copy()
    world.run(1.0)
    assert (world.joints == before).all(), "the stream goes on, the arm does not"
    servo.sends = False
    world.run(1.3)
    servo.begin, servo.sent, servo.sends = world.time, 0, True
    servo.goal = lambda time: before + WRIST * (time - servo.begin)
    world.run(0.5)
    assert np.abs(world.joints - before).max() > 0.02


def test_a_window_that_ends_in_motion_belongs_to_a_stream(world):
    rows = [HOME + WRIST * time for time in (0.0, 0.05, 0.1)]
    world.move(rows, [0.0, 0.05, 0.1], velocities=[WRIST] * 3)
    world.run_to_arm_end(1.0)
    assert world.warnings == [] and np.abs(world.joints - HOME).max() > 0.01


def test_single_points_with_the_platform_are_refused_with_the_way(world):
    world.move([[0.5, 0.0]], [0.15], names=["odom_x", "elbow_joint"])
    assert "the platform takes cmd_vel" in world.warnings[-1] and not world.joint_previews
