"""Conversion of keys to a twist, for terminals, which do not report the release of a key.

A terminal sends a key once when it is pressed, again after the keyboard's repeat delay (0.25 to
0.6 s), and then 10 to 40 times a second until it is released or another key is pressed: only the
key pressed last repeats. A key therefore counts as held for PRESS_HOLD_TIME after a press, and for
REPEAT_HOLD_TIME after a fast repeat. Keys pressed within SIMULTANEITY_TIME of each other add up,
and are held as long as the last of them. A key pressed later replaces those that are held, so
that a key whose release cannot be detected never keeps the robot moving together with a new one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from omniman_ros.core.framing import Twist

#: Time for which a key counts as held after a press, above the keyboard's repeat delay [s]
PRESS_HOLD_TIME = 0.6
REPEAT_HOLD_TIME = 0.2  #: Time for which a key counts as held after a fast repeat [s]
#: Longest interval between two fast repeats of a key [s].
#:
#: The first repeat of a key, and a key that is tapped, come at longer intervals.
FAST_REPEAT_INTERVAL = 0.15
SIMULTANEITY_TIME = 0.25  #: Longest time between the first presses of keys that add up [s]
SCALE_STEP = 1.1  #: Factor by which one press of + scales both speeds; a press of - divides by it
MIN_SCALE = 0.1  #: Smallest scale of both speeds
MAX_SCALE = 10.0  #: Largest scale of both speeds

Direction = tuple[int, int, int]  #: Signs of a motion forward, to the left, and counterclockwise

MOTIONS: dict[str, Direction] = {
    "w": (1, 0, 0),
    "s": (-1, 0, 0),
    "a": (0, 1, 0),
    "d": (0, -1, 0),
    "q": (0, 0, 1),
    "e": (0, 0, -1),
    "up": (1, 0, 0),
    "down": (-1, 0, 0),
    "left": (0, 0, 1),
    "right": (0, 0, -1),
    "u": (1, 1, 0),
    "o": (1, -1, 0),
    "m": (-1, 1, 0),
    ".": (-1, -1, 0),
    "i": (1, 0, 0),
    ",": (-1, 0, 0),
    "j": (0, 1, 0),
    "l": (0, -1, 0),
}  #: Direction in which each key moves the robot

#: Arrow keys by the last letter of their escape sequences
ARROW_KEYS = {"A": "up", "B": "down", "C": "right", "D": "left"}


def split_keys(text: str) -> Iterator[str]:
    """Yield the names of the keys in text from a terminal; other escape sequences are skipped."""
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
            if end == at + 2 and text[end : end + 1] in ARROW_KEYS:
                yield ARROW_KEYS[text[end]]
        at = end + 1


@dataclass
class _HeldKey:
    first: float
    last: float


class KeyTeleop:
    """Converts keys to a twist, with given speeds at scale 1 [m/s, rad/s].

    Args:
        linear: Speed at scale 1 [m/s].
        angular: Yaw rate at scale 1 [rad/s].
    """

    def __init__(self, linear: float, angular: float) -> None:
        self._linear = linear
        self._angular = angular
        self._held: dict[str, _HeldKey] = {}
        self._until = 0.0
        self.scale = 1.0

    def press(self, key: str, now: float) -> bool:
        """Process a key that was sent at a time [s]; return whether it moves the robot."""
        if key not in MOTIONS:
            return False
        if now >= self._until:
            self._held.clear()
        held = self._held.get(key)
        if held is not None:
            is_fast = now - held.last <= FAST_REPEAT_INTERVAL
            window = REPEAT_HOLD_TIME if is_fast else PRESS_HOLD_TIME
            held.last = now
        else:
            window = PRESS_HOLD_TIME
            if any(now - other.first > SIMULTANEITY_TIME for other in self._held.values()):
                self._held.clear()
            self._held[key] = _HeldKey(now, now)
        self._until = now + window
        return True

    def release(self) -> None:
        """Release all keys."""
        self._held.clear()
        self._until = 0.0

    def change_speed(self, factor: float) -> None:
        """Multiply the scale by a factor, within its bounds."""
        self.scale = min(max(self.scale * factor, MIN_SCALE), MAX_SCALE)

    @property
    def speeds(self) -> tuple[float, float]:
        """Linear [m/s] and angular [rad/s] speed that a key commands at this scale."""
        return self._linear * self.scale, self._angular * self.scale

    def twist(self, now: float) -> Twist | None:
        """Return the commanded body twist [m/s, m/s, rad/s] while keys are held, else None.

        Diagonal motions are as fast as the others; opposite keys cancel.
        """
        if now >= self._until:
            self.release()
            return None
        x, y, yaw = (
            float(max(-1, min(1, sum(MOTIONS[key][axis] for key in self._held))))
            for axis in range(3)
        )
        linear, angular = self.speeds
        if x and y:
            linear *= 0.5**0.5
        return x * linear, y * linear, yaw * angular
