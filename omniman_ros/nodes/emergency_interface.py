"""The topic `emergency_stop`, which several publishers may press."""

from collections.abc import Callable

from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool

from omniman_ros.core.emergency_buttons import EmergencyButtons
from omniman_ros.core.unheard_publishers import UnheardPublishers
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.rclpy_compat import MessageOrigin, subscribe_with_origin

TOPIC = "emergency_stop"  #: Name of the topic
#: Topic on which nodes that move nothing tell those that do of a press, with its reason
RELAY = "emergency_relay"
#: Reason of a stop for a press that may have been lost
MISSED = "emergency_stop: a publisher came and went, and its message did not arrive"


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
            subscribe_with_origin(node, Bool, TOPIC, self._on_message, qos, events)
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
        return self._buttons.is_pressed(self._node.count_publishers(TOPIC))

    def _report(self) -> None:
        self._state = self._is_pressed()
        self._on_state(self._state)
