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

from omniman_ros import conversions
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.hermite import Hermite
from omniman_ros.core.path.interpolator import PathState
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.stopping import ALL_LATCHED

from .harness import PERIOD
from .test_path_interpolator import BENT, Alone

NAN = math.nan
HOME = np.array([0.3, -1.2, 1.4, -0.5, 0.2, 0.1])
FAR = HOME + [0.8, 0.5, -0.6, 0.3, 0.0, -0.4]
LONG = [(0, 0, 0), (3.0, 0, 0)]
STEP = 0.004


def trajectory(rows: Any, times: Any = None, names: Any = UR_JOINTS, **more: Any) -> Any:
    """A message; rows (k, d), times in s, more rows as velocities or accelerations."""
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


class WithArm(Alone):
    """The interpolator, a fake controller, and an arm that follows its reference at once.

    Attributes:
        arm_alive: Whether it reports.
        pushed: (6,) how far it is from where it was led [rad].
        scaling: What it says each 50 ms, or None.
    """

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(parameters)
        self.arm_alive, self.scaling = True, None
        self.joints, self.pushed = HOME.copy(), np.zeros(6)
        self.joint_previews: list[tuple[float, float, Any]] = []
        self.probe.create_subscription(
            JointTrajectory, "arm/joint_reference", self._hear_joints, 100, raw=True
        )
        publisher = self.node.arm_previews.publisher
        self._await(lambda: publisher.get_subscription_count() > 0, "arm/joint_reference")
        self._states = self.publisher(JointState, "arm/joint_states")
        self._scalings = self.publisher(Float64, "arm/speed_scaling")
        self.trajectories = self.publisher(JointTrajectory, "joint_trajectory")
        self._count = 0
        self.hooks.append(self._report)
        self.run(4 * PERIOD)

    @property
    def arm(self) -> Any:
        return self.node.arm.core

    def _hear_joints(self, data: bytes) -> None:
        message = deserialize_message(data, JointTrajectory)
        assert list(message.joint_names) == list(UR_JOINTS)
        start = conversions.time_seconds(message.header.stamp)
        times = [start + conversions.time_seconds(p.time_from_start) for p in message.points]
        arrays = (
            np.array([getattr(point, label) for point in message.points])
            for label in ("positions", "velocities", "accelerations")
        )
        self.joint_previews.append((self.time, start, Hermite(np.array(times), *arrays)))

    def _report(self) -> None:
        self._count += 1
        if self.joint_previews:
            self.joints = self.joint_previews[-1][2].sample(self.time + 1e-9)[0]
        if self.arm_alive:
            message = JointState(
                name=[*UR_JOINTS], position=[*map(float, self.joints + self.pushed)]
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

    def arm_arrives(self, seconds: float = 20.0) -> float:
        return self.run_until(lambda: self.arm.state is PathState.IDLE, seconds, "the arm's end")

    def driven(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Times (k,), x, x', x'' (k, 6) each 4 ms as a receiver of the stream has them."""
        previews = self.joint_previews[since:]
        arrivals = np.array([arrival for arrival, _, _ in previews])
        end = max(previews[-1][0], previews[-1][2].end) + 0.05
        times = np.arange(arrivals[0] + 1e-3, end, STEP)
        latest = np.searchsorted(arrivals, times, side="right") - 1
        rows = [previews[i][2].sample(now) for i, now in zip(latest, times, strict=True)]
        x, v, a = (np.array(part) for part in zip(*rows, strict=True))
        return times, x, v, a

    def assert_arm_smooth(self, since: int = 0) -> tuple[np.ndarray, ...]:
        """Speeds and accelerations within limits, and nothing jumps: as a guard would see it."""
        times, x, v, a = self.driven(since)
        assert np.abs(v).max() <= math.pi and np.abs(a).max() <= 5.0 * (1 + 1e-6)
        step = round(TICK / STEP)  # the guard's
        second = (x[2 * step :] - 2 * x[step:-step] + x[: -2 * step]) / TICK**2
        assert np.abs(second).max() <= 5.0 * (1 + 1e-6)
        assert np.abs(np.diff(x, axis=0) / STEP - 0.5 * (v[1:] + v[:-1])).max() < 2e-3
        return times, x, v, a


@pytest.fixture
def world():
    with WithArm() as made:
        yield made


# ---- trajectories -----------------------------------------------------------------------------


def test_a_trajectory_without_times_is_planned_and_arrives_together(world):
    world.move(FAR)
    assert world.arm.state is PathState.FOLLOWING
    world.arm_arrives()
    times, x, v, a = world.assert_arm_smooth()
    assert x[0] == pytest.approx(HOME, abs=1e-12) and x[-1] == pytest.approx(FAR, abs=1e-12)
    jerk = np.abs(np.diff(a, axis=0)).max() / STEP
    assert jerk <= 45.0 * (1 + 1e-4)
    moving = np.abs(v) > 1e-9
    used = np.flatnonzero(np.abs(FAR - HOME) > 0)
    ends = [times[np.flatnonzero(moving[:, k])[[0, -1]]] for k in used]
    assert np.ptp(np.array(ends), axis=0).max() < 0.02, "all joints begin and end together"
    arrival, start, curve = world.joint_previews[1]
    assert curve.end - start == pytest.approx(0.4, abs=1e-9)
    assert np.diff([t for t, _, _ in world.joint_previews[2:]]) == pytest.approx(0.04)
    assert world.warnings == []


def test_given_times_are_kept_with_and_without_velocities(world):
    middle = 0.5 * (HOME + FAR)
    times = [1.0, 2.1]
    for rows, more in (
        ([middle, FAR], {}),
        ([middle, HOME], {"velocities": [0.3 * (HOME - FAR), 0 * HOME]}),
    ):
        since = len(world.joint_previews)
        world.move(rows, times, **more)
        begin = world.arm._motion.start
        world.arm_arrives()
        at, x, v, _ = world.assert_arm_smooth(since)
        for k, t in enumerate(times):
            i = int(np.argmin(np.abs(at - begin - t)))
            near = x[i] + (begin + t - at[i]) * v[i]
            assert near == pytest.approx(rows[k], abs=1e-5)
            if more:
                assert v[i] == pytest.approx(more["velocities"][k], abs=0.01)
    assert world.warnings == []


def test_joints_that_are_not_named_hold_their_place(world):
    world.move([[0.1, 0.6]], names=[UR_JOINTS[5], UR_JOINTS[0]])
    world.arm_arrives()
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
    world.arm_arrives()
    at, x, v, _ = world.assert_arm_smooth()
    moving = at[np.abs(v).max(axis=1) > 1e-9]
    assert moving[0] == pytest.approx(due, abs=0.015)
    assert moving[-1] == pytest.approx(due + 1.5, abs=0.015)


BAD: dict[str, Any] = {
    "unknown name": ({"names": [*UR_JOINTS[:5], "elbow"]}, "no joint elbow"),
    "a name twice": ({"names": [*UR_JOINTS[:5], UR_JOINTS[0]]}, "one twice"),
    "too few positions": ({"rows": FAR[:5]}, "point 0: 5 positions for 6 joints"),
    "NaN": ({"rows": FAR * NAN}, "positions .* not finite"),
    "infinity": ({"rows": FAR * math.inf}, "positions .* not finite"),
    "huge": ({"rows": FAR * 1e9}, "positions .* beyond"),
    "beyond a limit": ({"rows": [[0, 0, 4, 0, 0, 0]]}, "elbow_joint: position 4 rad of point 0"),
    "too fast": ({"rows": FAR, "times": [0.3]}, r"shoulder_pan_joint: velocity .* at 0.150 s"),
    "too hard": ({"rows": FAR, "times": [0.7]}, "shoulder_pan_joint: acceleration .* limit is 5"),
    "too sudden": ({"rows": FAR, "times": [0.98]}, "shoulder_pan_joint: jerk .* limit is 50"),
    "times back": ({"rows": [FAR, HOME], "times": [2.0, 1.0]}, "do not increase: point 0 at 2 s"),
    "some times": ({"rows": [FAR, HOME, FAR], "times": [0, 0, 2.0]}, "do not increase"),
    "elsewhere": ({"rows": [FAR, HOME], "times": [0, 2.0]}, "0.8 rad from where it is"),
    "end in motion": ({"times": [2.0], "velocities": [0.1 + 0 * FAR]}, "not at rest"),
    "accelerations alone": ({"times": [2.0], "accelerations": [0 * FAR]}, "without velocities"),
    "too many": ({"rows": np.tile(HOME, (2001, 1))}, "2001 points, at most 2000"),
    "nowhere": ({"rows": HOME}, "is there already"),
}


def test_what_cannot_be_driven_is_refused_by_name_and_nothing_moves(world):
    for what, (given, words) in BAD.items():
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


@pytest.mark.parametrize("after", [0.1, 0.45, 0.8])
@pytest.mark.parametrize("times", [None, [2.5]])
def test_a_new_trajectory_on_the_move_replaces_the_old_without_a_jump(world, times, after):
    world.move(FAR)
    world.run(after)
    goal = HOME + [0, 0.2, 0.3, 0, 0.5, 0]
    world.move(goal, times)
    assert world.warnings == []
    world.arm_arrives()
    _, x, _, _ = world.assert_arm_smooth()
    assert x[-1] == pytest.approx(goal, abs=1e-9)


def test_a_trajectory_without_points_stops_on_the_path(world):
    world.move(FAR)
    world.run(0.5)
    world.trajectories.publish(JointTrajectory())
    assert world.arm_arrives() < 0.8
    _, x, v, _ = world.assert_arm_smooth()
    share = (x - HOME)[:, [0, 1, 2, 3, 5]] / (FAR - HOME)[[0, 1, 2, 3, 5]]
    assert 0.1 < share[-1].max() < 0.9 and np.ptp(share, axis=1).max() < 1e-9
    assert not v[-1].any()
    world.run(2 * PERIOD)
    before = len(world.joint_previews)
    world.run(0.3)
    assert len(world.joint_previews) == before
    world.move(FAR)
    world.arm_arrives()
    assert world.assert_arm_smooth(before)[1][-1] == pytest.approx(FAR, abs=1e-9)


def test_pause_resume_and_cancel_act_on_platform_and_arm_alike(world):
    world.send(LONG)
    world.move(FAR, [4.0])
    world.run(1.0)
    assert world.ask("pause").message == "pausing"
    world.run(1.5)
    assert world.core.state is PathState.PAUSED and world.arm.state is PathState.PAUSED
    place, joints = world.setpoint.pose.copy(), world.joints.copy()
    world.run(0.5)
    assert (world.joints == joints).all() and world.setpoint.pose == pytest.approx(
        place, abs=1e-12
    )
    assert world.ask("resume").success
    world.run(0.5)
    assert world.ask("cancel").success
    world.arm_arrives(2.0)
    world.arrive(2.0)
    world.assert_arm_smooth()
    world.assert_smooth()
    assert not world.ask("resume").success


def test_progress_is_that_of_the_part_that_has_most_before_it(world):
    world.send(BENT)
    world.move(FAR, [6.0])
    world.arrive()
    world.arm_arrives()
    seen = [message.data for message in world.progress]
    assert seen[-1] == 1.0 and (np.diff(seen[2:]) >= 0.0).all()
    assert 0.2 < np.interp(3.0, 0.04 * np.arange(len(seen)), seen) < 0.6


# ---- who gives up what ------------------------------------------------------------------------


def test_twists_that_take_the_platform_leave_the_arm_alone(world):
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(0.5)
    world.takes = False
    world.say("cmd_vel")
    world.run(2 * PERIOD)
    assert world.core.state is PathState.IDLE and world.arm.state is PathState.FOLLOWING
    world.arm_arrives()
    assert world.assert_arm_smooth()[1][-1] == pytest.approx(FAR, abs=1e-9)


def emergency(world: WithArm) -> None:
    world.publisher(Bool, "emergency_stop").publish(Bool(data=True))


def stopped_peer(world: WithArm) -> None:
    world.probe.create_publisher(DiagnosticStatus, "stop_state", ALL_LATCHED).publish(
        DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/platform", message="stopped: ~/stop")
    )
    world.run(0.1)


@pytest.mark.parametrize("stop", [emergency, stopped_peer])
def test_a_stop_gives_both_up_and_refuses_new_ones(world, stop):
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
    ("way", "why"), [("silent", "no arm/joint_states"), ("pushed", "rad from")]
)
def test_an_arm_that_is_silent_or_elsewhere_is_led_to_rest_and_given_up(world, way, why):
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.0)
    if way == "silent":
        world.arm_alive = False
    else:
        world.pushed[3] = 0.3
    took = world.run_until(lambda: world.arm.state is PathState.IDLE, 1.0, "the end")
    assert took <= 0.26 and why in world.warnings[-1]
    world.run(1.0)
    _, x, v, _ = world.assert_arm_smooth()
    assert world.joint_previews[-1][2].end_speed == 0.0
    assert np.abs(world.joint_previews[-1][2].sample(1e9)[0] - x[-1]).max() < 0.6
    assert world.core.state is PathState.FOLLOWING, "the platform goes on"
    world.move(FAR)
    assert "joint_trajectory" in world.warnings[-1] if way == "silent" else True


