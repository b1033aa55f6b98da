"""What a node that sends references hears of who drives: topics in, a `ControlWatch` told."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from std_msgs.msg import Bool, String

from omniman_ros.core.control import ControlWatch
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.stopping import ALL_LATCHED, LATCHED


class ControlPort:
    """`active_source`, `stop_state` and `emergency_stop` of a node, for one watch.

    Args:
        node: The node that sends references.
        watch: Is told.
        look: Called after each, to give up what is no longer followed.
    """

    def __init__(self, node: OmnimanNode, watch: ControlWatch, look: Callable[[], None]) -> None:
        self._node = node
        self._watch = watch
        self._look = look
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop, ALL_LATCHED)
        # A transient-local subscription alone does not match volatile publishers.
        for qos in (LATCHED, QoSProfile(depth=10)):
            node.create_subscription(Bool, "emergency_stop", self._on_emergency, qos)
        node.every(1.0, self._check_stopped)

    def _on_source(self, message: String) -> None:
        self._watch.hear_source(message.data)
        self._look()

    def _on_stop(self, message: DiagnosticStatus) -> None:
        stopped = message.level == DiagnosticStatus.ERROR
        self._watch.hear_stop(message.name, stopped, message.message)
        self._look()

    def _on_emergency(self, message: Bool) -> None:
        self._watch.hear_emergency(message.data)
        self._look()

    def _check_stopped(self) -> None:
        """A stopped node that vanished cannot be reset: those that it stopped, say so."""
        if self._watch.stopped:
            publishers = self._node.get_publishers_info_by_topic("stop_state")
            there = {f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers}
            for name in set(self._watch.stopped) - there:
                self._watch.hear_stop(name, False, "")
