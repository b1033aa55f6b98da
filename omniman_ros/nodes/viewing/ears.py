"""Subscriptions that cost little: the last of a stream, and some only while somebody looks."""

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile

from omniman_ros.nodes.runtime import OmnimanNode

LATEST = QoSProfile(depth=1)
"""Of a stream: of what came since the last look, the last message is taken in."""

Handler = Callable[[Any], str | None]


class Ears:
    """The node's subscriptions.

    Args:
        node: Whose.
    """

    def __init__(self, node: OmnimanNode) -> None:
        self._node = node
        self._waiting: dict[str, Callable[[], None]] = {}
        self._watched: list[tuple[type, str, Handler, QoSProfile | int]] = []
        self._open: list[Any] = []

    def hear(
        self, kind: type, topic: str, handler: Handler, qos: QoSProfile | int = LATEST
    ) -> None:
        """Hear a topic all the time."""
        self._subscribe(kind, topic, handler, qos)

    def hear_watched(
        self, kind: type, topic: str, handler: Handler, qos: QoSProfile | int = LATEST
    ) -> None:
        """Hear a topic while somebody looks: it is fast, or its sender makes it for us alone."""
        self._watched.append((kind, topic, handler, qos))

    def watch(self, watched: bool) -> None:
        """Note whether somebody looks."""
        if watched and not self._open:
            self._open = [self._subscribe(*given) for given in self._watched]
        elif not watched:
            while self._open:
                self._node.destroy_subscription(self._open.pop())

    def take_in(self) -> None:
        """Take in the last messages of all streams."""
        while self._waiting:
            self._waiting.popitem()[1]()

    def _subscribe(self, kind: type, topic: str, handler: Handler, qos: QoSProfile | int) -> Any:
        take = self._node.guarded(topic, handler)
        if qos is LATEST:
            take = self._keeper(topic, take)
        return self._node.create_subscription(kind, topic, take, qos)

    def _keeper(self, topic: str, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """Keep the last message only, until it is taken in: a stream comes faster than frames."""

        def keep(message: Any) -> None:
            self._waiting[topic] = lambda: take(message)

        return keep
