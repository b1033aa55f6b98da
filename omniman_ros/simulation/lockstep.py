"""Lockstep of simulated time with the processes that live in it."""

ROUND_OFF = 1e-6  #: By how much a permit may be exceeded, as messages count nanoseconds [s]


class Lockstep:
    """Decides whether simulated time may go on, by how far its participants have come.

    Each participant permits time to go on up to an instant, and gives the next permit when it has
    done its work. So the simulation takes as long as its slowest part, however busy the machine
    is. A participant that holds it up for longer than the patience counts as dead: time goes on
    without it, so that the others find that out in their own ways, until it gives a permit again.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._permits: dict[str, float] = {}
        self._held_since: float | None = None

    def permit(self, name: str, until: float) -> None:
        """Let simulated time go on up to an instant [s]; a new participant joins."""
        self._permits[name] = until

    def leave(self, name: str) -> None:
        """Stop waiting for a participant until it gives a permit again."""
        self._permits.pop(name, None)

    def laggards(self, until: float) -> list[str]:
        """Return the names of the participants for which the time `until` [s] has to wait."""
        return [name for name, permit in self._permits.items() if permit < until - ROUND_OFF]

    def drop_dead(self, until: float, now: float) -> list[str]:
        """Drop and return those who have held the step to a simulated time up for too long.

        `now` is the real time, from any origin [s].
        """
        laggards = self.laggards(until)
        if not laggards:
            self._held_since = None
        elif self._held_since is None:
            self._held_since = now
        elif now - self._held_since > self._patience:
            self._held_since = None
            for name in laggards:
                self.leave(name)
            return laggards
        return []
