"""Tests of the node over real topics in simulated time, with a fake and the real controller."""

import itertools
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Quaternion, Twist
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import Trigger

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.poses import path_message
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.pending_start import WAIT_TIMEOUT
from omniman_ros.core.preview import Setpoint
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.path_interpolator.node import PathInterpolatorNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.followers import FakeFollower, StreamWorld
from test.nodes.harness import PERIOD, World, last
from test.nodes.rig import twist
from test.tiers import exhaustive

Poses = Sequence[Sequence[float]]

BENT = [(0, 0, 0), (0.5, 0, 0), (0.5, 0.3, 0.5)]
OTHER = [(0.3, 0.1, 0), (0.9, 0.4, -0.5), (1.0, -0.2, -0.5)]
NAN, INF = math.nan, math.inf


def path(poses: Poses, frame: str = "odom") -> Path:
    return path_message(np.array(poses, dtype=float).reshape(-1, 3), frame)


class InterpolatorWorld(StreamWorld):
    """An interpolator node with its stream, progress and diagnostics."""

    maker: type = PathInterpolatorNode
    name, source = "path_interpolator", "path"

    def __init__(self, *others: Any, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(*others, parameters=parameters)
        self.progress = self.listen(Float64, "path_progress")
        self.diagnostics = self.listen(DiagnosticArray, "/diagnostics")
        self.listen_to_requests()

    def listen_to_requests(self) -> None:
        """Make the publishers of what the node is asked for."""
        self.core = self.node.motions.path.core
        self.paths = self.publisher(Path, "path")

    def subscription_count(self) -> int:
        return int(self.node.motions.platform_previews.publisher.get_subscription_count())

    def send(self, poses: Poses, **options: Any) -> None:
        self.paths.publish(path(poses, **options))
        self.run(2 * PERIOD)

    def drive_path(self, poses: Poses) -> None:
        """Send a path that may have to wait, and run until it has ended."""
        self.send(poses)
        self.run_until(lambda: self.core.state is PathState.FOLLOWING, 3.0, "the path to begin")
        self.run_to_end()

    def run_to_end(self, seconds: float = 20.0) -> None:
        self.run_until(lambda: self.core.state is PathState.IDLE, seconds, "the end of the path")

    def status(self, wait: float = 1.1) -> DiagnosticStatus:
        """Return the interpolator's latest diagnostics after waiting for an update.

        A new level or message is published after 0.1 s, new values after 1 s.
        """
        self.run(wait)
        ours = [s for array in self.diagnostics for s in array.status if self.name in s.name]
        return last(ours)

    def received_motion(self, since: int = 0, step: float = 0.002) -> tuple[np.ndarray, ...]:
        """Return times (k,) and x, x', x'' (k, 3) as a receiver of the stream samples them."""
        times, setpoints = [], []
        ends = [*self.arrivals[since + 1 :], self.arrivals[-1] + 0.1]
        for i, end in enumerate(ends, start=since):
            preview = self.preview(i)
            for now in np.arange(self.arrivals[i], end - 1e-9, step):
                times.append(now)
                setpoints.append(preview.sample(now + 1e-9))  # not just before its start
        x, v, a = (
            np.array([getattr(setpoint, name) for setpoint in setpoints])
            for name in ("pose", "velocity", "acceleration")
        )
        x[:, 2] = np.unwrap(x[:, 2])
        return np.array(times), x, v, a

    def assert_smooth(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Assert that limits and continuity hold at the points of the stream and between them."""
        times, x, v, a = self.received_motion(since)
        dt = np.diff(times)[:, None]
        jerk = np.diff(a, axis=0) / dt
        groups = self.core.parameters.groups()
        for group in groups:
            assert group.norm(v).max() <= group.velocity * (1 + 1e-6)
            assert group.norm(a).max() <= group.acceleration * (1 + 1e-6)
            assert group.norm(jerk).max() <= group.jerk * (1 + 1e-4)
        most = np.array([groups[0].jerk, groups[0].jerk, groups[1].jerk])
        assert (np.abs(np.diff(v, axis=0) - dt * a[:-1]) <= 0.51 * most * dt**2 + 1e-9).all()
        off = np.diff(x, axis=0) - dt * (v[:-1] + 0.5 * dt * a[:-1])
        assert (np.abs(off) <= 0.17 * most * dt**3 + 1e-9).all()
        return times, x, v, a


class FakeControllerWorld(InterpolatorWorld, FakeFollower):
    """The interpolator with a fake controller that follows without delay."""

    def __init__(self, parameters: dict[str, Any] | None = None, source: str = "none") -> None:
        super().__init__(parameters=parameters)
        self.follow(source)


class RealControllerWorld(InterpolatorWorld):
    """The interpolator with the real controller on the simulated drive."""

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(PlatformControllerNode, SimulatedDriveNode, parameters=parameters)
        self.controller, self.drive = self.nodes[1:]
        self.odom = self.listen(Odometry, "odom")
        self.sources = self.listen(String, "active_source", LATCHED)
        self.cmd_vel = self.publisher(Twist, "cmd_vel")
        self.run_until(lambda: len(self.odom) > 3, 2.0, "odom")
        self.run_until_none_drives()

    def run_until_none_drives(self) -> None:
        """Run until the node knows that none drives.

        What the probe hears does not tell: it may hear the first, latched report twice.
        """
        monitor = self.node.motions.stream_monitor
        self.run_until(lambda: monitor.source == "none", 2.0, "none to drive")

    @property
    def at_rest(self) -> bool:
        return self.controller.core.at_rest and self.true_speed() < 0.01

    def true_speed(self) -> float:
        """Return the platform's true speed [m/s or rad/s]."""
        return float(np.abs(self.drive.drives.ground_truth()[1]).max())

    def assert_stays_at_rest(self, seconds: float = 1.5) -> None:
        """Assert that the platform comes to rest and does not move again by itself."""
        self.run_until(lambda: self.at_rest, 1.5, "rest")
        place = self.drive.drives.ground_truth()[0]
        self.assert_silent(seconds)
        assert self.drive.drives.ground_truth()[0] == pytest.approx(place, abs=2e-3)

    def drivers(self) -> list[str]:
        """Return who drove, in turn; the middleware may deliver the first, latched one twice."""
        return [source for source, _ in itertools.groupby(m.data for m in self.sources)]

    def refused_previews(self) -> int:
        """Return the number of previews that the controller has refused."""
        return self.controller._throttle.counts.get("path/reference refused", 0)


@pytest.fixture
def world():
    with FakeControllerWorld() as world:
        yield world


@pytest.fixture
def robot():
    with RealControllerWorld() as world:
        yield world


# ---- following --------------------------------------------------------------------------------


def test_the_robot_follows_within_5_mm_at_half_a_metre_per_second():
    with RealControllerWorld({"path.linear_velocity": 0.5}) as world:
        world.send(BENT)
        world.run_to_end()
        for message in (world.message(0), world.message(-1)):
            assert message.header.frame_id == "odom" and message.joint_names == ["platform"]
            times = [time_seconds(point.time_from_start) for point in message.points]
            assert times == pytest.approx(TICK * np.arange(51), abs=1e-9)
        assert np.diff(world.arrivals[1:]) == pytest.approx([0.04] * len(world.arrivals[2:]))
        _, _, v, _ = world.assert_smooth()
        assert np.hypot(*v.T[:2]).max() == pytest.approx(0.5, abs=1e-6)

        previews = [world.preview(i) for i in range(len(world.references))]
        odom = [(time_seconds(m.header.stamp), m.pose.pose) for m in world.odom]
        errors = []
        for time, pose in odom:
            i = max((i for i, p in enumerate(previews) if p.start <= time), default=None)
            if i is not None:
                x, y, _ = previews[i].sample(time).pose
                errors.append(math.hypot(pose.position.x - x, pose.position.y - y))
        assert len(errors) > 150
        assert math.sqrt(np.mean(np.square(errors))) <= 0.005

        steps = [m.data for m in world.progress]
        assert steps[0] == 0.0 and steps[-1] == 1.0 and (np.diff(steps) >= 0.0).all()
        assert previews[-1].sample(math.inf).pose == pytest.approx(BENT[-1], abs=1e-12)
        assert world.controller.core.odometry.pose == pytest.approx(BENT[-1], abs=3e-3)
        world.run(0.8)
        assert world.drivers() == ["none", "path", "none"]
        assert world.refused_previews() == 0
        status = world.status()
        assert status.level == DiagnosticStatus.OK and status.message == "idle"


def test_overlapping_previews_agree(world):
    world.send(BENT)
    world.run_to_end()
    overlaps = 0
    for i in range(len(world.references) - 1):
        first, second = world.preview(i), world.preview(i + 1)
        for now in np.arange(second.start, first.end - 1e-6, TICK):
            a, b = first.sample(now + 1e-9), second.sample(now + 1e-9)
            assert b.pose == pytest.approx(a.pose, abs=1e-9)
            assert b.velocity == pytest.approx(a.velocity, abs=1e-6)
            overlaps += 1
    assert overlaps > 800


EVENTS: dict[str, list[Any]] = {
    "new path": [BENT, 0.8, OTHER],
    "pause, resume, pause, resume": [
        BENT,
        0.5,
        "pause",
        0.0,
        "resume",
        0.0,
        "pause",
        0.03,
        "resume",
    ],
    "new path while cancelling": [BENT, 0.8, "cancel", 0.1, OTHER],
}


@pytest.mark.parametrize("events", EVENTS.values(), ids=EVENTS)
def test_the_stream_stays_smooth_and_ends_where_the_last_path_ends(world, events):
    goal = None
    for event in events:
        if event == "settle":
            world.run(world.core.remaining(world.time) + 0.1)
        elif isinstance(event, str):
            answer = world.call_service(event)
            assert answer.success, answer.message
        elif isinstance(event, float):
            world.run(event)
        else:
            goal = [np.add(pose, [0.2, 0.1, 0]) for pose in event] if event is not BENT else event
            world.paths.publish(path(goal))
            world.run(PERIOD)
    assert goal is not None
    world.run_to_end()
    _, x, _, _ = world.assert_smooth()
    assert world.warnings == []
    assert x[-1] == pytest.approx(goal[-1], abs=1e-9)
    assert last(world.progress).data == 1.0


@pytest.mark.parametrize(
    ("before", "wait"),
    [("", 0.0), exhaustive("pause", 0.0), ("pause", 0.1), exhaustive("pause", 1.2)],
)
def test_a_cancel_stops_on_the_path_and_discards_it(world, before, wait):
    world.send(BENT)
    world.run(0.6)
    if before:
        world.call_service(before)
        world.run(wait)
    assert world.call_service("cancel").message in ("cancelling", "idle")
    assert not world.call_service("resume").success
    world.run_to_end(3.0)
    _, x, v, _ = world.assert_smooth()
    assert not v[-1].any() and 0.02 < x[-1, 0] < 0.5 and x[-1, 1] == 0.0
    assert 0.0 < last(world.progress).data < 1.0
    values = {v.key: v.value for v in world.status().values}
    assert (values["state"], values["last"]) == ("idle", "cancelled")
    world.assert_silent(0.2)


def test_requests_without_a_path_are_refused_with_a_reason(world):
    for name, why in (
        ("pause", "pause: idle"),
        ("resume", "end: idle"),
        ("cancel", "cancel: idle"),
    ):
        answer = world.call_service(name)
        assert not answer.success and why in answer.message
    world.send(BENT)
    assert not world.call_service("resume").success
    assert world.call_service("cancel").success
    assert not world.call_service("pause").success


def test_a_path_of_one_pose_keeps_the_heading_along_the_path():
    with FakeControllerWorld({"path.heading": "along"}) as world:
        world.setpoint = Setpoint(np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))
        world.run(4 * PERIOD)
        world.send([(0.2, 0.1, 0)])
        world.run_to_end()
        assert world.received_motion()[1][-1] == pytest.approx([0.2, 0.1, 1.0], abs=1e-9)


# ---- invalid paths ----------------------------------------------------------------------------


def path_with_orientation(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 0.0) -> Path:
    """Return a path whose second pose has the given quaternion."""
    message = path(BENT)
    message.poses[1].pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return message


def path_with_position(x: float, frame: str = "") -> Path:
    """Return a path whose second pose has the given position and frame."""
    message = path(BENT)
    message.poses[1].pose.position.x, message.poses[1].header.frame_id = x, frame
    return message


INVALID_PATHS: dict[str, tuple[Callable[[], Path | bytes], str]] = {
    "empty": (lambda: path([]), "the path is empty"),
    "NaN": (lambda: path_with_position(NAN), "positions .*nan.* not finite"),
    "very long": (lambda: path_with_position(9e5), "takes .* s, at most 3600 s"),
    "a pose in map": (
        lambda: path_with_position(0.6, frame="map"),
        "frame 'map', expected 'odom'",
    ),
    "zero quaternion": (path_with_orientation, "pose 1: it has a quaternion of length 0"),
    "too far": (lambda: path([(3, 4, 0), (5, 5, 0)]), "starts 5.00 m from the robot"),
    "oversized": (lambda: bytes(80_000_000), "80 MB, at most 20000 poses"),
}


def publish_or_inject(world: InterpolatorWorld, what: Path | bytes) -> None:
    if isinstance(what, bytes):  # injected directly: such a message is refused unread
        world.run(PERIOD)
        [subscription] = [s for s in world.node.subscriptions if s.topic_name == "/path"]
        subscription.callback(what)
    else:
        world.paths.publish(what)
    world.run_until(lambda: bool(world.warnings), 0.5, "a warning")


@pytest.fixture(scope="module")
def resting_world():
    with FakeControllerWorld({"path.start_distance": 1.5}) as world:
        yield world


@pytest.mark.parametrize(("make", "why"), INVALID_PATHS.values(), ids=INVALID_PATHS)
def test_an_invalid_path_moves_nothing_and_is_reported(resting_world, make, why):
    resting_world.warnings.clear()
    publish_or_inject(resting_world, make())
    [warning] = resting_world.warnings
    assert len(warning) < 300
    status = resting_world.status(0.15)
    assert status.level == DiagnosticStatus.WARN and "refused" in status.message
    for text in (warning, status.message):
        assert re.search(why, text), text
    assert resting_world.core.state is PathState.IDLE and not resting_world.references


def test_single_and_repeated_poses_and_the_map_frame_are_accepted():
    with FakeControllerWorld({"map_is_odom": True}) as world:
        world.send([(0.2, 0.1, 0.3)], frame="map")
        world.run_to_end()
        world.send([(0.2, 0.1, 0.3)] * 3 + [(0.5, 0.1, 0.3)] * 4)
        world.run_to_end()
        _, x, _, _ = world.assert_smooth()
        assert x[-1] == pytest.approx([0.5, 0.1, 0.3], abs=1e-9)
        world.send([(0.5, 0.1, 0.3)] * 2)
        assert "the robot is already there" in world.warnings[0]
        world.assert_silent(0.3)


# ---- odom -------------------------------------------------------------------------------------


def invalid_odom(
    world: FakeControllerWorld, x: float = 0.0, frame: str = "odom", age: float = 0.0
) -> Odometry:
    message = world.odom_message()
    message.header.frame_id, message.header.stamp = frame, world.stamp(-age)
    message.pose.pose.position.x += x
    return message


INVALID_ODOM: dict[str, tuple[dict[str, Any], str]] = {
    "stale": ({"age": 3.0}, "odom is 3.0. s old"),
    "in map": ({"frame": "map"}, "no odom"),
    "NaN": ({"x": NAN}, "no odom"),
    "ahead": ({"age": -1.0}, "no odom"),
    "huge": ({"x": 1e9}, "no odom"),
}


@pytest.mark.parametrize(("odd", "why"), INVALID_ODOM.values(), ids=INVALID_ODOM)
def test_invalid_odometry_is_ignored(odd, why):
    with FakeControllerWorld(source="") as world:
        world.node.motions.odom.pose = None  # as before the first message
        world.odometry = lambda: invalid_odom(world, **odd)
        world.publish_source("none")
        world.run(0.05)
        world.send(BENT)
        world.run(1.0)
        assert world.status().message.startswith("a path is waiting: ")
        world.run(WAIT_TIMEOUT)
        refusals = [w for w in world.warnings if w.startswith("path not used")]
        assert len(refusals) == 1
        assert re.search(why, refusals[0]), refusals[0]
        assert not world.references


@pytest.mark.parametrize(
    "odd", [None, *(odd for odd, _ in INVALID_ODOM.values())], ids=["gone", *INVALID_ODOM]
)
def test_a_path_is_given_up_when_odometry_fails(world, odd):
    world.send(BENT)
    world.run(0.5)
    world.odometry = None if odd is None else lambda: invalid_odom(world, **odd)
    world.run(0.6)
    assert world.core.state is PathState.IDLE
    assert "given up: no odom for" in world.status().message
    world.odometry = world.odom_message
    world.assert_silent()


def test_a_waiting_path_begins_when_odometry_arrives(world):
    world.odometry = None
    world.run(0.6)
    world.send(BENT)
    world.run(2.0)
    world.odometry = world.odom_message
    world.run(0.2)
    assert world.core.state is PathState.FOLLOWING and world.warnings == []


def test_a_waiting_path_can_be_cancelled(world):
    world.odometry = None
    world.run(0.6)
    world.send(BENT)
    assert world.call_service("cancel").success
    world.odometry = world.odom_message
    world.assert_silent(0.5)
    assert not world.call_service("cancel").success


# ---- active source ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("", "no platform_controller"),
        ("cmd_vel", "cmd_vel drives"),
        ("stop", "stopped"),
        ("mpc", "mpc drives"),
    ],
)
def test_a_path_that_cannot_begin_is_refused_with_the_reason(source, why):
    with FakeControllerWorld(source=source) as world:
        world.follows_stream = False
        world.send(BENT)
        world.run(1.1 if source else 5.1)  # what may pass by itself
        [warning] = world.warnings
        assert why in warning and why in world.status().message
        world.publish_source("none")
        world.assert_silent()


