"""What an interface for paths of the tool needs of those that plan and drive them."""

from collections.abc import Callable
from typing import Protocol, TypeVar

from omniman_ros.core.arrays import Array

Plan = TypeVar("Plan")


class ToolDriver(Protocol[Plan]):
    """Plans motions along paths of the tool, and drives them."""

    def planner(self, poses: Array, start: Array) -> Callable[[], Plan]:
        """Return what plans tool poses (k, 4, 4) in odom from axes (9,), also in a thread."""
        ...

    def drive(self, plan: Plan) -> None:
        """Start a planned motion; raise InputError if it cannot be driven any more."""
        ...
