"""Hold-to-drive: a twist while a motion button is held, guarded by a dead man's switch."""

import math

from omniman_ros.core.framing import Twist
from omniman_ros.viewer.events import ButtonHeld, ButtonReleased, ClientDisconnected

MOTIONS: dict[str, Twist] = {
    "turn_left": (0.0, 0.0, 1.0),
    "forward": (1.0, 0.0, 0.0),
    "turn_right": (0.0, 0.0, -1.0),
    "left": (0.0, 1.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}  #: Direction of the body twist of each motion button, in the order of the page, three per row
DEAD_MAN_TIMEOUT = 0.2  #: Silence of a page after which the buttons it held count as released [s]


class HoldToDrive:
    """Motion buttons that are held, on any number of pages.

    A page repeats each button that it holds; one that is silent has released it,
    whatever the reason: a lost connection, a stalled browser, a page in the background. When
    several pages hold buttons, only the page that pressed last drives. Two buttons of one page
    (two fingers) add up.
    """

    def __init__(self) -> None:
        self._held_at: dict[tuple[int, str], float] = {}

    def update(self, event: ButtonHeld | ButtonReleased | ClientDisconnected, now: float) -> None:
        """Process an event of a page at a time `now` of any steady clock [s]."""
        if isinstance(event, ButtonHeld):
            if event.motion in MOTIONS:
                self._held_at[event.client, event.motion] = now
        elif isinstance(event, ButtonReleased):
            self._held_at.pop((event.client, event.motion), None)
        else:
            for key in [key for key in self._held_at if key[0] == event.client]:
                del self._held_at[key]

    def release_all(self) -> None:
        """Release every button."""
        self._held_at.clear()

    def twist(self, now: float, linear: float, angular: float) -> Twist | None:
        """Return the body twist that the held buttons request, or None while none is held.

        A button has a linear speed [m/s], which diagonals have too, or a yaw rate [rad/s].
        """
        for key, held_at in list(self._held_at.items()):
            if now - held_at >= DEAD_MAN_TIMEOUT:
                del self._held_at[key]
        if not self._held_at:
            return None
        driver = next(reversed(self._held_at))[0]
        directions = [MOTIONS[motion] for client, motion in self._held_at if client == driver]
        x, y, yaw = (sum(direction[axis] for direction in directions) for axis in range(3))
        scale = linear / max(math.hypot(x, y), 1.0)
        return x * scale, y * scale, yaw * angular
