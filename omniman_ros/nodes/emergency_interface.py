"""The topic `emergency_stop`, which several publishers may press."""

from collections.abc import Callable

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool

from omniman_ros.core.emergency_buttons import EmergencyButtons
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.rclpy_compat import MessageOrigin, subscribe_with_origin

TOPIC = "emergency_stop"
"""Name of the topic."""


class EmergencyInterface:
    """Subscribes to `emergency_stop`, and tells whether one of its publishers says true.

    Args:
        node: Node that subscribes.
        on_state: Called with that after each message, and when a publisher has gone.
    """

    def __init__(self, node: OmnimanNode, on_state: Callable[[bool], None]) -> None:
        self._node, self._on_state = node, on_state
        self._buttons = EmergencyButtons()
        self._state = False
        # A transient-local subscription alone does not match volatile publishers, of which it is
        # not to warn, and a volatile one alone does not get what was published before.
        silent = SubscriptionEventCallbacks(incompatible_qos=lambda event: None)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for qos, events in ((latched, silent), (QoSProfile(depth=10), None)):
            subscribe_with_origin(node, Bool, TOPIC, self._on_message, qos, events)
        node.every(1.0, self.check)

    def _on_message(self, message: Bool, origin: MessageOrigin) -> None:
        self._buttons.update(message.data, origin.number, origin.sent)
        self._report()

    def check(self) -> None:
        """Report a state that has changed because a publisher has gone."""
        if self._state and not self._is_pressed():
            self._report()

    def _is_pressed(self) -> bool:
        return self._buttons.is_pressed(self._node.count_publishers(TOPIC))

    def _report(self) -> None:
        self._state = self._is_pressed()
        self._on_state(self._state)
