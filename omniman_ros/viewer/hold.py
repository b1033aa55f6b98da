"""Hold to drive: a twist while a button is held, and a dead man's switch for the rest."""

import math

from omniman_ros.core.framing import Twist
from omniman_ros.viewer.events import Gone, Held, Released

MOTIONS: dict[str, Twist] = {
    "turn_left": (0.0, 0.0, 1.0),
    "forward": (1.0, 0.0, 0.0),
    "turn_right": (0.0, 0.0, -1.0),
    "left": (0.0, 1.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}
"""Buttons in the order of the page, three in a row, and what one of them asks for."""
DEAD_MAN = 0.2
"""Silence of a page after which what it held is released [s]."""


class HoldToDrive:
    """Buttons that are held, on any number of pages.

    A page repeats each button that it holds; one that is silent for `timeout` has released it,
    whatever the reason: a lost connection, a stalled browser, a page in the background. When
    several pages hold buttons, the one that pressed last drives, alone. Two buttons of one page
    (two fingers) add up.

    Args:
        timeout: See above [s].
    """

    def __init__(self, timeout: float = DEAD_MAN) -> None:
        self._timeout = timeout
        self._heard: dict[tuple[int, str], float] = {}

    def hear(self, event: Held | Released | Gone, now: float) -> None:
        """Take in what a page says, at a time on any steady clock [s]."""
        if isinstance(event, Held):
            if event.motion in MOTIONS:
                self._heard[event.client, event.motion] = now
        elif isinstance(event, Released):
            self._heard.pop((event.client, event.motion), None)
        else:
            for key in [key for key in self._heard if key[0] == event.client]:
                del self._heard[key]

    def release(self) -> None:
        """Forget all that is held."""
        self._heard.clear()

    def twist(self, now: float, linear: float, angular: float) -> Twist | None:
        """Body twist of what is held at `now` [s], or None if nothing is.

        Args:
            now: On the clock of :meth:`hear` [s].
            linear: Speed of a button [m/s]; diagonals are as fast as the rest.
            angular: Yaw rate of a button [rad/s].
        """
        for key, heard in list(self._heard.items()):
            if now - heard >= self._timeout:
                del self._heard[key]
        if not self._heard:
            return None
        driver = next(reversed(self._heard))[0]
        held = [MOTIONS[motion] for client, motion in self._heard if client == driver]
        x, y, turn = (sum(motion[axis] for motion in held) for axis in range(3))
        share = linear / max(math.hypot(x, y), 1.0)
        return x * share, y * share, turn * angular
