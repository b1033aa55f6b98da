"""The planner's node in simulated time, with the controller and the slipping plant.

The node is created as usual, but not spun: the callbacks of its subscriptions are called with
messages, that of its timer when it is due, and what it publishes is collected. Its clock is the
simulation's. While it computes, the plant drives on: an answer reaches the controller after the
time that it was measured to take, and messages wait meanwhile, as in a node with one thread.
"""

import math
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.time import Time
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.odometry import fill_odometry
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.conversions.wheels import LIMIT_SCALE_KEY
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.scene_generator import RandomScene, scene
from omniman_ros.lab.studies.scenes import (
    LIMIT,
    Outcome,
    SceneDrive,
    agility_of,
    box_of,
    judged,
    mover_of,
    true_robot,
)
from omniman_ros.nodes.mpc_planner import MpcPlannerNode
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.robots import load_robot
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

EPOCH = 1000.0
"""ROS time at which the simulation begins; a stamp of zero would mean the present time [s]."""
ODOM_EVERY = 2
"""Number of ticks of the plant between two messages on odom, which makes 100 Hz."""
ODOM_NOISE = (0.002, 0.002, 0.002, 0.005, 0.005, 0.005)
"""Standard deviations in odom, of the pose [m, m, rad] and the twist [m/s, m/s, rad/s]."""
MARKER_NOISE = 0.01
"""Standard deviation of a marker's x and y [m]."""
MARKER_PERIOD = (0.04, 0.12)
"""Range of the random time between two messages of obstacles [s]."""
MARKER_DELAY = (0.005, 0.03)
"""Range of the random time from an observation to its arrival [s]."""
GOAL_TIME = 0.25
"""Time on the plant's clock at which the goal is sent, after a few observations [s]."""
IDLE_TIMEOUT = 1.0
"""Time without a goal after which a drive is over [s]."""
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


class CallbackPublisher:
    """Stands for a publisher of the node, and passes messages to a function.

    Args:
        on_message: Called with each message.
        has_subscriber: Whether it reports a subscriber; the node does not publish without one.
    """

    def __init__(self, on_message: Callable[[Any], None], has_subscriber: bool) -> None:
        self.publish = on_message
        self._has_subscriber = has_subscriber

    def get_subscription_count(self) -> int:
        """Return the number of subscribers."""
        return int(self._has_subscriber)


class CallbackPlanner(MpcPlannerNode):
    """The planner's node, whose references go to a function.

    Args:
        on_reference: Called with each reference.
        options: Options of the node.
    """

    def __init__(
        self, on_reference: Callable[[MultiDOFJointTrajectory], None], **options: Any
    ) -> None:
        self._on_reference = on_reference
        super().__init__(**options)

    def create_publisher(self, msg_type: Any, topic: str, *args: Any, **options: Any) -> Any:
        """Make a callback publisher; for topics that are not the node's own, a real one."""
        if topic == "mpc/reference":
            return CallbackPublisher(self._on_reference, has_subscriber=True)
        if topic.startswith("mpc/") or topic == "/diagnostics":
            return CallbackPublisher(lambda _: None, has_subscriber=topic == "mpc/status")
        return super().create_publisher(msg_type, topic, *args, **options)

    def warn(self, subject: str, text: str) -> None:
        """Do not log: the warnings of hundreds of drives would fill the terminal."""