@pytest.mark.parametrize("late", [0.0, 3.0])
def test_without_joint_states_nothing_begins(late):
    with WithArm() as world:
        world.arm_alive = late > 0.0
        if late == 0.0:
            world.node.arm_feed.forget_place()
        world.run(late)
        world.arm_alive = False
        world.run(0.3)
        world.move(FAR)
        words = "no arm/joint_states" if late == 0.0 else "arm/joint_states are 0.3"
        assert words in world.warnings[-1] and not world.joint_previews


def test_an_end_of_the_node_comes_to_rest_on_both_paths(world):
    world.send(LONG)
    world.move(FAR, [4.0])
    world.run(1.0)
    world.node.begin_shutdown("SIGINT")
    patience = world.node.patience
    took = world.run_until(lambda: world.node.finished, 5.0, "the end")
    assert took < patience
    assert not world.assert_arm_smooth()[2][-1].any()
    assert not world.assert_smooth()[2][-1].any()


# ---- speed scaling ----------------------------------------------------------------------------


def begin_of_change(times: np.ndarray, speed: np.ndarray, since: float) -> float:
    """How long after a time the speed begins to differ from what it was [s]."""
    before = speed[times <= since][-1]
    return float(times[(times > since) & (np.abs(speed - before) > 1e-6)][0] - since)


