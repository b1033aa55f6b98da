"""What a page says: buttons held and pressed, things placed and dragged, values set."""

from dataclasses import dataclass

Pose = tuple[float, float, float]
"""x, y [m], heading [rad] in `odom`."""


@dataclass(frozen=True)
class Held:
    """A page says, again and again, that a button is held."""

    client: int
    motion: str


@dataclass(frozen=True)
class Released:
    """A button was let go."""

    client: int
    motion: str


@dataclass(frozen=True)
class Gone:
    """A page has lost its connection."""

    client: int


@dataclass(frozen=True)
class Pressed:
    """Another button was pressed.

    Attributes:
        action: stop, reset; pause, resume, cancel (path and planner alike); go (send the goal as
            it lies); restart (everything back to the start); add (an obstacle); clear (trails).
    """

    action: str


@dataclass(frozen=True)
class GoalDragged:
    """The goal is dragged; `done` when it is let go."""

    pose: Pose
    done: bool


@dataclass(frozen=True)
class StartDragged:
    """The start is dragged; `done` when it is let go."""

    pose: Pose
    done: bool


@dataclass(frozen=True)
class ObstacleDragged:
    """An obstacle of the page is dragged to a place (x, y) in odom [m]."""

    number: int
    place: tuple[float, float]
    done: bool


@dataclass(frozen=True)
class ObstacleSent:
    """An obstacle of the page is given a velocity (x, y) in odom [m/s]."""

    number: int
    velocity: tuple[float, float]


@dataclass(frozen=True)
class ObstacleShaped:
    """An obstacle of the page is given semi-axes [m] and a heading [rad]."""

    number: int
    semi_axes: tuple[float, float]
    angle: float


@dataclass(frozen=True)
class ObstacleChosen:
    """An obstacle of the page is chosen, to be shaped or deleted; None: none is."""

    number: int | None


@dataclass(frozen=True)
class ObstacleDeleted:
    """An obstacle of the page is deleted; None: all are."""

    number: int | None


@dataclass(frozen=True)
class CaseChosen:
    """A case of the paper is asked for by name."""

    name: str


@dataclass(frozen=True)
class Tuned:
    """A parameter of the planner is set."""

    name: str
    value: float


Event = (
    Held | Released | Gone | Pressed | GoalDragged | StartDragged | ObstacleDragged
    | ObstacleSent | ObstacleShaped | ObstacleChosen | ObstacleDeleted | CaseChosen | Tuned
)  # fmt: skip
