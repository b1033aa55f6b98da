"""What an interface for paths of the tool needs of those that plan and drive them."""

from collections.abc import Callable
from typing import Protocol, TypeVar

from omniman_ros.core.arrays import Array

Plan = TypeVar("Plan")


class ToolDriver(Protocol[Plan]):
    """Plans motions along paths of the tool, and drives them."""

    def planner(self, poses: Array, start: Array) -> Callable[[], Plan]:
        """Return what plans a motion, which may be called in a thread.

        Args:
            poses: Poses (k, 4, 4) of `tool0` in odom.
            start: (9,) positions of all axes at rest.
        """
        ...

    def drive(self, plan: Plan) -> None:
        """Start a planned motion.

        Raises:
            InputError: It cannot be driven any more.
        """
        ...