def test_speed_scaling_slows_platform_and_arm_together_on_their_paths(world):
    world.scaling = 1.0
    away = HOME + [1.5, 0, 0, 0, 0, 0]
    world.send(LONG)
    world.move(away, [5.0])
    world.run(2.0)
    world.run(3 * PERIOD)  # not together with a tick
    world.scaling = 0.5
    world.scale(0.5)
    heard = world.time
    world.run(1.5)
    slow = world.time
    world.scaling = 1.0
    world.arrive()
    world.arm_arrives()
    times, x, v, _ = world.assert_arm_smooth()
    at, place, speed, rate = world.followed()
    groups = world.core.parameters.groups()
    assert groups[0].norm(rate).max() <= groups[0].acceleration * (1 + 1e-3)
    assert begin_of_change(at, speed[:, 0], heard) <= 0.05
    assert speed[(at > slow - 0.2) & (at < slow), 0] == pytest.approx(0.25, abs=1e-4)
    assert place[-1] == pytest.approx(LONG[-1], abs=1e-9) and (place[:, 1] == 0.0).all()
    assert x[-1] == pytest.approx(away, abs=1e-9)
    duration = np.ptp(times[np.abs(v[:, 0]) > 1e-9])
    assert duration == pytest.approx(5.0 + 0.75, abs=0.15), "half the time was lost in 1.5 s"
    assert world.warnings == []


