"""Outcome of the latest goal, as an enumeration and in words."""

from omniman_ros.nodes.motion_ledger import MotionLedger
from omniman_ros.planning.cycle import GoalOutcome

#: Outcomes of which the status warns
_TROUBLE = (GoalOutcome.WAITING, GoalOutcome.REFUSED, GoalOutcome.GIVEN_UP)


class GoalLog:
    """Outcome of the latest goal, the outcomes of goals by their numbers, and counts of goals."""

    def __init__(self) -> None:
        self.outcome, self.text = GoalOutcome.NONE, "no goal yet"
        self.accepted = self.refused = 0
        self._ledger = MotionLedger()
        self._waiting = self._driven = 0

    @property
    def is_trouble(self) -> bool:
        """Whether the status warns of the outcome while there is no goal."""
        return self.outcome in _TROUBLE

    @property
    def latest(self) -> int:
        """Number of the latest goal that could be used; 0 before the first."""
        return self._ledger.accepted

    @property
    def has_goal(self) -> bool:
        """Whether a goal waits or is driven to."""
        return bool(self._waiting or self._driven)

    def outcome_of(self, goal: int) -> str | None:
        """Return why a goal ended: empty if it was reached; None while it has not ended."""
        return None if goal in (self._waiting, self._driven) else self._ledger.outcome(goal)

    def receive(self) -> None:
        """Number a goal that can be used; it waits from now on."""
        self._ledger.accept()
        self._waiting = self._close(self._waiting, "replaced by a new goal") or self.latest

    def wait(self, reason: str) -> None:
        """Record that the goal waits."""
        self.outcome, self.text = GoalOutcome.WAITING, f"a goal waits: {reason}"

    def accept(self) -> None:
        """Record that the goal that waited is driven to from now on."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, ""
        self.accepted += 1
        self._close(self._driven, "replaced by a new goal")
        self._driven, self._waiting = self._waiting, 0

    def reject(self, reason: str) -> None:
        """Record that a goal could not be used; the others stay as they are."""
        self.outcome, self.text = GoalOutcome.REFUSED, f"a goal was refused: {reason}"
        self.refused += 1

    def refuse(self, reason: str) -> None:
        """Record that the goal that waited was refused."""
        self.reject(reason)
        self._waiting = self._close(self._waiting, reason)

    def give_up(self, reason: str) -> None:
        """Record that the goal was given up."""
        self.outcome, self.text = GoalOutcome.GIVEN_UP, f"the goal was given up: {reason}"
        self._driven = self._close(self._driven, reason)

    def cancel(self) -> None:
        """Record that the goal was cancelled, and any that waited."""
        self.outcome, self.text = GoalOutcome.CANCELLED, "cancelled"
        self._waiting = self._close(self._waiting, self.text)
        self._driven = self._close(self._driven, self.text)

    def arrive(self) -> None:
        """Record that the goal was reached."""
        self.outcome, self.text = GoalOutcome.ARRIVED, "arrived"
        self._driven = self._close(self._driven, "")

    def reject_plan(self, reason: str) -> None:
        """Record that the last plan to the accepted goal was not used."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, f"last plan not used: {reason}"

    def _close(self, goal: int, outcome: str) -> int:
        """Record how a goal ended, if there is one; return 0, the number of no goal."""
        if goal:
            self._ledger.close(outcome, goal)
        return 0
