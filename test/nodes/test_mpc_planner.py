"""MPC planner node over real topics in simulated time, with a fake and the real controller."""

import math
import re
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Quaternion, Twist
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.qos import DurabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core import se2
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.pending_start import WAIT_TIMEOUT
from omniman_ros.nodes.mpc_planner.node import MpcPlannerNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.planner import Planner
from test.nodes.followers import FakeFollower, StreamWorld
from test.nodes.harness import PERIOD, World
from test.nodes.rig import reference, twist
from test.tiers import exhaustive, representative
from test.work import calls

NAN, INF = math.nan, math.inf
FAR = (2.0, 0.0, 0.0)
CYCLE = 0.05
TICK = 0.01  #: Time passes in such steps where the controller is a fake [s]
#: Largest number of calls that a marker of a message costs, with those of two cycles
MARKER_CALLS = 120
LEAST = 0.02  #: The parameter safety.least_clearance [m]


def goal(x: float, y: float, theta: float = 0.0, frame: str = "odom") -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = float(x), float(y)
    message.pose.orientation = quaternion_from_yaw(theta)
    return message


def goal_state(
    pose: Sequence[float], velocity: Sequence[float], frame: str = "odom", child: str = "base_link"
) -> Odometry:
    message = Odometry(child_frame_id=child)
    message.header.frame_id = frame
    message.pose.pose = goal(*pose).pose
    message.twist.twist = twist(*velocity)
    return message


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 0.0) -> PoseStamped:
    """Return a goal with an unnormalised orientation."""
    message = goal(0.5, 0.0)
    message.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return message


class TrueObstacle:
    """True round obstacle that moves at a constant velocity from a time on."""

    def __init__(
        self, x: float, y: float, radius: float = 0.2, velocity: Sequence[float] = (0.0, 0.0)
    ) -> None:
        self.origin, self.radius = np.array([x, y], dtype=float), radius
        self.velocity, self.since = np.array(velocity, dtype=float), 0.0

    def place(self, time: float) -> np.ndarray:
        return self.origin + (time - self.since) * self.velocity


def marker(
    x: float, y: float, radius: float = 0.2, number: int = 0, frame: str = "odom"
) -> Marker:
    made = Marker(ns="things", id=number, type=Marker.CYLINDER, action=Marker.ADD)
    made.header.frame_id = frame
    made.pose.position.x, made.pose.position.y = float(x), float(y)
    made.pose.orientation.w = 1.0
    made.scale.x = made.scale.y = 2.0 * radius
    made.scale.z = 1.0
    return made