@cache
def context() -> rclpy.Context:
    """Return the context of this process, which discovers no other participant."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    made = rclpy.Context()
    made.init(args=[])
    return made


@dataclass(frozen=True)
class Request:
    """Settings of the drives through scenes.

    Attributes:
        robot: Name of the robot, or the path of its file.
        seed: Seed of all noise, in addition to the scene's own.
        solve_time: Duration of each answer [s]; None means its CPU time.

    Raises:
        InputError: The duration is negative or not finite.
    """

    robot: str = "ig42"
    seed: int = 0
    solve_time: float | None = None

    def __post_init__(self) -> None:
        if self.solve_time is not None and not 0.0 <= self.solve_time < math.inf:
            raise InputError(f"the solve time must be 0 s or more, got {self.solve_time} s")


class NodeLoop:
    """Runs the planner's node, controller and plant through one scene.

    Args:
        robot: Name of the robot, or the path of its file.
        made: The scene.
        seed: Seed of the noise.
        solve_time: Duration of each answer [s]; None means that it is measured.

    Attributes:
        loop: Controller and plant.
        node: The planner's node.
        times: Times of the ticks on the plant's clock [s].
        poses: True poses (3,) at the ticks in odom [m, m, rad].
        energy: Electric energy consumed so far [J].
        answers: Times from the begin of a cycle to its reference [s].
        late: Number of answers after the planner's deadline.
        whys: Reasons why plans were not used, with their numbers.
    """

    def __init__(
        self, robot: str, made: RandomScene, seed: int = 0, solve_time: float | None = None
    ) -> None:
        values = load_robot(robot)
        self.made = made
        self.loop = _loop(values, made)
        self.node = CallbackPlanner(
            self._on_reference,
            context=context(),
            parameter_overrides=_overrides(robot, made),
            enable_rosout=False,
            start_parameter_services=False,
        )
        rclpy.logging.set_logger_level(
            self.node.get_logger().name, rclpy.logging.LoggingSeverity.FATAL
        )
        self._callbacks = {s.topic_name.lstrip("/"): s.callback for s in self.node.subscriptions}
        self._random = np.random.default_rng((2021, made.seed, seed))
        self._solve_time = solve_time
        self._propose = self.node.core.propose
        self.node.core.propose = self._proposed  # type: ignore[assignment,method-assign]
        self._begun: float | None = None
        self._tick_at = 0.0
        self._planned = False
        self._answered = math.nan
        self._free = self._due = 0.0
        self._inbox: list[tuple[float, str, Any]] = []
        self._outbox: list[tuple[float, MultiDOFJointTrajectory]] = []
        self._observed_next = 0.0
        self._source = self._health = ""
        self.times: list[float] = []
        self.poses: list[Array] = []
        self.energy: list[float] = []
        self.answers: list[float] = []
        self.late = 0
        self.whys: Counter[str] = Counter()

    def close(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()

    @property
    def now(self) -> float:
        """Time of the plant [s]."""
        return self.loop.now

    # ---- a drive ------------------------------------------------------------------------------

    def run(self, limit: float = LIMIT) -> SceneDrive:
        """Send the goal, and drive until the planner arrives or abandons it, up to a limit [s]."""
        while self.now < GOAL_TIME - 1e-9:
            self.step()
        self._send("goal_pose", _goal(self.made.goal))
        first = len(self.times)
        end, idle = self.now + limit, self.now
        while self.now < end - 1e-9:
            self.step()
            if self.node.core.state is PlannerState.ARRIVED:
                break
            if self.node.core.goal is not None:
                idle = self.now
            elif self.now - idle > IDLE_TIMEOUT + GOAL_TIME:
                break
        return self._drive(first)

    def _drive(self, first: int) -> SceneDrive:
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
            dict(self.whys.most_common(5)),
        )

    def step(self) -> None:
        """Run one tick of the plant, and what the node does until the next."""
        self._deliver()
        self.loop.step()
        self.times.append(self.now - PERIOD)
        self.poses.append(self.loop.truth.copy())
        self.energy.append(float(self.loop.drives.electrical()[:, 2].sum()))
        self._report()
        self._observe()
        if self.now >= self._free - 1e-9:
            self._serve()

    # ---- the node -----------------------------------------------------------------------------

    def _serve(self) -> None:
        """Deliver arrived messages to the node, and call its timer if that is due."""
        now = self.now
        self._set_clock(now)
        arrived = [item for item in self._inbox if item[0] <= now + 1e-9]
        self._inbox = [item for item in self._inbox if item[0] > now + 1e-9]
        newest = max((k for k, item in enumerate(arrived) if item[1] == "odom"), default=-1)
        for k, (_, topic, message) in enumerate(arrived):
            if topic != "odom" or k == newest:  # the node's queue holds one message of odom
                self._callbacks[topic](message)
        if now < self._due - 1e-9:
            return
        period = self.node.settings.value.period
        self._due += period * max(math.floor((now - self._due) / period + 1e-9) + 1, 1)
        self._tick(now)

    def _tick(self, now: float) -> None:
        self._tick_at, self._planned, self._answered = now, False, math.nan
        self._begun = time.thread_time()
        self.node.tick()
        took = self._elapsed()
        self._free, self._begun = now + took, None
        if self._planned:
            # A robot that is to stand still gets no reference.
            self.answers.append(took if math.isnan(self._answered) else self._answered)
            report = self.node.core.report
            self.late += report.lateness > 0.0
            if report.reason:
                self.whys[_NUMBER.sub("#", report.reason)] += 1

    def _elapsed(self) -> float:
        """Return the time since the begin of the tick [s]."""
        if self._begun is None:
            return 0.0
        if self._solve_time is not None:
            return self._solve_time if self._planned else 0.0
        return time.thread_time() - self._begun

    def _proposed(self, *args: Any) -> Any:
        """Plan, and advance the node's clock by the time that it took."""
        proposal = self._propose(*args)
        self._planned = True
        self._set_clock(self._tick_at + self._elapsed())
        return proposal

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        """Queue a reference for its delayed delivery to the controller."""
        self._answered = self._elapsed()
        self._outbox.append((self._tick_at + self._answered, message))

    def _deliver(self) -> None:
        """Pass the last reference that has arrived to the controller, as its node does."""
        arrived = [message for at, message in self._outbox if at <= self.now + 1e-9]
        if not arrived:
            return
        self._outbox = [item for item in self._outbox if item[0] > self.now + 1e-9]
        message = arrived[-1]
        start = time_seconds(message.header.stamp) - EPOCH
        try:
            preview = preview_from_message(message, start, ("odom",))
            refusal = self.loop.controller.set_preview(Source.MPC, preview, self.now)
        except InputError as error:
            refusal = str(error)
        if refusal:
            self.whys[_NUMBER.sub("#", f"controller: {refusal}")] += 1

    def _set_clock(self, now: float) -> None:
        # Only a ROS clock has it, and the node runs on one.
        clock: Any = self.node.get_clock()
        clock.set_ros_time_override(Time(nanoseconds=round((EPOCH + now) * 1e9)))

    # ---- messages to the node -------------------------------------------------------------------

    def _send(self, topic: str, message: Any, after: float = 0.0) -> None:
        self._inbox.append((self.now + after, topic, message))

    def _report(self) -> None:
        """Send the messages of the controller's node in a tick."""
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
        source = core.arbiter.active
        active = source.value if source else "none" if core.latch.released else "stop"
        if active != self._source:
            self._source = active
            self._send("active_source", String(data=active))
        health = f"{core.parameters.drive.dead_limits if core.wheel_health.idle else 1.0:g}"
        if health != self._health:
            self._health = health
            share = KeyValue(key=LIMIT_SCALE_KEY, value=health)
            self._send("wheel_health", DiagnosticStatus(values=[share]))

    def _observe(self) -> None:
        """Observe obstacles from time to time; the message arrives a little later."""
        if self.now < self._observed_next - 1e-9:
            return
        self._observed_next = self.now + float(self._random.uniform(*MARKER_PERIOD))
        message = MarkerArray()
        for number, obstacle in enumerate(self.made.obstacles):
            noise = MARKER_NOISE * self._random.standard_normal(2)
            marker = Marker(ns="scene", id=number, type=Marker.CYLINDER, action=Marker.ADD)
            marker.header.frame_id, marker.header.stamp = "odom", _stamp(self.now)
            x, y = (obstacle.place(self.now) + noise).tolist()
            marker.pose.position.x, marker.pose.position.y = x, y
            marker.pose.orientation = quaternion_from_yaw(obstacle.angle)
            marker.scale.x, marker.scale.y = (2.0 * axis for axis in obstacle.semi_axes)
            marker.scale.z = 1.0
            message.markers.append(marker)
        self._send("obstacles", message, float(self._random.uniform(*MARKER_DELAY)))


