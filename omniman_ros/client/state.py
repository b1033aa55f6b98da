"""What is known of a robot: values with their age, and the errors of who asks for them."""

import math
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from omniman_ros.core.errors import OmnimanError

T = TypeVar("T")


class RobotError(OmnimanError):
    """A running robot is not there, or cannot do what it is asked to do."""


class RobotTimeoutError(RobotError, TimeoutError):
    """A robot has not done something in the time that it was given."""


class NodesRefusedError(RobotError):
    """Nodes have not stopped, or were not reset; `answers` has those of all nodes."""

    def __init__(self, action: str, answers: "tuple[NodeAnswer, ...]") -> None:
        faults = [f"{a.node}: {a.message or 'refused'}" for a in answers if not a.success]
        super().__init__(f"{action} failed: {'; '.join(faults)}")
        self.answers = answers


class PlanarPose(NamedTuple):
    """A pose of the platform in odom."""

    x: float  #: [m]
    y: float  #: [m]
    heading: float  #: [rad], in (-pi, pi]


class BodyTwist(NamedTuple):
    """A twist of the platform, in its own frame: x ahead, y to the left."""

    vx: float  #: [m/s]
    vy: float  #: [m/s]
    wz: float  #: Yaw rate [rad/s]


class NodeAnswer(NamedTuple):
    """The answer of one node to `stop` or `reset`."""

    node: str  #: Full name of the node
    success: bool
    message: str  #: What the node says, or that it does not answer


@dataclass(frozen=True, repr=False)
class Reading(Generic[T]):
    """The latest value of a topic, and its age."""

    topic: str
    #: Time since it was received [s], on the steady clock; infinite if nothing has been received
    age: float = math.inf
    _value: T | None = None

    def __repr__(self) -> str:
        return (
            f"<{self.topic}: {self._value if self.is_known else 'unknown'}, {self.age:.3g} s old>"
        )

    @property
    def is_known(self) -> bool:
        """Whether anything has been received."""
        return self.age < math.inf

    @property
    def value(self) -> T:
        """The latest value; RobotError if nothing has been received yet."""
        if self._value is None:
            raise RobotError(f"nothing has been received on '{self.topic}' yet")
        return self._value
