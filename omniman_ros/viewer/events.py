"""Events that a page sends to the node: pressed buttons, dragged objects, entered numbers."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from omniman_ros.core.errors import InputError
from omniman_ros.viewer.obstacle_paths import ObstaclePath, PathKind

MAX_EVENTS = 1000  #: Largest number of events that wait, or are processed at once
STOP = "stop"  #: Action of the button that stops the robot

Pose = tuple[float, float, float]  #: x, y [m], heading [rad] in `odom`


@dataclass(frozen=True)
class ButtonHeld:
    """A page reports, repeatedly, that a motion button is held."""

    client: int
    motion: str


@dataclass(frozen=True)
class ButtonReleased:
    """A motion button was released."""

    client: int
    motion: str


@dataclass(frozen=True)
class ClientDisconnected:
    """A page has lost its connection."""

    client: int


@dataclass(frozen=True)
class ButtonPressed:
    """Any other button was clicked."""

    #: stop, reset; pause, resume, cancel (path and planner alike); go (send the displayed goal);
    #: restart (move robot and obstacles back to the start); add (an obstacle); clear (trails);
    #: tour (end it, or begin it anew); tool_place (the handle at the tool), tool_add (a pose to
    #: its path), tool_send (the path), tool_remove (the handle).
    action: str


@dataclass(frozen=True)
class GoalDragged:
    """The goal is being dragged; `done` is true once it is released."""

    pose: Pose
    done: bool


@dataclass(frozen=True)
class StartDragged:
    """The start is being dragged; `done` is true once it is released."""

    pose: Pose
    done: bool


@dataclass(frozen=True)
class ObstacleDragged:
    """An obstacle of the page is being dragged to a position (x, y) in `odom` [m]."""

    number: int
    position: tuple[float, float]
    done: bool


@dataclass(frozen=True)
class ObstacleVelocitySet:
    """An obstacle of the page is given a velocity (x, y) in `odom` [m/s]."""

    number: int
    velocity: tuple[float, float]


@dataclass(frozen=True)
class ObstacleMotionSet:
    """An obstacle of the page is given another kind of motion."""

    number: int
    motion: PathKind


@dataclass(frozen=True)
class ObstaclePathSet:
    """An obstacle of the page is given a path."""

    number: int
    path: ObstaclePath


@dataclass(frozen=True)
class WaypointAdded:
    """A way point (x, y) in `odom` [m] is appended to the path of the selected obstacle."""

    number: int
    position: tuple[float, float]


@dataclass(frozen=True)
class ObstacleResized:
    """An obstacle of the page is given semi-axes [m] and a heading [rad]."""

    number: int
    semi_axes: tuple[float, float]
    angle: float


@dataclass(frozen=True)
class ObstacleSelected:
    """An obstacle of the page is selected for editing; None deselects."""

    number: int | None


@dataclass(frozen=True)
class ObstacleDeleted:
    """An obstacle of the page is deleted; None deletes all."""

    number: int | None


@dataclass(frozen=True)
class CaseSelected:
    """A test case of MPC 2021 is requested by name."""

    name: str


@dataclass(frozen=True)
class ParameterChanged:
    """A parameter of the planner is set."""

    name: str
    value: float


@dataclass(frozen=True)
class ToolHandleMoved:
    """The handle of the tool is moved to a position x, y, z [m] and a rotation (w, x, y, z)."""

    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


Event = (
    ButtonHeld
    | ButtonReleased
    | ClientDisconnected
    | ButtonPressed
    | GoalDragged
    | StartDragged
    | ObstacleDragged
    | ObstacleVelocitySet
    | ObstacleMotionSet
    | ObstaclePathSet
    | WaypointAdded
    | ObstacleResized
    | ObstacleSelected
    | ObstacleDeleted
    | CaseSelected
    | ParameterChanged
    | ToolHandleMoved
)  #: Any event


class EventQueue:
    """Passes events from the threads of the page to the thread of the node.

    A stop is served next, and what was requested before it is discarded: neither many events of
    one page nor slow handlers delay the Stop of another. Of too many events, the new ones are
    discarded; a button that is held is released without its events.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._events: deque[Event] = deque()
        self._closed = False

    def post(self, event: Event) -> None:
        """Append an event; may be called from any thread and hardly ever waits."""
        with self._lock:
            if event == ButtonPressed(STOP):
                self._events.clear()
            if not self._closed and len(self._events) < MAX_EVENTS:
                self._events.append(event)

    def process(
        self, handlers: Mapping[type, Callable[[Any, float], None]], now: float
    ) -> Iterator[InputError]:
        """Pass the queued events to the handlers of their types.

        Yields:
            The errors of the handlers that refused an event, as they occur.
        """
        for _ in range(MAX_EVENTS):
            with self._lock:
                if not self._events:
                    return
                event = self._events.popleft()
            try:
                handlers[type(event)](event, now)
            except InputError as error:
                yield error

    def close(self) -> None:
        """Discard all events, queued and future ones."""
        with self._lock:
            self._closed = True
            self._events.clear()
