"""The planner's node in simulated time, in closed loop with the controller and the simulation.

The node is created as usual, but not spun. Instead, the loop calls the callbacks of its
subscriptions with messages, calls its timer when it is due, and collects what it publishes. The
node's clock shows the time of the simulation. The robot keeps moving while the node computes: an
answer reaches the controller only after its measured computation time, and messages to the node
wait until then, as in a node with a single-threaded executor.
"""

import contextlib
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from rclpy.time import Time
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.maps import map_message
from omniman_ros.conversions.odometry import fill_odometry
from omniman_ros.conversions.tracks import track_markers
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.conversions.wheels import LIMIT_SCALE_KEY
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.scanned_surroundings import ScannedSurroundings
from omniman_ros.lab.studies.scene_generator import RandomScene, scene
from omniman_ros.lab.studies.scenes import (
    TIME_LIMIT,
    SceneDrive,
    SceneOutcome,
    box_of,
    judge_drive,
    true_robot,
)
from omniman_ros.lab.studies.worlds import HEIGHT, obstacle_name, place_obstacles, scene_world
from omniman_ros.nodes.mpc_planner.node import MpcPlannerNode
from omniman_ros.nodes.rclpy_compat import deliver
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

EPOCH = 1000.0  #: ROS time at which the simulation starts [s]; a stamp of 0 is the present time
ODOM_EVERY = 2  #: number of ticks of the plant per message on `odom`, which results in 100 Hz
#: Standard deviations of the pose [m, m, rad] and the twist [m/s, m/s, rad/s] on `odom`
ODOM_NOISE = (0.002, 0.002, 0.002, 0.005, 0.005, 0.005)
MARKER_NOISE = 0.01  #: standard deviation of a marker's x and y [m]
MARKER_PERIOD = (0.04, 0.12)  #: range of the random time between two messages on `obstacles` [s]
MARKER_DELAY = (0.005, 0.03)  #: range of the random delay of an observation's arrival [s]
GOAL_TIME = 0.25  #: time at which the goal is sent, after a few observations [s]
TRACK_LIFETIME = 0.5  #: lifetime of what the scanners see [s]
CORNER = 0.45  #: place of the scanners, over the platform's length and width [-]
SCANNED_RANGE = 10.0  #: range of the scanners [m]
#: Posture of the arm, if the robot has one, in which it is above the platform [rad]
UPRIGHT = (0.0, -0.5 * math.pi, 0.0, -0.5 * math.pi, 0.0, 0.0)
IDLE_TIMEOUT = 1.0  #: time after which a drive ends if the planner has no goal [s]


class CallbackPlanner(MpcPlannerNode):
    """The planner's node with its publishers replaced; references are passed to a function."""

    def __init__(
        self, on_reference: Callable[[MultiDOFJointTrajectory], None], **options: Any
    ) -> None:
        self._on_reference = on_reference
        super().__init__(**options)

    def create_publisher(self, msg_type: Any, topic: str, *args: Any, **options: Any) -> Any:
        """Create a callback publisher for the node's own topics, and a real one for all others."""
        if topic == "mpc/reference":
            return _publisher(self._on_reference, subscribers=1)
        if topic.startswith("mpc/") or topic == "/diagnostics":
            return _publisher(lambda _: None, subscribers=int(topic == "mpc/status"))
        return super().create_publisher(msg_type, topic, *args, **options)

    def warn(self, subject: str, text: str) -> None:
        """Suppress warnings: those of hundreds of drives would fill the terminal."""


def _publisher(on_message: Callable[[Any], None], subscribers: int) -> SimpleNamespace:
    """Return a replacement for a publisher that passes each message to a function."""
    return SimpleNamespace(publish=on_message, get_subscription_count=lambda: subscribers)