def test_cmd_vel_takes_over_and_a_later_path_is_driven(robot):
    robot.send(BENT)
    robot.run(0.8)
    robot.run(0.2, lambda: robot.cmd_vel.publish(twist(0.0, 0.2)))
    assert robot.core.state is PathState.IDLE
    assert "given up: cmd_vel drives" in robot.warnings[-1]
    begin = len(robot.references)
    robot.send(BENT)
    assert "cmd_vel drives" in robot.warnings[-1]
    robot.run(0.3, lambda: robot.cmd_vel.publish(twist(0.0, 0.0)))
    robot.run_until_none_drives()
    refused = robot.refused_previews()
    x, y, theta = robot.controller.core.odometry.pose
    robot.drive_path([(x, y, theta), (x - 0.2, y, theta)])
    assert len(robot.references) > begin + 10
    assert robot.controller.core.odometry.pose[0] == pytest.approx(x - 0.2, abs=3e-3)
    robot.run(0.8)
    assert robot.refused_previews() == refused <= 1
    assert robot.drivers() == ["none", "path", "cmd_vel", "none", "path", "none"]


def publish_emergency_stop(qos: Any) -> Callable[[InterpolatorWorld], None]:
    def act(world: InterpolatorWorld) -> None:
        world.publisher(Bool, "emergency_stop", qos).publish(Bool(data=True))

    return act


