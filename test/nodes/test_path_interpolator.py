"""The node over real topics, on simulated time: with a fake controller, and with the real one."""

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Quaternion, Twist
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros import conversions
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.path.interpolator import PathState
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.preview import Preview, Setpoint
from omniman_ros.nodes.motions.waiting import PATIENCE
from omniman_ros.nodes.path_interpolator import PathInterpolatorNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stopping import LATCHED

from .harness import PERIOD, World, last
from .rig import twist

Poses = Sequence[Sequence[float]]

BENT = [(0, 0, 0), (0.5, 0, 0), (0.5, 0.3, 0.5)]
OTHER = [(0.3, 0.1, 0), (0.9, 0.4, -0.5), (1.0, -0.2, -0.5)]
THIRD = [(0.4, -0.3, 0.2), (-0.2, -0.4, 1.0)]
NAN, INF = math.nan, math.inf


def path(poses: Poses, frame: str = "odom") -> Path:
    return conversions.path_message(np.array(poses, dtype=float).reshape(-1, 3), frame)


class Station(World):
    """An interpolator, its stream with the times of arrival, and what it says."""

    def __init__(self, *others: Any, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(PathInterpolatorNode, *others, parameters=parameters)
        self.node: PathInterpolatorNode = self.nodes[0]
        self.core = self.node.path.core
        self.arrivals: list[float] = []
        self.references: list[bytes] = []  # unpacked where they are looked at: that takes longest
        self._previews: dict[int, Preview] = {}
        self.probe.create_subscription(
            MultiDOFJointTrajectory, "path/reference", self._hear, 100, raw=True
        )
        self._await(lambda: self.count_listeners() > 0, "a publisher of path/reference")
        self.progress = self.listen(Float64, "path_progress")
        self.diagnostics = self.listen(DiagnosticArray, "/diagnostics")
        self.paths = self.publisher(Path, "path")
        self.warnings: list[str] = []
        warn = self.node.warn
        self.node.warn = lambda subject, text: (self.warnings.append(text), warn(subject, text))

    def count_listeners(self) -> int:
        return int(self.node.platform_previews.publisher.get_subscription_count())

    def _hear(self, data: bytes) -> None:
        self.references.append(data)
        self.arrivals.append(self.time)

    def send(self, poses: Poses, **options: Any) -> None:
        self.paths.publish(path(poses, **options))
        self.run(2 * PERIOD)

    def ask(self, name: str) -> Trigger.Response:
        return self.call(Trigger, f"path_interpolator/{name}")

    def set(self, name: str, value: object, node: str = "path_interpolator") -> Any:
        given = value if isinstance(value, Parameter) else Parameter(name, value=value)
        request = SetParameters.Request(parameters=[given.to_parameter_msg()])
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def travel(self, poses: Poses) -> None:
        """Send a path that may have to wait, and see it to its end."""
        self.send(poses)
        self.run_until(lambda: self.core.state is PathState.FOLLOWING, 3.0, "the path to begin")
        self.arrive()

    def arrive(self, seconds: float = 20.0) -> None:
        self.run_until(lambda: self.core.state is PathState.IDLE, seconds, "the end of the path")

    def assert_silent(self, seconds: float = 1.0) -> None:
        """Nothing is streamed."""
        before = len(self.references)
        self.run(seconds)
        assert len(self.references) == before

    def status(self, wait: float = 1.1) -> DiagnosticStatus:
        """The interpolator's last diagnostics, after time enough for new ones.

        A new level or message is published after 0.1 s, new values after 1 s.
        """
        self.run(wait)
        ours = [s for array in self.diagnostics for s in array.status if "interp" in s.name]
        return last(ours)

    def message(self, i: int) -> MultiDOFJointTrajectory:
        return deserialize_message(self.references[i], MultiDOFJointTrajectory)

    def preview(self, i: int) -> Preview:
        i %= len(self.references)
        if i not in self._previews:
            message = self.message(i)
            start = conversions.time_seconds(message.header.stamp)
            self._previews[i] = conversions.preview(message, start, ("odom",))
        return self._previews[i]

    def followed(self, since: int = 0, step: float = 0.002) -> tuple[np.ndarray, ...]:
        """Times (k,), x, x', x'' (k, 3) as a receiver of the stream has them."""
        times, setpoints = [], []
        ends = [*self.arrivals[since + 1 :], self.arrivals[-1] + 0.1]
        for i, end in enumerate(ends, start=since):
            preview = self.preview(i)
            for now in np.arange(self.arrivals[i], end - 1e-9, step):
                times.append(now)
                setpoints.append(preview.sample(now + 1e-9))  # not just before its begin
        x, v, a = (
            np.array([getattr(setpoint, name) for setpoint in setpoints])
            for name in ("pose", "velocity", "acceleration")
        )
        x[:, 2] = np.unwrap(x[:, 2])
        return np.array(times), x, v, a

    def assert_smooth(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Limits hold in the stream and between its points, and nothing in it jumps."""
        times, x, v, a = self.followed(since)
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


class Alone(Station):
    """The interpolator with a fake controller that follows at once.

    Attributes:
        takes: Whether the controller takes the stream.
        odometry: Makes what is published on odom, or None for nothing.
        busy_until: Time until which it says nothing new [s].
    """

    def __init__(self, parameters: dict[str, Any] | None = None, source: str = "none") -> None:
        super().__init__(parameters=parameters)
        self.takes, self.busy_until = True, 0.0
        self.odometry: Callable[[], Odometry] | None = self.odom_message
        self.setpoint = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))
        self._odom = self.publisher(Odometry, "odom")
        self._source = self.publisher(String, "active_source", LATCHED)
        self._said, self._heard = "", 0
        self._preview: Preview | None = None
        self.hooks.append(self._control)
        if source:
            self.say(source)
        else:
            self.takes = False
        self.run(4 * PERIOD)

    def say(self, source: str) -> None:
        """Say who drives."""
        if source != self._said:
            self._said = source
            self._source.publish(String(data=source))

    def _control(self) -> None:
        new, self._heard = len(self.references) > self._heard, len(self.references)
        if not self.takes:
            self._preview = None
        elif new:
            self._preview = self.preview(-1)
        if self._preview is not None:
            self.setpoint = self._preview.sample(self.time + 1e-9)
            held = 0.0 if self._preview.end_speed > 1e-6 else 0.2
            if self.time > self.busy_until:
                self.say("path" if self.time <= self._preview.end + held else "none")
        if self.odometry is not None:
            self._odom.publish(self.odometry())

    def odom_message(self) -> Odometry:
        """The controller's odometry: where the stream is now."""
        message = Odometry()
        message.header.frame_id, message.header.stamp = "odom", self.stamp()
        x, y, theta = self.setpoint.pose.tolist()
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation = conversions.quaternion(theta)
        message.twist.twist = twist(*self.setpoint.velocity)
        return message


class Robot(Station):
    """The interpolator with the real controller on the simulated drive."""

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(PlatformControllerNode, SimulatedDriveNode, parameters=parameters)
        self.controller, self.drive = self.nodes[1:]
        self.odom = self.listen(Odometry, "odom")
        self.sources = self.listen(String, "active_source", LATCHED)
        self.cmd_vel = self.publisher(Twist, "cmd_vel")
        self.run_until(lambda: len(self.odom) > 3, 2.0, "odom")

    @property
    def at_rest(self) -> bool:
        return self.controller.core.at_rest and self.moved() < 0.01

    def moved(self) -> float:
        """The platform's true speed [m/s or rad/s]."""
        return float(np.abs(self.drive.drives.ground_truth()[1]).max())

    def assert_rests(self, seconds: float = 1.5) -> None:
        """It comes to rest, and nothing moves again by itself."""
        self.run_until(lambda: self.at_rest, 1.5, "rest")
        place = self.drive.drives.ground_truth()[0]
        self.assert_silent(seconds)
        assert self.drive.drives.ground_truth()[0] == pytest.approx(place, abs=2e-3)

    def refusals(self) -> int:
        """How many previews the controller has refused."""
        return self.controller._throttle.counts.get("path/reference refused", 0)


@pytest.fixture
def alone():
    with Alone() as world:
        yield world


@pytest.fixture
def robot():
    with Robot() as world:
        yield world


# ---- following --------------------------------------------------------------------------------


def test_the_robot_follows_within_5_mm_at_half_a_metre_a_second():
    with Robot({"path.linear_velocity": 0.5}) as world:
        world.send(BENT)
        world.arrive()
        for message in (world.message(0), world.message(-1)):
            assert message.header.frame_id == "odom" and message.joint_names == ["platform"]
            times = [conversions.time_seconds(point.time_from_start) for point in message.points]
            assert times == pytest.approx(TICK * np.arange(51), abs=1e-9)
        assert np.diff(world.arrivals[1:]) == pytest.approx([0.04] * len(world.arrivals[2:]))
        _, _, v, _ = world.assert_smooth()
        assert np.hypot(*v.T[:2]).max() == pytest.approx(0.5, abs=1e-6)

        previews = [world.preview(i) for i in range(len(world.references))]
        odom = [(conversions.time_seconds(m.header.stamp), m.pose.pose) for m in world.odom]
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
        assert [m.data for m in world.sources] == ["none", "path", "none"]
        assert world.refusals() == 0
        status = world.status()
        assert status.level == DiagnosticStatus.OK and status.message == "idle"


def test_previews_agree_where_they_overlap(alone):
    alone.send(BENT)
    alone.arrive()
    overlaps = 0
    for i in range(len(alone.references) - 1):
        first, second = alone.preview(i), alone.preview(i + 1)
        for now in np.arange(second.start, first.end - 1e-6, TICK):
            a, b = first.sample(now + 1e-9), second.sample(now + 1e-9)
            assert b.pose == pytest.approx(a.pose, abs=1e-9)
            assert b.velocity == pytest.approx(a.velocity, abs=1e-6)
            overlaps += 1
    assert overlaps > 800


EVENTS: dict[str, list[Any]] = {
    "new path": [BENT, 0.8, OTHER],
    "new path in the same tick": [BENT, 0.8, OTHER, 0.0, THIRD],
    "new path 2 ticks later": [BENT, 0.8, OTHER, 0.015, THIRD],
    "new path at once": [BENT, 0.0, OTHER],
    "pause": [BENT, 0.8, "pause", 1.5, "resume"],
    "pause at once": [BENT, 0.0, "pause", 0.5, "resume"],
    "pause twice": [BENT, 0.8, "pause", 0.1, "pause", 1.0, "pause", 0.1, "resume"],
    "resume while braking": [BENT, 0.8, "pause", 0.1, "resume"],
    "pause, resume, pause, resume": [BENT, 0.5, "pause", 0.0, "resume", 0.0, "pause", 0.03,
                                     "resume"],
    "new path while pausing": [BENT, 0.8, "pause", 0.1, OTHER],
    "new path while paused": [BENT, 0.8, "pause", 1.5, OTHER],
    "new path while cancelling": [BENT, 0.8, "cancel", 0.1, OTHER],
    "new path while it settles": [BENT, "settle", OTHER],
    "pause while it settles": [BENT, "settle", "pause", 0.5, "resume"],
}  # fmt: skip


@pytest.mark.parametrize("events", EVENTS.values(), ids=EVENTS)
def test_the_stream_stays_smooth_and_ends_where_the_last_path_ends(alone, events):
    goal = None
    for event in events:
        if event == "settle":
            alone.run(alone.core.remaining(alone.time) + 0.1)
        elif isinstance(event, str):
            answer = alone.ask(event)
            assert answer.success, answer.message
        elif isinstance(event, float):
            alone.run(event)
        else:
            goal = [np.add(pose, [0.2, 0.1, 0]) for pose in event] if event is not BENT else event
            alone.paths.publish(path(goal))
            alone.run(PERIOD)
    assert goal is not None
    alone.arrive()
    _, x, _, _ = alone.assert_smooth()
    assert alone.warnings == []
    assert x[-1] == pytest.approx(goal[-1], abs=1e-9)
    assert last(alone.progress).data == 1.0


@pytest.mark.parametrize(
    ("before", "wait"), [("", 0.0), ("pause", 0.0), ("pause", 0.1), ("pause", 1.2)]
)
def test_cancel_stops_on_the_path_and_forgets_it(alone, before, wait):
    alone.send(BENT)
    alone.run(0.6)
    if before:
        alone.ask(before)
        alone.run(wait)
    assert alone.ask("cancel").message in ("cancelling", "idle")
    assert not alone.ask("resume").success
    alone.arrive(3.0)
    _, x, v, _ = alone.assert_smooth()
    assert not v[-1].any() and 0.02 < x[-1, 0] < 0.5 and x[-1, 1] == 0.0
    assert 0.0 < last(alone.progress).data < 1.0
    values = {v.key: v.value for v in alone.status().values}
    assert (values["state"], values["last"]) == ("idle", "cancelled")
    alone.assert_silent(0.2)


def test_requests_without_a_path_are_refused_with_a_reason(alone):
    for name, why in (
        ("pause", "pause: idle"),
        ("resume", "end: idle"),
        ("cancel", "cancel: idle"),
    ):
        answer = alone.ask(name)
        assert not answer.success and why in answer.message
    alone.send(BENT)
    assert not alone.ask("resume").success
    assert alone.ask("cancel").success
    assert not alone.ask("pause").success


def test_a_flood_of_paths_ends_at_the_last(alone):
    alone.send(BENT)
    alone.run(0.5)
    for i in range(50):
        alone.paths.publish(path([(0.3, 0.0, 0), (0.6 + 0.01 * i, 0.3 - 0.01 * i, 0.02 * i)]))
        alone.run(0.02)
    alone.arrive()
    _, x, _, _ = alone.assert_smooth()
    assert x[-1] == pytest.approx([1.09, -0.19, 0.98], abs=1e-9)
    assert alone.warnings == []


def test_a_long_pause_holds_the_place(alone):
    alone.send(BENT)
    alone.run(0.8)
    alone.ask("pause")
    alone.run(1.0)
    begin = len(alone.references)
    alone.run(4.0)
    assert alone.core.state is PathState.PAUSED and alone.warnings == []
    place = alone.preview(begin).sample(0.0).pose
    assert len(alone.references) == begin + 100
    for i in (begin, begin + 50, -1):
        assert alone.preview(i).sample(INF).pose.tolist() == place.tolist()
        assert alone.preview(i).end_speed == 0.0
    assert alone.ask("resume").success
    alone.arrive()
    _, x, _, _ = alone.assert_smooth(begin + 90)
    assert x[-1] == pytest.approx(BENT[-1], abs=1e-9)


def test_along_the_path_looks_where_it_goes_and_at_no_quaternion():
    with Alone({"path.heading": "along", "path.corner_tolerance": 0.02}) as world:
        message = path([(0, 0, 0), (0.8, 0, 0), (0.8, 0.8, 0)])
        for stamped, z in zip(message.poses, (0.0, NAN, 7.0), strict=True):
            stamped.pose.orientation = Quaternion(x=z, y=0.0, z=z, w=0.0)
        world.paths.publish(message)
        world.run(0.1)
        world.arrive()
        _, x, v, _ = world.assert_smooth()
        straight = (x[:, 0] < 0.65) | (x[:, 1] > 0.15)
        fast = straight & (np.hypot(*v.T[:2]) > 0.05)
        assert fast.sum() > 300
        assert x[fast, 2] == pytest.approx(np.arctan2(v[fast, 1], v[fast, 0]), abs=0.03)
        assert x[-1] == pytest.approx([0.8, 0.8, math.pi / 2], abs=1e-9)


def test_along_a_path_of_one_place_the_heading_stays():
    with Alone({"path.heading": "along"}) as world:
        world.setpoint = Setpoint(np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))
        world.run(4 * PERIOD)
        world.send([(0.2, 0.1, 0)])
        world.arrive()
        assert world.followed()[1][-1] == pytest.approx([0.2, 0.1, 1.0], abs=1e-9)


def test_without_tolerance_it_stops_at_the_corner():
    with Alone({"path.corner_tolerance": 0.0}) as world:
        world.send([(0, 0, 0), (0.4, 0, 0), (0.4, 0.4, 0)])
        world.arrive()
        _, x, v, _ = world.assert_smooth()
        corner = np.hypot(x[:, 0] - 0.4, x[:, 1]).argmin()
        assert x[corner] == pytest.approx([0.4, 0, 0], abs=1e-9)
        assert np.abs(v[corner]).max() < 1e-9
        assert (np.minimum(abs(x[:, 0] - 0.4), abs(x[:, 1])) < 1e-9).all()


def test_no_wheel_is_asked_for_more_than_its_share():
    quick = {"velocity": 5.0, "acceleration": 8.0, "deceleration": 8.0, "jerk": 80.0}
    limits = {f"limits.{kind}_{k}": v for kind in ("linear", "angular") for k, v in quick.items()}
    with Alone(limits | {"path.linear_velocity": 5.0, "path.angular_velocity": 5.0}) as world:
        world.send([(0, 0, 0), (1.2, 1.2, 3.0)])
        world.arrive()
        _, x, v, _ = world.followed()
        robot = world.core.parameters.robot
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        body = np.column_stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]])
        wheels = np.abs(body @ PlatformKinematics(robot.wheels).J.T).max()
        # The smoothing may take 1 % more, of the 10 % that are left to feedback.
        assert 0.9 * 0.9 < wheels / robot.motor.max_speed <= 0.9 * 1.01


