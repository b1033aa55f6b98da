"""Plausibility checks of a drive's reports, for faults that the drive does not detect."""

import math

from omniman_ros.can_drives.axis import Feedback

#: Ratio of the wheel speed that counts as running away to the largest commanded speed
RUNAWAY_SPEED = 1.5
MIN_COMPARED_SPEED = 0.5  #: Speed below which position and speed are not compared [rad/s]
#: Travel, integrated from the reported speed, in which the position has to change [rad]; an
#: encoder's step must be smaller.
UNMOVED_TRAVEL = 0.2
#: Smallest number of reports in a row without a change: one that follows a gap is not enough
UNMOVED_REPORTS = 4
#: Smallest plausible ratio of position change to travel; well below 1, as reports may be late
MIN_MOVED_FRACTION = 0.1
MAX_REPORT_INTERVAL = 0.05  #: Longest time for which a reported speed is integrated [s]


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
        """Return why a report at the motor's shaft cannot be accepted, or an empty string."""
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
        if self._travel < UNMOVED_TRAVEL or self._reports < UNMOVED_REPORTS:
            return ""
        self._begin(position)
        return f"its encoder moved {moved:.3f} rad while it reported {speed:.1f} rad/s"

    def _begin(self, position: float) -> None:
        """Count travel and reports from a position on [rad]."""
        self._anchor, self._travel, self._reports = position, 0.0, 0