def publish_stopped_peer_state(world: InterpolatorWorld) -> Any:
    message = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/arm", message="stopped: test")
    publisher = world.publisher(DiagnosticStatus, "stop_state", LATCHED)
    publisher.publish(message)
    world.run(PERIOD)
    return publisher


def stop_by_controller(world: FakeControllerWorld) -> None:
    world.follows_stream = False
    world.publish_source("stop")


def cancel_by_controller(world: FakeControllerWorld) -> None:
    world.follows_stream = False
    world.publish_source("none")


LOSSES_OF_CONTROL = {
    "emergency_stop": (publish_emergency_stop(10), "emergency_stop is true"),
    "latched emergency_stop": (publish_emergency_stop(LATCHED), "emergency_stop is true"),
    "a stopped peer": (publish_stopped_peer_state, "/arm is stopped: test"),
    "the controller stops": (stop_by_controller, "the platform is stopped"),
    "the controller cancels": (cancel_by_controller, "has cancelled it"),
}


@pytest.mark.parametrize("paused", [False, exhaustive(True)], ids=["moving", "paused"])
@pytest.mark.parametrize(("loss", "why"), LOSSES_OF_CONTROL.values(), ids=LOSSES_OF_CONTROL)
def test_lost_control_is_not_taken_back(world, loss, why, paused):
    world.send(BENT)
    world.run(0.5)
    if paused:
        world.call_service("pause")
        world.run(1.0)
    loss(world)
    world.run(2 * PERIOD)
    assert world.core.state is PathState.IDLE
    assert why in world.warnings[-1] and world.warnings[-1].startswith("the path was given up")
    world.assert_silent(0.5)
    assert not world.call_service("resume").success
    assert why in world.status().message


