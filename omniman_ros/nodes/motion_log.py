"""What becomes of the motions of a node, from the request of each to its end, and who is told."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from itertools import count

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.conversions.headers import Stamp
from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import ALL_LATCHED


class MotionInput(Enum):
    """Input of a motion, and what a motion of this input is called."""

    GOAL = ("goal", "goal")
    PATH = ("path", "path")
    ARM = ("arm", "trajectory")
    BODY = ("body", "trajectory")
    TOOL_PATH = ("tool_path", "tool path")
    TOOL_GOAL = ("tool_goal", "tool goal")
    JOINT_GOAL = ("joint_goal", "joint goal")

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


_TROUBLE = ("waiting", "refused", "given_up")  #: Events to warn of
#: Events after which nothing more happens to a motion
_ENDS = ("refused", "replaced", "given_up", "cancelled", "arrived")
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
    kind: MotionInput
    request: str  #: Stamp of the request: seconds, a point, and nine digits of nanoseconds
    number: int = 0  #: Number in its node; 0 until the motion is told of
    #: Why it ended, empty if it arrived; None while it has not ended
    outcome: str | None = None
    told: tuple[MotionEvent, str] = (MotionEvent.NONE, "")  #: Last event, reason without numbers


#: Tells clients of an event of a motion: its reason, and a sentence for the log of the process
Tell = Callable[[LoggedMotion, MotionEvent, str, str], None]


def is_trouble(event: MotionEvent, reason: str) -> bool:
    """Return whether to warn of an event; who pauses a motion by a request gives no reason."""
    return event.value in _TROUBLE or (event is MotionEvent.PAUSED and bool(reason))


class MotionLog:
    """Events of one interface's motions, which have `numbers`; each has exactly one end."""

    def __init__(self, kind: MotionInput, numbers: "count[int]", tell: Tell) -> None:
        self._kind, self._numbers, self._tell = kind, numbers, tell
        #: Latest event, and the same in words
        self.event, self.text = MotionEvent.NONE, f"no {kind.label} yet"
        self.is_trouble = False  #: Whether the diagnostics warn of the latest event
        self.order = 0  #: Grows with each event of any log; 0 before the first of this one
        self.counts: Counter[MotionEvent] = Counter()  #: Number of motions by their events
        self.driven: LoggedMotion | None = None  #: Motion under way

    def receive(
        self, stamp: Stamp, kind: MotionInput | None = None, *, quietly: bool = False
    ) -> LoggedMotion:
        """Return what a message asks for; clients are told `quietly` of a motion that is used."""
        request = f"{stamp.sec}.{stamp.nanosec:09d}"
        motion = LoggedMotion(self, kind or self._kind, request)
        if not quietly:
            self.report(motion, MotionEvent.RECEIVED)
        return motion

    def report(
        self,
        motion: LoggedMotion,
        event: MotionEvent,
        reason: str = "",
        by: LoggedMotion | None = None,
    ) -> None:
        """Record what happens to a motion; nothing happens to one that has ended.

        The latest event is told again if its reason changes otherwise than by its numbers.

        Args:
            by: Motion by which it is replaced.
        """
        if motion.outcome is not None:
            return
        if not motion.number and event is not MotionEvent.REFUSED:
            motion.number = next(self._numbers)
            self.report(motion, MotionEvent.RECEIVED)
        form = _SENTENCES.get(event, "{reason}" if reason else event.value)
        text = form.format(label=(by or motion).kind.label, reason=reason)
        for log in {self, motion.log}:
            if (event, text) != (log.event, log.text):
                log.event, log.text, log.order = event, text, next(_order)
            log.is_trouble = is_trouble(event, reason)
        if event.value in _ENDS:
            motion.outcome = reason if event is MotionEvent.REFUSED else text
            if event is MotionEvent.ARRIVED:
                motion.outcome = ""
            if motion is self.driven:
                self.driven = None
        told, motion.told = motion.told, (event, _NUMBERS.sub("", reason))
        if motion.told == told:
            return
        self.counts[event] += 1
        if motion.number:
            self._tell(motion, event, reason, text)

    def end(self, motion: LoggedMotion, by: LoggedMotion | None) -> None:
        """Record that a motion was cancelled, or replaced by another one."""
        self.report(motion, MotionEvent.REPLACED if by else MotionEvent.CANCELLED, by=by)

    def refuse(self, motion: LoggedMotion, why: str) -> InputError:
        """Record a refusal; return the error for it."""
        self.report(motion, MotionEvent.REFUSED, why)
        return InputError(why)

    def start(self, motion: LoggedMotion, text: str = "") -> None:
        """Record that a motion, described by a text, is under way in place of the last one."""
        if self.driven is not None:
            self.report(self.driven, MotionEvent.REPLACED, by=motion)
        self.driven = motion
        self.report(motion, MotionEvent.STARTED, text)

    def note(self, event: MotionEvent, reason: str = "") -> None:
        """Record an event of the motion under way, if there is one; only a paused one resumes."""
        if self.driven is not None and (event is not MotionEvent.RESUMED or self.is_paused):
            self.report(self.driven, event, reason)

    @property
    def is_paused(self) -> bool:
        """Whether the motion under way is paused."""
        return self.driven is not None and self.driven.told[0] is MotionEvent.PAUSED


