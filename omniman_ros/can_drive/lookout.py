"""Who else speaks on the bus: our own echoes, a second host, and frames that nobody knows."""

from collections import Counter, deque
from collections.abc import Iterable

from omniman_ros.can_drive.frame import Frame

MEMORY = 32
"""Own frames of each id that may still come back as an echo."""


class Lookout:
    """Tells own echoes from commands of another host; counts what is not used.

    Some interfaces (udp_multicast) give back what was sent, each frame once. A frame with an id
    that only the host sends is an echo if one like it was sent and has not come back yet, else
    somebody else commands the drives: a second host betrays itself though it says the same.

    Args:
        command_ids: Ids, and whether they are extended, that only the host sends.

    Attributes:
        counts: Frames that were not used, by "echo", "unknown" and "malformed".
    """

    def __init__(self, command_ids: Iterable[tuple[int, bool]]) -> None:
        self._sent: dict[tuple[int, bool], deque[bytes]] = {
            key: deque(maxlen=MEMORY) for key in command_ids
        }
        self.counts: Counter[str] = Counter()

    def note(self, frames: Iterable[Frame]) -> None:
        """Remember what is sent."""
        for frame in frames:
            sent = self._sent.get((frame.id, frame.extended))
            if sent is not None and not frame.remote:
                sent.append(frame.data)

    def is_host(self, frame: Frame) -> bool:
        """Whether only a host sends such frames."""
        return (frame.id, frame.extended) in self._sent

    def is_echo(self, frame: Frame) -> bool:
        """Whether one like it was sent and has not come back yet; it is counted then."""
        sent = self._sent[frame.id, frame.extended]
        if frame.remote or frame.data not in sent:
            return False
        sent.remove(frame.data)
        self.counts["echo"] += 1
        return True