# ---- bad paths --------------------------------------------------------------------------------


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 0.0) -> Path:
    """A path whose second pose has an odd orientation."""
    message = path(BENT)
    message.poses[1].pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return message


def placed(x: float, frame: str = "") -> Path:
    """A path whose second pose is elsewhere."""
    message = path(BENT)
    message.poses[1].pose.position.x, message.poses[1].header.frame_id = x, frame
    return message


def many(count: int) -> Path:
    message = path(BENT)
    message.poses = [message.poses[0]] * count
    return message


BAD: dict[str, tuple[Callable[[], Path | bytes], str]] = {
    "empty": (lambda: path([]), "an empty path"),
    "NaN": (lambda: placed(NAN), "positions .*nan.* not finite"),
    "infinite": (lambda: placed(-INF), "positions .*inf.* not finite"),
    "huge": (lambda: placed(1e7), "beyond"),
    "very long": (lambda: placed(9e5), "takes .* s, at most 3600 s"),
    "in map": (lambda: path(BENT, frame="map"), "frame 'map', expected 'odom'"),
    "in no frame": (lambda: path(BENT, frame=""), "frame '', expected 'odom'"),
    "a pose in map": (lambda: placed(0.6, frame="map"), "frame 'map', expected 'odom'"),
    "zero quaternion": (turned, "pose 1: quaternion of length 0"),
    "long quaternion": (lambda: turned(w=1.5), "pose 1: quaternion of length 1.5"),
    "NaN quaternion": (lambda: turned(w=NAN), "pose 1: quaternion of length nan"),
    "tilted": (lambda: turned(x=0.6, w=0.8), "pose 1: .* not about the vertical"),
    "too far": (lambda: path([(3, 4, 0), (5, 5, 0)]), "begins 5.00 m from the robot"),
    "too many": (lambda: many(20_001), "20001 poses, at most 20000"),
    "a million": (lambda: bytes(80_000_000), "80 MB, at most 20000 poses"),
}


