"""The tour on the page: six things to try, each ticked off when somebody has done it there."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from omniman_ros.viewer.events import (
    STOP,
    ButtonHeld,
    ButtonPressed,
    Event,
    GoalDragged,
    ObstacleVelocitySet,
)

Handler = Callable[[Any, float], None]  #: Handles an event at a time [s], or refuses it


@dataclass(frozen=True)
class TourStep:
    """A step of the tour."""

    text: str  #: What to do, and what happens then
    is_done_by: Callable[[Event], bool]  #: Whether an event of a page is what is to be done


STEPS = (
    TourStep(
        "Hold Forward, or the key I: the robot drives until you let go.",
        lambda event: isinstance(event, ButtonHeld),
    ),
    TourStep(
        "Press Stop, or Space: nothing moves any more until Reset.",
        lambda event: event == ButtonPressed(STOP),
    ),
    TourStep(
        "Press Reset, then drag the blue goal: the robot plans its way there.",
        lambda event: isinstance(event, GoalDragged) and event.done,
    ),
    TourStep(
        "Obstacles, Add: an obstacle appears ahead of the robot.",
        lambda event: event == ButtonPressed("add"),
    ),
    TourStep(
        "Drag the tip of its arrow: it moves, and the planner minds where it will be.",
        lambda event: isinstance(event, ObstacleVelocitySet),
    ),
    TourStep(
        "Task, Moving, then Go: the robot crosses a floor where obstacles move.",
        lambda event: event == ButtonPressed("go"),
    ),
)  #: The steps in their order


class Tour:
    """Which steps of the tour are done; they may be done in any order."""

    def __init__(self) -> None:
        self._done = [False] * len(STEPS)

    def note(self, event: Event) -> None:
        """Tick off the steps that an event of a page does."""
        for k, step in enumerate(STEPS):
            self._done[k] = self._done[k] or step.is_done_by(event)

    def following(self, handlers: Mapping[type, Handler]) -> dict[type, Handler]:
        """Return handlers of events that also note those events that they do not refuse."""

        def followed(handler: Handler) -> Handler:
            def handle(event: Any, now: float) -> None:
                handler(event, now)
                self.note(event)

            return handle

        return {kind: followed(handler) for kind, handler in handlers.items()}

    def toggle(self) -> None:
        """End the tour, or begin it anew if it is at its end."""
        self._done = [bool(self.text)] * len(STEPS)

    @property
    def text(self) -> str:
        """The first step that is not done yet, with its number; empty at the end of the tour."""
        for k, (step, done) in enumerate(zip(STEPS, self._done, strict=True)):
            if not done:
                return f"{k + 1} of {len(STEPS)}: {step.text}"
        return ""
