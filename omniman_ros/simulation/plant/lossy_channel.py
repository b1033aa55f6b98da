"""Channel that loses and delays messages, for the faults of state reports."""

import random
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")  #: Type of a message


class LossyChannel(Generic[T]):
    """Keeps messages until they are due, and loses some; their order is kept."""

    def __init__(self, seed: int = 0) -> None:
        self._random = random.Random(seed)
        self._waiting: deque[tuple[float, T]] = deque()

    def put(self, item: T, now: float, lost: float = 0.0, late: float = 0.0) -> None:
        """Send an item, with a probability to lose it, 0 to 1, and a delay [s]."""
        if lost <= 0.0 or self._random.random() >= lost:
            self._waiting.append((now + late, item))

    def due(self, now: float) -> list[T]:
        """Remove and return the items that have arrived by time `now` [s]."""
        arrived = []
        while self._waiting and self._waiting[0][0] <= now:
            arrived.append(self._waiting.popleft()[1])
        return arrived
