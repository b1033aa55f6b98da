"""Dragging over the floor: what a hand holds, where the pointer's ray leads it, what is shown.

The pointer is known as a point in space that it is in front of, and by the place of the camera:
what is dragged is moved on the level plane through the point where it was grabbed.
"""

import math
from collections import deque
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

Pair = tuple[float, float]
Thing = Hashable
"""What is dragged, as ("obstacle", 3)."""
Hand = Hashable
"""Who drags: a browser and what it has grabbed."""

FARTHEST = 60.0
"""Where a ray meets its plane farther away than this, it points at the horizon [m]."""
FORGET = 2.0
"""Silence after which what is dragged is shown where it is known to be again [s]."""
LINGER = 0.3
"""The same once it is let go: about what it takes until this is known everywhere [s]."""


def on_plane(eye: Sequence[float], through: Sequence[float], height: float) -> Pair | None:
    """Where the ray from the camera through a point meets a level plane, None for nowhere.

    Args:
        eye: Place of the camera (x, y, z) [m].
        through: Point (x, y, z) [m].
        height: Of the plane [m].
    """
    down = through[2] - eye[2]
    if abs(down) < 1e-9:
        return None
    along = (height - eye[2]) / down
    if not along > 0.0:
        return None
    dx, dy = along * (through[0] - eye[0]), along * (through[1] - eye[1])
    if not math.hypot(dx, dy) <= FARTHEST:
        return None
    return eye[0] + dx, eye[1] + dy


@dataclass(frozen=True)
class Grip:
    """A thing in a hand.

    Attributes:
        thing: See `Thing`.
        height: Of the point where it was grabbed [m].
        offset: From that point to the thing's place [m].
        place: Where the thing was led last [m].
    """

    thing: Thing
    height: float
    offset: Pair
    place: Pair


class Hands:
    """What is held. Points are in the world of the cameras, places are on the floor.

    `floor` is the place of the floor's origin in the world at that time [m].
    """

    def __init__(self) -> None:
        self._grips: dict[Hand, Grip] = {}

    def grab(
        self, hand: Hand, thing: Thing, place: Pair, point: Sequence[float], floor: Pair
    ) -> None:
        """Take hold of a thing.

        Args:
            hand: Whose.
            thing: Which.
            place: Where it is [m].
            point: Where it was grabbed (x, y, z) [m].
            floor: See above.
        """
        offset = place[0] - (point[0] - floor[0]), place[1] - (point[1] - floor[1])
        self._grips[hand] = Grip(thing, point[2], offset, place)

    def lead(
        self, hand: Hand, eye: Sequence[float], point: Sequence[float], floor: Pair
    ) -> Grip | None:
        """Lead a thing to where the pointer is; at the horizon it stays where it was.

        Returns:
            What is held, at its new place; None if nothing is.
        """
        grip = self._grips.get(hand)
        hit = None if grip is None else on_plane(eye, point, grip.height)
        if grip is None or hit is None:
            return grip
        (dx, dy), (x, y) = grip.offset, floor
        grip = self._grips[hand] = replace(grip, place=(hit[0] - x + dx, hit[1] - y + dy))
        return grip

    def let_go(self, hand: Hand) -> None:
        """Let go of what is held, if anything is."""
        self._grips.pop(hand, None)


class Ahead:
    """What is dragged is shown where the hand has it, ahead of what is known.

    A browser that stalls says nothing any more: what it dragged is then shown as it is known.
    `put` may be called by any thread, `values` by one.
    """

    def __init__(self) -> None:
        self._news: deque[tuple[Thing, Any, bool]] = deque()
        self._values: dict[Thing, Any] = {}
        self._until: dict[Thing, float] = {}

    def put(self, thing: Thing, value: Any, done: bool) -> None:
        """A thing is dragged; `done` when it is let go."""
        self._news.append((thing, value, done))

    def values(self, now: float) -> Mapping[Thing, Any]:
        """What is dragged at a time of any steady clock [s], and where it is shown."""
        while self._news:
            thing, value, done = self._news.popleft()
            self._values[thing] = value
            self._until[thing] = now + (LINGER if done else FORGET)
        for thing in [thing for thing, until in self._until.items() if now >= until]:
            del self._values[thing], self._until[thing]
        return self._values
