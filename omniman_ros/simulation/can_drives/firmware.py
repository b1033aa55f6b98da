"""Base of simulated drives that send periodic reports: restarts, report timers and faults."""

import math
from abc import ABC, abstractmethod

import can

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.motor import DriveFaults, DriveMotor

ROUNDING = 1e-6  #: Fraction of a period by which a rounded time may lie before its grid point


class Timer:
    """Decides when a periodic action is due, on a grid of equally spaced absolute times.

    Missed actions are skipped: if several periods pass between two calls, the action is due once.
    With a period of 0 it is never due.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Restart the grid at `now` [s], the first time at which the action is due."""
        self._start, self._last = now, -1

    def due(self, now: float) -> bool:
        """Return whether a grid point has been reached by `now` [s] since the last one due."""
        if not self.period:
            return False
        index = math.floor((now - self._start) / self.period + ROUNDING)
        if index <= self._last:
            return False
        self._last = index
        return True


class ReportFaults:
    """Applies faults to outgoing reports, which are then truncated, duplicated or reordered."""

    def __init__(self) -> None:
        self._delayed: dict[int, can.Message] = {}

    def apply(self, message: can.Message, faults: DriveFaults) -> list[can.Message]:
        """Return the messages to send now in place of a report that is due."""
        delayed = self._delayed.pop(message.arbitration_id, None)
        if delayed is not None:
            messages = [message, delayed] if faults.reordered_reports else [delayed, message]
        elif faults.reordered_reports:
            self._delayed[message.arbitration_id] = message
            return []
        else:
            messages = [message]
        if faults.short_reports:
            messages = [_without_last_byte(report) for report in messages]
        if faults.duplicated_reports:
            messages = [report for report in messages for _ in range(2)]
        return messages


def _without_last_byte(message: can.Message) -> can.Message:
    return can.Message(
        arbitration_id=message.arbitration_id,
        is_extended_id=message.is_extended_id,
        data=message.data[:-1],
    )


def require_above(name: str, value: float, low: float = 0.0, inclusive: bool = True) -> None:
    """Check that a parameter is finite and not below a lower limit.

    Raises:
        ParameterError: The value is not finite, or below the limit, or at it unless `inclusive`.
    """
    if not math.isfinite(value) or value < low or (value == low and not inclusive):
        raise ParameterError(name, value, f"must be {'at least' if inclusive else 'above'} {low}")


class Firmware(ABC):
    """Base class of simulated drives that send periodic reports.

    It handles the first start, restarts, the silence while the drive boots, the supply voltage,
    and the encoder with its faults.
    """

    def __init__(self, motor: DriveMotor, boot_time: float) -> None:
        self.faults = DriveFaults()  #: Faults to simulate; the caller may change them at any time
        self._motor = motor
        self._boot_time = boot_time
        self._report_faults = ReportFaults()
        self._reboots = 0
        self._frozen_encoder: tuple[float, float] | None = None
        self._has_started = False
        self._ready_at = 0.0

    @abstractmethod
    def _restart(self) -> None:
        """Set the state as after power-up; the firmware runs from `_ready_at` on."""

    @abstractmethod
    def _clear_position(self) -> None:
        """Make the position start at zero after the next restart."""

    def _start_at(self, ready_at: float) -> None:
        self._ready_at = ready_at
        self._restart()

    def _reboot(self, now: float) -> None:
        """Restart at `now` [s] as after a reset: boot, then begin with the position at zero."""
        self._clear_position()
        self._start_at(now + self._boot_time)

    def _update(self, now: float) -> bool:
        """Apply requested restarts and encoder faults; return whether it runs at `now` [s]."""
        if not self._has_started:
            self._has_started = True
            self._start_at(now)
        if self.faults.reboots > self._reboots:
            self._reboot(now)
        self._reboots = self.faults.reboots
        if not self.faults.frozen_encoder:
            self._frozen_encoder = None
        elif self._frozen_encoder is None:
            self._frozen_encoder = self._motor.position, self._motor.velocity
        return now >= self._ready_at

    @property
    def _supply(self) -> float:
        """Supply voltage [V]: that of the faults or, if it is 0, that of the motor."""
        return self.faults.supply or self._motor.supply

    @property
    def _encoder(self) -> tuple[float, float]:
        """Position [rad] and velocity [rad/s] that the encoder measures."""
        return self._frozen_encoder or (self._motor.position, self._motor.velocity)
