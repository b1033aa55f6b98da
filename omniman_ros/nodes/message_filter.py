"""Messages of a topic that wait for the transforms of their frames."""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from std_msgs.msg import Header

from omniman_ros.nodes.omniman_node import OmnimanNode

M = TypeVar("M")

MOST_WAITING = 50  #: Largest number of messages of a topic that wait; the oldest ones are dropped
#: Period at which messages that wait for transforms are looked at, if none arrive [s]
RETRY_PERIOD = 0.05


class MessageFilter:
    """Hands the messages of a topic on in their order, each when its transforms are known.

    Args:
        handle_now: Handles a message that need not wait; its result is that of `handle`.
        handle_later: Handles a message that has waited, whether its transforms came or not.
    """

    def __init__(
        self,
        headers: Callable[[Any], Iterable[Header]],
        is_awaited: Callable[[Header], bool],
        give_up: Callable[[Iterable[Header]], None],
        handle_now: Callable[[Any], str | None],
        handle_later: Callable[[Any], None],
    ) -> None:
        self._headers, self._is_awaited, self._give_up = headers, is_awaited, give_up
        self._handle_now, self._handle_later = handle_now, handle_later
        self._waiting: deque[tuple[float, Any]] = deque(maxlen=MOST_WAITING)

    def handle(self, message: Any, now: float) -> str | None:
        """Handle a message that arrives at `now` [s]; return None if it waits."""
        if not self._waiting and self._is_ready(self._headers(message)):
            return self._handle_now(message)
        self._waiting.append((now, message))
        return None

    def retry(self, now: float, max_wait: float) -> None:
        """Hand on the messages that have their transforms, or have waited for `max_wait` [s]."""
        while self._waiting:
            arrival, message = self._waiting[0]
            headers = list(self._headers(message))
            is_over = not 0.0 <= now - arrival < max_wait
            if not is_over and not self._is_ready(headers):
                return
            self._waiting.popleft()
            if is_over:
                self._give_up(headers)
            self._handle_later(message)

    def _is_ready(self, headers: Iterable[Header]) -> bool:
        return not any(self._is_awaited(header) for header in headers)


class MessageFilters:
    """The message filters of a node, and the frames for which they do not wait any more."""

    def __init__(
        self,
        node: OmnimanNode,
        may_come: Callable[[Header], bool],
        is_related: Callable[[Header], bool],
    ) -> None:
        self._node, self._may_come, self._is_related = node, may_come, is_related
        self._filters: list[MessageFilter] = []
        self._abandoned: set[str] = set()

    def deferred(
        self,
        topic: str,
        headers: Callable[[M], Iterable[Header]],
        handler: Callable[[M], str | None],
    ) -> Callable[[M], str | None]:
        """Wrap a handler so that messages wait for the transforms of their `headers`, in order.

        The handler is called in any case: after the wait, its own lookup says what is missing.
        """
        handle_later = self._node.guarded(topic, handler)
        waiting = MessageFilter(headers, self._is_awaited, self._give_up, handler, handle_later)
        self._filters.append(waiting)
        return lambda message: waiting.handle(message, self._node.now())

    def retry(self, max_wait: float) -> None:
        """Hand on the messages that have their transforms, or have waited for `max_wait` [s]."""
        for waiting in self._filters:
            waiting.retry(self._node.now(), max_wait)

    def reconsider(self) -> None:
        """Wait for all frames again, because there is a new one that may relate them to odom."""
        self._abandoned.clear()

    def _is_awaited(self, header: Header) -> bool:
        return header.frame_id not in self._abandoned and self._may_come(header)

    def _give_up(self, headers: Iterable[Header]) -> None:
        """Wait no more for frames that nothing relates to odom, until there are other frames."""
        self._abandoned.update(h.frame_id for h in headers if not self._is_related(h))
