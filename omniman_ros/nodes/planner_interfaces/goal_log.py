"""Outcome of the latest goal, as an enumeration and in words."""

from omniman_ros.planning.cycle import GoalOutcome

_TROUBLE = (GoalOutcome.WAITING, GoalOutcome.REFUSED, GoalOutcome.GIVEN_UP)
"""Outcomes of which the status warns."""


class GoalLog:
    """Outcome of the latest goal, and counts of goals.

    Attributes:
        outcome: Outcome of the latest goal.
        text: The latest event in words, for humans only: nothing parses it.
        accepted: Number of goals that were accepted.
        refused: Number of goals that were refused.
    """

    def __init__(self) -> None:
        self.outcome, self.text = GoalOutcome.NONE, "no goal yet"
        self.accepted = self.refused = 0

    @property
    def is_trouble(self) -> bool:
        """Whether the status warns of the outcome while there is no goal."""
        return self.outcome in _TROUBLE

    def wait(self, reason: str) -> None:
        """Record that a goal waits."""
        self.outcome, self.text = GoalOutcome.WAITING, f"a goal waits: {reason}"

    def accept(self) -> None:
        """Record that a goal was accepted."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, ""
        self.accepted += 1

    def refuse(self, reason: str) -> None:
        """Record that a goal was refused."""
        self.outcome, self.text = GoalOutcome.REFUSED, f"a goal was refused: {reason}"
        self.refused += 1

    def give_up(self, reason: str) -> None:
        """Record that the goal was given up."""
        self.outcome, self.text = GoalOutcome.GIVEN_UP, f"the goal was given up: {reason}"

    def cancel(self) -> None:
        """Record that the goal was cancelled."""
        self.outcome, self.text = GoalOutcome.CANCELLED, "cancelled"

    def arrive(self) -> None:
        """Record that the goal was reached."""
        self.outcome, self.text = GoalOutcome.ARRIVED, "arrived"

    def reject_plan(self, reason: str) -> None:
        """Record that the last plan to the accepted goal was not used."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, f"last plan not used: {reason}"