def give(world: Station, what: Path | bytes) -> None:
    if isinstance(what, bytes):  # not over the wire: it is refused unseen
        world.run(PERIOD)
        [subscription] = [s for s in world.node.subscriptions if s.topic_name == "/path"]
        subscription.callback(what)
    else:
        world.paths.publish(what)
    world.run_until(lambda: bool(world.warnings), 0.5, "a warning")


@pytest.fixture(scope="module")
def resting():
    with Alone({"path.start_distance": 1.5}) as world:
        yield world


@pytest.mark.parametrize(("make", "why"), BAD.values(), ids=BAD)
def test_a_bad_path_moves_nothing_and_is_told(resting, make, why):
    resting.warnings.clear()
    give(resting, make())
    [warning] = resting.warnings
    assert len(warning) < 300
    status = resting.status(0.15)
    assert status.level == DiagnosticStatus.WARN and "refused" in status.message
    for text in (warning, status.message):
        assert re.search(why, text), text
    assert resting.core.state is PathState.IDLE and not resting.references


def test_bad_paths_do_not_harm_the_one_under_way(alone):
    alone.send(BENT)
    alone.run(0.3)
    for make, _ in BAD.values():
        alone.warnings.clear()
        give(alone, make())
        alone.run(0.05)
    assert alone.core.state is PathState.FOLLOWING
    alone.arrive()
    _, x, _, _ = alone.assert_smooth()
    assert x[-1] == pytest.approx(BENT[-1], abs=1e-9)


