"""Whether a stream of references is followed, and whether one may begin."""

TAKE_OVER = 0.5
"""Time in which the platform controller takes a stream over [s]."""


class ControlWatch:
    """Watches `active_source`, `stop_state` and `emergency_stop`.

    Args:
        silence: How long the stream must be silent after it lost control, to be heard again [s].
        ours: What `active_source` says while the stream is followed.
        below: Sources that the stream overrules.

    Attributes:
        source: Who drives, as the platform controller said last; empty before.
    """

    def __init__(self, silence: float, ours: str = "path", below: tuple[str, ...] = ()) -> None:
        self.silence = silence
        self._ours = ours
        self._free = ("", "none", ours, *below)
        self.source = ""
        self._stopped: dict[str, str] = {}
        self._emergency = False
        self._began: float | None = None
        self._taken = False
        self._sent = float("-inf")
        self._quiet_until = float("-inf")

    def hear_source(self, source: str) -> None:
        """Hear who drives."""
        self.source = source
        self._taken = self._taken or (source == self._ours and self._began is not None)
        self._overruled()

    def hear_stop(self, node: str, stopped: bool, reason: str) -> None:
        """Hear the state of a node that moves something."""
        if stopped:
            self._stopped[node] = reason
        else:
            self._stopped.pop(node, None)
        self._overruled()

    def hear_emergency(self, active: bool) -> None:
        """Hear the emergency stop."""
        self._emergency = active
        self._overruled()

    def _overruled(self) -> None:
        """A stream that has just ended is cancelled, too: the controller still held its end."""
        if self._began is None and self.obstacle:
            self._quiet_until = self._sent + self.silence

    @property
    def stopped(self) -> tuple[str, ...]:
        """Nodes that are stopped."""
        return tuple(self._stopped)

    @property
    def stop(self) -> str:
        """Why nothing may move, whoever drives; or an empty string."""
        if self._emergency:
            return "emergency_stop is true"
        return "; ".join(f"{node} is {why}" for node, why in sorted(self._stopped.items()))

    @property
    def obstacle(self) -> str:
        """Why no stream can begin now, or an empty string."""
        if self.stop:
            return self.stop
        if self.source == "stop":
            return "the platform is stopped"
        if not self.source:
            return "no platform_controller (nothing heard on active_source)"
        return "" if self.source in self._free else f"{self.source} drives"

    def wait(self, now: float) -> float:
        """How long a new stream must wait to be heard [s]."""
        return max(self._quiet_until - now, 0.0)

    def begin(self, now: float) -> None:
        """A stream begins."""
        if self._began is None:
            self._began, self._taken = now, False

    def sent(self, now: float) -> None:
        """A preview was sent."""
        self._sent = now

    def end(self, lost: bool) -> None:
        """The stream has ended, by itself or because control was lost."""
        self._began = None
        if lost:
            self._quiet_until = self._sent + self.silence

    def restart(self, now: float) -> None:
        """Time has gone back, or the controller was reset: silence counts from now."""
        self._sent = now
        self._quiet_until = now + self.silence

    def lost(self, now: float) -> str:
        """Why the stream is not followed, or an empty string."""
        if self._began is None:
            return ""
        if self.obstacle:
            return self.obstacle
        late = now - self._began > TAKE_OVER
        if self.source == self._ours:
            # It may be what was said of the stream before, whose end is still held.
            self._taken = self._taken or late
            return ""
        if self._taken:
            return "the platform controller has cancelled it"
        return "the platform controller does not take it" if late else ""
