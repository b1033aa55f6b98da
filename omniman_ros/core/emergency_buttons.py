"""The emergency stop of several publishers: it is pressed as long as one of them says so.

The middleware does not tell which publisher has sent a message, but numbers the messages of each
publisher one after the other. A message with number k + 1 comes from one of the publishers whose
last message had number k.
"""

from collections import deque
from dataclasses import dataclass

MAX_GROUPS = 64  #: Largest number of groups of publishers, gone ones included, that are kept
#: Stands for the number of a message without one, which no other message continues
UNNUMBERED = -2
REMEMBERED = 64  #: Number of messages that are recognised when they are delivered a second time


@dataclass
class _Group:
    size: int = 0  #: Number of publishers
    pressing: int = 0  #: Largest number of them that may have said true last


class EmergencyButtons:
    """Combines the messages of several publishers.

    It is released when no publisher whose messages have all been received presses. Where two of
    them have sent equally many messages, and one says false, nobody knows which one it was: it
    stays pressed until the other one has said false, too. A publisher of whom messages are
    missing, because it is older than the subscription or they were lost, is taken for another one
    if its next message has the number that the other one's would have.

    A single publisher needs no numbers: its last message counts, and that of one that is gone.
    """

    def __init__(self) -> None:
        self._last = False
        self._groups: dict[int, _Group] = {}
        self._seen: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)

    def update(self, pressed: bool, number: int | None, sent: int) -> bool:
        """Register a message; one that was registered before changes nothing.

        The result is whether it is the first message of a publisher, as far as the numbers tell.

        Args:
            number: Its number among the messages of its publisher; None if it is unknown. Then
                the last message counts, whoever sent it.
            sent: Time at which it was sent, in nanoseconds of the sender's clock.
        """
        if number is None:
            self._groups.clear()
            number = UNNUMBERED
        elif (number, sent) in self._seen:
            return False
        self._seen.append((number, sent))
        self._last = pressed
        before = self._groups.get(number - 1)
        if before is not None:
            before.size -= 1
            before.pressing = min(before.pressing, before.size)
            if not before.size:
                del self._groups[number - 1]
        group = self._groups.setdefault(number, _Group())
        group.size += 1
        group.pressing += pressed
        if len(self._groups) > MAX_GROUPS:
            self._forget_one()
        return before is None

    def _forget_one(self) -> None:
        released = (number for number, group in self._groups.items() if not group.pressing)
        del self._groups[next(released, next(iter(self._groups)))]

    def is_pressed(self, publishers: int) -> bool:
        """Return whether a publisher may say that the emergency stop is pressed."""
        if publishers <= 1 and not self._last:
            self._groups.clear()
        return any(group.pressing for group in self._groups.values())
