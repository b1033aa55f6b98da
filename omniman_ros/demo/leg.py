"""Base class of the demo's legs."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from omniman_ros.demo.driver import Driver
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording


class Leg(ABC):
    """A part of the demo, which drives the robot and measures its errors.

    Attributes:
        limits: Limits of the figures that `measure` returns.
    """

    limits: ClassVar[tuple[Limit, ...]] = ()

    @abstractmethod
    def drive(self, driver: Driver) -> None:
        """Drive this leg from the robot's present pose until the robot is at rest.

        Raises:
            CommandError: The robot did not follow a command, or stopped.
        """

    @abstractmethod
    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the figures of this leg by section of the result, once it has been driven."""
