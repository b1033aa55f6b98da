"""What a node with motions hears of the arm's speed scaling."""

from collections.abc import Callable

from std_msgs.msg import Float64

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.runtime import OmnimanNode

ROUND_OFF = 1e-3
"""How far beyond 0 to 1 it may be, and which changes count."""


class ScalingPort:
    """Input `arm/speed_scaling`, 0 to 1.

    Args:
        node: The node that moves something.
        changed: Called after each change.

    Attributes:
        value: The last that was heard, 1 before.
        silent: Time since it was heard [s]; 0 before.
    """

    def __init__(self, node: OmnimanNode, changed: Callable[[], None]) -> None:
        self.value, self.silent = 1.0, 0.0
        self._heard = False
        self._changed = changed
        node.create_subscription(
            Float64, "arm/speed_scaling", node.guarded("arm/speed_scaling", self._on_scaling), 1
        )

    def pass_time(self, elapsed: float) -> None:
        """Let time pass [s]."""
        if self._heard:
            self.silent += elapsed

    def forget(self) -> None:
        """Be as if nothing had been heard."""
        self.value, self.silent, self._heard = 1.0, 0.0, False

    def _on_scaling(self, message: Float64) -> None:
        if not -ROUND_OFF <= message.data <= 1.0 + ROUND_OFF:
            raise InputError(f"{message.data}, expected 0 to 1; {self.value:.3f} is kept")
        self._heard, self.silent = True, 0.0
        value = min(max(message.data, 0.0), 1.0)
        # The ends count exactly: at 0 nothing moves, at 1 nothing is slowed.
        if value != self.value and (value in (0.0, 1.0) or abs(value - self.value) > ROUND_OFF):
            self.value = value
            self._changed()
