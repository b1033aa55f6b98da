"""Measurements of all drives, converted to the wheels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.can_drives.axis import DriveAxis, Feedback
from omniman_ros.can_drives.transmission import Transmission, max_wheel_speed, transmissions
from omniman_ros.core.arrays import Array
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.platform import Platform

#: Ratio of the wheel speed that counts as running away to the largest commanded speed
RUNAWAY_SPEED = 1.5
MIN_COMPARED_SPEED = 0.5  #: Speed below which position and speed are not compared [rad/s]
#: Travel, integrated from the reported speed, in which the position has to change [rad]; an
#: encoder's step must be smaller.
MIN_INTEGRATED_ANGLE = 0.2
#: Smallest number of reports in a row without a change: one that follows a gap is not enough
UNMOVED_REPORTS = 4
#: Smallest plausible ratio of position change to travel; well below 1, as reports may be late
MIN_MOVED_FRACTION = 0.1
MAX_REPORT_INTERVAL = 0.05  #: Longest time for which a reported speed is integrated [s]
#: Smallest step between the stamps of two wheel states, in periods.
#: Of several reports that arrive late in a bunch only one is used.
MIN_STAMP_STEP = 0.25


class WheelMonitor:
    """Checks the reports of one wheel against limits and against each other.

    A speed that is reported while the position does not change means a dead encoder: the drive's
    velocity loop would continue at an unknown speed.
    """

    def __init__(self) -> None:
        self._at: float | None = None
        self._anchor = 0.0
        self._travel, self._reports = 0.0, 0

    def restart(self) -> None:
        """Forget all reports."""
        self._at = None

    def check(self, feedback: Feedback, ratio: float, max_speed: float, min_supply: float) -> str:
        """Return why a report at the motor's shaft cannot be accepted, or an empty string.

        Args:
            max_speed: Largest speed of the wheel [rad/s].
            min_supply: Lowest supply voltage [V].
        """
        speed = feedback.velocity / ratio
        if abs(speed) > RUNAWAY_SPEED * max_speed:
            return f"runs away at {speed:.1f} rad/s, the limit is {max_speed:.1f} rad/s"
        if feedback.bus_voltage < min_supply:  # false for NaN: an unknown supply is accepted
            return f"supply {feedback.bus_voltage:.1f} V, at least {min_supply:.1f} V are needed"
        return self._compare(feedback.at, feedback.position / ratio, speed)

    def _compare(self, at: float, position: float, speed: float) -> str:
        """Return why the encoder counts as dead; empty if it does not.

        The travel counts from the last report on in which the position had changed enough.
        """
        before, self._at = self._at, at
        if before is None or abs(speed) < MIN_COMPARED_SPEED or not math.isfinite(position):
            self._begin(position)
            return ""
        self._travel += abs(speed) * min(max(at - before, 0.0), MAX_REPORT_INTERVAL)
        self._reports += 1
        moved = abs(position - self._anchor)
        if not moved < MIN_MOVED_FRACTION * self._travel:  # also if the anchor is not finite
            self._begin(position)
            return ""
        if self._travel < MIN_INTEGRATED_ANGLE or self._reports < UNMOVED_REPORTS:
            return ""
        self._begin(position)
        return f"its encoder moved {moved:.3f} rad while it reported {speed:.1f} rad/s"

    def _begin(self, position: float) -> None:
        """Count travel and reports from a position on [rad]."""
        self._anchor, self._travel, self._reports = position, 0.0, 0


@dataclass(frozen=True)
class WheelStates:
    """Feedback of all wheels, arrays (n,), wheels in the robot's order."""

    #: Time of the measurement [s]: that of a SYNC, or else that at which the oldest of the reports
    #: was received. It always increases.
    at: float
    position: Array  #: Unwrapped angles [rad]
    velocity: Array  #: Velocities [rad/s]
    effort: Array  #: Torques at the wheels [N m]; NaN if the drive does not report them


