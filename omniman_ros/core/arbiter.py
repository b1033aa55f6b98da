"""Arbitration between the sources that can drive the platform.

A source that loses control is cancelled: its setpoints are used again only after it has been
silent for a while (or has sent a neutral setpoint), so that it never takes over by itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

NEVER = float("-inf")  #: Time of an event that has not happened [s]


class Source(Enum):
    """Sources of motion by descending priority; the values are those of `active_source`."""

    CMD_VEL = "cmd_vel"
    MPC = "mpc"
    BODY = "body"
    PATH = "path"
    STATION = "station"


#: Sources that send previews, on `SOURCE/reference`
PREVIEW_SOURCES = (Source.MPC, Source.BODY, Source.PATH, Source.STATION)


@dataclass
class _Slot:
    fresh_until: float = NEVER  #: Time until which its setpoint may drive [s]
    received: float = NEVER  #: Time of its last setpoint [s]
    cancelled: str = ""  #: Reason why it is cancelled; empty if it is not


class Arbiter:
    """Selects the source that drives; all times are on the caller's steady clock.

    Args:
        silence: Time for which each source, once cancelled, must be silent before it is used
            again [s].

    Attributes:
        silence: May be changed at any time.
    """

    def __init__(self, silence: Mapping[Source, float]) -> None:
        self.silence = silence
        self._slots = {source: _Slot() for source in Source}
        self.active: Source | None = None

    def offer(self, source: Source, now: float, fresh_until: float, neutral: bool = False) -> str:
        """Register a valid setpoint of a source; return why it is not used, or an empty string.

        Args:
            fresh_until: Time until which it may drive [s].
            neutral: Whether it asks for rest, which ends a cancellation.
        """
        slot = self._slots[source]
        active = self.active
        if active is not None and active is not source and _precedes(active, source):
            slot.cancelled = f"{active.value} drives"
        elif slot.cancelled and (neutral or now - slot.received > self.silence[source]):
            slot.cancelled = ""
        slot.received = now
        if slot.cancelled:
            return slot.cancelled
        slot.fresh_until = fresh_until
        return ""

    def refuse(self, source: Source, now: float, reason: str) -> str:
        """Cancel a source whose setpoint of `now` [s] must not be used; return the reason."""
        self._slots[source].received = now
        self.cancel(source, reason)
        return reason

    def ignore(self, source: Source, now: float, reason: str) -> str:
        """Register a setpoint that arrived at `now` [s] and must not be used.

        Its source goes on as before: neither is it cancelled, nor does it stay fresh for longer. A
        cancelled source has not been silent. The result is why the source is cancelled; if it is
        not, the given reason.
        """
        slot = self._slots[source]
        slot.received = now
        return slot.cancelled or reason

    def select(self, now: float) -> Source | None:
        """Return the source that drives now; sources that lose control are cancelled."""
        chosen = None
        for source, slot in self._slots.items():
            fresh = not slot.cancelled and slot.fresh_until >= now
            if fresh and chosen is None:
                chosen = source
            elif chosen is not None and (fresh or source is self.active):
                # Otherwise it would take over by itself once the other falls silent.
                self.cancel(source, f"{chosen.value} took over")
        self.active = chosen
        return chosen

    def cancel(self, source: Source, reason: str) -> None:
        """Withdraw control from a source until it has been silent or neutral."""
        slot = self._slots[source]
        slot.cancelled = slot.cancelled or reason
        slot.fresh_until = NEVER
        if self.active is source:
            self.active = None

    def restart(self, now: float, reason: str) -> None:
        """Cancel every source and count its silence from `now` [s], after time has gone back."""
        self.cancel_all(reason)
        self.resume(now)

    def resume(self, now: float) -> None:
        """Count the silence of cancelled sources from `now` [s], after a gap in reception."""
        for slot in self._slots.values():
            if slot.cancelled:
                slot.received = now

    def cancel_all(self, reason: str) -> None:
        """Cancel every source, as a stop does."""
        for source in Source:
            self.cancel(source, reason)


def _precedes(first: Source, second: Source) -> bool:
    order = list(Source)
    return order.index(first) < order.index(second)