@cache
def context() -> rclpy.Context:
    """Return the ROS context of this process, with discovery of other participants turned off."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    shared = rclpy.Context()
    shared.init(args=[])
    return shared


@dataclass(frozen=True)
class SceneRunSettings:
    """Settings of drives through random scenes."""

    robot: str = "ig42"  #: name of the robot, or path of its file
    seed: int = 0  #: seed of the noise, which is combined with the seed of the scene
    solve_time: float | None = None  #: assumed for each answer [s]; None: the CPU time it takes
    wheels: str | None = None  #: kind of wheels in the physics world; None for the plant
    calibration: Mapping[str, float] = field(default_factory=dict)  #: of odometry, names to values
    by_scanner: bool = False  #: whether two laser scanners in the world see what is around


class NodeLoop:
    """Closed loop of the planner's node, the controller and the simulation in one scene."""

    def __init__(self, random_scene: RandomScene, settings: SceneRunSettings) -> None:
        self.scene = random_scene
        self.loop = _closed_loop(random_scene, settings)
        self.node = CallbackPlanner(
            self._on_reference,
            context=context(),
            parameter_overrides=_overrides(settings.robot, random_scene),
            enable_rosout=False,
            start_parameter_services=False,
        )
        rclpy.logging.set_logger_level(
            self.node.get_logger().name, rclpy.logging.LoggingSeverity.FATAL
        )
        self._callbacks: dict[str, Callable[[Any], None]] = {
            subscription.topic_name.lstrip("/"): partial(self._hand_over, subscription)
            for subscription in self.node.subscriptions
        }
        self._random = np.random.default_rng((2021, random_scene.seed, settings.seed))
        self._solve_time = settings.solve_time
        self._propose = self.node.core.propose
        self.node.core.propose = self._timed_propose  # type: ignore[assignment,method-assign]
        self._tick_started: float | None = None
        self._tick_time = 0.0
        self._has_planned = False
        self._answer_time = math.nan
        self._busy_until = self._next_tick = 0.0
        self._inbox: list[tuple[float, str, Any]] = []
        self._outbox: list[tuple[float, MultiDOFJointTrajectory]] = []
        self._next_observation = 0.0
        self._scanned: ScannedSurroundings | None = None
        self._reported: set[int] = set()
        if settings.by_scanner:
            assert self.loop.world is not None
            seed = random_scene.seed + settings.seed
            scanners = corner_scanners(self.node.settings.value.core.robot)
            self._scanned = ScannedSurroundings(self.loop.world, scanners, seed)
        self._source = self._health = ""
        self.times: list[float] = []
        self.poses: list[Array] = []  # true poses (3,) in odom [m, m, rad]
        self.energy: list[float] = []
        self.answers: list[float] = []
        self.late = 0
        self.touched: tuple[float, int] | None = None

    def close(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()

    @property
    def now(self) -> float:
        """Present time of the plant [s]."""
        return self.loop.now

    # ---- a drive ------------------------------------------------------------------------------

    def run(self, limit: float = TIME_LIMIT) -> SceneDrive:
        """Send the goal, and drive until the planner arrives or abandons the goal.

        Returns:
            The drive, from the sending of the goal on.
        """
        while self.now < GOAL_TIME - 1e-9:
            self.step()
        self._send("goal_pose", _goal_message(self.scene.goal))
        first = len(self.times)
        end, last_active = self.now + limit, self.now
        while self.now < end - 1e-9:
            self.step()
            if self.node.core.state is PlannerState.ARRIVED:
                break
            if self.node.core.goal is not None:
                last_active = self.now
            elif self.now - last_active > IDLE_TIMEOUT + GOAL_TIME:
                break
        return self._recorded_drive(first)

    def _recorded_drive(self, first: int) -> SceneDrive:
        """Return the record of the drive from the tick number `first` on."""
        core = self.node.core
        odometry = np.array(self.loop.controller.odometry.pose)
        message, last = self.node.status()[1], self.node.loop.goals.text
        return SceneDrive(
            np.array(self.times[first:]),
            np.array(self.poses[first:]),
            self.energy[-1] - self.energy[first],
            core.state is PlannerState.ARRIVED,
            np.array(self.answers),
            self.late,
            float(np.hypot(*(odometry - self.poses[-1])[:2])),
            core.state.value,
            message if message == last else f"{message}; {last}",
            self.touched,
        )

    def step(self) -> None:
        """Run one tick of the plant, and the callbacks of the node that are due after it."""
        self._deliver()
        if self.loop.world is not None:
            place_obstacles(self.loop.world, self.scene.obstacles, self.now)
        self.loop.step()
        self.times.append(self.now - PERIOD)
        self._receive_contacts()
        self.poses.append(self.loop.truth.copy())
        self.energy.append(float(self.loop.drives.electrical()[:, 2].sum()))
        self._send_controller_state()
        if self._scanned is None:
            self._send_obstacles()
        else:
            self._send_scanned(self._scanned)
        if self.now >= self._busy_until - 1e-9:
            self._run_callbacks()

    # ---- the world ----------------------------------------------------------------------------

    def _receive_contacts(self) -> None:
        """Note the first contact with an obstacle in the world."""
        world = self.loop.world
        if world is None or self.touched is not None or not world.contacts:
            return
        names = [obstacle_name(index) for index in range(len(self.scene.obstacles))]
        met = [names.index(each.element) for each in world.contacts if each.element in names]
        if met:
            self.touched = self.times[-1], met[0]

    # ---- the node -----------------------------------------------------------------------------

    def _hand_over(self, subscription: Subscription, message: Any) -> None:
        deliver(subscription, message, round(1e9 * self.now))

    def _run_callbacks(self) -> None:
        """Deliver arrived messages to the node, and call its timer if it is due."""
        now = self.now
        self._set_clock(now)
        arrived = [item for item in self._inbox if item[0] <= now + 1e-9]
        self._inbox = [item for item in self._inbox if item[0] > now + 1e-9]
        newest_odom = max((k for k, item in enumerate(arrived) if item[1] == "odom"), default=-1)
        for k, (_, topic, message) in enumerate(arrived):
            if topic != "odom" or k == newest_odom:  # the node keeps only the last odom message
                self._callbacks[topic](message)
        if now < self._next_tick - 1e-9:
            return
        period = self.node.settings.value.period
        self._next_tick += period * max(math.floor((now - self._next_tick) / period + 1e-9) + 1, 1)
        self._tick(now)

    def _tick(self, now: float) -> None:
        """Call the node's timer, and record how long its answer took."""
        self._tick_time, self._has_planned, self._answer_time = now, False, math.nan
        self._tick_started = time.thread_time()
        self.node.tick()
        duration = self._elapsed()
        self._busy_until, self._tick_started = now + duration, None
        if self._has_planned:
            # There is no reference if the robot is to stand still.
            has_reference = not math.isnan(self._answer_time)
            self.answers.append(self._answer_time if has_reference else duration)
            self.late += self.node.core.report.lateness > 0.0

    def _elapsed(self) -> float:
        """Return the time since the start of the node's tick, measured or assumed [s]."""
        if self._tick_started is None:
            return 0.0
        if self._solve_time is not None:
            return self._solve_time if self._has_planned else 0.0
        return time.thread_time() - self._tick_started

    def _timed_propose(self, *args: Any) -> Any:
        """Plan, and advance the node's clock by the time that the planning took."""
        proposal = self._propose(*args)
        self._has_planned = True
        self._set_clock(self._tick_time + self._elapsed())
        return proposal

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        """Queue a reference for its delayed delivery to the controller."""
        self._answer_time = self._elapsed()
        self._outbox.append((self._tick_time + self._answer_time, message))

    def _deliver(self) -> None:
        """Pass the newest reference that has arrived to the controller, as its node would do."""
        arrived = [message for arrival, message in self._outbox if arrival <= self.now + 1e-9]
        if not arrived:
            return
        self._outbox = [item for item in self._outbox if item[0] > self.now + 1e-9]
        message = arrived[-1]
        start = time_seconds(message.header.stamp) - EPOCH
        with contextlib.suppress(InputError):  # what is refused is not followed
            preview = preview_from_message(message, start, ("odom",))
            self.loop.controller.set_preview(Source.MPC, preview, self.now)

    def _set_clock(self, now: float) -> None:
        # The method exists on ROS clocks only; the node has one, as it uses simulated time.
        clock: Any = self.node.get_clock()
        clock.set_ros_time_override(Time(nanoseconds=round((EPOCH + now) * 1e9)))

    # ---- messages to the node -------------------------------------------------------------------

    def _send(self, topic: str, message: Any, delay: float = 0.0) -> None:
        """Queue a message to the node that arrives after a delay [s]."""
        self._inbox.append((self.now + delay, topic, message))

    def _send_controller_state(self) -> None:
        """Send the messages that the controller's node would publish in this tick."""
        core = self.loop.controller
        if self.loop.tick % ODOM_EVERY == 0:
            noise = np.array(ODOM_NOISE) * self._random.standard_normal(6)
            odometry, message = core.odometry, Odometry(child_frame_id="base_link")
            message.header.frame_id = "odom"
            fill_odometry(
                message,
                (np.array(odometry.pose) + noise[:3]).tolist(),
                odometry.twist + noise[3:],
                odometry.covariance,
                _stamp(core.feedback.time),
            )
            self._send("odom", message)
            if self._scanned is not None:
                pose, twist = np.array(odometry.pose) + noise[:3], odometry.twist + noise[3:]
                self._scanned.add_pose(core.feedback.time, pose, twist)
        source = core.arbiter.active
        active = source.value if source else "none" if core.latch.released else "stop"
        if active != self._source:
            self._source = active
            self._send("active_source", String(data=active))
        health = f"{core.wheel_health.limit_scale:g}"
        if health != self._health:
            self._health = health
            limit_scale = KeyValue(key=LIMIT_SCALE_KEY, value=health)
            self._send("wheel_health", DiagnosticStatus(values=[limit_scale]))

    def _send_obstacles(self) -> None:
        """Send noisy positions of the obstacles, at random intervals and with a random delay."""
        if self.now < self._next_observation - 1e-9:
            return
        self._next_observation = self.now + float(self._random.uniform(*MARKER_PERIOD))
        message = MarkerArray()
        for number, obstacle in enumerate(self.scene.obstacles):
            noise = MARKER_NOISE * self._random.standard_normal(2)
            marker = Marker(ns="scene", id=number, type=Marker.CYLINDER, action=Marker.ADD)
            marker.header.frame_id, marker.header.stamp = "odom", _stamp(self.now)
            x, y = (obstacle.place(self.now) + noise).tolist()
            marker.pose.position.x, marker.pose.position.y = x, y
            marker.pose.orientation = quaternion_from_yaw(obstacle.angle)
            marker.scale.x, marker.scale.y = (2.0 * axis for axis in obstacle.semi_axes)
            message.markers.append(marker)
        self._send("obstacles", message, float(self._random.uniform(*MARKER_DELAY)))

    def _send_scanned(self, scanned: ScannedSurroundings) -> None:
        """Send what the scanners see, as `obstacle_tracker` does, and with a random delay."""
        time = self.loop.controller.feedback.time
        obstacles = scanned.scan(time, self.node.core.footprint)
        if obstacles is None:
            return
        delay, stamp = float(self._random.uniform(*MARKER_DELAY)), _stamp(time)
        present = {obstacle.number for obstacle in obstacles}
        gone, self._reported = sorted(self._reported - present), present
        message = track_markers(
            obstacles, gone, "odom", stamp, lifetime=TRACK_LIFETIME, height=HEIGHT
        )
        self._send("obstacles", message, delay)
        if scanned.is_map_due(time):
            grid, cells = scanned.tracker.map, scanned.tracker.occupancy()
            known = map_message(cells, grid.resolution, grid.origin, "odom", stamp)
            self._send("map", known, delay)


def corner_scanners(robot: Platform) -> list[ScannerParameters]:
    """Return two scanners at opposite corners of the platform, which see all sides."""
    x, y = CORNER * robot.body.length, CORNER * robot.body.width
    return [
        ScannerParameters(
            x=side * x,
            y=side * y,
            yaw=math.atan2(side, side),
            field_of_view=1.5 * math.pi,
            range_max=SCANNED_RANGE,
            noise=MARKER_NOISE,
            sees_robot=False,
        )
        for side in (1.0, -1.0)
    ]


def _closed_loop(random_scene: RandomScene, settings: SceneRunSettings) -> ClosedLoop:
    """Return a loop with the controller of the nominal robot and the drives of the true robot."""
    values = {**robot_parameters(settings.robot), **settings.calibration}
    true_values, changes = true_robot(values, random_scene.mismatch)
    start, world = random_scene.start, None
    if settings.wheels:
        obstacles = random_scene.obstacles
        world = scene_world(true_values, settings.wheels, start, obstacles, posture=UPRIGHT)
    loop = ClosedLoop(
        build(PlatformParameters, values),
        build(SimulationParameters, changes),
        world=world,
        robot=build(Platform, true_values),
    )
    loop.set_pose(start)
    return loop


def _overrides(robot: str, random_scene: RandomScene) -> list[Parameter]:
    """Return the parameters of the node: simulated time, the robot and the scene's workspace."""
    overrides: dict[str, Any] = {"use_sim_time": True, "robot": robot}
    if random_scene.workspace is not None:
        names = ("x_min", "y_min", "x_max", "y_max")
        bounds = zip(names, random_scene.workspace, strict=True)
        overrides |= {f"workspace.{name}": bound for name, bound in bounds}
    return [Parameter(name, value=value) for name, value in overrides.items()]


def _goal_message(pose: tuple[float, float, float]) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "odom"
    message.pose.position.x, message.pose.position.y = pose[:2]
    message.pose.orientation = quaternion_from_yaw(pose[2])
    return message


def _stamp(now: float) -> Any:
    return Time(nanoseconds=round((EPOCH + now) * 1e9)).to_msg()


def drive_scene(settings: SceneRunSettings, seed: int) -> SceneOutcome:
    """Drive through the random scene of a seed, and judge the drive by the ground truth."""
    box = box_of(robot_parameters(settings.robot))
    random_scene = scene(seed, box)
    loop = NodeLoop(random_scene, settings)
    try:
        return judge_drive(random_scene, loop.run(), box)
    finally:
        loop.close()