def test_at_zero_both_hold_still_and_go_on_by_themselves(world):
    world.scaling = 1.0
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.0)
    world.scaling = 0.0
    world.run(1.5)
    joints, pose = world.joints.copy(), world.setpoint.pose.copy()
    world.run(1.0)
    assert (world.joints == joints).all() and (world.setpoint.pose == pose).all()
    assert world.arm.state is PathState.FOLLOWING
    world.scaling = 1.0
    world.arm_arrives()
    world.arrive()
    assert world.assert_arm_smooth()[1][-1] == pytest.approx(FAR, abs=1e-9)
    assert world.warnings == []


def test_a_pause_at_zero_lasts_until_the_resume_and_a_cancel_ends_at_once(world):
    world.scaling = 1.0
    world.send(LONG)
    world.move(FAR, [3.0])
    world.run(1.0)
    world.scaling = 0.0
    world.run(1.5)
    assert world.ask("pause").success
    world.scaling = 1.0
    joints = world.joints.copy()
    world.run(1.0)
    assert (world.joints == joints).all(), "what stands does not move for a pause"
    assert world.ask("resume").success
    world.run(0.5)
    assert np.abs(world.joints - joints).max() > 0.01
    world.scaling = 0.0
    world.run(1.5)
    assert world.ask("cancel").success
    world.run(0.05)
    assert world.core.state is PathState.IDLE and world.arm.state is PathState.IDLE
    world.assert_arm_smooth()


