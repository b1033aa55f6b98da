"""Topic `motion_events`: tells clients what becomes of the motions that they asked for."""

from itertools import count

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionInput,
    MotionLog,
    is_trouble,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import ALL_LATCHED

TOPIC = "motion_events"
_LOGGED = (MotionEvent.STARTED, MotionEvent.CANCELLED, MotionEvent.ARRIVED)


class MotionEvents:
    """Publishes `motion_events`, and numbers the motions of a node."""

    def __init__(self, node: OmnimanNode) -> None:
        self._node, self._numbers = node, count(1)
        self._publisher = node.create_publisher(DiagnosticStatus, TOPIC, ALL_LATCHED)
        node.final_publishers.append(self._publisher)

    def log(self, kind: MotionInput) -> MotionLog:
        """Return a log whose events are published."""
        return MotionLog(kind, self._numbers, self._tell)

    def _tell(self, motion: LoggedMotion, event: MotionEvent, reason: str, text: str) -> None:
        label = motion.kind.label
        if event is MotionEvent.GIVEN_UP:
            self._node.warn(f"{label} given up", text)
        elif event in _LOGGED:
            self._node.get_logger().info(f"{label}: {text}")
        level = DiagnosticStatus.WARN if is_trouble(event, reason) else DiagnosticStatus.OK
        values = [
            ("kind", motion.kind.key),
            ("event", event.value),
            ("motion", motion.number),
            ("request", motion.request),
        ]
        self._publisher.publish(self._node.status_message(level, reason, values))