def test_one_pose_repeated_poses_and_map_by_parameter():
    with Alone({"map_is_odom": True}) as world:
        world.send([(0.2, 0.1, 0.3)], frame="map")
        world.arrive()
        world.send([(0.2, 0.1, 0.3)] * 3 + [(0.5, 0.1, 0.3)] * 4)
        world.arrive()
        _, x, _, _ = world.assert_smooth()
        assert x[-1] == pytest.approx([0.5, 0.1, 0.3], abs=1e-9)
        world.send([(0.5, 0.1, 0.3)] * 2)
        assert "the robot is there already" in world.warnings[0]
        world.assert_silent(0.3)


# ---- odom -------------------------------------------------------------------------------------


def odd_odom(world: Alone, x: float = 0.0, frame: str = "odom", age: float = 0.0) -> Odometry:
    message = world.odom_message()
    message.header.frame_id, message.header.stamp = frame, world.stamp(-age)
    message.pose.pose.position.x += x
    return message


ODD: dict[str, tuple[dict[str, Any], str]] = {
    "stale": ({"age": 3.0}, "odom is 3.0. s old"),
    "in map": ({"frame": "map"}, "no odom"),
    "NaN": ({"x": NAN}, "no odom"),
    "ahead": ({"age": -1.0}, "no odom"),
    "huge": ({"x": 1e9}, "no odom"),
}


