"""The ROS interface of a stop latch: services, topics and peers."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from omniman_ros.core.emergency_buttons import EmergencyButtons
from omniman_ros.core.stop import ResetRefusedError, StopLatch, StopState, StopStatus
from omniman_ros.core.unheard_publishers import UnheardPublishers
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.rclpy_compat import MessageOrigin, subscribe_with_origin

EMERGENCY_STOP = "emergency_stop"  #: Topic on which buttons stop everything
#: Topic on which nodes that move nothing tell those that do of a press, with its reason
RELAY = "emergency_relay"
#: Reason of a stop for a press that may have been lost
MISSED = "emergency_stop: a publisher came and went, and its message did not arrive"
#: Topic on which each node that moves something publishes its stop state
STOP_STATE = "stop_state"
ENDING = "ending"  #: Key of the value that says that a node is stopped because it ends in order
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)  #: Quality of service of a topic whose last message reaches late subscribers
ALL_LATCHED = QoSProfile(
    depth=50, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)  #: Quality of service of a subscription to the last messages of many latched publishers
_LEVELS = {
    StopState.RUNNING: DiagnosticStatus.OK,
    StopState.HOLDING: DiagnosticStatus.WARN,
    StopState.STOPPED: DiagnosticStatus.ERROR,
}


class EmergencyInterface:
    """Subscribes to `emergency_stop`, and tells whether one of its publishers says true.

    Args:
        on_missed: Called when a publisher came and went whose message did not arrive.
    """

    def __init__(
        self,
        node: OmnimanNode,
        on_state: Callable[[bool], None],
        on_missed: Callable[[], None],
    ) -> None:
        self._node, self._on_state, self._on_missed = node, on_state, on_missed
        self._buttons = EmergencyButtons()
        self._unheard = UnheardPublishers()
        self._state = False
        # A transient-local subscription alone does not match volatile publishers, of which it is
        # not to warn, and a volatile one alone does not get what was published before.
        silent = SubscriptionEventCallbacks(incompatible_qos=lambda event: None)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        matched = SubscriptionEventCallbacks(matched=self._on_matched)  # with any publisher
        for qos, events in ((latched, silent), (QoSProfile(depth=10), matched)):
            subscribe_with_origin(node, Bool, EMERGENCY_STOP, self._on_message, qos, events)
        node.every(1.0, self.check)
        node.every(0.05, self._check_missed)

    def _on_message(self, message: Bool, origin: MessageOrigin) -> None:
        if self._buttons.update(message.data, origin.number, origin.sent):
            self._unheard.hear(self._node.now())
        self._report()

    def _on_matched(self, change: QoSSubscriptionMatchedInfo) -> None:
        now, came = self._node.now(), change.total_count_change
        for _ in range(came):
            self._unheard.appear(now)
        for _ in range(came - change.current_count_change):
            self._unheard.vanish(now, change.current_count)

    def _check_missed(self) -> None:
        if self._unheard.missed(self._node.now()):
            self._on_missed()

    def check(self) -> None:
        """Report a state that has changed because a publisher has gone."""
        if self._state and not self._is_pressed():
            self._report()

    def _is_pressed(self) -> bool:
        return self._buttons.is_pressed(self._node.count_publishers(EMERGENCY_STOP))

    def _report(self) -> None:
        self._state = self._is_pressed()
        self._on_state(self._state)


def publisher_nodes(node: Node, topic: str) -> set[str]:
    """Return the full names of the nodes that publish a topic, as `node` sees the graph now."""
    return {
        f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        for info in node.get_publishers_info_by_topic(topic)
    }


class StopInterface:
    """Connects a stop latch to `~/stop`, `~/reset`, `emergency_stop`, its relay and `stop_state`.

    Args:
        on_stop: Called when the latch no longer allows motion; may be called again.
    """

    def __init__(
        self,
        node: OmnimanNode,
        latch: StopLatch,
        reset: Callable[[], None],
        on_stop: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._latch = latch
        self._reset = reset
        self._on_stop = on_stop
        self._name = node.get_fully_qualified_name()
        self._published: StopStatus | None = None
        node.create_service(Trigger, "~/stop", self._on_stop_service)
        node.create_service(Trigger, "~/reset", self._on_reset_service)
        self._emergency = EmergencyInterface(
            node, self._on_emergency, lambda: self._latch_press(MISSED)
        )
        node.create_subscription(String, RELAY, self._on_relay, 10)
        node.create_subscription(DiagnosticStatus, STOP_STATE, self._on_peer, ALL_LATCHED)
        self._publisher = node.create_publisher(DiagnosticStatus, STOP_STATE, LATCHED)
        node.every(1.0, self._check_peers)
        self.publish()

    def publish(self, news: str = "motion is possible again") -> None:
        """Publish and log the stop state if it has changed; call this once a tick."""
        status = self._latch.status
        if status == self._published:
            return
        previous, self._published = self._published, status
        text = f"{status.state.value}: {status.reason}" if status.reason else status.state.value
        values: list[tuple[str, object]] = [
            ("state", status.state.value),
            ("reason", status.reason),
            (ENDING, status.is_ending),
        ]
        self._publisher.publish(self._node.status_message(_LEVELS[status.state], text, values))
        log = self._node.get_logger()
        if status.state is not StopState.RUNNING:
            log.warning(text)
            self._on_stop()
        elif previous is not None:
            log.info(f"released: {news}")
        self._node.report_changes()

    def _on_stop_service(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._latch.stop("~/stop")
        self.publish()
        response.success = True
        response.message = self._latch.status.reason
        return response

    def _on_reset_service(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._emergency.check()
        try:
            self._reset()
        except ResetRefusedError as error:
            response.success = False
            response.message = str(error)
        else:
            response.success = True
            response.message = self._latch.status.state.value
        self.publish()
        return response

    def _on_emergency(self, pressed: bool) -> None:
        self._latch.set_emergency(pressed)
        self.publish()

    def _on_relay(self, message: String) -> None:
        self._latch_press(message.data or EMERGENCY_STOP)

    def _latch_press(self, reason: str) -> None:
        """Latch a stop for a press that another node has heard, or that may have been lost."""
        self._latch.stop(reason)
        self.publish()

    def _on_peer(self, message: DiagnosticStatus) -> None:
        if message.name != self._name:
            stopped = message.level == DiagnosticStatus.ERROR
            is_ending = any(v.key == ENDING and v.value == str(True) for v in message.values)
            self._latch.set_peer(message.name, stopped, message.message, is_ending)
            self.publish()

    def _check_peers(self) -> None:
        if not self._latch.peers:
            return
        present = publisher_nodes(self._node, STOP_STATE)
        for name in self._latch.peers:
            if name not in present:
                self._latch.lose_peer(name)
        self.publish("the peers that held it have ended")
