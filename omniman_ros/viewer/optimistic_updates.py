"""Values that the page displays while they are dragged, before the node has confirmed them."""

from collections import deque
from collections.abc import Hashable, Mapping
from typing import Any

Key = Hashable  #: Identifier of a dragged object, for instance ("obstacle", 3)

DRAG_TIMEOUT = 2.0  #: Silence of a drag after which the confirmed value is displayed again [s]
RELEASE_TIMEOUT = 0.3  #: Time from a release until the confirmed value is displayed [s]


class OptimisticUpdates:
    """Keeps the values of dragged objects, each until its timeout.

    A browser that stalls sends nothing more: its objects are then displayed at their confirmed
    values.
    `put` may be called from any thread, `values` from one only.
    """

    def __init__(self) -> None:
        self._received: deque[tuple[Key, Any, bool]] = deque()
        self._values: dict[Key, Any] = {}
        self._expires_at: dict[Key, float] = {}

    def put(self, key: Key, value: Any, done: bool) -> None:
        """Store the value of a dragged object; `done` is true once it is released."""
        self._received.append((key, value, done))

    def values(self, now: float) -> Mapping[Key, Any]:
        """Return the values to display in place of the confirmed ones, at any steady time [s]."""
        while self._received:
            key, value, done = self._received.popleft()
            self._values[key] = value
            self._expires_at[key] = now + (RELEASE_TIMEOUT if done else DRAG_TIMEOUT)
        for key in [key for key, expiry in self._expires_at.items() if now >= expiry]:
            del self._values[key], self._expires_at[key]
        return self._values
