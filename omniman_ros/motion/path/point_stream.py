"""When a stream of points may move the arm: it never takes over by itself again."""

from omniman_ros.core.arbiter import NEVER


class PointStream:
    """State of a stream of points; all times are on one clock.

    A stream that lost control, or whose point was refused as nothing may move, is used again only
    after a pause. One that only fell silent goes on with its next point.
    """

    def __init__(self) -> None:
        self.active = False
        self._lost = ""
        self._received = self._fresh_until = NEVER

    def offer(self, now: float, refusal: str, pause: float) -> str:
        """Register a point; return why it is not used, or an empty string.

        No point may move the arm for a `refusal`. After a `pause` [s] a stream that lost control
        is used again.
        """
        if now - self._received > pause:
            self._lost = ""
        self._received = now
        if refusal:
            self.active, self._lost = False, refusal
            return refusal
        return self._lost and f"{self._lost}; the stream must pause for {pause:g} s"

    def follow(self, fresh_until: float) -> None:
        """Note that a point is followed, until a time [s] without another one."""
        self.active, self._fresh_until = True, fresh_until

    def is_silent(self, now: float) -> bool:
        """Return whether the stream drives the motion under way, and fell silent."""
        return self.active and now > self._fresh_until

    def end(self) -> None:
        """Note that its motion ends by itself: the next point begins anew."""
        self.active = False

    def lose(self, reason: str) -> None:
        """Note that something else ended its motion, if it drives one."""
        if self.active:
            self.active, self._lost = False, reason