@pytest.mark.parametrize("value", [NAN, math.inf, -0.2, 1.2])
def test_scaling_that_cannot_be_is_ignored_loudly(world, value):
    world.send(BENT)
    world.run(0.5)
    world.scale(value)
    world.run(0.1)
    assert world.warnings and "arm/speed_scaling ignored" in world.warnings[0]
    world.arrive()
    world.assert_smooth()
    assert world.node.together.pace.plain


def test_when_the_scaling_falls_silent_the_arm_is_given_up_and_later_paths_are_fast(world):
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
    world.ask("cancel")
    world.arrive()
    since = len(world.references)
    world.send([world.setpoint.pose, (2.5, 0, 0)])
    world.arrive()
    assert np.abs(world.followed(since)[2][:, 0]).max() == pytest.approx(0.5, abs=1e-6)


def test_with_a_scaling_of_one_the_stream_is_bit_for_bit_that_without():
    streams = []
    for scaling in (None, 1.0):
        with WithArm() as world:
            world.scaling = scaling
            world.run(0.1)
            world.send(BENT)
            world.run(1.2)
            assert world.node.together.pace.plain
            streams.append(
                [
                    [p.transforms[0].translation, p.velocities, p.accelerations]
                    for i in range(len(world.references))
                    for p in world.message(i).points
                ]
            )
    assert streams[0] == streams[1]


def test_reports_that_cannot_be_used_do_not_count_as_fresh(world):
    """What says where the tool is looks at them first: they must not vouch for an older place."""
    world.run(0.2)
    good, world.joints = world.joints, np.full(6, NAN)
    world.run(0.5)
    world.arm_alive, world.joints = False, good
    world.run(0.15)
    world.move([FAR])
    world.run(0.2)
    assert not world.joint_previews
    assert "arm/joint_states" in world.node.arm.last and " old" in world.node.arm.last
