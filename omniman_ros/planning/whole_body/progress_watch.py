"""Progress of the tool on its path: when the robot waits, and when another way is searched for."""

import math

from omniman_ros.planning.whole_body.platform_path import NoPathError

#: Movement on the path within `BLOCKED` that counts as progress [m]: a robot that waits creeps
PROGRESS = 0.001
#: Time without progress after which the robot counts as waiting, and another way is searched for;
#: least time between two searches [s].
BLOCKED = 1.0


class ProgressWatch:
    """Watches a motion from a time on.

    Attributes:
        no_path: Why the last search found no way, until there is progress.
    """

    def __init__(self, now: float) -> None:
        self.no_path: NoPathError | None = None
        self._place, self._moved_at, self._at = 0.0, now, now
        self._placed_at = now
        self._held, self._was_held = 0.0, 0.0  # times for which a limit has held the robot [s]
        self._searched_at = -math.inf

    def waiting_time(self, now: float) -> float:
        """Return how long there has been no progress [s]."""
        return now - self._moved_at

    def excuse(self, now: float) -> None:
        """Note that no progress was expected since the last call: paused, braking or arrived."""
        self._moved_at += now - self._at
        self._at = now

    def note(self, now: float, place: float, *, is_held: bool, is_excused: bool) -> None:
        """Note the place on the path [m] at a time [s].

        Args:
            is_held: Whether a limit has slowed the robot down to a stand.
            is_excused: Whether this is what somebody wants, so that no progress is expected.
        """
        elapsed, self._at = now - self._at, now
        if place > self._place + PROGRESS:
            self._moved_at, self.no_path = now, None
        elif is_excused:
            self._moved_at += elapsed
        if place > self._place + PROGRESS or now - self._placed_at >= BLOCKED:
            self._place, self._placed_at = max(place, self._place), now
        self._was_held, self._held = self._held, self._held + elapsed if is_held else 0.0

    def is_search_due(self, now: float, *, is_obstructed: bool) -> bool:
        """Return whether another way is to be searched for now; True counts as a search.

        It is, at most once in a time, as an obstacle stands in the way of the plan, and while
        there is no progress, whatever the cause; once where a limit holds the robot for long, as
        that may depend on where the robot wants to go.
        """
        is_held = self._was_held < BLOCKED <= self._held
        is_blocked = is_obstructed or is_held or self.waiting_time(now) >= BLOCKED
        if not is_blocked or now - self._searched_at < BLOCKED:
            return False
        self._searched_at = now
        return True
