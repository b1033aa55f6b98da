"""The ROS side of a client: it hears and moves one robot."""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node

from omniman_ros.client import messages
from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.motions import INPUTS, SentMotions
from omniman_ros.client.shared_node import SharedNode
from omniman_ros.client.state import NodeAnswer, Reading, RobotTimeoutError
from omniman_ros.client.streams import CONTROLLER, ObstacleStream, TwistStream
from omniman_ros.client.telemetry import Telemetry
from omniman_ros.console.session import ANNOUNCEMENT_TIME, DISCOVERY_TIMEOUT
from omniman_ros.core.planar import Triple
from omniman_ros.nodes.stop_interface import STOP_STATE
from omniman_ros.nodes.stoppable_nodes import TriggerCalls

PERIOD = 0.05  #: Period of `cmd_vel` and of the link's other work [s]
OBSTACLE_TICKS = 2  #: Number of periods between two messages on `obstacles`
WATCH_TICKS = 20  #: Number of periods between two looks at the nodes that drive motions
ANSWER_TIMEOUT = 5.0  #: Time within which a node must answer a stop or a reset [s]
BRAKE_TIMEOUT = 3.0  #: Time within which nodes must confirm that motions are cancelled [s]
REST_TIMEOUT = 5.0  #: Time for which the end of a client waits until the robot stands [s]
ZEROS_TIMEOUT = 1.0  #: Time for which it waits until the last zero twists are out [s]

DRIVE = "drive"  #: What a robot can do besides motions: be driven by twists
ABILITIES = (DRIVE, *INPUTS)  #: All that can be waited for