@pytest.mark.parametrize(("odd", "why"), ODD.values(), ids=ODD)
def test_odd_odom_is_no_odom(odd, why):
    with Alone(source="") as world:
        world.node.odom.pose = None  # as if this were the first
        world.odometry = lambda: odd_odom(world, **odd)
        world.say("none")
        world.run(0.05)
        world.send(BENT)
        world.run(1.0)
        assert world.status().message.startswith("a path waits: ")
        world.run(PATIENCE)
        refusals = [w for w in world.warnings if w.startswith("path not used")]
        assert len(refusals) == 1
        assert re.search(why, refusals[0]), refusals[0]
        assert not world.references


@pytest.mark.parametrize("odd", [None, *(odd for odd, _ in ODD.values())], ids=["gone", *ODD])
def test_a_path_whose_odom_fails_is_given_up(alone, odd):
    alone.send(BENT)
    alone.run(0.5)
    alone.odometry = None if odd is None else lambda: odd_odom(alone, **odd)
    alone.run(0.6)
    assert alone.core.state is PathState.IDLE
    assert "given up: no odom for" in alone.status().message
    alone.odometry = alone.odom_message
    alone.assert_silent()


def test_a_waiting_path_begins_when_odom_comes(alone):
    alone.odometry = None
    alone.run(0.6)
    alone.send(BENT)
    alone.run(2.0)
    alone.odometry = alone.odom_message
    alone.run(0.2)
    assert alone.core.state is PathState.FOLLOWING and alone.warnings == []


def test_a_waiting_path_can_be_cancelled(alone):
    alone.odometry = None
    alone.run(0.6)
    alone.send(BENT)
    assert alone.ask("cancel").success
    alone.odometry = alone.odom_message
    alone.assert_silent(0.5)
    assert not alone.ask("cancel").success


# ---- who drives -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "why"), [("", "no platform_controller"), ("cmd_vel", "cmd_vel drives"),
                        ("stop", "stopped"), ("mpc", "mpc drives")],
)  # fmt: skip
def test_a_path_while_it_cannot_drive_is_refused_with_the_reason(source, why):
    with Alone(source=source) as world:
        world.takes = False
        world.send(BENT)
        [warning] = world.warnings
        assert why in warning and why in world.status().message
        world.say("none")
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
    robot.run_until(lambda: last(robot.sources).data == "none", 2.0, "none to drive")
    refused = robot.refusals()
    x, y, theta = robot.controller.core.odometry.pose
    robot.travel([(x, y, theta), (x - 0.2, y, theta)])
    assert len(robot.references) > begin + 10
    assert robot.controller.core.odometry.pose[0] == pytest.approx(x - 0.2, abs=3e-3)
    robot.run(0.8)
    assert robot.refusals() == refused <= 1
    assert [m.data for m in robot.sources] == ["none", "path", "cmd_vel", "none", "path", "none"]


def emergency(qos: Any) -> Callable[[Station], None]:
    def act(world: Station) -> None:
        world.publisher(Bool, "emergency_stop", qos).publish(Bool(data=True))

    return act


def peer(world: Station) -> Any:
    message = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/arm", message="stopped: test")
    publisher = world.publisher(DiagnosticStatus, "stop_state", LATCHED)
    publisher.publish(message)
    world.run(PERIOD)
    return publisher


def say_stop(world: Alone) -> None:
    world.takes = False
    world.say("stop")


def cancels(world: Alone) -> None:
    world.takes = False
    world.say("none")


WAYS = {
    "emergency_stop": (emergency(10), "emergency_stop is true"),
    "latched emergency_stop": (emergency(LATCHED), "emergency_stop is true"),
    "a stopped peer": (peer, "/arm is stopped: test"),
    "the controller stops": (say_stop, "the platform is stopped"),
    "the controller cancels": (cancels, "has cancelled it"),
}


@pytest.mark.parametrize("paused", [False, True], ids=["moving", "paused"])
@pytest.mark.parametrize(("way", "why"), WAYS.values(), ids=WAYS)
def test_control_that_is_lost_is_not_taken_back(alone, way, why, paused):
    alone.send(BENT)
    alone.run(0.5)
    if paused:
        alone.ask("pause")
        alone.run(1.0)
    way(alone)
    alone.run(2 * PERIOD)
    assert alone.core.state is PathState.IDLE
    assert why in alone.warnings[-1] and alone.warnings[-1].startswith("the path was given up")
    alone.assert_silent(0.5)
    assert not alone.ask("resume").success
    assert why in alone.status().message


