"""Topics from which a stream monitor is updated."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, String

from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED, STOP_STATE, publisher_nodes


class StreamMonitorInterface:
    """Updates a stream monitor from `active_source`, `stop_state` and `emergency_stop`.

    Args:
        node: Node that sends references.
        monitor: Monitor to update.
        on_update: Called after each message, to give up a stream that is no longer followed.
    """

    def __init__(
        self, node: OmnimanNode, monitor: StreamMonitor, on_update: Callable[[], None]
    ) -> None:
        self._node = node
        self._monitor = monitor
        self._on_update = on_update
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(DiagnosticStatus, STOP_STATE, self._on_stop_state, ALL_LATCHED)
        # A transient-local subscription alone does not match volatile publishers.
        for qos in (LATCHED, QoSProfile(depth=10)):
            node.create_subscription(Bool, "emergency_stop", self._on_emergency, qos)
        node.every(1.0, self._forget_vanished)

    def _on_source(self, message: String) -> None:
        self._monitor.update_source(message.data)
        self._on_update()

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        stopped = message.level == DiagnosticStatus.ERROR
        self._monitor.update_stop_state(message.name, stopped, message.message)
        self._on_update()

    def _on_emergency(self, message: Bool) -> None:
        self._monitor.update_emergency(message.data)
        self._on_update()

    def _forget_vanished(self) -> None:
        """Forget stopped nodes that vanished: their peers latch the stop, and can be reset."""
        if self._monitor.stopped_nodes:
            present = publisher_nodes(self._node, STOP_STATE)
            for name in set(self._monitor.stopped_nodes) - present:
                self._monitor.update_stop_state(name, False, "")
