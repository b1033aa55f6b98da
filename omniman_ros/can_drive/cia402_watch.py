"""What a CiA 402 drive does not say, or says for too long; and the reasons that are kept."""

import math
from collections.abc import Iterator

from omniman_ros.can_drive.axis import AxisSettings, Demand
from omniman_ros.can_drive.cia402_objects import mode_text
from omniman_ros.can_drive.cia402_state import PdsState

MISSED = 3
"""Heartbeats that may be missing, and statuswords."""
PATIENCE = 0.1
"""How long a drive may show another mode, or no quick stop, than it was told, s."""
TROUBLES = 4
"""How many reasons are kept."""

Reason = tuple[str, str]
"""Kind and words of a trouble."""


class Troubles:
    """Why a drive cannot drive: of each kind the first reason."""

    def __init__(self) -> None:
        self._reasons: dict[str, str] = {}

    def __contains__(self, kind: str) -> bool:
        return kind in self._reasons

    def __str__(self) -> str:
        return "; ".join(self._reasons.values())

    def add(self, kind: str, reason: str) -> None:
        """Keep a reason, unless there are enough."""
        if len(self._reasons) < TROUBLES:
            self._reasons.setdefault(kind, reason)

    def clear(self) -> None:
        """Forget all."""
        self._reasons.clear()


class Watch:
    """Times of what a drive said last.

    Args:
        settings: Of the drive.
    """

    def __init__(self, settings: AxisSettings) -> None:
        self._settings = settings
        self._patience = max(PATIENCE, 5.0 * settings.period)
        self.begin()

    def begin(self) -> None:
        """Forget what was heard."""
        self._heartbeat = self._status = -math.inf
        self._asked = 0  # SYNCs since the last statusword
        self.excuse()

    def excuse(self) -> None:
        """Begin to wait anew for what was told."""
        self._other_mode: float | None = None
        self._no_stop: float | None = None

    def heartbeat(self, now: float) -> None:
        """There was one."""
        self._heartbeat = now

    def status(self, now: float) -> None:
        """There was a statusword."""
        self._status, self._asked = now, 0

    def tick(self) -> None:
        """The drive is about to be asked for its status by SYNC."""
        self._asked += 1

    def loss(self, now: float) -> Reason | None:
        """What has not come: then the drive may have lost its configuration too."""
        settings = self._settings
        if now - self._heartbeat > MISSED * settings.drive_heartbeat + settings.period:
            return "heartbeat", f"heartbeat lost for {now - self._heartbeat:.3f} s"
        # Without SYNC there is no statusword: where the ticks pause, time alone does not count.
        late = settings.feedback_timeout + settings.period
        if self._asked > MISSED and now - self._status > late:
            return "statusword", f"statusword lost for {now - self._status:.3f} s"
        return None

    def refusals(
        self, state: PdsState, demand: Demand, shown: int, asked: int, now: float
    ) -> Iterator[Reason]:
        """What the drive was told and does not show.

        Args:
            state: What it shows.
            demand: What is wanted of it.
            shown, asked: Modes of operation.
            now: Time, s.
        """
        enabled = state is PdsState.ENABLED
        wrong = enabled and demand is Demand.DRIVE and shown != asked
        self._other_mode = _first(self._other_mode, now) if wrong else None
        if self._other_mode is not None and now - self._other_mode > self._patience:
            yield "mode", f"shows mode {mode_text(shown)} instead of {mode_text(asked)}"
        unmoved = enabled and demand is Demand.STOP
        self._no_stop = _first(self._no_stop, now) if unmoved else None
        if self._no_stop is not None and now - self._no_stop > self._patience:
            yield "stop", f"shows {state} although it was told to quick stop"


def _first(since: float | None, now: float) -> float:
    return now if since is None else since
