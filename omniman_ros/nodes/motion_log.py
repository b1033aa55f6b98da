"""What becomes of the motions of a node, from the request of each to its end; no ROS."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from itertools import count

from omniman_ros.core.errors import InputError


class MotionKind(Enum):
    """Input of a motion, and what a motion of this input is called."""

    GOAL = ("goal", "goal")
    PATH = ("path", "path")
    ARM = ("arm", "trajectory")
    BODY = ("body", "trajectory")
    TOOL_PATH = ("tool_path", "tool path")

    def __init__(self, key: str, label: str) -> None:
        self.key, self.label = key, label


class MotionEvent(Enum):
    """What happened to a motion; the values are those of `motion_events` and of the statuses."""

    NONE = "none"  #: No motion yet
    RECEIVED = "received"
    WAITING = "waiting"  #: It waits until the robot is ready
    PLANNING = "planning"
    STARTED = "started"
    PAUSED = "paused"
    RESUMED = "resumed"
    REFUSED = "refused"
    REPLACED = "replaced"  #: A newer motion took over
    GIVEN_UP = "given_up"
    CANCELLED = "cancelled"  #: It was discarded, and the robot has come to rest
    ARRIVED = "arrived"  #: The robot is at rest at its end

    @property
    def is_end(self) -> bool:
        """Whether nothing more happens to the motion."""
        return self in _ENDS


_ENDS = frozenset(
    (
        MotionEvent.REFUSED,
        MotionEvent.REPLACED,
        MotionEvent.GIVEN_UP,
        MotionEvent.CANCELLED,
        MotionEvent.ARRIVED,
    )
)
#: Sentences of events that need more words than their reason
_SENTENCES = {
    MotionEvent.WAITING: "a {label} is waiting: {reason}",
    MotionEvent.REFUSED: "a {label} was refused: {reason}",
    MotionEvent.REPLACED: "replaced by a new {label}",
    MotionEvent.GIVEN_UP: "the {label} was given up: {reason}",
}
_NUMBERS = re.compile(r"[\d.]+")
_order = count(1)  #: Numbers of the events of all logs, in the order of time


@dataclass(eq=False)
class LoggedMotion:
    """A motion, from its request to its end."""

    log: "MotionLog"  #: Log of the interface that received it
    kind: MotionKind
    request: str  #: Stamp of the request: seconds, a point, and nine digits of nanoseconds
    number: int = 0  #: Number in its node; 0 until the motion is told of
    #: Why it ended, empty if it arrived; None while it has not ended
    outcome: str | None = None
    told: tuple[MotionEvent, str] = (MotionEvent.NONE, "")  #: Last event, reason without numbers


#: Tells clients of an event of a motion: its reason, and a sentence for the log of the process
Tell = Callable[[LoggedMotion, MotionEvent, str, str], None]


def is_trouble(event: MotionEvent, reason: str) -> bool:
    """Return whether to warn of an event; who pauses a motion by a request gives no reason."""
    if event is MotionEvent.PAUSED:
        return bool(reason)
    return event in (MotionEvent.WAITING, MotionEvent.REFUSED, MotionEvent.GIVEN_UP)


class MotionLog:
    """Events of the motions of one interface, each told once, and exactly one end of each motion.

    Args:
        numbers: Numbers of the node's motions.

    Attributes:
        driven: Motion under way, if any.
        is_paused: Whether it is paused.
        event: Latest event.
        text: The latest event in words.
        is_trouble: Whether the diagnostics warn of the latest event.
        order: Grows with each event of any log; 0 before the first event of this one.
        counts: Number of motions by their events.
    """

    def __init__(self, kind: MotionKind, numbers: "count[int]", tell: Tell) -> None:
        self._kind, self._numbers, self._tell = kind, numbers, tell
        self.event, self.text = MotionEvent.NONE, f"no {kind.label} yet"
        self.is_trouble, self.order = False, 0
        self.counts: Counter[MotionEvent] = Counter()
        self.driven: LoggedMotion | None = None
        self.is_paused = False

    def receive(
        self, request: str, kind: MotionKind | None = None, *, quietly: bool = False
    ) -> LoggedMotion:
        """Return a motion that was asked for.

        Args:
            request: Stamp of the request, see :class:`LoggedMotion`.
            kind: Input of the motion if it is another one than the log's.
            quietly: Whether to tell of the motion only if it is not refused.
        """
        motion = LoggedMotion(self, kind or self._kind, request)
        if not quietly:
            self._introduce(motion)
        return motion

    def _introduce(self, motion: LoggedMotion) -> None:
        motion.number = next(self._numbers)
        self.report(motion, MotionEvent.RECEIVED)

    def report(self, motion: LoggedMotion, event: MotionEvent, reason: str = "") -> None:
        """Record what happens to a motion; nothing happens to one that has ended.

        The latest event is told again if its reason changes otherwise than by its numbers.
        """
        if motion.outcome is not None:
            return
        if not motion.number and event is not MotionEvent.REFUSED:
            self._introduce(motion)
        form = _SENTENCES.get(event, "{reason}" if reason else event.value)
        text = form.format(label=motion.kind.label, reason=reason)
        for log in {self, motion.log}:
            log._show(event, text, reason)
        if event.is_end:
            motion.outcome = "" if event is MotionEvent.ARRIVED else text
            if event is MotionEvent.REFUSED:
                motion.outcome = reason
            if motion is self.driven:
                self.driven = None
        told, motion.told = motion.told, (event, _NUMBERS.sub("", reason))
        if motion.told == told:
            return
        self.counts[event] += 1
        if motion.number:
            self._tell(motion, event, reason, text)

    def _show(self, event: MotionEvent, text: str, reason: str) -> None:
        if (event, text) != (self.event, self.text):
            self.event, self.text, self.order = event, text, next(_order)
        self.is_trouble = is_trouble(event, reason)

    def refuse(self, motion: LoggedMotion, why: str) -> InputError:
        """Record a refusal; return the error for it."""
        self.report(motion, MotionEvent.REFUSED, why)
        return InputError(why)

    def start(self, motion: LoggedMotion, text: str = "") -> None:
        """Record that a motion, described by a text, is under way in place of the last one."""
        if self.driven is not None:
            self.report(self.driven, MotionEvent.REPLACED)
        self.driven, self.is_paused = motion, False
        self.report(motion, MotionEvent.STARTED, text)

    def pause(self, reason: str = "") -> None:
        """Record that the motion under way is paused; the node gives a reason if it does it."""
        if self.driven is not None:
            self.is_paused = True
            self.report(self.driven, MotionEvent.PAUSED, reason)

    def resume(self) -> None:
        """Record that the motion under way goes on, if it was paused."""
        if self.driven is not None and self.is_paused:
            self.is_paused = False
            self.report(self.driven, MotionEvent.RESUMED)

    def end(self, event: MotionEvent, reason: str = "") -> None:
        """Record the end of the motion under way, if there is one."""
        if self.driven is not None:
            self.report(self.driven, event, reason)
