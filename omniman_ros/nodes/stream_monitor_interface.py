"""Topics from which a stream monitor is updated."""

import math
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String

from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.rclpy_compat import subscribe_with_source_time
from omniman_ros.nodes.stop_interface import (
    ALL_LATCHED,
    EMERGENCY_STOP,
    LATCHED,
    MISSED,
    RELAY,
    STOP_STATE,
    EmergencyInterface,
    publisher_nodes,
)

REPETITION = 5.0  #: Longest time after a report in which an older one may be delivered again [s]


class StreamMonitorInterface:
    """Updates a stream monitor from `active_source`, `stop_state` and `emergency_stop`.

    What it hears of `emergency_stop` it relays to the nodes that move something: a publisher that
    ends after one message may have reached this node alone.
    """

    def __init__(
        self, node: OmnimanNode, monitor: StreamMonitor, on_update: Callable[[], None]
    ) -> None:
        self._node = node
        self._monitor = monitor
        self._on_update = on_update
        self._source_sent, self._source_received = 0, -math.inf
        subscribe_with_source_time(node, String, "active_source", self._on_source, LATCHED)
        node.create_subscription(DiagnosticStatus, STOP_STATE, self._on_stop_state, ALL_LATCHED)
        self._is_pressed = False
        self._relay = node.create_publisher(String, RELAY, 10)
        EmergencyInterface(node, self._on_emergency, lambda: self._tell(MISSED))
        node.every(1.0, self._forget_vanished)

    def _on_source(self, message: String, source_time: int) -> None:
        """Take the active source, unless it is an old report.

        On a busy machine, the middleware was seen to deliver a latched message a second time,
        after newer ones.
        """
        now = self._node.now()
        if source_time < self._source_sent and 0.0 <= now - self._source_received <= REPETITION:
            return
        self._source_sent, self._source_received = source_time, now
        self._monitor.update_source(message.data)
        self._on_update()

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        stopped = message.level == DiagnosticStatus.ERROR
        self._monitor.update_stop_state(message.name, stopped, message.message)
        self._on_update()

    def _on_emergency(self, pressed: bool) -> None:
        if pressed and not self._is_pressed:
            self._tell(EMERGENCY_STOP)
        self._is_pressed = pressed
        self._monitor.update_emergency(pressed)
        self._on_update()

    def _tell(self, reason: str) -> None:
        self._relay.publish(String(data=reason))

    def _forget_vanished(self) -> None:
        """Forget stopped nodes that vanished: their peers latch the stop, and can be reset."""
        if self._monitor.stopped_nodes:
            present = publisher_nodes(self._node, STOP_STATE)
            for name in set(self._monitor.stopped_nodes) - present:
                self._monitor.update_stop_state(name, False, "")
