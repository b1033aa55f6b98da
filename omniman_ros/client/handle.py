"""One motion that was sent to a robot: what it does, and how it ends.

A handle knows no ROS. Whoever sends the motion tells it the node's events, which are those of the
topic `motion_events`, and the progress; any thread may read it, or wait for the end.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from omniman_ros.client.state import RobotTimeoutError
from omniman_ros.core.errors import OmnimanError

SENT = "sent"  #: State of a motion of which no node has said anything yet
STARTED = "started"  #: Event of a motion that is under way from then on
CANCEL_TIMEOUT = 10.0  #: Time within which a cancelled motion must come to rest [s]


class Outcome(enum.Enum):
    """How a motion ended; the values of all but LOST are events of `motion_events`."""

    ARRIVED = "arrived"  #: The robot stands at the end
    REFUSED = "refused"  #: It was never begun
    REPLACED = "replaced"  #: A newer motion took its place
    GIVEN_UP = "given_up"  #: The node abandoned it, for instance because of a stop
    CANCELLED = "cancelled"  #: Somebody cancelled it
    LOST = "lost"  #: No node has received it, or the node that drove it is gone


_ENDS = {outcome.value: outcome for outcome in Outcome}


@dataclass(frozen=True)
class MotionResult:
    """How a motion ended, and why."""

    outcome: Outcome
    reason: str  #: The node's words, which may be empty if it arrived


@dataclass(frozen=True)
class MotionFeedback:
    """What a motion does at the moment."""

    #: Latest event of the motion, such as waiting, planning, started, paused or arrived; `sent`
    #: before the first one
    state: str
    reason: str  #: The node's words about it
    #: Fraction of the motion that is done, 0 to 1; None while it is not known. Of motions that a
    #: node drives at the same time, it is that of the least advanced.
    progress: float | None
    remaining: float | None  #: Distance from the goal [m]; None for other motions


class MotionError(OmnimanError):
    """A motion did not arrive; `outcome` and `reason` say how it ended instead."""

    def __init__(self, motion: str, result: MotionResult) -> None:
        reason = f": {result.reason}" if result.reason else ""
        super().__init__(f"{motion}: {result.outcome.value}{reason}")
        self.outcome = result.outcome
        self.reason = result.reason


class MotionLink(Protocol):
    """The connection to the robot that a handle needs."""

    def wait(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        """Wait until a condition holds, up to a time [s]; return whether it does."""

    def request_cancel(self, handle: "MotionHandle") -> None:
        """Ask the node that drives a motion to cancel it, without waiting."""


class MotionHandle:
    """A motion that was sent to a robot.

    Attributes:
        name: What the motion is, for messages.
        kind: `goal`, `path`, `arm`, `tool`, `tool_goal` or `joint_goal`.
        node: Full name of the node that reports on it; empty before the first report.
    """

    def __init__(self, kind: str, name: str, link: MotionLink) -> None:
        self.kind, self.name, self.node = kind, name, ""
        self._link = link
        self._feedback = MotionFeedback(SENT, "", None, None)
        self._result: MotionResult | None = None
        self._has_started = False
        self._farthest = 0.1  # [m]: the least distance by which progress is measured
        self._cancel_answer: tuple[bool, str] | None = None

    def __repr__(self) -> str:
        return f"<{self.name}: {self._feedback.state}>"

    # ---- for the user ---------------------------------------------------------------------------

    @property
    def outcome(self) -> Outcome | None:
        """How the motion ended; None while it goes on."""
        return None if self._result is None else self._result.outcome

    @property
    def reason(self) -> str:
        """The node's words about the latest event."""
        return self._feedback.reason if self._result is None else self._result.reason

    @property
    def feedback(self) -> MotionFeedback:
        """What the motion does at the moment."""
        return self._feedback

    def result(self, timeout: float | None = None) -> MotionResult:
        """Wait for the end, and return it, whatever it is.

        Args:
            timeout: Longest time to wait [s]; None: for ever. The motion goes on after it.

        Raises:
            RobotTimeoutError: It has not ended in that time.
        """
        if not self._link.wait(lambda: self._result is not None, timeout):
            state, why = self._feedback.state, self._feedback.reason
            words = f"{state}: {why}" if why else state
            raise RobotTimeoutError(f"{self.name} has not ended within {timeout:g} s ({words})")
        assert self._result is not None
        return self._result

    def wait(self, timeout: float | None = None) -> None:
        """Wait until the robot has arrived.

        Raises:
            MotionError: The motion ended in another way.
            RobotTimeoutError: It has not ended within `timeout` [s]; it goes on.
        """
        result = self.result(timeout)
        if result.outcome is not Outcome.ARRIVED:
            raise MotionError(self.name, result)

    def cancel(self, timeout: float = CANCEL_TIMEOUT) -> MotionResult:
        """Brake, and wait until the node reports the end of the motion; return that end.

        A motion that has ended already stays as it ended. The node that drives it also cancels
        what else it drives: `path_interpolator` the motions of platform and arm.

        Raises:
            RobotTimeoutError: The node has not confirmed it within `timeout` [s]: the robot may go
                on.
        """
        if self._result is None:
            self._link.request_cancel(self)
            if not self._link.wait(lambda: self._result is not None, timeout):
                raise RobotTimeoutError(
                    f"{self.name}: {self._cancel_state} within {timeout:g} s: the robot may go "
                    "on; `stop` stops it"
                )
        assert self._result is not None
        return self._result

    @property
    def _cancel_state(self) -> str:
        if self._cancel_answer is None:
            return "the node did not confirm that it is cancelled"
        success, message = self._cancel_answer
        if success:
            return "the node has confirmed that it is cancelled, but has not come to rest"
        return f"the node did not cancel it ({message})"

    # ---- for who sends it -----------------------------------------------------------------------

    def report(self, node: str, event: str, reason: str) -> None:
        """Take an event of a node; what comes after the end changes nothing."""
        if self._result is not None:
            return
        self.node, old = node, self._feedback
        self._has_started = self._has_started or event == STARTED
        self._feedback = MotionFeedback(event, reason, old.progress, old.remaining)
        if event in _ENDS:
            self._result = MotionResult(_ENDS[event], reason)

    def lose(self, reason: str) -> None:
        """End the motion, because nobody will report on it any more."""
        self.report(self.node, Outcome.LOST.value, reason)

    def advance(self, progress: float) -> None:
        """Take the fraction of the motion that is done."""
        self._set_progress(progress, None)

    def approach(self, remaining: float) -> None:
        """Take the distance from the goal [m]."""
        self._farthest = max(self._farthest, remaining)
        self._set_progress(1.0 - remaining / self._farthest, remaining)

    def _set_progress(self, progress: float, remaining: float | None) -> None:
        old = self._feedback
        if self._has_started and self._result is None:
            bounded = min(max(progress, 0.0), 1.0)
            self._feedback = MotionFeedback(old.state, old.reason, bounded, remaining)

    def answer_cancel(self, success: bool, message: str) -> None:
        """Take the node's answer to the request to cancel."""
        self._cancel_answer = (success, message)