def test_path_and_stop_in_the_same_instant(alone):
    stop = alone.publisher(Bool, "emergency_stop")
    alone.paths.publish(path(BENT))
    stop.publish(Bool(data=True))
    alone.run(PERIOD * 2)
    assert alone.core.state is PathState.IDLE and alone.warnings
    alone.assert_silent()
    stop.publish(Bool(data=False))
    alone.assert_silent()


def test_after_a_stop_and_reset_nothing_moves_until_a_new_path(robot):
    robot.send(BENT)
    robot.run(0.8)
    assert robot.moved() > 0.1
    assert robot.call(Trigger, "platform_controller/stop").success
    robot.assert_rests(0.5)
    assert "~/stop" in robot.warnings[-1]
    robot.send(BENT)
    assert "is stopped: ~/stop" in robot.warnings[-1]
    assert robot.call(Trigger, "platform_controller/reset").success
    robot.assert_rests(0.5)
    refused = robot.refusals()
    x, y, theta = robot.controller.core.odometry.pose
    robot.travel([(x, y + 0.2, theta)])
    assert robot.controller.core.odometry.pose[1] == pytest.approx(y + 0.2, abs=3e-3)
    robot.run(4 * PERIOD)
    # A stop that comes just after the end cancels what the controller still holds.
    assert robot.call(Trigger, "platform_controller/stop").success
    robot.run(0.05)
    assert robot.call(Trigger, "platform_controller/reset").success
    robot.run(0.05)
    robot.travel([(x, y, theta)])
    assert robot.refusals() == refused <= 1
    assert robot.controller.core.odometry.pose[1] == pytest.approx(y, abs=3e-3)


def test_odometry_that_is_reset_ends_the_path(robot):
    robot.send(BENT)
    robot.run(0.8)
    assert robot.call(Trigger, "platform_controller/reset_odometry").success
    robot.run(0.1)
    assert "has cancelled it" in robot.warnings[-1]
    robot.assert_rests()


def test_a_path_waits_until_the_robot_has_rolled_out(alone):
    alone.setpoint = Setpoint(np.zeros(3), np.array([0.0, 0.0, 0.3]), np.zeros(3))
    alone.run(4 * PERIOD)
    alone.send(BENT)
    alone.run(1.0)
    assert alone.node.status()[1] == "a path waits: the robot moves" and not alone.references
    alone.setpoint = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))
    alone.run(0.1)
    assert alone.core.state is PathState.FOLLOWING


def test_a_stopped_node_that_vanished_does_not_block_paths(alone):
    publisher = peer(alone)
    alone.send(BENT)
    assert "/arm is stopped" in alone.warnings[-1]
    alone.probe.destroy_publisher(publisher)
    alone.run(1.1)
    alone.send(BENT)
    assert alone.core.state is PathState.FOLLOWING


def test_a_controller_that_never_takes_it_is_told_and_a_later_path_is_heard(alone):
    alone.takes = False
    alone.send(BENT)
    alone.run(0.6)
    assert "does not take it" in alone.warnings[-1]
    sent = alone.arrivals[-1]
    alone.takes = True
    alone.send(BENT)
    assert "waits: control was lost" in alone.node.status()[1]
    alone.run_until(lambda: alone.core.state is PathState.FOLLOWING, 2.0, "the path to begin")
    alone.arrive()
    assert min(t for t in alone.arrivals if t > sent) - sent > 1.0


def test_a_path_right_after_the_end_of_another_is_driven(alone):
    """The controller has said `path` already, and it may say `none` once more."""
    alone.send(BENT)
    alone.arrive()
    assert alone._said == "path"
    alone.send([BENT[-1], (0.3, 0.2, 0.5)])
    alone.run(0.7)
    assert alone.core.state is PathState.FOLLOWING and alone.warnings == []
    alone.arrive()
    alone.send([(0.3, 0.2, 0.5), (0.2, 0.1, 0.5)])
    alone.say("none")
    alone.run(0.02)
    alone.arrive()
    assert alone.warnings == []
    assert alone.followed()[1][-1] == pytest.approx([0.2, 0.1, 0.5], abs=1e-9)


# ---- a dead wheel -----------------------------------------------------------------------------

LONG = [(0, 0, 0), (1.5, 0, 0), (1.5, 0.5, 0.5)]


class Health:
    """What a platform controller says on wheel_health."""

    def __init__(self, world: Alone) -> None:
        self._publisher = world.publisher(DiagnosticStatus, "wheel_health", LATCHED)
        self._world = world

    def say(self, limits: str | None) -> None:
        message = DiagnosticStatus(name="/platform_controller")
        if limits is not None:
            message.values = [KeyValue(key="limits", value=limits)]
        self._publisher.publish(message)
        self._world.run(2 * PERIOD)


def speeds(v: np.ndarray) -> np.ndarray:
    return np.hypot(v[:, 0], v[:, 1])


