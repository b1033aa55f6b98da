"""Decide whether a stream of references may begin, and whether it is still followed."""

TAKE_OVER = 0.5  #: Time within which the platform controller begins to follow a new stream [s]


class StreamMonitor:
    """Tracks whether the platform controller follows a node's stream of references.

    It is fed with what `active_source`, `stop_state` and `emergency_stop` report.

    Args:
        silence: Time for which the stream must pause after it lost control before the platform
            controller accepts it again [s].
        own_source: Value of `active_source` while the stream is followed.
        overruled: Sources that the stream takes control from.

    Attributes:
        silence: May be changed at any time.
        source: Source that drives, as last reported; empty before the first report.
    """

    def __init__(
        self, silence: float, own_source: str = "path", overruled: tuple[str, ...] = ()
    ) -> None:
        self.silence = silence
        self._own_source = own_source
        self._free_sources = ("", "none", own_source, *overruled)
        self.source = ""
        self._stopped: dict[str, str] = {}
        self._emergency = False
        self._began: float | None = None
        self._taken_over = False
        self._last_sent = float("-inf")
        self._silent_until = float("-inf")

    def update_source(self, source: str) -> None:
        """Set the source that drives, as reported on `active_source`."""
        self.source = source
        own_stream = source == self._own_source and self._began is not None
        self._taken_over = self._taken_over or own_stream
        self._demand_silence_if_blocked()

    def update_stop_state(self, node: str, stopped: bool, reason: str) -> None:
        """Set the stop state of a node that moves something."""
        if stopped:
            self._stopped[node] = reason
        else:
            self._stopped.pop(node, None)
        self._demand_silence_if_blocked()

    def update_emergency(self, active: bool) -> None:
        """Set the state of the emergency stop."""
        self._emergency = active
        self._demand_silence_if_blocked()

    def _demand_silence_if_blocked(self) -> None:
        """Require silence after a stream that has just ended.

        The controller still holds the end of the stream, and now cancels it.
        """
        if self._began is None and self.blocking_reason:
            self._silent_until = self._last_sent + self.silence

    @property
    def stopped_nodes(self) -> tuple[str, ...]:
        """Full names of the nodes that are stopped."""
        return tuple(self._stopped)

    @property
    def stop_reason(self) -> str:
        """Reason why nothing may move, whichever source drives; empty if there is no stop."""
        if self._emergency:
            return "emergency_stop is true"
        return "; ".join(f"{node} is {reason}" for node, reason in sorted(self._stopped.items()))

    @property
    def blocking_reason(self) -> str:
        """Reason why no stream can begin now; empty if a stream can begin."""
        if self.stop_reason:
            return self.stop_reason
        if self.source == "stop":
            return "the platform is stopped"
        if not self.source:
            return "no platform_controller (no message on active_source)"
        return "" if self.source in self._free_sources else f"{self.source} drives"

    @property
    def passing_reason(self) -> str:
        """The blocking reason if it may pass by itself in a moment, else empty.

        The controller reports a motion for a moment after its end. Who drives by twists has the
        robot on purpose.
        """
        is_passing = not self.stop_reason and self.source not in ("", "stop", "cmd_vel")
        return self.blocking_reason if is_passing else ""

    @property
    def is_unheard(self) -> bool:
        """Whether nothing has been heard of the controller yet, as after the start of a node."""
        return not self.stop_reason and not self.source

    def waiting_time(self, now: float) -> float:
        """Return how long a new stream must wait until it is accepted [s]."""
        return max(self._silent_until - now, 0.0)

    def begin(self, now: float) -> None:
        """Record that a stream begins; without effect while one runs."""
        if self._began is None:
            self._began, self._taken_over = now, False

    def sent(self, now: float) -> None:
        """Record that a preview of the stream was sent."""
        self._last_sent = now

    def end(self, lost: bool) -> None:
        """Record that the stream has ended."""
        self._began = None
        if lost:
            self._silent_until = self._last_sent + self.silence

    def restart(self, now: float) -> None:
        """Count the silence from `now`: time went back, or the platform controller was reset."""
        self._last_sent = now
        self._silent_until = now + self.silence

    def loss_reason(self, now: float) -> str:
        """Return why the stream is not followed; empty if it is, or if none runs."""
        if self._began is None:
            return ""
        if self.blocking_reason:
            return self.blocking_reason
        late = now - self._began > TAKE_OVER
        if self.source == self._own_source:
            # The report may be about the previous stream, whose end is still held.
            self._taken_over = self._taken_over or late
            return ""
        if self._taken_over:
            return "the platform controller has cancelled it"
        return "the platform controller does not follow it" if late else ""
