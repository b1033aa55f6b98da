"""Who drives the platform: stop, then cmd_vel, then MPC, then path.

A source that loses control is cancelled: it is heard again only after it has been silent for a
while (or has sent a neutral setpoint), so that it never takes over by itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

NEVER = float("-inf")


class Source(Enum):
    """Sources of motion, the first before the last; the values are those of `active_source`."""

    CMD_VEL = "cmd_vel"
    MPC = "mpc"
    PATH = "path"


@dataclass
class _Slot:
    fresh_until: float = NEVER
    heard: float = NEVER
    cancelled: str = ""


class Arbiter:
    """Chooses the source that drives; time [s] is the caller's steady clock.

    Args:
        silence: How long each source, once cancelled, must be silent to be heard again [s].
    """

    def __init__(self, silence: Mapping[Source, float]) -> None:
        self.silence = silence
        self._slots = {source: _Slot() for source in Source}
        self.active: Source | None = None

    def offer(self, source: Source, now: float, fresh_until: float, neutral: bool = False) -> str:
        """Hear a valid setpoint of a source.

        Args:
            source: Where it came from.
            now: Time of arrival [s].
            fresh_until: Time until which it may drive [s].
            neutral: Whether it asks for rest, which ends a cancellation.

        Returns:
            Why it is not used, or an empty string.
        """
        slot = self._slots[source]
        above = self.active
        if above is not None and above is not source and _before(above, source):
            slot.cancelled = f"{above.value} drives"
        elif slot.cancelled and (neutral or now - slot.heard > self.silence[source]):
            slot.cancelled = ""
        slot.heard = now
        if slot.cancelled:
            return slot.cancelled
        slot.fresh_until = fresh_until
        return ""

    def refuse(self, source: Source, now: float, reason: str) -> str:
        """Hear a setpoint that must not be used; returns the reason."""
        self._slots[source].heard = now
        self.cancel(source, reason)
        return reason

    def select(self, now: float) -> Source | None:
        """Return who drives now; sources that lose control to another are cancelled."""
        chosen = None
        for source, slot in self._slots.items():
            fresh = not slot.cancelled and slot.fresh_until >= now
            if fresh and chosen is None:
                chosen = source
            elif chosen is not None and (fresh or source is self.active):
                # Else it would take over by itself when the other falls silent.
                self.cancel(source, f"{chosen.value} took over")
        self.active = chosen
        return chosen

    def cancel(self, source: Source, reason: str) -> None:
        """Take control from a source until it has been silent or neutral."""
        slot = self._slots[source]
        slot.cancelled = slot.cancelled or reason
        slot.fresh_until = NEVER
        if self.active is source:
            self.active = None

    def restart(self, now: float, reason: str) -> None:
        """Cancel every source and count its silence from now: time has gone back."""
        self.cancel_all(reason)
        self.resume(now)

    def resume(self, now: float) -> None:
        """Count silence from now: for a while it was the receiver that did not listen."""
        for slot in self._slots.values():
            if slot.cancelled:
                slot.heard = now

    def cancel_all(self, reason: str) -> None:
        """Cancel every source: a stop."""
        for source in Source:
            self.cancel(source, reason)


def _before(first: Source, second: Source) -> bool:
    order = list(Source)
    return order.index(first) < order.index(second)
