"""Latest event of an interface, as an enumeration and in words."""

import enum
import itertools


class MotionEvent(enum.Enum):
    """What happened last to the motions of an interface.

    The values are published in the diagnostics, under keys that end in `_event`.
    """

    NONE = "none"
    PLANNING = "planning"
    WAITING = "waiting"
    REFUSED = "refused"
    STARTED = "started"
    PAUSED = "paused"
    GIVEN_UP = "given_up"
    CANCELLED = "cancelled"
    ARRIVED = "arrived"

    @property
    def is_trouble(self) -> bool:
        """Whether the diagnostics warn of this event."""
        return self in _TROUBLE


#: Events of which the diagnostics warn
_TROUBLE = (MotionEvent.WAITING, MotionEvent.REFUSED, MotionEvent.PAUSED, MotionEvent.GIVEN_UP)
_order = itertools.count(1)  #: Numbers of the events of all interfaces, in the order of time


class MotionStatus:
    """Latest event of one interface, comparable in time with those of the others.

    Attributes:
        text: The latest event in words, for humans only: nothing parses it.
        order: Grows with each event of any interface; 0 before the first event of this one.
    """

    def __init__(self, text: str) -> None:
        self.event, self.text, self.order = MotionEvent.NONE, text, 0

    def report(self, event: MotionEvent, text: str) -> None:
        """Record an event; repeating the latest one changes nothing."""
        if (event, text) != (self.event, self.text):
            self.event, self.text, self.order = event, text, next(_order)