def test_a_stop_prevails_over_a_path_at_the_same_instant(world):
    stop = world.publisher(Bool, "emergency_stop")
    world.paths.publish(path(BENT))
    stop.publish(Bool(data=True))
    world.run(PERIOD * 2)
    assert world.core.state is PathState.IDLE and world.warnings
    world.assert_silent()
    stop.publish(Bool(data=False))
    world.assert_silent()


def test_after_a_stop_and_reset_nothing_moves_until_a_new_path(robot):
    robot.send(BENT)
    robot.run(0.8)
    assert robot.true_speed() > 0.1
    assert robot.call(Trigger, "platform_controller/stop").success
    robot.assert_stays_at_rest(0.5)
    assert "~/stop" in robot.warnings[-1]
    robot.send(BENT)
    assert "is stopped: ~/stop" in robot.warnings[-1]
    assert robot.call(Trigger, "platform_controller/reset").success
    robot.assert_stays_at_rest(0.5)
    refused = robot.refused_previews()
    x, y, theta = robot.controller.core.odometry.pose
    robot.drive_path([(x, y + 0.2, theta)])
    assert robot.controller.core.odometry.pose[1] == pytest.approx(y + 0.2, abs=3e-3)
    robot.run(4 * PERIOD)
    # A stop just after the end cancels the preview that the controller still holds.
    assert robot.call(Trigger, "platform_controller/stop").success
    robot.run(0.05)
    assert robot.call(Trigger, "platform_controller/reset").success
    robot.run(0.05)
    robot.drive_path([(x, y, theta)])
    assert robot.refused_previews() == refused <= 1
    assert robot.controller.core.odometry.pose[1] == pytest.approx(y, abs=3e-3)