class RobotLink:
    """Hears and moves one robot; see :class:`SharedNode` for the arguments.

    Its timer and subscriptions are served by whoever spins the node; all else may be called from
    any thread.
    """

    def __init__(
        self, node: Node, prefix: str, serve: Callable[[float], object] | None = None
    ) -> None:
        self.shared = SharedNode(node, prefix, serve)
        self.wait, self._lock = self.shared.wait, self.shared.lock
        self._opened = self.shared.now()
        self._calls: list[TriggerCalls] = []
        self._ticks = 0
        self._telemetry = Telemetry(self.shared)
        self._motions = SentMotions(self.shared)
        self._twists = TwistStream(self.shared, self._telemetry)
        self._obstacles = ObstacleStream(self.shared, self._telemetry)
        self.shared.every(PERIOD, self._tick)

    def _tick(self) -> None:
        with self._lock:
            self._ticks += 1
            self._twists.tick()
            for calls in self._calls:
                calls.poll()
            if self._ticks % OBSTACLE_TICKS == 0:
                self._obstacles.tick()
            if self._ticks % WATCH_TICKS == 0:
                self._motions.watch()
            self._lock.notify_all()

    # ---- what is there --------------------------------------------------------------------------

    @property
    def domain(self) -> int:
        """ROS domain of the node."""
        return int(self.shared.node.context.get_domain_id())

    def reading(self, name: str) -> Reading[Any]:
        """Return the latest value of a topic, and its age; `twist` is that of `odom`."""
        with self._lock:
            return self._telemetry.reading(name)

    @property
    def can_drive(self) -> bool:
        """Whether anybody takes twists."""
        return self._twists.is_heard

    def missing(self, abilities: Sequence[str]) -> list[str]:
        """Return what is not there yet of what some abilities need."""
        faults = []
        with self._lock:
            if not self._telemetry.knows("odom", "active_source", STOP_STATE):
                faults.append(f"{CONTROLLER} with odom")
            elif DRIVE in abilities and not self.can_drive:
                faults.append("subscriber of cmd_vel")
            for kind, to in INPUTS.items():
                is_known = not to.measured or self._telemetry.knows(to.measured)
                if kind in abilities and not (is_known and self._motions.can_send(kind)):
                    measured = f" with {to.measured}" if to.measured else ""
                    faults.append(" or ".join(to.nodes) + to.hint + measured)
        return faults

    def require(self, abilities: Sequence[str], timeout: float = DISCOVERY_TIMEOUT) -> None:
        """Wait until a robot is there that has some abilities.

        Raises:
            RobotTimeoutError: It is not within `timeout` [s]; the message says what is missing.
        """
        if not self.wait(lambda: not self.missing(abilities), timeout):
            is_alone = not self._telemetry.knows("odom")
            raise RobotTimeoutError(
                f"no {', no '.join(self.missing(abilities))} was found within {timeout:g} s"
                + (": start `omniman up`, or set ROS_DOMAIN_ID to the robot's" if is_alone else "")
            )

    # ---- what moves -----------------------------------------------------------------------------

    def drive(self, twist: Triple | None) -> None:
        """Stream a twist [m/s, m/s, rad/s] from now on; None: some zeros, then nothing.

        A new twist of a stream that has begun does not wait for the next period.
        """
        with self._lock:
            is_new, self._twists.target = twist != self._twists.target, twist
            if twist is not None and is_new and self._twists.is_streaming:
                self._twists.publish(twist)

    def send(self, kind: str, name: str, message: Any) -> MotionHandle:
        """Send a motion to the node that takes it, once that is there, and return its handle."""
        self.require((kind,))
        handle = MotionHandle(kind, name, self)
        with self._lock:
            message.header.stamp = self._telemetry.next_stamp()
            self._motions.send(handle, message)
        return handle

    def request_cancel(self, handle: MotionHandle) -> None:
        """Ask the node that drives a motion to cancel it, without waiting."""
        self._motions.request_cancel(handle)

    def place(self, obstacle: messages.RoundObstacle) -> None:
        """Show an obstacle to the robot from now on, in place of one of the same name."""
        with self._lock:
            self._obstacles.place(obstacle)

    def remove(self, name: str) -> None:
        """Remove an obstacle that was placed; RobotError if there is none of that name."""
        with self._lock:
            self._obstacles.remove(name)

    # ---- what stops -----------------------------------------------------------------------------

    def call_all(
        self, action: str, timeout: float, report: Callable[[NodeAnswer], None]
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

        calls = TriggerCalls(self.shared.node, action, self.shared.prefix, take)
        with self._lock:
            self._twists.target = None
            self._calls.append(calls)
        try:
            self._await_answers(calls, timeout)
        finally:
            with self._lock:
                self._calls.remove(calls)
                calls.close()
        answers = []
        for name, answer in sorted(calls.answers.items()):
            if answer is None:
                answer = (False, f"no answer within {ANSWER_TIMEOUT:g} s")
                take(name, *answer)
            answers.append(NodeAnswer(name, *answer))
        return tuple(answers)

    def _await_answers(self, calls: TriggerCalls, timeout: float) -> None:
        if not self.wait(lambda: bool(calls.answers), timeout):
            raise RobotTimeoutError(
                f"no node that can be stopped was found within {timeout:g} s; check that "
                "ROS_DOMAIN_ID is the robot's"
            )
        # On a busy machine nodes are discovered one after the other: each may be the last but one.
        now, known_at = self.shared.now, self._opened + ANNOUNCEMENT_TIME
        found = 0
        while len(calls.answers) > found:
            if found:
                known_at = now() + ANNOUNCEMENT_TIME
            found = len(calls.answers)

            def is_settled(found: int = found, known_at: float = known_at) -> bool:
                is_complete = now() > known_at and None not in calls.answers.values()
                return is_complete or len(calls.answers) > found

            self.wait(is_settled, max(known_at - now(), 0.0) + ANSWER_TIMEOUT)

    def halt(self) -> None:
        """End what this client moves, and wait until the robot stands, up to some seconds.

        Motions are cancelled. Where nobody confirms that, zero twists take the platform over.
        """
        with self._lock:
            running = self._motions.running
            was_driving = self._twists.target is not None or self._twists.is_streaming
            self._twists.target = None
        if not running and not was_driving:
            return
        for handle in running:
            self.request_cancel(handle)
        if was_driving:
            self._twists.publish((0.0, 0.0, 0.0))
        if not self.wait(lambda: not self._motions.running, BRAKE_TIMEOUT):
            self.drive((0.0, 0.0, 0.0))
        self.wait(lambda: self._telemetry.stands, REST_TIMEOUT)
        self.drive(None)
        self.wait(lambda: not self._twists.is_streaming, ZEROS_TIMEOUT)

    def flush(self) -> None:
        """Remove the obstacles, and wait until all that is to be heard has been delivered."""
        with self._lock:
            self._obstacles.clear()
            self._obstacles.tick()
        for publisher in (self._obstacles.publisher, self._twists.publisher):
            if publisher is not None:
                publisher.wait_for_all_acked(Duration(seconds=1))
