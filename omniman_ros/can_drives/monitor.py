"""Plausibility checks of a drive's reports, for faults that the drive does not detect."""

import math

from omniman_ros.can_drives.axis import Feedback

RUNAWAY_SPEED = 1.5
"""Ratio of the wheel speed that counts as running away to the largest commanded speed."""
MIN_COMPARED_SPEED = 0.5
"""Speed below which position and speed are not compared [rad/s]."""
COMPARED_TRAVEL = 0.5
"""Travel, integrated from the reported speed, after which the position is compared [rad]."""
MIN_MOVED_FRACTION = 0.1
"""Smallest plausible ratio of position change to travel; well below 1, as reports may be late."""
MAX_REPORT_INTERVAL = 0.05
"""Longest time for which a reported speed is integrated [s]."""


class WheelMonitor:
    """Checks the reports of one wheel against limits and against each other.

    A speed that is reported while the position does not change means a dead encoder: the drive's
    velocity loop would continue at an unknown speed.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._travel = 0.0
        self._moved = 0.0

    def restart(self) -> None:
        """Forget all reports."""
        self._last = None
        self._travel = self._moved = 0.0

    def check(self, feedback: Feedback, ratio: float, max_speed: float, min_supply: float) -> str:
        """Return why a new report cannot be accepted, or an empty string.

        Args:
            feedback: The report, at the motor's shaft.
            ratio: Revolutions of the motor per revolution of the wheel.
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
        last, self._last = self._last, (at, position)
        if last is None or abs(speed) < MIN_COMPARED_SPEED or not math.isfinite(position):
            self._travel = self._moved = 0.0
            return ""
        self._travel += abs(speed) * min(at - last[0], MAX_REPORT_INTERVAL)
        self._moved += abs(position - last[1])
        if self._travel < COMPARED_TRAVEL:
            return ""
        is_dead = self._moved < MIN_MOVED_FRACTION * self._travel
        moved, self._travel, self._moved = self._moved, 0.0, 0.0
        if is_dead:
            return f"its encoder moved {moved:.3f} rad while it reported {speed:.1f} rad/s"
        return ""