def test_a_reset_of_odometry_ends_the_path(robot):
    robot.send(BENT)
    robot.run(0.8)
    assert robot.call(Trigger, "platform_controller/reset_odometry").success
    robot.run(0.1)
    assert "has cancelled it" in robot.warnings[-1]
    robot.assert_stays_at_rest()


def test_a_path_waits_until_the_robot_has_come_to_rest(world):
    world.setpoint = Setpoint(np.zeros(3), np.array([0.0, 0.0, 0.3]), np.zeros(3))
    world.run(4 * PERIOD)
    world.send(BENT)
    world.run(1.0)
    assert world.node.status()[1] == "a path is waiting: the robot moves" and not world.references
    world.setpoint = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))
    world.run(0.1)
    assert world.core.state is PathState.FOLLOWING


def test_a_stopped_node_that_vanished_does_not_block_paths(world):
    publisher = publish_stopped_peer_state(world)
    world.send(BENT)
    assert "/arm is stopped" in world.warnings[-1]
    world.probe.destroy_publisher(publisher)
    world.run(1.1)
    world.send(BENT)
    assert world.core.state is PathState.FOLLOWING


def test_a_path_that_the_controller_ignores_is_reported_and_a_later_one_is_driven(world):
    world.follows_stream = False
    world.send(BENT)
    world.run(0.6)
    assert "does not follow it" in world.warnings[-1]
    sent = world.arrivals[-1]
    world.follows_stream = True
    world.send(BENT)
    assert "is waiting: control was lost" in world.node.status()[1]
    world.run_until(lambda: world.core.state is PathState.FOLLOWING, 2.0, "the path to begin")
    world.run_to_end()
    assert min(t for t in world.arrivals if t > sent) - sent > 1.0


