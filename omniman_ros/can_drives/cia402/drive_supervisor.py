"""Detection of missing reports and ignored commands of a CiA 402 drive, and its fault reasons."""

import math
from collections.abc import Iterator

from omniman_ros.can_drives.axis import AxisSettings, Demand
from omniman_ros.can_drives.cia402.objects import mode_text
from omniman_ros.can_drives.cia402.state import PdsState

MAX_MISSED = 3  #: Largest number of heartbeats, and of statuswords, that may be missing
#: Longest time for which a drive may report another mode than requested, or no quick stop [s]
REACTION_TIME = 0.1
MAX_REASONS = 4  #: Largest number of reasons that are kept

Reason = tuple[str, str]  #: Kind of a fault reason, and its text


class FaultReasons:
    """Records why a drive cannot be driven: the first reason of each kind."""

    def __init__(self) -> None:
        self._reasons: dict[str, str] = {}

    def __contains__(self, kind: str) -> bool:
        return kind in self._reasons

    def __str__(self) -> str:
        return "; ".join(self._reasons.values())

    def add(self, kind: str, reason: str) -> None:
        """Record a reason, unless there is one of its kind or there are `MAX_REASONS`."""
        if len(self._reasons) < MAX_REASONS:
            self._reasons.setdefault(kind, reason)

    def clear(self) -> None:
        """Forget all reasons."""
        self._reasons.clear()


class DriveSupervisor:
    """Supervises the reports of a drive, and whether it follows its commands."""

    def __init__(self, settings: AxisSettings) -> None:
        self._settings = settings
        self._reaction_time = max(REACTION_TIME, 5.0 * settings.period)
        self.begin()

    def begin(self) -> None:
        """Forget all reports."""
        self._heartbeat_at = self._status_at = -math.inf
        self._syncs = 0  # number of SYNCs since the last statusword
        self.excuse()

    def excuse(self) -> None:
        """Restart the time that the drive has to react."""
        self._wrong_mode_since: float | None = None
        self._ignored_stop_since: float | None = None

    def heartbeat(self, now: float) -> None:
        """Record a heartbeat."""
        self._heartbeat_at = now

    def status(self, now: float) -> None:
        """Record a statusword."""
        self._status_at, self._syncs = now, 0

    def tick(self) -> None:
        """Record that a SYNC is about to request a statusword."""
        self._syncs += 1

    def loss(self, now: float) -> Reason | None:
        """Return which report is lost, or None; the drive may then have lost its configuration."""
        settings = self._settings
        if now - self._heartbeat_at > MAX_MISSED * settings.drive_heartbeat + settings.period:
            return "heartbeat", f"heartbeat lost for {now - self._heartbeat_at:.3f} s"
        # Without SYNC there is no statusword: if the ticks pause, time alone is no evidence.
        late = settings.feedback_timeout + settings.period
        if self._syncs > MAX_MISSED and now - self._status_at > late:
            return "statusword", f"statusword lost for {now - self._status_at:.3f} s"
        return None

    def refusals(
        self, state: PdsState, demand: Demand, shown: int, requested: int, now: float
    ) -> Iterator[Reason]:
        """Yield the commands that the drive does not follow; `shown` is its mode of operation."""
        enabled = state is PdsState.ENABLED
        wrong = enabled and demand is Demand.DRIVE and shown != requested
        self._wrong_mode_since = _first(self._wrong_mode_since, now) if wrong else None
        if (
            self._wrong_mode_since is not None
            and now - self._wrong_mode_since > self._reaction_time
        ):
            yield "mode", f"shows mode {mode_text(shown)} instead of {mode_text(requested)}"
        ignores_stop = enabled and demand is Demand.STOP
        self._ignored_stop_since = _first(self._ignored_stop_since, now) if ignores_stop else None
        if (
            self._ignored_stop_since is not None
            and now - self._ignored_stop_since > self._reaction_time
        ):
            yield "stop", f"shows {state} although a quick stop was commanded"


def _first(since: float | None, now: float) -> float:
    return now if since is None else since
