"""What simulated drives have in common that report by themselves: when, and how it goes wrong."""

import math

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.drive.can.motor import DriveFaults

GRID = 1e-6
"""Part of a period by which a time may miss its place on the grid: rounding."""


class Timer:
    """Tells when something periodic is due, on a grid of absolute time.

    Several periods that went by unseen are one: what was missed is not made up for.

    Args:
        period: s; 0 for never.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Begin the grid anew; the first time that is due is `now`."""
        self._start, self._last = now, -1

    def due(self, now: float) -> bool:
        """Say whether a time of the grid has come since the last call."""
        if not self.period:
            return False
        place = math.floor((now - self._start) / self.period + GRID)
        if place <= self._last:
            return False
        self._last = place
        return True


class ReportFaults:
    """Plays the faults of reports on their way to the bus: short, sent twice, out of order."""

    def __init__(self) -> None:
        self._held: dict[int, can.Message] = {}

    def apply(self, message: can.Message, faults: DriveFaults) -> list[can.Message]:
        """Return what is sent now for a report that is due."""
        held = self._held.pop(message.arbitration_id, None)
        messages = [message]
        if faults.reordered_reports:
            if held is None:
                self._held[message.arbitration_id] = message
                return []
            messages = [message, held]
        if faults.short_reports:
            messages = [_without_last_byte(each) for each in messages]
        if faults.duplicated_reports:
            messages = [each for each in messages for _ in range(2)]
        return messages


def _without_last_byte(message: can.Message) -> can.Message:
    return can.Message(
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id,
        data=message.data[:-1],
    )


def check_above(name: str, value: float, low: float = 0.0, inclusive: bool = True) -> None:
    """Compare a number with its lower limit.

    Raises:
        ParameterError: It is below, or not finite.
    """
    if not math.isfinite(value) or value < low or (value == low and not inclusive):
        raise ParameterError(
            name, value, f"it must be {'at least' if inclusive else 'above'} {low}"
        )