# ---- a dead wheel -----------------------------------------------------------------------------

LONG = [(0, 0, 0), (1.5, 0, 0), (1.5, 0.5, 0.5)]


class WheelHealthPublisher:
    """Publishes the platform controller's `wheel_health`."""

    def __init__(self, world: FakeControllerWorld) -> None:
        self._publisher = world.publisher(DiagnosticStatus, "wheel_health", LATCHED)
        self._world = world

    def publish_limits(self, limits: str | None, key: str = "limits") -> None:
        message = DiagnosticStatus(name="/platform_controller")
        if limits is not None:
            message.values = [KeyValue(key=key, value=limits)]
        self._publisher.publish(message)
        self._world.run(2 * PERIOD)


def speeds(v: np.ndarray) -> np.ndarray:
    return np.hypot(v[:, 0], v[:, 1])


def test_a_posture_slows_the_path_and_its_end_does_not_interrupt_it(world):
    """A dead wheel's limits return by a reset only, which expects a silence of the stream."""
    health = WheelHealthPublisher(world)
    world.send(BENT)
    world.run(0.5)
    health.publish_limits("0.5", "posture_limits")
    assert world.core.limit_scale == 0.5
    world.run_until(lambda: world.core.state is PathState.FOLLOWING, 2.5, "a rest")
    world.run(0.5)
    health.publish_limits("1", "posture_limits")
    assert world.core.limit_scale == 1.0 and world.core.state is PathState.FOLLOWING
    world.run_to_end()
    world.assert_smooth()
    assert world.warnings == []


