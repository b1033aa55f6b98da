"""The ROS side of a client: topics and services of one robot, on a node that somebody spins."""

import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros.client import messages
from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.state import (
    BodyTwist,
    NodeAnswer,
    PlanarPose,
    Reading,
    RobotError,
    RobotTimeoutError,
)
from omniman_ros.console.session import ANNOUNCEMENT_TIME, DISCOVERY_TIMEOUT, Session
from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.core.errors import InputError
from omniman_ros.core.framing import CmdVelFraming
from omniman_ros.core.planar import Triple
from omniman_ros.nodes.stop_interface import ALL_LATCHED, STOP_STATE
from omniman_ros.nodes.stoppable_nodes import TriggerCalls

PERIOD = 0.05  #: Period of `cmd_vel` and of the link's other work [s]
OBSTACLE_TICKS = 2  #: Number of periods between two messages on `obstacles`
WATCH_TICKS = 20  #: Number of periods between two looks at the nodes that drive motions
RECEIPT_TIMEOUT = 5.0  #: Time within which a node must report that it has received a motion [s]
ANSWER_TIMEOUT = 5.0  #: Time within which a node must answer a stop or a reset [s]
BRAKE_TIMEOUT = 3.0  #: Time within which nodes must confirm that motions are cancelled [s]
REST_TIMEOUT = 5.0  #: Time for which the end of a client waits until the robot stands [s]
REST_SPEED = 0.01  #: Speed below which a platform stands [m/s]
REST_RATE = 0.02  #: Rate below which a platform and an arm's joint stand [rad/s]
SPIN_TIME = 0.05  #: Time for which callbacks are served before the end is looked for again [s]
POLL_PERIOD = 0.05  #: Longest time between two looks at a condition that is waited for [s]

MOTION_EVENTS = "motion_events"  #: Topic on which nodes report what becomes of motions
CONTROLLER = "platform_controller"  #: Node that takes `cmd_vel`


@dataclass(frozen=True)
class MotionInput:
    """Where motions of one kind are sent to."""

    topic: str
    message: type
    nodes: tuple[str, ...]  #: Names of the nodes of which one takes them
    measured: str = ""  #: Topic that must have been heard before


INPUTS = {
    "goal": MotionInput("goal_pose", PoseStamped, ("mpc_planner",)),
    "path": MotionInput("path", Path, ("path_interpolator",)),
    "arm": MotionInput(
        "joint_trajectory", JointTrajectory, ("path_interpolator",), "arm/joint_states"
    ),
    "tool": MotionInput(
        "tool_path", Path, ("path_interpolator", "whole_body_planner"), "tool_pose"
    ),
}  #: Inputs for motions, by their kind
DRIVE = "drive"  #: What a robot can do besides: be driven by twists
ABILITIES = (DRIVE, *INPUTS)  #: All that can be waited for


