"""Subscriptions that process only the latest message of a stream, some only while watched."""

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from omniman_ros.nodes.omniman_node import OmnimanNode

LATEST = QoSProfile(depth=1)  #: QoS of a stream, of which only the latest message is used

#: The same for a sensor, whose publisher may be reliable or not
LATEST_READING = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

Handler = Callable[[Any], str | None]  #: Processes a message; returns why it is refused


class LazySubscriptions:
    """The node's subscriptions."""

    def __init__(self, node: OmnimanNode) -> None:
        self._node = node
        self._pending: dict[str, Callable[[], None]] = {}
        self._while_watched: list[tuple[type, str, Handler, QoSProfile | int]] = []
        self._open: list[Any] = []

    def subscribe(
        self, message_type: type, topic: str, handler: Handler, qos: QoSProfile | int = LATEST
    ) -> Any:
        """Subscribe to a topic permanently."""
        process = self._node.guarded(topic, handler)
        if qos not in (LATEST, LATEST_READING):
            return self._node.create_subscription(message_type, topic, process, qos)

        # A stream may be faster than the frames of the page: only its latest message is kept.
        def keep(message: Any) -> None:
            self._pending[topic] = lambda: process(message)

        return self._node.create_subscription(message_type, topic, keep, qos)

    def subscribe_while_watched(
        self, message_type: type, topic: str, handler: Handler, qos: QoSProfile | int = LATEST
    ) -> None:
        """Subscribe to a topic only while a browser is connected.

        This is for topics that are fast, or that their sender computes only for subscribers.
        """
        self._while_watched.append((message_type, topic, handler, qos))

    def set_watched(self, watched: bool) -> None:
        """Open or close the subscriptions that depend on a connected browser."""
        if watched and not self._open:
            self._open = [self.subscribe(*arguments) for arguments in self._while_watched]
        elif not watched:
            while self._open:
                self._node.destroy_subscription(self._open.pop())

    def process_latest(self) -> None:
        """Process the latest message of each stream."""
        while self._pending:
            self._pending.popitem()[1]()