def test_malformed_limits_cause_a_warning_and_change_nothing(world):
    values = ["", "half", "0", "-0.5", "1.5", "nan", "inf", "1e-999"]
    health = WheelHealthPublisher(world)
    world.send(BENT)
    world.run(0.5)
    for value in values:
        health.publish_limits(value)
        assert world.core.state is PathState.FOLLOWING and world.core.limit_scale == 1.0
    assert len(world.warnings) == len(values)
    for value, warning in zip(values, world.warnings, strict=True):
        assert warning.startswith("wheel_health ignored: limits") and repr(value) in warning
    world.run_to_end()
    _, _, v, _ = world.assert_smooth()
    assert speeds(v).max() > 0.45


def test_a_path_that_the_remaining_limits_make_too_long_is_paused(world):
    health = WheelHealthPublisher(world)
    world.send(LONG)
    world.run(1.0)
    health.publish_limits("1e-6")
    world.run(1.5)
    assert world.core.state is PathState.PAUSED
    assert len(world.warnings) == 1 and "a path was paused: the path takes" in world.warnings[0]
    answer = world.call_service("resume")
    assert not answer.success and "cannot continue: the path takes" in answer.message
    health.publish_limits("1.0")
    assert world.call_service("resume").message == "following"
    world.run_to_end()
    _, x, _, _ = world.assert_smooth()
    assert x[-1] == pytest.approx(LONG[-1], abs=1e-9)


# ---- time -------------------------------------------------------------------------------------


def suspend_node(world: InterpolatorWorld, seconds: float) -> None:
    """Let time pass without running the node."""
    world.executor.remove_node(world.node)
    world.run(seconds)
    world.executor.add_node(world.node)


