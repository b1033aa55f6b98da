"""Detection of a second host on the bus, which commands the same drives."""

from collections import Counter, deque
from collections.abc import Iterable

from omniman_ros.can_drives.frame import CanFrame

ECHO_MEMORY = 32  #: Number of sent frames per id that may still come back as an echo


class ForeignHostDetector:
    """Distinguishes echoes of the host's own frames from the commands of another host.

    Some interfaces (udp_multicast) return each sent frame once. A frame with an id that only a
    host sends is an echo if an equal frame was sent and has not come back yet. Otherwise another
    host commands the drives: it is detected even if it sends the same frames.

    Args:
        command_ids: Ids, and whether they are extended, that only a host sends.
    """

    def __init__(self, command_ids: Iterable[tuple[int, bool]]) -> None:
        self._sent: dict[tuple[int, bool], deque[bytes]] = {
            key: deque(maxlen=ECHO_MEMORY) for key in command_ids
        }
        self.counts: Counter[str] = Counter()

    def record_sent(self, frames: Iterable[CanFrame]) -> None:
        """Remember frames that are about to be sent."""
        for frame in frames:
            sent = self._sent.get((frame.id, frame.extended))
            if sent is not None and not frame.remote:
                sent.append(frame.data)

    def is_host_frame(self, frame: CanFrame) -> bool:
        """Return whether only a host sends frames with this id."""
        return (frame.id, frame.extended) in self._sent

    def is_echo(self, frame: CanFrame) -> bool:
        """Return whether an equal frame was sent and has not come back yet; if so, count it."""
        sent = self._sent[frame.id, frame.extended]
        if frame.remote or frame.data not in sent:
            return False
        sent.remove(frame.data)
        self.counts["echo"] += 1
        return True
