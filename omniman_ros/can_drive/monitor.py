"""What no drive says of itself: speeds, supplies and encoders that cannot be right."""

import math

from omniman_ros.can_drive.axis import Feedback

OVERSPEED = 1.5
"""Share of the largest commanded speed at which a wheel runs away."""
SLOW = 0.5
"""Speed below which an encoder is not compared with the speed, rad/s."""
TRAVEL = 0.5
"""Believed travel after which an encoder must have moved, rad."""
STANDS = 0.1
"""Share of the believed travel that it must have moved: reports may have come late."""
LONGEST = 0.05
"""Longest time that a reported speed is believed, s."""


class WheelMonitor:
    """Checks the reports of one wheel against each other.

    A speed that is reported while the position stands is an encoder that is dead; its drive, in a
    velocity loop on it, would go on at a speed that nobody sees.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._believed = 0.0
        self._moved = 0.0

    def restart(self) -> None:
        """Forget what was seen."""
        self._last = None
        self._believed = self._moved = 0.0

    def check(
        self, feedback: Feedback, ratio: float, max_speed: float, min_supply: float
    ) -> str:  # fmt: skip
        """Return what is wrong with a new report, or nothing.

        Args:
            feedback: The report, at the motor's shaft.
            ratio: Turns of the motor per turn of the wheel.
            max_speed: Of the wheel, rad/s.
            min_supply: V.
        """
        speed = feedback.velocity / ratio
        if abs(speed) > OVERSPEED * max_speed:
            return f"runs away at {speed:.1f} rad/s, the limit is {max_speed:.1f} rad/s"
        if feedback.bus_voltage < min_supply:  # not where it is NaN, unknown
            return f"supply {feedback.bus_voltage:.1f} V, at least {min_supply:.1f} V are needed"
        return self._compare(feedback.at, feedback.position / ratio, speed)

    def _compare(self, at: float, position: float, speed: float) -> str:
        last, self._last = self._last, (at, position)
        if last is None or abs(speed) < SLOW or not math.isfinite(position):
            self._believed = self._moved = 0.0
            return ""
        self._believed += abs(speed) * min(at - last[0], LONGEST)
        self._moved += abs(position - last[1])
        if self._believed < TRAVEL:
            return ""
        dead = self._moved < STANDS * self._believed
        moved, self._believed, self._moved = self._moved, 0.0, 0.0
        if dead:
            return f"its encoder moved {moved:.3f} rad while it reported {speed:.1f} rad/s"
        return ""