def test_a_suspended_node_gives_the_path_up_rather_than_jump(world):
    world.send(BENT)
    world.run(0.6)
    suspend_node(world, 0.3)
    assert world.core.state is PathState.FOLLOWING
    world.run(0.2)
    assert world.core.state is PathState.FOLLOWING
    world.assert_smooth()
    suspend_node(world, 0.6)
    sent = len(world.references)
    world.run(0.1)
    assert world.core.state is PathState.IDLE and len(world.references) == sent
    assert "given up: no preview for 0.6" in world.warnings[-1]
    world.assert_silent()


def delay_planning(world: FakeControllerWorld, seconds: float) -> None:
    """Let planning take a given time [s], during which the node receives nothing."""
    propose = world.core.propose

    def slow(*args: Any) -> Any:
        proposal = propose(*args)
        world.time += seconds
        for node in (*world.nodes, world.probe):
            world._set_time(node)
        if world.odometry is not None:
            world._odom.publish(world.odometry())  # the other nodes continue
        # No source is reported until the previews sent meanwhile have arrived.
        world.busy_until = world.time + 4 * PERIOD
        return proposal

    world.core.propose = slow


def test_planning_from_rest_may_take_longer_than_a_preview(world):
    delay_planning(world, 2.0)
    world.send(BENT)
    world.run(0.5)
    assert world.core.state is PathState.FOLLOWING and world.warnings == []
    world.run_to_end()
    _, x, _, _ = world.assert_smooth()
    assert x[-1] == pytest.approx(BENT[-1], abs=1e-9)


@pytest.mark.parametrize(
    ("seconds", "good"), [exhaustive(0.05, True), exhaustive(0.1, True), (0.3, False)]
)
def test_slow_planning_during_motion_never_causes_a_jump(world, seconds, good):
    world.send(BENT)
    world.run(0.5)
    delay_planning(world, seconds)
    world.send(OTHER)
    world.run(0.1)
    assert world.core.state is PathState.FOLLOWING
    assert ["could not be planned in time" in w for w in world.warnings] == [True] * (not good)
    since = 0 if good else len(world.references)
    world.run_to_end()
    _, x, _, _ = world.assert_smooth(since)
    assert x[-1] == pytest.approx((OTHER if good else BENT)[-1], abs=1e-9)


def test_a_jump_back_in_time_ends_the_path_and_a_new_one_is_driven(world):
    world.send(BENT)
    world.run(0.5)
    world.time -= 500.0
    world.run(0.1)
    assert world.core.state is PathState.IDLE and "time went back" in world.warnings[-1]
    world.assert_silent(0.3)
    world.odometry = None
    world.send([world.setpoint.pose, (0.5, 0.3, 0.0)])
    world.run(0.5)
    assert world.core.state is PathState.IDLE, "odometry from before the jump is not used"
    world.odometry = world.odom_message
    world.run_until(lambda: world.core.state is PathState.FOLLOWING, 2.0, "the path to begin")
    world.run_to_end()


def test_a_shutdown_comes_to_rest_on_the_path_and_refuses_others(world):
    assert world.node.finished
    world.send(BENT)
    world.run(0.5)
    world.node.begin_shutdown("SIGINT")
    assert not world.node.finished
    patience = world.node.stop_timeout
    world.run(0.1)
    world.send(OTHER)
    assert "the node is shutting down" in world.warnings[-1]
    took = world.run_until(lambda: world.node.finished, 5.0, "the end")
    assert took + 0.1 < patience
    _, x, v, _ = world.assert_smooth()
    assert not v[-1].any() and x[-1, 1] == 0.0 and x[-1, 0] < 0.5


# ---- parameters -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("limits.linear_velocity", -1.0),
        ("limits.angular_jerk", NAN),
        ("path.heading", "sideways"),
        ("path.corner_tolerance", -0.1),
        ("path.reserve", 1.0),
        ("horizon", 1.0),
    ],
)
def test_invalid_parameter_values_are_refused_by_name(resting_world, name, value):
    result = resting_world.set(name, value)
    assert not result.successful and name in result.reason
    assert resting_world.core.parameters == resting_world.node.settings.value.core


def test_a_period_too_long_for_the_horizon_is_refused():
    with pytest.raises(ParameterError, match="period"):
        World(PathInterpolatorNode, parameters={"period": 0.2, "horizon": 0.3})
