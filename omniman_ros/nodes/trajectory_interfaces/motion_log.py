"""What happens to the motions of an interface: for its status, for clients and for the log."""

import enum
import itertools

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motion_ledger import MotionLedger
from omniman_ros.nodes.omniman_node import OmnimanNode


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
        order: Grows with each event of any interface; 0 before the first event of this one.
    """

    def __init__(self, text: str) -> None:
        self.event, self.text, self.order = MotionEvent.NONE, text, 0

    def report(self, event: MotionEvent, text: str) -> None:
        """Record an event; repeating the latest one changes nothing."""
        if (event, text) != (self.event, self.text):
            self.event, self.text, self.order = event, text, next(_order)


class MotionLog:
    """Records each event of an interface's motions where it is asked for."""

    def __init__(self, node: OmnimanNode, kind: str) -> None:
        self._node, self._kind = node, kind
        self.status = MotionStatus(f"no {kind} yet")
        self.ledger = MotionLedger()

    def refuse(self, why: str) -> InputError:
        """Record a refusal; return the error for it."""
        self.status.report(MotionEvent.REFUSED, f"a {self._kind} was refused: {why}")
        return InputError(why)

    def accept(self, *, replaces_pending: bool) -> None:
        """Number a motion that was accepted, in place of the one that waits, if there is one."""
        if replaces_pending:
            self.ledger.close(self._replaced, self.ledger.accepted)
        self.ledger.accept()

    def wait(self, reason: str) -> None:
        """Record why the motion that was accepted last waits."""
        self.status.report(MotionEvent.WAITING, f"a {self._kind} is waiting: {reason}")

    def refuse_pending(self, why: str) -> None:
        """Record that the motion that waited was refused."""
        self.refuse(why)
        self.ledger.close(why, self.ledger.accepted)

    def discard_pending(self) -> None:
        """Record that the motion that waited was discarded."""
        self.ledger.close(MotionEvent.CANCELLED.value, self.ledger.accepted)

    def start(self, *, replaces_driven: bool) -> None:
        """Record that the motion that was accepted last has started."""
        if replaces_driven:
            self.ledger.close(self._replaced, self.ledger.started)
        self.ledger.start()

    def announce(self, text: str) -> None:
        """Describe the motion that has started."""
        self.status.report(MotionEvent.STARTED, text)
        self._node.get_logger().info(f"{self._kind}: {text}")

    def give_up(self, why: str) -> None:
        """Record that the motion under way was given up."""
        text = f"the {self._kind} was given up: {why}"
        self.status.report(MotionEvent.GIVEN_UP, text)
        self._node.warn(f"{self._kind} given up", text)
        self.ledger.close(text, self.ledger.started)

    def end(self, *, cancelled: bool) -> None:
        """Record that the motion under way came to rest by itself."""
        event = MotionEvent.CANCELLED if cancelled else MotionEvent.ARRIVED
        self.status.report(event, event.value)
        self.ledger.close(event.value if cancelled else "", self.ledger.started)
        self._node.get_logger().info(f"{self._kind}: {event.value}")

    @property
    def _replaced(self) -> str:
        return f"replaced by a new {self._kind}"
