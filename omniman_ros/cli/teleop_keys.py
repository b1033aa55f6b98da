"""From keys to a twist: hold to drive, release stops, in a terminal that reports no releases.

A terminal sends a key once when it is pressed, again after the keyboard's repeat delay (0.25 to
0.6 s), and then 10 to 40 times a second, until it is released or another key is pressed: only the
key pressed last repeats. So a key is held for HOLD_PRESS after a press and for HOLD_REPEAT after
a fast repeat. Keys pressed at once (within TOGETHER) add up and live as long as the last of them;
a key pressed later replaces what was held, so that a key whose release nobody can see never
drives on beside a new one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from omniman_ros.core.framing import Twist

HOLD_PRESS = 0.6
"""How long a key counts as held after a press: longer than the keyboard's repeat delay [s]."""
HOLD_REPEAT = 0.2
"""How long it counts as held after a fast repeat [s]."""
FAST = 0.15
"""Interval of a key up to which it repeats; the first repeat comes later, as does a tap [s]."""
TOGETHER = 0.25
"""Keys whose first presses are within this time add up [s]."""
STEP = 1.1
"""Factor on both speeds of one press of + or -."""
SLOWEST, FASTEST = 0.1, 10.0
"""Bounds of the product of those factors."""

Direction = tuple[int, int, int]

MOTIONS: dict[str, Direction] = {
    "w": (1, 0, 0), "s": (-1, 0, 0), "a": (0, 1, 0), "d": (0, -1, 0),
    "q": (0, 0, 1), "e": (0, 0, -1),
    "up": (1, 0, 0), "down": (-1, 0, 0), "left": (0, 0, 1), "right": (0, 0, -1),
    "u": (1, 1, 0), "o": (1, -1, 0), "m": (-1, 1, 0), ".": (-1, -1, 0),
    "i": (1, 0, 0), ",": (-1, 0, 0), "j": (0, 1, 0), "l": (0, -1, 0),
}  # fmt: skip
"""Key to direction: forward, left, counterclockwise."""

ESCAPES = {"A": "up", "B": "down", "C": "right", "D": "left"}
"""Last letter of an arrow's escape sequence."""


def split_keys(text: str) -> Iterator[str]:
    """Names of the keys in what a terminal sent; other escape sequences are passed over."""
    at = 0
    while at < len(text):
        if text[at] != "\x1b":
            yield text[at].lower()
            at += 1
            continue
        end = at + 1
        if text[end : end + 1] in ("[", "O"):
            end += 1
            while end < len(text) and not text[end].isalpha() and text[end] != "~":
                end += 1
            if end == at + 2 and text[end : end + 1] in ESCAPES:
                yield ESCAPES[text[end]]
        at = end + 1


@dataclass
class _Held:
    first: float
    last: float


class KeyTeleop:
    """Turns presses into a twist.

    Args:
        linear: Speed at scale 1 [m/s].
        angular: Yaw rate at scale 1 [rad/s].

    Attributes:
        scale: Factor on both.
    """

    def __init__(self, linear: float, angular: float) -> None:
        self._linear = linear
        self._angular = angular
        self._held: dict[str, _Held] = {}
        self._until = 0.0
        self.scale = 1.0

    def press(self, key: str, now: float) -> bool:
        """Take a key that the terminal sent at `now` [s]; False if it moves nothing."""
        if key not in MOTIONS:
            return False
        if now >= self._until:
            self._held.clear()
        held = self._held.get(key)
        if held is not None:
            window = HOLD_REPEAT if now - held.last <= FAST else HOLD_PRESS
            held.last = now
        else:
            window = HOLD_PRESS
            if any(now - other.first > TOGETHER for other in self._held.values()):
                self._held.clear()
            self._held[key] = _Held(now, now)
        self._until = now + window
        return True

    def release(self) -> None:
        """Forget what is held."""
        self._held.clear()
        self._until = 0.0

    def faster(self, factor: float) -> None:
        """Multiply the scale, within its bounds."""
        self.scale = min(max(self.scale * factor, SLOWEST), FASTEST)

    @property
    def speeds(self) -> tuple[float, float]:
        """Linear [m/s] and angular [rad/s] speed of a key at this scale."""
        return self._linear * self.scale, self._angular * self.scale

    def twist(self, now: float) -> Twist | None:
        """Body twist [m/s, m/s, rad/s] while keys are held, else None.

        Diagonals are as fast as the rest; opposite keys cancel.
        """
        if now >= self._until:
            self.release()
            return None
        x, y, turn = (
            float(max(-1, min(1, sum(MOTIONS[key][axis] for key in self._held))))
            for axis in range(3)
        )
        linear, angular = self.speeds
        if x and y:
            linear *= 0.5**0.5
        return x * linear, y * linear, turn * angular