def test_with_a_dead_wheel_the_path_is_slowed_and_driven_to_its_end():
    with Robot({"drive.dead_wheel": "drive_on"}) as world:
        truths: list[tuple[float, np.ndarray]] = []
        world.hooks.append(
            lambda: truths.append((world.time, world.drive.drives.ground_truth()[0].copy()))
        )
        world.send(LONG)
        world.run(1.5)
        assert world.moved() > 0.4
        world.set("faults.dead_motor", ["rear_left"], "simulated_drive")
        world.run_until(lambda: world.core.state is PathState.SLOWING, 1.5, "the dead wheel")
        world.run_until(lambda: world.core.state is PathState.FOLLOWING, 1.5, "a rest")
        rested = world.time
        assert world.core.share == 0.5
        world.arrive()

        times, x, v, a = world.assert_smooth()
        assert speeds(v[times < rested]).max() == pytest.approx(0.5, abs=1e-6)
        linear = world.core.parameters.groups()[0]
        slow = times > rested + 0.1
        assert 0.2 < speeds(v[slow]).max() <= 0.25 * (1 + 1e-6)
        assert speeds(a[slow]).max() <= 0.5 * linear.acceleration * (1 + 1e-6)
        assert x[-1] == pytest.approx(LONG[-1], abs=1e-9)
        driven = [(t, pose) for t, pose in truths if times[0] <= t <= times[-1]]
        wanted = np.column_stack(
            [np.interp([t for t, _ in driven], times, column) for column in x[:, :2].T]
        )
        errors = np.hypot(*(np.array([pose[:2] for _, pose in driven]) - wanted).T)
        assert math.sqrt(np.mean(errors**2)) <= 0.020
        assert world.warnings == [] and world.refusals() == 0

        repaired = Parameter("faults.dead_motor", Parameter.Type.STRING_ARRAY, [])
        world.set("faults.dead_motor", repaired, "simulated_drive")
        world.run_until(lambda: world.at_rest, 1.5, "rest")
        for node in ("simulated_drive", "platform_controller"):
            assert world.call(Trigger, f"{node}/reset").success
        world.run(1.2)  # after a reset the controller takes no stream for a while
        assert world.core.share == 1.0
        since = len(world.references)
        world.travel([(0.7, 0.5, 0.5)])
        _, x, v, _ = world.assert_smooth(since)
        assert speeds(v).max() > 0.45, "the next path is a fast one again"


@pytest.mark.parametrize("value", ["", "half", "0", "-0.5", "1.5", "nan", "inf", "1e-999"])
def test_malformed_limits_are_warned_of_and_change_nothing(alone, value):
    health = Health(alone)
    alone.send(BENT)
    alone.run(0.5)
    health.say(value)
    assert alone.core.state is PathState.FOLLOWING and alone.core.share == 1.0
    [warning] = alone.warnings
    assert warning.startswith("wheel_health ignored: limits") and repr(value) in warning
    alone.arrive()
    _, _, v, _ = alone.assert_smooth()
    assert speeds(v).max() > 0.45


def test_limits_that_are_back_count_from_the_next_path(alone):
    health = Health(alone)
    health.say("0.4")
    alone.send(BENT)
    alone.run(1.0)
    health.say(None)
    assert alone.core.state is PathState.FOLLOWING, "it does not stop for more speed"
    alone.arrive()
    assert speeds(alone.assert_smooth()[2]).max() == pytest.approx(0.2, abs=1e-6)
    since = len(alone.references)
    alone.send([BENT[-1], (-0.4, 0.3, 0.5)])
    alone.run(0.5)
    alone.arrive()
    assert speeds(alone.assert_smooth(since)[2]).max() == pytest.approx(0.5, abs=1e-6)


def test_pause_and_cancel_while_it_slows_down(alone):
    health = Health(alone)
    alone.send(LONG)
    alone.run(1.5)
    health.say("0.4")
    assert alone.core.state is PathState.SLOWING
    assert alone.ask("pause").message == "pausing"
    assert alone.ask("resume").message == "slowing", "not on at full speed"
    assert alone.ask("pause").success
    alone.run(1.5)
    assert alone.core.state is PathState.PAUSED
    place = alone.setpoint.pose
    alone.run(0.5)
    assert alone.setpoint.pose == pytest.approx(place, abs=1e-12)
    assert alone.ask("resume").message == "following"
    since = len(alone.references)
    alone.run(1.0)
    assert speeds(alone.followed(since)[2]).max() == pytest.approx(0.2, abs=1e-6)
    health.say("0.2")
    assert alone.core.state is PathState.SLOWING
    assert alone.ask("cancel").message == "cancelling"
    alone.arrive(3.0)
    alone.run(2 * PERIOD)
    _, x, _, _ = alone.assert_smooth()
    assert 0.0 < x[-1, 0] < 1.5 and alone.node.status()[2][-1] == ("last", "cancelled")
    alone.assert_silent()


def test_a_path_that_would_take_hours_with_what_is_left_is_paused(alone):
    health = Health(alone)
    alone.send(LONG)
    alone.run(1.0)
    health.say("1e-6")
    alone.run(1.5)
    assert alone.core.state is PathState.PAUSED
    assert len(alone.warnings) == 1 and "a path was paused: the path takes" in alone.warnings[0]
    answer = alone.ask("resume")
    assert not answer.success and "cannot go on: the path takes" in answer.message
    health.say("1.0")
    assert alone.ask("resume").message == "following"
    alone.arrive()
    _, x, _, _ = alone.assert_smooth()
    assert x[-1] == pytest.approx(LONG[-1], abs=1e-9)