class PlannerWorld(StreamWorld):
    """A planner with a short horizon, and its messages with their times of arrival.

    Attributes:
        obstacles_present: True obstacles in the world.
        seen: Whether the obstacles are reported, every 50 ms.
        gaps: Minimum true gap between robot and obstacles so far [m].
    """

    maker = MpcPlannerNode
    name, source = "mpc_planner", "mpc"

    def __init__(self, *others: Any, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(*others, parameters={"horizon.steps": 10} | (parameters or {}))
        self.core: Planner = self.node.core
        self.statuses = self.listen(DiagnosticStatus, "mpc/status")
        self.goals = self.publisher(PoseStamped, "goal_pose")
        self.obstacles_present: list[TrueObstacle] = []
        self.seen = False
        self.gap = INF
        self._reported = -INF
        self.hooks.append(self._look)

    def subscription_count(self) -> int:
        return int(self.node.publisher.reference.get_subscription_count())

    @cached_property
    def markers(self) -> Any:
        """The publisher of obstacles: who has one is expected to publish."""
        return self.publisher(MarkerArray, "obstacles", 50)

    # ---- true state -------------------------------------------------------------------------

    def true_pose(self) -> np.ndarray:
        raise NotImplementedError

    def true_speed(self) -> float:
        """Return the largest component of the true velocity [m/s, rad/s]."""
        raise NotImplementedError

    def _look(self) -> None:
        if self.seen and self.time >= self._reported + CYCLE - 1e-9:
            self._reported = self.time
            self.report(*self.marks())
        if self.obstacles_present:
            centers = np.array([[thing.place(self.time) for thing in self.obstacles_present]])
            axes = np.array([[(thing.radius, thing.radius) for thing in self.obstacles_present]])
            box, flat = self.core.footprint.platform, np.zeros(len(self.obstacles_present))
            gaps = box_gap(self.true_pose()[None, :], box, centers, axes, flat)
            self.gap = min(self.gap, float(gaps.min()))

    def marks(self) -> list[Marker]:
        """Return markers of the current obstacles."""
        return [
            marker(*thing.place(self.time), thing.radius, i)
            for i, thing in enumerate(self.obstacles_present)
        ]

    def report(self, *marks: Marker) -> None:
        self.markers.publish(MarkerArray(markers=list(marks)))

    # ---- requests ----------------------------------------------------------------------------

    def send(self, *pose: float) -> None:
        self.goals.publish(goal(*pose))
        self.run(2 * PERIOD)

    # ---- reactions ---------------------------------------------------------------------------

    @property
    def state(self) -> PlannerState:
        return self.core.state

    def begin(self, seconds: float = 8.0) -> None:
        self.run_until(lambda: self.core.active, seconds, "the goal to be driven to")

    def arrive(self, seconds: float = 8.0) -> float:
        return self.run_until(
            lambda: self.state is PlannerState.ARRIVED and self.node.finished,
            seconds,
            "the arrival",
        )

    def rest(self, seconds: float = 3.0) -> float:
        """Wait until the robot is at rest; assert that it stays at rest."""
        return self.run_until(lambda: self.true_speed() < 0.01, seconds, "rest")

    def last_status(self) -> tuple[bytes, str, dict[str, str]]:
        """Return level, message and values of the last mpc/status."""
        if not self.statuses:
            return b"", "", {}
        status = self.statuses[-1]
        return status.level, status.message, {item.key: item.value for item in status.values}

    def since_start(self) -> float:
        """Return the distance from the start of odometry [m]."""
        return float(np.hypot(*self.true_pose()[:2]))

    def distance(self, *pose: float) -> float:
        """Return the largest error of the true pose [m, rad]."""
        error = self.true_pose() - np.array(pose)
        error[2] = se2.wrap(float(error[2]))
        return float(np.abs(error).max())


class PlannerWithFakeController(PlannerWorld, FakeFollower):
    """The planner with a fake controller that follows instantly."""

    def __init__(self, parameters: dict[str, Any] | None = None, source: str = "none") -> None:
        super().__init__(parameters=parameters)
        self.speeds: list[float] = []
        self.hooks.append(lambda: self.speeds.append(self.true_speed()))
        self.follow(source)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Run like `World.run`, in longer steps."""
        for _ in range(max(round(seconds / TICK), 1)):
            self.time += TICK - PERIOD
            super().run(PERIOD, each)

    def true_pose(self) -> np.ndarray:
        return np.array(self.setpoint.pose)

    def true_speed(self) -> float:
        return float(np.abs(self.setpoint.velocity).max())


class PlannerWithRealController(PlannerWorld):
    """The planner with the real controller on the simulated drive."""

    def __init__(self, *others: Any, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(
            PlatformControllerNode,
            SimulatedDriveNode,
            *others,
            parameters={"robot": "ig42"} | (parameters or {}),
        )
        self.controller, self.drive = self.nodes[1:3]
        self.sources = self.listen(String, "active_source", LATCHED)
        self.run_until(lambda: self.node.inputs.measured is not None, 2.0, "odom")
        self.run_until(lambda: self.node._monitor.source == "none", 2.0, "active_source")

    def true_pose(self) -> np.ndarray:
        return np.array(self.drive.drives.ground_truth()[0])

    def true_speed(self) -> float:
        return float(np.abs(self.drive.drives.ground_truth()[1]).max())

    def refusals(self) -> int:
        """Return the number of references and voltages refused by the controller."""
        counts = self.controller._throttle.counts
        return sum(n for subject, n in counts.items() if subject.startswith("mpc/"))


@pytest.fixture
def alone():
    with PlannerWithFakeController() as world:
        yield world


@pytest.fixture
def robot():
    with PlannerWithRealController() as world:
        yield world


# ---- goals ------------------------------------------------------------------------------------

NUMBERS = ("solve_ms", "slack_m", "cost_j", "energy_j", "distance_m", "angle_rad")


@pytest.mark.parametrize("output", ["reference", exhaustive("voltages")])
def test_robot_reaches_its_goal(output):
    with PlannerWithRealController(parameters={"output": output}) as world:
        plans = world.listen(Path, "mpc/plan")
        predicted = world.listen(MarkerArray, "mpc/predicted_obstacles")
        volts: list[tuple[float, JointState]] = []
        world.probe.create_subscription(
            JointState, "mpc/voltages", lambda m: volts.append((world.time, m)), 100
        )
        world.obstacles_present, world.seen = [TrueObstacle(0.2, -0.8)], True
        place = (0.4, 0.15, 0.3)
        world.send(*place)
        world.begin()
        world.run(0.5)
        level, message, values = world.last_status()
        assert (level, message, values["state"]) == (DiagnosticStatus.OK, "driving", "driving")
        assert all(math.isfinite(float(values[key])) for key in NUMBERS), values
        assert values["obstacles"] == "1" and values["plan_used"] == "True"
        world.arrive()
        assert world.distance(*place) < 0.03
        world.run(0.8)
        assert world.last_status()[:2] == (DiagnosticStatus.OK, "arrived")
        assert world.warnings == [] and world.refusals() == 0
        assert [m.data for m in world.sources] == ["none", "mpc", "none"]
        assert world.distance(*place) < 0.03 and world.true_speed() < 0.01
        assert world.gap > LEAST

        plan = plans[2]
        assert plan.header.frame_id == "odom" and len(plan.poses) > 8
        first, final = plan.poses[0].pose.position, plan.poses[-1].pose.position
        assert math.hypot(final.x - first.x, final.y - first.y) > 0.05
        shown = predicted[2].markers
        assert [m.action for m in shown] == [Marker.DELETEALL, *[Marker.ADD] * 3]
        for one in shown[1:]:
            assert (one.pose.position.x, one.pose.position.y) == pytest.approx(
                (0.2, -0.8), abs=1e-3
            )
            assert one.scale.x >= 0.4
        if output == "voltages":
            assert_volts(world, volts)
        else:
            assert volts == []
            assert np.diff(world.arrivals[1:20]) == pytest.approx([CYCLE] * 18, abs=1e-6)


def assert_volts(world: PlannerWithRealController, volts: list[tuple[float, JointState]]) -> None:
    """Assert that voltages are periodic, stamped, named and within the supply until arrival."""
    assert len(volts) > 60
    times = np.array([time for time, _ in volts])
    assert np.diff(times) == pytest.approx(np.full(len(times) - 1, 0.01), abs=1e-6)
    limit = world.core.model.max_voltage
    for time, message in volts:
        assert list(message.name) == list(world.core.parameters.robot.wheels.names)
        assert time_seconds(message.header.stamp) == pytest.approx(time, abs=PERIOD + 1e-6)
        assert np.isfinite(message.effort).all() and np.abs(message.effort).max() <= limit
        assert not message.velocity and not message.position
    assert np.abs([message.effort for _, message in volts]).max() > 1.0
    begin, end = times[0], times[-1]
    away = [time for time in world.arrivals if begin + CYCLE < time < end]
    assert away == [], "the reference is sent until the first voltages, and after the last"
    assert world.arrivals[-1] > end


@pytest.mark.parametrize(
    ("child", "given", "velocity"),
    [
        ("base_link", (0.3, 0.0, 0.0), (0.287, 0.089, 0.0)),
        exhaustive("odom", (0.3, 0.1, 0.0), (0.3, 0.1, 0.0)),
    ],
)
def test_goal_with_a_velocity_is_passed_at_that_velocity(child, given, velocity):
    with PlannerWithFakeController({"horizon.steps": 20}) as world:
        goals = world.publisher(Odometry, "goal_state")
        goals.publish(goal_state((1.2, 0.0, 0.3), given, child=child))
        world.begin()
        world.run_until(lambda: world.state is PlannerState.ARRIVED, 8.0, "the goal to be passed")
        assert world.distance(1.2, 0.0, 0.3) < 0.08
        assert world.setpoint.velocity == pytest.approx(velocity, abs=0.05)
        world.rest(4.0)
        world.run(2 * CYCLE)
        assert world.last_status()[:2] == (DiagnosticStatus.OK, "arrived") and world.warnings == []
        world.assert_silent(0.3)


def line(world: PlannerWorld, end: float = 3.0, stamp: Any = None, **options: Any) -> Any:
    """Return a goal that moves sideways at 0.2 m/s and then stands."""
    poses = [(0.0, 0.0, 0.0), (0.0, 0.2 * end, 0.0)]
    velocities = [(0.0, 0.2, 0.0), (0.0, 0.2, 0.0)]
    return reference((0.0, end), poses, velocities, stamp or world.stamp(), **options)


def test_moving_goal_is_followed_to_its_end(alone):
    goals = alone.publisher(MultiDOFJointTrajectory, "goal_trajectory")
    begin = alone.time
    goals.publish(line(alone))
    alone.run(2 * PERIOD)
    errors = []
    alone.run(1.5)
    alone.run(1.4, lambda: errors.append(alone.true_pose()[1] - 0.2 * (alone.time - begin)))
    assert np.abs(errors).max() < 0.05
    alone.arrive()
    assert alone.distance(0.0, 0.6, 0.0) < 0.02 and alone.warnings == []


def test_goals_in_map_frame_are_enabled_by_parameter():
    with PlannerWithFakeController({"map_is_odom": True}) as world:
        world.goals.publish(goal(0.2, 0.0, frame="map"))
        world.run(2 * PERIOD)
        assert world.state is PlannerState.DRIVING and world.warnings == []


# ---- refused goals ----------------------------------------------------------------------------

STATE, MOVING, POSE = "goal_state", "goal_trajectory", "goal_pose"
ROOM = {"workspace.x_max": 4.0, "workspace.y_min": -4.0}
STONE = (0.0, 3.0)

BAD: dict[str, tuple[str, Callable[[PlannerWorld], Any], str]] = {
    "in map": (POSE, lambda _: goal(1, 0, frame="map"), "frame 'map', expected 'odom'"),
    "NaN": (POSE, lambda _: goal(NAN, 0), "position .*nan.* not finite"),
    "tilted": (POSE, lambda _: turned(x=0.6, w=0.8), "not about the vertical"),
    "in an obstacle": (POSE, lambda _: goal(*STONE), "an obstacle stands where the robot would"),
    "outside": (POSE, lambda _: goal(4.5, 0), "4.50 m, .* not within the workspace"),
    "state in map": (STATE, lambda _: goal_state((1, 0, 0), (0, 0, 0), "map"), "frame 'map'"),
    "state too fast": (STATE, lambda _: goal_state((1, 0, 0), (1e6, 0, 0)), "beyond"),
    "over": (MOVING, lambda w: line(w, stamp=w.stamp(-5.0)), "trajectory ended 2.0. s ago"),
    "backwards": (MOVING, lambda w: line(w, -1.0), "times do not increase"),
    "empty": (MOVING, lambda w: reference((), (), (), w.stamp()), "1 to 5000 points, got 0"),
}


FIXED = [
    ("safety.least_clearance", 0.2, "above safety.clearance"),
    ("safety.clearance", 0.01, "above safety.clearance"),
    ("safety.deadline", 0.1, "must be <= the period 0.05 s"),
    ("weights.position", -1.0, ""),
    ("weights.energy", NAN, ""),
    ("workspace.x_max", -2e3, "must be above workspace.x_min"),
    ("output", "torque", ""),
    ("horizon.steps", 20, ""),
    ("horizon.step", 0.2, ""),
    ("wheels.radius", [0.2], ""),
    ("period", 0.1, ""),
    ("odom_frame", "map", ""),
]


class GoalPublishers(PlannerWithFakeController):
    """A world with one obstacle and publishers of every kind of goal."""

    def __init__(self) -> None:
        super().__init__(ROOM)
        self.obstacles_present, self.seen = [TrueObstacle(*STONE)], True
        self.kinds = {
            POSE: self.goals,
            STATE: self.publisher(Odometry, STATE),
            MOVING: self.publisher(MultiDOFJointTrajectory, MOVING),
        }
        self.run(0.1)

    def give(self, kind: str, message: Any) -> None:
        self.warnings.clear()
        self.node._throttle.__init__(1.0)  # every message must be received
        self.kinds[kind].publish(message)
        self.run(2 * PERIOD)


@pytest.fixture(scope="class")
def resting():
    with GoalPublishers() as world:
        yield world


class TestAtRest:
    """Share one world among tests without motion; it ends with the class to free its domain."""

    @pytest.mark.parametrize(("kind", "make", "why"), BAD.values(), ids=BAD)
    def test_invalid_goal_moves_nothing_and_is_reported(self, resting, kind, make, why):
        resting.give(kind, make(resting))
        resting.run(2 * CYCLE)
        [warning] = resting.warnings
        assert warning.startswith(kind) and len(warning) < 300
        level, message, _ = resting.last_status()
        assert level == DiagnosticStatus.WARN and message.startswith("a goal was refused: ")
        for text in (warning, message):
            assert re.search(why, text), text
        assert resting.state is PlannerState.IDLE and not resting.references

    @pytest.mark.parametrize(("name", "value", "why"), FIXED)
    def test_invalid_and_read_only_parameters_are_refused_by_name(self, resting, name, value, why):
        before = resting.core.parameters
        result = resting.set(name, value)
        assert not result.successful and why in result.reason
        named = "safety.least_clearance" if name == "safety.clearance" else name
        assert named in result.reason or "read-only" in result.reason
        assert resting.core.parameters == before == resting.node.settings.value.core


# ---- odom -------------------------------------------------------------------------------------


def odd_odom(
    world: PlannerWithFakeController, x: float = 0.0, frame: str = "odom", age: float = 0.0
) -> Odometry:
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
def test_invalid_odometry_is_ignored(odd, why):
    with PlannerWithFakeController(source="") as world:
        world.node.inputs.measured = None  # as if this were the first message
        world.odometry = lambda: odd_odom(world, **odd)
        world.publish_source("none")
        world.run(0.05)
        world.send(*FAR)
        world.run(0.3)
        assert world.state is PlannerState.IDLE and not world.references
        assert re.search(f"a goal is waiting: {why}", world.last_status()[2]["last"])
        if "age" in odd:
            world.run(WAIT_TIMEOUT)
            [refusal] = [w for w in world.warnings if w.startswith("goal not used")]
            assert re.search(why, refusal) and re.search(why, world.last_status()[1])
            world.odometry = world.odom_message
            world.assert_silent(0.3)


@pytest.mark.parametrize(
    "odd", representative([None, *(odd for odd, _ in ODD.values())], 3), ids=["gone", *ODD]
)
def test_goal_is_aborted_and_the_robot_brakes_when_odometry_fails(alone, odd):
    alone.send(*FAR)
    alone.run(1.0)
    place = alone.since_start()
    alone.odometry = None if odd is None else lambda: odd_odom(alone, **odd)
    alone.run(0.4)
    assert alone.state is PlannerState.IDLE
    level, message, _ = alone.last_status()
    assert level == DiagnosticStatus.WARN
    assert re.match(r"the goal was given up: odom is \d\.\d\d s old", message)
    alone.rest(1.0)
    assert alone.since_start() - place < 0.6, "it does not go on blind"
    alone.odometry = alone.odom_message
    alone.run(0.2)
    alone.assert_silent()
    assert alone.state is PlannerState.IDLE


def test_single_invalid_odometry_message_is_tolerated(alone):
    alone.send(0.5, 0.0, 0.0)
    alone.run(0.5)
    alone.odometry = lambda: odd_odom(alone, x=NAN)
    alone.run(0.1)
    alone.odometry = alone.odom_message
    alone.arrive()
    assert alone.distance(0.5, 0.0, 0.0) < 0.03
    assert all(re.match(r"odom ignored: position.*nan", w) for w in alone.warnings)


# ---- source of commands -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("", "no platform_controller"),
        ("cmd_vel", "cmd_vel drives"),
        ("stop", "the platform is stopped"),
    ],
)
def test_goal_is_refused_with_the_reason_while_the_robot_cannot_drive(source, why):
    with PlannerWithFakeController(source=source) as world:
        world.follows_stream = False
        world.send(*FAR)
        world.run(CYCLE if source else 5.0 + 2 * CYCLE)  # the controller may be heard yet
        [warning] = world.warnings
        assert "goal not used: " in warning.replace("goal_pose", "goal") and why in warning
        assert world.last_status()[0] == DiagnosticStatus.WARN and why in world.last_status()[1]
        world.publish_source("none")
        world.assert_silent()


def test_cmd_vel_takes_over_and_a_later_goal_waits_for_its_silence(robot):
    cmd_vel = robot.publisher(Twist, "cmd_vel")
    robot.send(*FAR)
    robot.run(0.8)
    assert robot.true_speed() > 0.1
    cmd_vel.publish(twist(0.0, 0.2))
    robot.run(2 * PERIOD)
    lost, sent = robot.time, len(robot.references)
    robot.run(0.3, lambda: cmd_vel.publish(twist(0.0, 0.2)))
    assert robot.state is PlannerState.IDLE and robot.node.finished
    assert robot.warnings == ["the goal was given up: cmd_vel drives"]
    robot.send(*FAR)
    assert robot.warnings[-1] == "goal_pose not used: cmd_vel drives"
    robot.run(0.2, lambda: cmd_vel.publish(twist(0.0, 0.0)))
    robot.run_until(lambda: robot.node._monitor.source == "none", 2.0, "none to drive")
    assert len(robot.references) == sent, "nothing is sent once the goal is given up"
    refused = robot.refusals()
    assert refused <= 1
    x, y, theta = robot.true_pose()
    robot.send(x, y + 0.2, theta)
    if not robot.core.active:
        robot.run(CYCLE)
        assert robot.last_status()[2]["last"] == "a goal is waiting: control was lost a moment ago"
    robot.begin()
    assert robot.time - lost > 1.0
    robot.arrive()
    assert robot.distance(x, y + 0.2, theta) < 0.03
    assert robot.refusals() == refused
    robot.run(0.4)
    assert [m.data for m in robot.sources] == ["none", "mpc", "cmd_vel", "none", "mpc", "none"]


def emergency(qos: Any) -> Callable[[PlannerWorld], None]:
    def act(world: PlannerWorld) -> None:
        world.publisher(Bool, "emergency_stop", qos).publish(Bool(data=True))

    return act


def peer(world: PlannerWorld) -> Any:
    message = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="/arm", message="stopped: test")
    publisher = world.publisher(DiagnosticStatus, "stop_state", LATCHED)
    publisher.publish(message)
    world.run(PERIOD)
    return publisher


def says(source: str) -> Callable[[Any], None]:
    def act(world: PlannerWithFakeController) -> None:
        world.follows_stream = False
        world.publish_source(source)

    return act


WAYS = {
    "emergency_stop": (emergency(10), "emergency_stop is true"),
    "latched emergency_stop": (emergency(LATCHED), "emergency_stop is true"),
    "a stopped peer": (peer, "/arm is stopped: test"),
    "the controller stops": (says("stop"), "the platform is stopped"),
    "cmd_vel": (says("cmd_vel"), "cmd_vel drives"),
}


LOST = [(way, False) for way in WAYS] + [("a stopped peer", True), ("cmd_vel", True)]


@pytest.mark.parametrize(("name", "paused"), LOST)
def test_lost_control_is_not_taken_back(alone, name, paused):
    way, why = WAYS[name]
    alone.send(*FAR)
    alone.run(0.6)
    if paused:
        alone.call_service("pause")
        alone.run(1.2)
    way(alone)
    alone.run(2 * PERIOD)
    assert alone.state is PlannerState.IDLE and alone.node.finished
    assert alone.warnings == [f"the goal was given up: {why}"]
    alone.assert_silent(0.3)
    assert not alone.call_service("resume").success
    alone.publish_source("none")
    alone.assert_silent(1.3)
    assert alone.last_status()[:2] == (DiagnosticStatus.WARN, f"the goal was given up: {why}")


def test_stream_ends_when_the_controller_cancels(alone):
    alone.send(*FAR)
    alone.run(0.6)
    says("none")(alone)
    alone.run(2 * PERIOD)
    assert "the platform controller has cancelled it" in alone.warnings[-1]
    alone.assert_silent(1.5)


def test_controller_that_never_accepts_the_stream_is_reported(alone):
    alone.follows_stream = False
    alone.send(*FAR)
    alone.run(0.6)
    assert "the platform controller does not follow it" in alone.warnings[-1]
    alone.assert_silent()


def test_stop_wins_over_a_goal_at_the_same_time(alone):
    stop = alone.publisher(Bool, "emergency_stop")
    alone.goals.publish(goal(*FAR))
    stop.publish(Bool(data=True))
    alone.run(PERIOD * 2)
    assert alone.state is PlannerState.IDLE and alone.warnings
    alone.assert_silent(0.3)
    stop.publish(Bool(data=False))
    alone.assert_silent(0.5)


# ---- pause, resume, cancel --------------------------------------------------------------------


def test_pause_keeps_the_goal_and_resume_continues(alone):
    alone.send(1.0, 0.0, 0.0)
    alone.run(0.8)
    speed, place = alone.true_speed(), alone.true_pose()[0]
    assert speed > 0.3
    answer = alone.call_service("pause")
    assert (answer.success, answer.message) == (True, "paused")
    alone.rest(1.0)
    assert alone.true_pose()[0] - place == pytest.approx(speed**2 / 2.04, rel=0.15)
    alone.run(1.0)
    alone.assert_silent(2.0)
    assert alone.last_status()[:2] == (DiagnosticStatus.OK, "paused") and alone.warnings == []
    answer = alone.call_service("resume")
    assert (answer.success, answer.message) == (True, "driving")
    alone.arrive()
    assert alone.distance(1.0, 0.0, 0.0) < 0.03 and alone.warnings == []


def test_new_goal_replaces_a_paused_one(alone):
    alone.send(*FAR)
    alone.run(0.5)
    alone.call_service("pause")
    alone.run(1.0)
    alone.send(0.0, 0.3, 0.0)
    alone.arrive()
    assert alone.distance(0.0, 0.3, 0.0) < 0.03
    assert not alone.call_service("resume").success


def test_requests_without_effect_are_refused_with_a_reason(alone):
    for _ in range(2):
        for name in ("pause", "resume", "cancel"):
            answer = alone.call_service(name)
            assert not answer.success and answer.message.startswith(f"nothing to {name}: ")
        alone.send(0.1, 0.0, 0.0)
        answer = alone.call_service("resume")
        assert (answer.success, answer.message) == (False, "nothing to resume: driving")
        alone.arrive()


def test_waiting_goal_can_be_cancelled(alone):
    alone.odometry = None
    alone.run(0.4)
    alone.send(*FAR)
    assert alone.call_service("cancel").success
    alone.odometry = alone.odom_message
    alone.assert_silent()
    assert not alone.call_service("cancel").success


# ---- obstacles --------------------------------------------------------------------------------


def test_silent_obstacle_source_brakes_until_its_messages_resume(alone):
    alone.seen = True
    alone.send(*FAR)
    alone.run(1.0)
    alone.seen = False
    alone.run(1.1)
    before = alone.true_pose()[0]
    alone.rest(1.2)
    assert alone.true_pose()[0] - before < 0.6
    alone.run(1.5)
    level, message, values = alone.last_status()
    assert level == DiagnosticStatus.WARN
    assert re.fullmatch(r"waits: no obstacles received for \d\.\d s", message)
    assert values["state"] == "driving" and "no obstacles received" in values["why"]
    assert all("no obstacles received" in warning for warning in alone.warnings)
    assert any(warning.startswith("the robot stops: ") for warning in alone.warnings)
    alone.assert_silent()
    alone.seen = True
    alone.run(0.2)
    assert alone.last_status()[:2] == (DiagnosticStatus.OK, "driving")
    alone.arrive()
    assert alone.distance(*FAR) < 0.03


@pytest.mark.parametrize("ends", ["cancel", "pause", "cmd_vel"])
def test_goal_that_ends_while_the_source_is_silent_stops_waiting(alone, ends):
    alone.seen = True
    alone.send(*FAR)
    alone.run(0.5)
    alone.seen = False
    alone.run(2.0)
    assert alone.last_status()[1].startswith("waits: ")
    if ends == "cmd_vel":
        says("cmd_vel")(alone)
    else:
        assert alone.call_service(ends).success
    alone.run(2 * CYCLE)
    expected = {
        "cancel": "idle",
        "pause": "paused",
        "cmd_vel": "the goal was given up: cmd_vel drives",
    }
    assert alone.last_status()[1] == expected[ends] and alone.last_status()[2]["why"] == ""


def test_new_goal_does_not_wait_for_a_source_without_publisher(alone):
    alone.seen = True
    alone.send(*FAR)
    alone.run(0.5)
    alone.seen = False
    alone.run(2.5)
    assert alone.last_status()[1].startswith("waits: ")
    alone.probe.destroy_publisher(alone.markers)
    alone.run(1.5)
    assert alone.last_status()[1].startswith("waits: "), "nobody has said that it may go on"
    alone.send(*FAR)
    alone.arrive()
    assert any("the source of obstacles is gone" in warning for warning in alone.warnings)


def test_goal_waits_for_a_required_source():
    with PlannerWithFakeController({"obstacles.required": True}) as world:
        world.send(0.3, 0.0, 0.0)
        world.run(1.0)
        assert (
            world.last_status()[2]["last"]
            == "a goal is waiting: no obstacles yet: nobody sends it"
        )
        assert not world.references
        world.seen = True
        world.arrive()
        assert world.warnings == []


def test_a_message_with_a_rejected_part_does_not_reset_the_source_timeout(alone):
    alone.report(marker(0, 3))
    alone.send(*FAR)
    alone.run(1.0)
    flat, odd, lost = marker(0, 3), marker(0, 3, number=1), marker(0, 3, number=2, frame="map")
    flat.scale.x = 0.0
    odd.scale.y = NAN

    def send() -> None:
        alone.report(flat, odd, lost)

    alone.run(0.5, send)
    [told, *_] = [w for w in alone.warnings if w.startswith("obstacles not used: ")]
    assert re.search(r"marker 'things' 0: scale \(0.0, 0.4\) m must be .* \(and 2 more\)", told)
    alone.run(0.8, send)
    assert alone.last_status()[1].startswith("waits: obstacles cannot be used: marker 'things' 0")
    alone.run(0.1, lambda: alone.report(flat, marker(0, 3)))
    assert alone.last_status()[1].startswith("waits: "), "where one of them is, is not known"
    alone.run(0.1, lambda: alone.report(marker(0, 3)))
    assert alone.last_status()[1] == "driving"


def test_two_thousand_markers_neither_crash_nor_stall_the_node(alone):
    alone.send(0.6, 0.0, 0.0)
    alone.run(0.2)
    alone.report(*(marker(i % 50, 3 + i // 50, number=i) for i in range(2000)))
    work = calls(lambda: alone.run(2 * CYCLE))
    assert work < 2000 * MARKER_CALLS
    assert alone.last_status()[2]["obstacles"] == "1000"
    reason = "there are 1000 already, at most 1000 are kept (and 999 more)"
    assert reason in alone.warnings[0]
    assert alone.last_status()[1].startswith("waits: obstacles cannot be used: ")
    assert reason in alone.last_status()[1]
    alone.report(Marker(action=Marker.DELETEALL), marker(0, 3))
    alone.hooks.append(lambda: alone.report(marker(0, 3)))
    alone.arrive()
    assert alone.distance(0.6, 0.0, 0.0) < 0.03


# ---- the solver -------------------------------------------------------------------------------


def slow(world: PlannerWithFakeController, seconds: float) -> None:
    """Delay the planner while the other nodes continue."""
    propose = Planner.propose

    def later(*args: Any) -> Any:
        proposal = propose(world.core, *args)
        world.time += seconds
        for node in (*world.nodes, world.probe):
            world._set_time(node)
        return proposal

    world.core.propose = later


def test_late_solutions_are_discarded_and_the_plan_is_followed(alone):
    alone.send(*FAR)
    alone.run(1.0)
    wanted = alone.core.motion
    slow(alone, 0.045)
    alone.run(0.8)
    assert alone.last_status()[2]["why"] == "the answer came 5 ms late"
    assert float(alone.last_status()[2]["solve_ms"]) == pytest.approx(45.0)
    assert alone.setpoint.pose == pytest.approx(wanted.sample(alone.time - PERIOD)[0], abs=5e-3)
    alone.rest(3.0)
    slow(alone, 0.02)
    alone.arrive()
    assert alone.distance(*FAR) < 0.03
    assert all("ms late" in w for w in alone.warnings) and alone.warnings


# ---- time, health, parameters, shutdown -------------------------------------------------------


def test_backward_time_jump_ends_the_goal_and_a_new_goal_is_driven(alone):
    alone.send(*FAR)
    alone.run(0.5)
    alone.odometry = None
    alone.time -= 500.0
    alone.run(0.1)
    assert alone.state is PlannerState.IDLE
    assert alone.warnings == ["the goal was given up: time went back"]
    alone.assert_silent(0.3)
    alone.send(0.5, 0.3, 0.0)
    alone.run(0.3)
    assert alone.state is PlannerState.IDLE, "odom of another time is no odom"
    assert alone.last_status()[2]["last"] == "a goal is waiting: no odom"
    alone.odometry = alone.odom_message
    alone.begin(2.0)
    alone.arrive()
    assert alone.distance(0.5, 0.3, 0.0) < 0.03


def test_backward_time_jump_at_rest_is_tolerated(alone):
    alone.send(0.1, 0.0, 0.0)
    alone.arrive()
    alone.time -= 500.0
    alone.run(0.1)
    assert alone.warnings == [] and alone.last_status()[0] == DiagnosticStatus.OK
    alone.assert_silent(0.3)


def test_dead_wheel_slows_the_robot(alone):
    health = alone.publisher(DiagnosticStatus, "wheel_health", LATCHED)

    def say(limits: str, posture: str = "1") -> None:
        values = [KeyValue(key="limits", value=limits)]
        values.append(KeyValue(key="posture_limits", value=posture))
        health.publish(DiagnosticStatus(name="/platform_controller", values=values))
        alone.run(2 * PERIOD)

    alone.send(3.0, 0.0, 0.0)
    alone.run(1.3)
    assert max(alone.speeds) > 0.7
    say("0.6")
    alone.run(1.6)
    slow_from = len(alone.speeds)
    alone.run(0.5)
    assert 0.4 < max(alone.speeds[slow_from:]) <= 0.6 * 0.85 * 1.035
    say("nonsense")
    assert alone.core.limits.limit_scale == 0.6 and "limits 'nonsense'" in alone.warnings[-1]
    alone.arrive()
    assert max(alone.speeds[slow_from:]) <= 0.6 * 0.85 * 1.035
    say("0.6", posture="0.5")
    assert alone.core.limits.limit_scale == 0.3
    assert alone.core.limits.braking_scale == 0.5


def test_output_can_change_at_rest_only(alone):
    assert alone.set("output", "voltages").successful and not alone.core.anchored
    assert alone.set("output", "reference").successful and alone.core.anchored
    alone.send(0.5, 0.0, 0.0)
    alone.run(0.5)
    result = alone.set("output", "voltages")
    assert not result.successful
    assert "output" in result.reason and "cancel it first" in result.reason
    assert alone.core.anchored and alone.call_service("cancel").success
    assert not alone.set("output", "voltages").successful, "it brakes still"
    alone.rest()
    alone.run(0.1)
    assert alone.set("output", "voltages").successful


def test_deadline_above_the_period_is_refused():
    with pytest.raises(ParameterError, match=r"safety\.deadline"):
        World(MpcPlannerNode, parameters={"safety.deadline": 0.1, "period": 0.05})


def test_shutdown_brings_the_robot_to_rest_and_refuses_goals(alone):
    assert alone.node.finished
    alone.send(*FAR)
    alone.run(0.8)
    alone.node.begin_shutdown("SIGINT")
    assert not alone.node.finished
    patience, place = alone.node.stop_timeout, alone.true_pose()[0]
    alone.run(0.1)
    alone.send(1.0, 0.0, 0.0)
    assert "the node is shutting down" in alone.warnings[-1]
    took = alone.run_until(lambda: alone.node.finished, 5.0, "the end")
    assert took + 0.1 < patience
    alone.run(PERIOD)
    assert alone.true_speed() < 1e-9 and 0.0 < alone.true_pose()[0] - place < 0.5


# ---- voltages ---------------------------------------------------------------------------------


def brake(world: PlannerWithRealController) -> None:
    assert world.call_service("pause").success


def end(world: PlannerWithRealController) -> None:
    world.node.begin_shutdown("SIGINT")


class VoltageDrive(PlannerWithRealController):
    """A robot under way that is driven by voltages, with their times of arrival."""

    def __init__(self) -> None:
        super().__init__(parameters={"output": "voltages"})
        self.volts: list[float] = []
        self.probe.create_subscription(
            JointState, "mpc/voltages", lambda _: self.volts.append(self.time), 100
        )
        self.send(*FAR)
        self.run(0.9)
        assert self.true_speed() > 0.3 and self.volts[-1] > self.time - 0.02
        self.run(PERIOD)


@pytest.mark.parametrize("way", [brake, end], ids=lambda way: way.__name__)
def test_braking_switches_from_voltages_to_the_reference(way):
    with VoltageDrive() as world:
        place, begin, sent = world.true_pose()[0], world.time, len(world.references)
        way(world)
        world.run(0.3)
        assert world.volts[-1] <= begin + 2 * PERIOD
        assert begin <= world.arrivals[sent] <= begin + 2 * PERIOD
        world.rest(1.5)
        assert 0.0 < world.true_pose()[0] - place < 0.6
        assert world.refusals() == 0 and world.warnings == []


def test_voltages_end_at_once_when_control_is_lost():
    with VoltageDrive() as world:
        assert world.call(Trigger, "platform_controller/stop").success
        world.run(2 * PERIOD)
        sent = len(world.volts), len(world.references)
        world.rest(1.5)
        world.run(1.0)
        assert (len(world.volts), len(world.references)) == sent
        assert world.state is PlannerState.IDLE and "~/stop" in world.warnings[-1]


# ---- maps -------------------------------------------------------------------------------------

CELL = 0.05  #: Of the maps here [m]


def a_map(world: PlannerWorld, wall: bool = True, frame: str = "odom") -> OccupancyGrid:
    """Return a map of a 3.4 x 2.4 m room with a wall at x = 1 that has a door of 1 m."""
    cells = np.zeros((48, 68), dtype=np.int8)
    if wall:
        cells[:1], cells[-1:], cells[:, :1], cells[:, -1:] = 100, 100, 100, 100
        cells[:24, 38:40] = 100  # x from 0.9 to 1.0, y from -1.2 to 0.0
        cells[44:, 38:40] = 100  # the door spans from there to 1.0
    message = OccupancyGrid()
    message.header.frame_id, message.header.stamp = frame, world.stamp()
    message.info.resolution, message.info.width, message.info.height = CELL, 68, 48
    message.info.origin.position.x, message.info.origin.position.y = -1.0, -1.2
    message.info.origin.orientation.w = 1.0
    message.data = cells.ravel().tolist()
    return message


def wall_gap(world: PlannerWorld) -> float:
    """Return the gap between the robot and the wall of the map [m]."""
    edge = np.arange(0.0, 0.101, 0.025)
    lower = np.array([(0.9 + dx, y) for dx in edge for y in np.arange(-1.2, 0.001, 0.025)])
    upper = np.array([(0.9 + dx, y) for dx in edge for y in np.arange(1.0, 1.201, 0.025)])
    walls = Walls(np.vstack([lower, upper]), 0.0)
    return float(walls.gaps(world.true_pose()[None], world.core.footprint.platform)[0])


def test_goal_behind_a_wall_is_reached_through_its_door(alone):
    (heard,) = alone.node.get_subscriptions_info_by_topic("map")
    assert heard.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    maps = alone.publisher(OccupancyGrid, "map", LATCHED)
    routes = alone.listen(Path, "mpc/route")
    maps.publish(a_map(alone))
    alone.run(2 * TICK)
    assert alone.core.grid is not None and alone.core.grid.size == pytest.approx((3.4, 2.4))
    alone.send(1.8, -0.5, 0.0)
    alone.begin()
    led, gaps = set(), []

    def note() -> None:
        led.add(alone.last_status()[2].get("led_by", ""))
        gaps.append(wall_gap(alone))

    alone.hooks.append(note)
    alone.arrive(25.0)
    assert alone.distance(1.8, -0.5, 0.0) < 0.03
    assert min(gaps) > LEAST - 0.005
    assert {"searches", "a route"} <= led
    assert alone.warnings == [], "it is not blocked while it searches"
    alone.run(3 * CYCLE)
    assert alone.last_status()[2]["led_by"] == "the goal"
    way = max(routes, key=lambda route: len(route.poses))
    assert way.header.frame_id == "odom"
    x, y = np.array([(p.pose.position.x, p.pose.position.y) for p in way.poses]).T
    assert (x[0], y[0]) == pytest.approx((0.0, 0.0), abs=0.05)
    assert (x[-1], y[-1]) == pytest.approx((1.8, -0.5), abs=1e-6)
    assert np.interp(0.95, x, y) > 0.3


def test_straight_route_is_reported_and_published(alone):
    routes = alone.listen(Path, "mpc/route")
    alone.send(1.0, 0.0, 0.0)
    alone.run(0.2)
    assert alone.last_status()[2]["led_by"] == "a straight line"
    ends = [(p.pose.position.x, p.pose.position.y) for p in routes[-1].poses]
    assert ends == [(0.0, 0.0), pytest.approx((1.0, 0.0))]


def test_an_invalid_map_is_refused_and_the_last_map_stays(alone):
    maps = alone.publisher(OccupancyGrid, "map", LATCHED)
    maps.publish(a_map(alone))
    alone.run(2 * TICK)
    kept = alone.core.grid
    assert kept is not None and alone.warnings == []
    maps.publish(a_map(alone, wall=False, frame="map"))
    alone.run(2 * TICK)
    [warning] = alone.warnings
    assert warning.startswith("map ignored: ") and "frame 'map', expected 'odom'" in warning
    assert alone.core.grid is kept
    maps.publish(a_map(alone, wall=False))
    alone.run(2 * TICK)
    assert alone.core.grid is not kept and not alone.core.grid.occupied.any()


def test_map_in_frame_map_is_accepted_where_map_equals_odom():
    given = {"map_is_odom": True, "map_threshold": 80}
    with PlannerWithFakeController(given) as world:
        maps = world.publisher(OccupancyGrid, "map", LATCHED)
        message = a_map(world, wall=False, frame="map")
        message.data[0], message.data[1], message.data[2] = -1, 79, 80
        maps.publish(message)
        world.run(2 * TICK)
        assert world.warnings == [] and world.core.grid is not None
        assert np.flatnonzero(world.core.grid.occupied).tolist() == [2]


def test_the_kept_map_follows_its_threshold_and_what_unknown_cells_mean(alone):
    message = a_map(alone, wall=False)
    message.data[0], message.data[1], message.data[2] = -1, 79, 80
    alone.publisher(OccupancyGrid, "map", LATCHED).publish(message)
    alone.run(2 * TICK)
    for name, value, occupied in (
        ("map_threshold", 80, [2]),
        ("map_unknown_is_free", False, [0, 2]),
        ("map_threshold", 79, [0, 1, 2]),
        ("map_unknown_is_free", True, [1, 2]),
    ):
        assert alone.set(name, value).successful
        assert np.flatnonzero(alone.core.grid.occupied).tolist() == occupied, name
    kept = alone.core.grid
    assert not alone.set("map_threshold", 0).successful
    assert alone.set("weights.energy", 10.0).successful
    assert alone.core.grid is kept
