"""How a stream of `cmd_vel` begins and ends, for those who drive by hand."""

Twist = tuple[float, float, float]
"""Body twist [m/s, m/s, rad/s]."""


class Framing:
    """Decides what to publish a tick: a zero, twists while keys are held, some zeros, nothing.

    The zero before says that this is a new motion, asked for after a stop and not left over from
    before it: the controller does not hear a cancelled source again without. Silence in the end
    lets other sources drive.

    Args:
        zeros: How many zeros follow.
    """

    def __init__(self, zeros: int = 5) -> None:
        self._zeros = zeros
        self._left = 0

    def next(self, twist: Twist | None) -> Twist | None:
        """The twist to publish in this tick, or None for none."""
        if twist is not None and self._left:
            self._left = self._zeros
            return twist
        if twist is not None:
            self._left = 1
        if self._left:
            self._left -= twist is None
            return 0.0, 0.0, 0.0
        return None