# ---- time -------------------------------------------------------------------------------------


def hold_up(world: Station, seconds: float) -> None:
    """The node does not get to run for a while."""
    world.executor.remove_node(world.node)
    world.run(seconds)
    world.executor.add_node(world.node)


def test_a_node_that_is_held_up_gives_the_path_up_before_it_would_jump(alone):
    alone.send(BENT)
    alone.run(0.6)
    hold_up(alone, 0.3)
    assert alone.core.state is PathState.FOLLOWING
    alone.run(0.2)
    assert alone.core.state is PathState.FOLLOWING
    alone.assert_smooth()
    hold_up(alone, 0.6)
    sent = len(alone.references)
    alone.run(0.1)
    assert alone.core.state is PathState.IDLE and len(alone.references) == sent
    assert "given up: no preview for 0.6" in alone.warnings[-1]
    alone.assert_silent()


def slow_planning(world: Alone, seconds: float) -> None:
    """Planning takes a while, in which nothing is heard."""
    propose = world.core.propose

    def slow(*args: Any) -> Any:
        proposal = propose(*args)
        world.time += seconds
        for node in (*world.nodes, world.probe):
            world._set_time(node)
        if world.odometry is not None:
            world._odom.publish(world.odometry())  # the others go on
        world.busy_until = world.time + 4 * PERIOD  # to hear what was sent in the meantime
        return proposal

    world.core.propose = slow


def test_planning_from_rest_may_take_longer_than_a_preview(alone):
    slow_planning(alone, 2.0)
    alone.send(BENT)
    alone.run(0.5)
    assert alone.core.state is PathState.FOLLOWING and alone.warnings == []
    alone.arrive()
    _, x, _, _ = alone.assert_smooth()
    assert x[-1] == pytest.approx(BENT[-1], abs=1e-9)


@pytest.mark.parametrize(("seconds", "good"), [(0.05, True), (0.1, True), (0.3, False)])
def test_planning_on_the_move_is_bridged_or_given_up_but_never_jumps(alone, seconds, good):
    alone.send(BENT)
    alone.run(0.5)
    slow_planning(alone, seconds)
    alone.send(OTHER)
    alone.run(0.1)
    assert alone.core.state is PathState.FOLLOWING
    assert ["could not be planned in time" in w for w in alone.warnings] == [True] * (not good)
    since = 0 if good else len(alone.references)
    alone.arrive()
    _, x, _, _ = alone.assert_smooth(since)
    assert x[-1] == pytest.approx((OTHER if good else BENT)[-1], abs=1e-9)


def test_time_that_goes_back_ends_the_path_and_a_new_one_is_driven(alone):
    alone.send(BENT)
    alone.run(0.5)
    alone.time -= 500.0
    alone.run(0.1)
    assert alone.core.state is PathState.IDLE and "time went back" in alone.warnings[-1]
    alone.assert_silent(0.3)
    alone.odometry = None
    alone.send([alone.setpoint.pose, (0.5, 0.3, 0.0)])
    alone.run(0.5)
    assert alone.core.state is PathState.IDLE, "odom of another time is no odom"
    alone.odometry = alone.odom_message
    alone.run_until(lambda: alone.core.state is PathState.FOLLOWING, 2.0, "the path to begin")
    alone.arrive()


def test_an_end_of_the_node_comes_to_rest_on_the_path_and_takes_no_other(alone):
    assert alone.node.finished
    alone.send(BENT)
    alone.run(0.5)
    alone.node.begin_shutdown("SIGINT")
    assert not alone.node.finished
    patience = alone.node.patience
    alone.run(0.1)
    alone.send(OTHER)
    assert "the node ends" in alone.warnings[-1]
    took = alone.run_until(lambda: alone.node.finished, 5.0, "the end")
    assert took + 0.1 < patience
    _, x, v, _ = alone.assert_smooth()
    assert not v[-1].any() and x[-1, 1] == 0.0 and x[-1, 0] < 0.5


# ---- parameters -------------------------------------------------------------------------------


def test_new_limits_count_from_the_next_path_that_begins_at_rest(alone):
    alone.send(BENT)
    alone.run(0.4)
    before = alone.core.parameters.groups()[0].velocity
    assert alone.set("path.linear_velocity", 0.2).successful
    alone.arrive()
    fast = np.hypot(*alone.followed()[2].T[:2]).max()
    assert 0.4 < fast <= before + 1e-9
    since = len(alone.references)
    alone.send([BENT[-1], (0.1, 0.3, 0.5)])
    alone.arrive()
    _, _, v, _ = alone.assert_smooth(since)
    assert np.hypot(*v.T[:2]).max() == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "value"),
    [("limits.linear_velocity", -1.0), ("limits.angular_jerk", NAN), ("path.heading", "sideways"),
     ("path.corner_tolerance", -0.1), ("path.reserve", 1.0), ("horizon", 1.0)],
)  # fmt: skip
def test_bad_values_are_refused_by_name(resting, name, value):
    result = resting.set(name, value)
    assert not result.successful and name in result.reason
    assert resting.core.parameters == resting.node.settings.value.core


def test_a_period_too_long_for_the_horizon_is_refused():
    with pytest.raises(ParameterError, match="period"):
        World(PathInterpolatorNode, parameters={"period": 0.2, "horizon": 0.3})