class RobotLink:
    """Hears and moves one robot.

    Its timer and subscriptions are served by whoever spins the node; all else may be called from
    any thread. On a node with `use_sim_time` its durations are those of simulated time.

    Args:
        prefix: Absolute namespace of the robot, without a slash at its end.
        serve: Spins the node for a time [s], in the thread that waits for something; None if
            another thread spins it.
    """

    def __init__(
        self, node: Node, prefix: str, serve: Callable[[float], object] | None = None
    ) -> None:
        self._node, self._prefix, self._serve = node, prefix, serve
        self._changed = threading.Condition(threading.RLock())
        self._is_simulated = bool(node.get_parameter("use_sim_time").value)
        self._opened = self.now()
        self.failure: BaseException | None = None
        self._heard: dict[str, tuple[float, Any]] = {}
        self._stop_states: dict[str, str] = {}
        self._stamp = 0  # of the newest message that was sent [ns]
        self._handles: dict[str, MotionHandle] = {}
        self._sent_at: dict[str, float] = {}
        self._drivers: dict[str, set[bytes]] = {}
        self._target: Triple | None = None
        self._framing, self._is_streaming = CmdVelFraming(), False
        self._twists: tuple[Publisher, bool] | None = None
        self._obstacles: dict[str, tuple[float, messages.RoundObstacle]] = {}
        self._removed: list[str] = []
        self._markers: Publisher | None = None
        self._calls: list[TriggerCalls] = []
        self._ticks = 0
        self._publishers = {
            kind: node.create_publisher(to.message, self._name(to.topic), 10)
            for kind, to in INPUTS.items()
        }
        self._cancels = {
            name: node.create_client(Trigger, self._name(f"{name}/cancel"))
            for name in sorted({name for to in INPUTS.values() for name in to.nodes})
        }
        self._subscriptions = [
            node.create_subscription(kind, self._name(topic), self._guarded(handler), qos)
            for kind, topic, handler, qos in (
                (Odometry, "odom", self._on_odom, 10),
                (JointState, "arm/joint_states", self._on_arm, 10),
                (PoseStamped, "tool_pose", self._on_tool, 10),
                (String, "active_source", self._on_source, ALL_LATCHED),
                (DiagnosticStatus, STOP_STATE, self._on_stop_state, ALL_LATCHED),
                (DiagnosticStatus, MOTION_EVENTS, self._on_event, ALL_LATCHED),
                (DiagnosticStatus, "mpc/status", self._on_planner, 10),
                (Float64, "path_progress", self._on_progress, 10),
            )
        ]
        clock = node.get_clock() if self._is_simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._tick, clock=clock)

    def _name(self, topic: str) -> str:
        return f"{self._prefix}/{topic}"

    # ---- time -----------------------------------------------------------------------------------

    def now(self) -> float:
        """Return the time from any origin [s]: steady, or that of the node if it is simulated."""
        if self._is_simulated:
            return float(self._node.get_clock().now().nanoseconds * 1e-9)
        return time.monotonic()

    def wait(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        """Wait until a condition holds, up to a time [s] or for ever; return whether it does.

        Raises:
            RobotError: The thread that serves the link has ended.
        """
        now = time.monotonic if self._serve is None else self.now
        end = math.inf if timeout is None else now() + timeout
        while True:
            with self._changed:
                if condition():
                    return True
                if self.failure is not None:
                    raise RobotError(f"the connection failed: {self.failure}") from self.failure
                remaining = min(end - now(), POLL_PERIOD)
                if remaining <= 0.0:
                    return False
                if self._serve is None:
                    self._changed.wait(remaining)
            if self._serve is not None:
                self._serve(remaining)

    def fail(self, error: BaseException) -> None:
        """Make all that wait fail: nobody spins the node any more."""
        with self._changed:
            self.failure = error
            self._changed.notify_all()

    def _next_stamp(self) -> Any:
        """Return a stamp that no other message has had: the robot's time, or one just after it.

        It is that of the latest `odom`. So it is right for robots on simulated time, too, and on
        another machine.
        """
        _, newest = self._heard.get("stamp", (0.0, 0))
        now = newest or self._node.get_clock().now().nanoseconds
        self._stamp = max(now, self._stamp + 1)
        return Time(nanoseconds=self._stamp).to_msg()

    # ---- what is heard --------------------------------------------------------------------------

    def _guarded(self, handler: Callable[[Any], None]) -> Callable[[Any], None]:
        def handle(message: Any) -> None:
            with self._changed:
                try:
                    handler(message)
                except InputError as error:  # a message of nonsense is as none
                    self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
                self._changed.notify_all()

        return handle

    def _hear(self, name: str, value: Any) -> None:
        self._heard[name] = (self.now(), value)

    def reading(self, name: str) -> Reading[Any]:
        """Return the latest value of a topic, and its age."""
        if name not in self._heard:
            return Reading(name)
        at, value = self._heard[name]
        return Reading(name, max(self.now() - at, 0.0), value)

    def _on_odom(self, message: Odometry) -> None:
        position = message.pose.pose.position
        heading = yaw_from_quaternion(message.pose.pose.orientation)
        twist = twist_array(message.twist.twist).tolist()
        self._hear("odom", (PlanarPose(position.x, position.y, heading), BodyTwist(*twist)))
        self._hear("stamp", Time.from_msg(message.header.stamp).nanoseconds)

    def _on_arm(self, message: JointState) -> None:
        names = list(message.name)
        positions = dict(zip(names, message.position, strict=False))
        self._hear("arm/joint_states", (positions, list(message.velocity)))

    def _on_tool(self, message: PoseStamped) -> None:
        position = message.pose.position
        self._hear("tool_pose", (position.x, position.y, position.z))

    def _on_source(self, message: String) -> None:
        self._hear("active_source", message.data)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        is_stopped = message.level == DiagnosticStatus.ERROR
        self._stop_states[message.name] = message.message if is_stopped else ""
        stopped = [
            f"{name.rpartition('/')[2]} {reason}"
            for name, reason in sorted(self._stop_states.items())
            if reason
        ]
        self._hear(STOP_STATE, "; ".join(stopped))

    # ---- motions --------------------------------------------------------------------------------

    def missing(self, abilities: Sequence[str]) -> list[str]:
        """Return what is not there yet of what some abilities need."""
        faults = []
        with self._changed:
            if "odom" not in self._heard or "active_source" not in self._heard:
                faults.append(f"{CONTROLLER} with odom")
            elif DRIVE in abilities and not self.can_drive:
                faults.append("subscriber of cmd_vel")
            for kind in INPUTS:
                if kind not in abilities:
                    continue
                to = INPUTS[kind]
                is_there = self._publishers[kind].get_subscription_count() and any(
                    self._cancels[name].service_is_ready() for name in to.nodes
                )
                if not is_there or (to.measured and to.measured not in self._heard):
                    what = f" with {to.measured}" if to.measured else ""
                    faults.append(" or ".join(to.nodes) + what)
        return faults

    def require(self, abilities: Sequence[str], timeout: float = DISCOVERY_TIMEOUT) -> None:
        """Wait until a robot is there that has some abilities.

        Raises:
            RobotTimeoutError: It is not within `timeout` [s]; the message says what is missing.
        """
        if not self.wait(lambda: not self.missing(abilities), timeout):
            raise RobotTimeoutError(
                f"no {', no '.join(self.missing(abilities))} was found within {timeout:g} s: "
                "start `omniman up`, or set ROS_DOMAIN_ID to the robot's"
            )

    def send(self, kind: str, name: str, message: Any) -> MotionHandle:
        """Send a motion to the node that takes it, once that is there, and return its handle."""
        self.require((kind,))
        handle = MotionHandle(kind, name, self)
        with self._changed:
            stamp = message.header.stamp = self._next_stamp()
            request = f"{stamp.sec}.{stamp.nanosec:09d}"
            self._handles[request], self._sent_at[request] = handle, self.now()
            self._publishers[kind].publish(message)
        return handle

    def request_cancel(self, handle: MotionHandle) -> None:
        """Ask the node that drives a motion to cancel it, without waiting."""
        nodes = INPUTS[handle.kind].nodes
        if handle.node:
            nodes = (handle.node.rpartition("/")[2],)
        for name in nodes:
            client = self._cancels[name]
            if len(nodes) > 1 and not client.service_is_ready():
                continue
            future = client.call_async(Trigger.Request())
            future.add_done_callback(lambda done: self._take_answer(handle, done.result()))

    def _take_answer(self, handle: MotionHandle, answer: Any) -> None:
        with self._changed:
            handle.answer_cancel(answer.success, answer.message)
            self._changed.notify_all()

    @property
    def running(self) -> list[MotionHandle]:
        """The motions of this client that have not ended."""
        with self._changed:
            return [handle for handle in self._handles.values() if handle.outcome is None]

    def _on_event(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        handle = self._handles.get(values.get("request", ""))
        if handle is None or handle.outcome is not None:
            return
        if not handle.node:
            self._drivers[message.name] = self._reporters(message.name)
        handle.report(message.name, values.get("event", ""), message.message)

    def _on_planner(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        for handle in self.running:
            if handle.kind == "goal":
                handle.approach(float(values.get("distance_m", "nan")))

    def _on_progress(self, message: Float64) -> None:
        for handle in self.running:
            if handle.kind != "goal":
                handle.advance(message.data)

    def _reporters(self, node: str) -> set[bytes]:
        """Return the identifiers of a node's publishers of events in the graph."""
        return {
            bytes(info.endpoint_gid)
            for info in self._node.get_publishers_info_by_topic(self._name(MOTION_EVENTS))
            if f"{info.node_namespace.rstrip('/')}/{info.node_name}" == node
        }

    def _watch(self) -> None:
        """End the motions of which nobody will report the end; forget those that have ended."""
        now = self.now()
        for request, handle in list(self._handles.items()):
            if handle.outcome is not None:
                del self._handles[request], self._sent_at[request]
            elif not handle.node:
                if now - self._sent_at[request] > RECEIPT_TIMEOUT:
                    self.request_cancel(handle)  # somebody may have received it nevertheless
                    handle.lose(f"no node has reported it within {RECEIPT_TIMEOUT:g} s")
            elif not self._drivers[handle.node] & self._reporters(handle.node):
                handle.lose(f"{handle.node} has ended")

    # ---- twists ---------------------------------------------------------------------------------

    def drive(self, twist: Triple | None) -> None:
        """Stream a twist [m/s, m/s, rad/s] from now on; None: some zeros, then nothing."""
        with self._changed:
            self._target = twist

    @property
    def can_drive(self) -> bool:
        """Whether anybody takes twists."""
        return self._twists is not None and self._twists[0].get_subscription_count() > 0

    def _find_controller(self) -> None:
        """Make the publisher of `cmd_vel`, of the type that the controller subscribes to."""
        topic = self._name("cmd_vel")
        listeners = self._node.get_subscriptions_info_by_topic(topic)
        listeners.sort(key=lambda info: info.node_name != CONTROLLER)
        if listeners:
            is_stamped = listeners[0].topic_type.endswith("/TwistStamped")
            kind = TwistStamped if is_stamped else Twist
            self._twists = self._node.create_publisher(kind, topic, 1), is_stamped

    def _stream(self) -> None:
        twist = self._framing.next(self._target)
        self._is_streaming = twist is not None
        if twist is not None:
            self._publish_twist(twist)

    def _publish_twist(self, twist: Triple) -> None:
        if self._twists is not None:
            publisher, is_stamped = self._twists
            publisher.publish(messages.twist(twist, self._next_stamp() if is_stamped else None))

    # ---- obstacles ------------------------------------------------------------------------------

    def place(self, obstacle: messages.RoundObstacle) -> None:
        """Show an obstacle to the robot from now on, in place of one of the same name."""
        with self._changed:
            self._obstacles[obstacle.name] = (self.now(), obstacle)

    def remove(self, name: str) -> None:
        """Remove an obstacle that was placed; RobotError if there is none of that name."""
        with self._changed:
            if self._obstacles.pop(name, None) is None:
                raise RobotError(f"there is no obstacle '{name}'")
            self._removed.append(name)

    def _show_obstacles(self) -> None:
        """Publish where the obstacles are. Who has begun to do so is expected to go on."""
        if self._markers is None:
            if not self._obstacles:
                return
            self._markers = self._node.create_publisher(MarkerArray, self._name("obstacles"), 50)
        now, stamp = self.now(), self._next_stamp()
        markers = [messages.removal(name) for name in self._removed]
        markers += [item.marker(now - at, stamp) for at, item in self._obstacles.values()]
        self._markers.publish(MarkerArray(markers=markers))
        self._removed.clear()

    # ---- stops ----------------------------------------------------------------------------------

    def call_all(
        self,
        action: str,
        timeout: float,
        report: Callable[[NodeAnswer], None],
    ) -> tuple[NodeAnswer, ...]:
        """Call `stop` or `reset` of all nodes of the robot that can be stopped.

        Args:
            timeout: Longest time until the first node is found [s].
            report: Called with each answer when it arrives, in another thread.

        Raises:
            RobotTimeoutError: No such node was found.
        """

        def take(name: str, success: bool, message: str) -> None:
            report(NodeAnswer(name, success, message))

        calls = TriggerCalls(self._node, action, self._prefix, take)
        with self._changed:
            self._target = None
            self._calls.append(calls)
        try:
            self._await_answers(calls, timeout)
        finally:
            with self._changed:
                self._calls.remove(calls)
                calls.close()
        late = f"no answer within {ANSWER_TIMEOUT:g} s"
        answers = [NodeAnswer(n, *(a or (False, late))) for n, a in calls.answers.items()]
        for answer in answers:
            if answer.message == late:
                report(answer)
        return tuple(sorted(answers))

    def _await_answers(self, calls: TriggerCalls, timeout: float) -> None:
        if not self.wait(lambda: bool(calls.answers), timeout):
            raise RobotTimeoutError(
                f"no node that can be stopped was found within {timeout:g} s; check that "
                "ROS_DOMAIN_ID is the robot's"
            )
        known_at = self._opened + ANNOUNCEMENT_TIME  # when all nodes are known that there are

        def is_complete() -> bool:
            return self.now() > known_at and None not in calls.answers.values()

        self.wait(is_complete, max(known_at - self.now(), 0.0) + ANSWER_TIMEOUT)

    # ---- the node's thread ----------------------------------------------------------------------

    def _tick(self) -> None:
        with self._changed:
            self._ticks += 1
            if self._twists is None:
                self._find_controller()
            self._stream()
            for calls in self._calls:
                calls.poll()
            if self._ticks % OBSTACLE_TICKS == 0:
                self._show_obstacles()
            if self._ticks % WATCH_TICKS == 0:
                self._watch()
            self._changed.notify_all()

    # ---- the end --------------------------------------------------------------------------------

    @property
    def stands(self) -> bool:
        """Whether platform and arm are at rest, as far as they are heard."""
        moving = False
        if "odom" in self._heard:
            vx, vy, wz = self._heard["odom"][1][1]
            moving = math.hypot(vx, vy) > REST_SPEED or abs(wz) > REST_RATE
        if "arm/joint_states" in self._heard:
            rates = self._heard["arm/joint_states"][1][1]
            moving = moving or any(abs(rate) > REST_RATE for rate in rates)
        return not moving

    def halt(self) -> bool:
        """End what this client moves, wait until the robot stands; return whether it does.

        Motions are cancelled. Where nobody confirms that, zero twists take the platform over.
        """
        running = self.running
        with self._changed:
            was_driving = self._target is not None or self._is_streaming
            self._target = None
        if not running and not was_driving:
            return True
        for handle in running:
            self.request_cancel(handle)
        if was_driving:
            self._publish_twist((0.0, 0.0, 0.0))
        if not self.wait(lambda: not self.running, BRAKE_TIMEOUT):
            self.drive((0.0, 0.0, 0.0))
        stands = self.wait(lambda: self.stands, REST_TIMEOUT)
        self.drive(None)
        self.wait(lambda: not self._is_streaming, 1.0)
        return stands

    def flush(self) -> None:
        """Remove the obstacles, and wait until all that is to be heard has been delivered."""
        with self._changed:
            self._removed += self._obstacles
            self._obstacles.clear()
            if self._removed:
                self._show_obstacles()
        for publisher in (self._markers, self._twists and self._twists[0]):
            if publisher is not None:
                publisher.wait_for_all_acked(Duration(seconds=1))

    def detach(self) -> None:
        """Take everything off the node."""
        node = self._node
        node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            node.destroy_subscription(subscription)
        for client in self._cancels.values():
            node.destroy_client(client)
        for publisher in (
            *self._publishers.values(),
            self._markers,
            self._twists and self._twists[0],
        ):
            if publisher is not None:
                node.destroy_publisher(publisher)


class LinkThread:
    """A link on a node of its own, which a thread of its own spins.

    Args:
        domain: ROS domain; None for that of the environment.
    """

    def __init__(self, namespace: str, domain: int | None) -> None:
        prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        # Taking an events executor down can deadlock; see `nodes.rclpy_compat`.
        self._session = Session(f"client_{os.getpid()}", prefix, events=False, domain=domain)
        self._session.__enter__()
        self.link = RobotLink(self._session.node, prefix)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="omniman_client", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            while not self._ending.is_set():
                self._session.spin(SPIN_TIME)
        except BaseException as error:
            self.link.fail(error)

    def close(self) -> None:
        """End what the link moves, and the thread; idempotent."""
        if self._ending.is_set():
            return
        try:
            if threading.current_thread() is not self._thread:
                self.link.halt()
            self.link.flush()
        finally:
            self._ending.set()
            if threading.current_thread() is not self._thread:
                self._thread.join()
                self.link.fail(RobotError("it was closed"))
                self._session.__exit__(None, None, None)


class LinkOnNode:
    """A link on a node of the user's; see `Robot`."""

    def __init__(
        self, node: Node, namespace: str, serve: Callable[[float], object] | None
    ) -> None:
        prefix = (namespace or node.get_namespace()).strip("/")
        self.link = RobotLink(node, f"/{prefix}" if prefix else "", serve)

    def close(self) -> None:
        """End what the link moves, and take it off the node."""
        self.link.halt()
        self.link.flush()
        self.link.detach()