TOPIC = "motion_events"
_LOGGED = (MotionEvent.STARTED, MotionEvent.CANCELLED, MotionEvent.ARRIVED)


class MotionEvents:
    """Publishes `motion_events`, and numbers the motions of a node."""

    def __init__(self, node: OmnimanNode) -> None:
        self._node, self._numbers = node, count(1)
        self._received: dict[int, LoggedMotion] = {}  # of which nothing else was told, by number
        self._publisher = node.create_publisher(DiagnosticStatus, TOPIC, ALL_LATCHED)
        node.final_publishers.append(self._publisher)

    def log(self, kind: MotionInput) -> MotionLog:
        """Return a log whose events are published."""
        return MotionLog(kind, self._numbers, self._tell)

    def cancel_received(self) -> bool:
        """Cancel the motions that wait for transforms of their frames; return if there are any."""
        waiting = [*self._received.values()]
        for motion in waiting:
            motion.log.end(motion, None)
        return bool(waiting)

    def _tell(self, motion: LoggedMotion, event: MotionEvent, reason: str, text: str) -> None:
        if event is MotionEvent.RECEIVED:
            self._received[motion.number] = motion
        else:
            self._received.pop(motion.number, None)
        label = motion.kind.label
        if event is MotionEvent.GIVEN_UP:
            self._node.warn(f"{label} given up", text)
        elif event in _LOGGED:
            self._node.get_logger().info(f"{label}: {text}")
        level = DiagnosticStatus.WARN if is_trouble(event, reason) else DiagnosticStatus.OK
        values = [
            ("kind", motion.kind.key),
            ("event", event.value),
            ("motion", motion.number),
            ("request", motion.request),
        ]
        self._publisher.publish(self._node.status_message(level, reason, values))


class PendingMotion:
    """Has at most one accepted motion wait, and tells the log what becomes of it.

    A `conflict` refuses a motion at once; for a `blocking_reason` it waits.
    """

    def __init__(
        self,
        node: OmnimanNode,
        monitor: StreamMonitor,
        log: MotionLog,
        blocking_reason: Callable[[], str],
        conflict: Callable[[], str],
    ) -> None:
        self._monitor, self._log = monitor, log
        self._blocking_reason, self._conflict = blocking_reason, conflict
        self._pending = PendingStart(node.now, monitor)
        self.motion: LoggedMotion | None = None  #: The motion that waits

    def __bool__(self) -> bool:
        return bool(self._pending)

    def accept(self, motion: LoggedMotion, start: Callable[[], None]) -> str:
        """Accept a motion in place of the one that waits; start it, return or raise why not."""
        self.discard(motion)
        self.motion = motion
        self._pending.put(start)
        return self.start()

    def start(self) -> str:
        """Start the motion that waits if possible; return why it is refused, or ""."""
        refusal = self._monitor.blocking_reason or self._conflict()
        attempt = self._pending.attempt(refusal, self._blocking_reason)
        if self.motion is not None and attempt.state is StartState.WAITING:
            self._log.report(self.motion, MotionEvent.WAITING, attempt.reason)
            return ""
        motion, self.motion = self.motion, None
        if motion is not None and attempt.refusal:
            self._log.refuse(motion, attempt.refusal)
        return attempt.refusal

    def discard(self, by: LoggedMotion | None = None) -> bool:
        """Cancel the motion that waits, or replace it; return whether there was one."""
        motion, self.motion = self.motion, None
        if motion is not None:
            self._log.end(motion, by)
        return self._pending.discard()

    def restart_timeout(self) -> None:
        """Let the motion wait for the whole timeout from now on."""
        self._pending.restart_timeout()