def _loop(values: Mapping[str, Any], made: RandomScene) -> ClosedLoop:
    """Return a loop of the nominal robot's controller and the true robot's drives."""
    true, changes = true_robot(values, made.mismatch)
    simulation = build(SimulationParameters, changes)
    loop = ClosedLoop(build(PlatformParameters, values), simulation)
    loop.drives = SimulatedDrives(build(Robot, true), simulation)
    loop.drives.set_pose(made.start)
    loop.controller.set_pose(made.start)
    return loop


def _overrides(robot: str, made: RandomScene) -> list[Parameter]:
    given: dict[str, Any] = {"use_sim_time": True, "robot": robot}
    if made.workspace is not None:
        names = ("x_min", "y_min", "x_max", "y_max")
        given |= {f"workspace.{n}": v for n, v in zip(names, made.workspace, strict=True)}
    return [Parameter(name, value=value) for name, value in given.items()]


def _goal(pose: tuple[float, float, float]) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "odom"
    message.pose.position.x, message.pose.position.y = pose[:2]
    message.pose.orientation = quaternion_from_yaw(pose[2])
    return message


def _stamp(now: float) -> Any:
    return Time(nanoseconds=round((EPOCH + now) * 1e9)).to_msg()


def drive_scene(request: Request, seed: int) -> Outcome:
    """Drive through the scene of a seed, and judge the drive."""
    values = load_robot(request.robot)
    made = scene(seed, box_of(values))
    loop = NodeLoop(request.robot, made, request.seed, request.solve_time)
    try:
        drive = loop.run()
    finally:
        loop.close()
    reaction = MARKER_PERIOD[1] + MARKER_DELAY[1]
    return judged(made, drive, mover_of(values), agility_of(values, reaction))


def driver(request: Request) -> Callable[[int], Outcome]:
    """Return a function that drives the scene of a seed, and that other processes can unpickle."""
    return partial(drive_scene, request)
