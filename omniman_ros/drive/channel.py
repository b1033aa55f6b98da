"""A link that loses and delays what it carries: for the faults of state reports."""

import random
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Channel(Generic[T]):
    """Holds reports until they are due; some never are. Order is kept.

    Args:
        seed: Seed of the losses.
    """

    def __init__(self, seed: int = 0) -> None:
        self._random = random.Random(seed)
        self._waiting: deque[tuple[float, T]] = deque()

    def put(self, item: T, now: float, lost: float = 0.0, late: float = 0.0) -> None:
        """Send an item.

        Args:
            item: What is sent.
            now: Time, s.
            lost: Probability that it is lost, 0 to 1.
            late: Delay, s.
        """
        if lost <= 0.0 or self._random.random() >= lost:
            self._waiting.append((now + late, item))

    def due(self, now: float) -> list[T]:
        """Take out what has arrived by a time, s."""
        arrived = []
        while self._waiting and self._waiting[0][0] <= now:
            arrived.append(self._waiting.popleft()[1])
        return arrived
