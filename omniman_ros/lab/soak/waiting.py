"""How long processes wait for a core, by the accounts of the scheduler."""

from collections.abc import Iterable
from pathlib import Path

PERIOD = 0.2  #: shortest time between two samples [s]
LONGEST_WAIT = 0.1  #: time of waiting between two samples from which on a thread is held up [s]
NANOSECOND = 1e-9  #: seconds in a nanosecond


def waited(pid: int, proc: Path = Path("/proc")) -> dict[int, float]:
    """Return for how long each thread of a process has waited for a core so far [s].

    Nothing is returned of a process that has ended, or where the system does not tell.
    """
    found = {}
    for path in proc.glob(f"{pid}/task/*/schedstat"):
        try:
            found[int(path.parent.name)] = NANOSECOND * int(path.read_text().split()[1])
        except (OSError, IndexError):
            continue
    return found


class WaitingWatch:
    """Notes how long any thread waits for a core between two samples."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc
        self._known: dict[int, float] = {}
        self._due = 0.0
        self.longest = 0.0

    def look(self, pids: Iterable[int], now: float) -> None:
        """Take a sample of processes if it is due at `now` [s]."""
        if now < self._due:
            return
        self._due = now + PERIOD
        found: dict[int, float] = {}
        for pid in pids:
            found |= waited(pid, self._proc)
        for thread in found.keys() & self._known.keys():
            self.longest = max(self.longest, found[thread] - self._known[thread])
        self._known = found

    def clear(self) -> None:
        """Forget the longest time."""
        self.longest = 0.0
