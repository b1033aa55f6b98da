"""Begin and end of a stream of `cmd_vel` messages from manual control."""

Twist = tuple[float, float, float]  #: Body twist [m/s, m/s, rad/s]


class CmdVelFraming:
    """Adds zero twists to a stream of twists: one before, some after, then silence.

    The zero before marks a new motion, which was demanded after a stop and is not left over from
    before it: without it the controller does not use a cancelled source again. The silence after
    the stream lets other sources drive.

    Args:
        zeros: Number of zeros that follow the twists.
    """

    def __init__(self, zeros: int = 5) -> None:
        self._zeros = zeros
        self._remaining = 0

    def next(self, twist: Twist | None) -> Twist | None:
        """Return the twist to publish, if any; none is demanded while no key is held."""
        if twist is not None and self._remaining:
            self._remaining = self._zeros
            return twist
        if twist is not None:
            self._remaining = 1
        if self._remaining:
            self._remaining -= twist is None
            return 0.0, 0.0, 0.0
        return None