class FeedbackConverter:
    """Converts the feedback of the axes into measurements of the wheels."""

    def __init__(
        self,
        axes: Sequence[DriveAxis],
        robot: Platform,
        parameters: CanParameters,
        samples_at_sync: bool,
    ) -> None:
        self._axes = axes
        self._samples_at_sync = samples_at_sync
        self._monitors = tuple(WheelMonitor() for _ in axes)
        self._checked = [0] * len(axes)
        self._taken = [0] * len(axes)
        self._stamp = -math.inf
        self._energy: Array = np.zeros(len(axes))
        self._max_believed_speed = 0.0
        self.update_parameters(robot, parameters)

    def update_parameters(self, robot: Platform, parameters: CanParameters) -> None:
        """Replace the limits."""
        self._parameters = parameters
        self._gears: tuple[Transmission, ...] = transmissions(robot, parameters)
        self._max_speed = max_wheel_speed(robot, parameters)
        # The wheels may still rotate as fast as an earlier, larger limit allowed.
        self._max_believed_speed = max(self._max_believed_speed, self._max_speed)

    @property
    def max_believed_speed(self) -> float:
        """Largest wheel speed that is believed: the largest limit so far [rad/s]."""
        return self._max_believed_speed

    def restart_monitors(self) -> None:
        """Restart the plausibility checks."""
        for monitor in self._monitors:
            monitor.restart()

    def check(self, k: int) -> str:
        """Return why the newest report of wheel `k` is implausible, or an empty string."""
        feedback = self._axes[k].feedback
        if feedback.count == self._checked[k]:
            return ""
        self._checked[k] = feedback.count
        min_supply = self._parameters.min_bus_voltage
        ratio = self._gears[k].ratio
        return self._monitors[k].check(feedback, ratio, self._max_speed, min_supply)

    def velocity(self) -> Array:
        """Return the wheel speeds (n,) [rad/s]; zero where none was received."""
        speeds = [
            axis.feedback.velocity / gear.ratio
            for axis, gear in zip(self._axes, self._gears, strict=True)
        ]
        return np.array([speed if math.isfinite(speed) else 0.0 for speed in speeds])

    def believed_velocity(self) -> Array:
        """Return the wheel speeds (n,) [rad/s], clipped to the largest speed.

        A ramp keeps the ratios of all speeds: a wheel that runs away or reports invalid values
        must not delay the others.
        """
        return np.clip(self.velocity(), -self._max_believed_speed, self._max_believed_speed)

    def take_states(self, last_tick: float, tick_before: float) -> WheelStates | None:
        """Return all wheels' states once all have reported; the last two periods' times in [s]."""
        feedback = [axis.feedback for axis in self._axes]
        counts = [report.count for report in feedback]
        if any(count == taken for count, taken in zip(counts, self._taken, strict=True)):
            return None
        self._taken = counts
        at = min(report.at for report in feedback)
        if self._samples_at_sync:
            at = last_tick if at >= last_tick else min(at, tick_before)
        if at < self._stamp + MIN_STAMP_STEP * self._parameters.period:
            return None
        self._stamp = at
        rows = []
        for report, gear in zip(feedback, self._gears, strict=True):
            velocity = report.velocity / gear.ratio
            effort = gear.to_wheel(report.torque, velocity)
            rows.append((report.position / gear.ratio, velocity, effort))
        table = np.array(rows).T
        table.flags.writeable = False
        return WheelStates(at, *table)

    def electrical(self, dt: float) -> Array:
        """Return the motors' values; see :meth:`CanDrives.electrical`."""
        rows = np.array(
            [
                gear.electrical(axis.feedback)
                for gear, axis in zip(self._gears, self._axes, strict=True)
            ]
        )
        power = rows[:, 0] * rows[:, 1]
        self._energy = self._energy + np.where(np.isfinite(power), power, 0.0) * dt
        return np.column_stack([rows, self._energy])
