"""Speed scaling of the arm's controller."""

from collections.abc import Callable

from std_msgs.msg import Float64

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Excess over the range 0 to 1 that is accepted, distance from its ends that counts as none, and
#: smallest change that counts.
SCALING_TOLERANCE = 1e-3


class ScalingInterface:
    """Subscribes to `arm/speed_scaling`, 0 to 1.

    Attributes:
        value: Speed scaling that was received last; 1 before the first message.
        silence: Time since the last message [s]; 0 before the first message.
    """

    def __init__(self, node: OmnimanNode, on_change: Callable[[], None]) -> None:
        self.value, self.silence = 1.0, 0.0
        self._received = False
        self._on_change = on_change
        node.create_subscription(
            Float64, "arm/speed_scaling", node.guarded("arm/speed_scaling", self._on_scaling), 1
        )

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the time that has elapsed [s]."""
        if self._received:
            self.silence += elapsed

    def forget(self) -> None:
        """Return to the state before the first message."""
        self.value, self.silence, self._received = 1.0, 0.0, False

    def _on_scaling(self, message: Float64) -> None:
        if not -SCALING_TOLERANCE <= message.data <= 1.0 + SCALING_TOLERANCE:
            raise InputError(f"{message.data} must be 0 to 1; {self.value:.3f} is kept")
        self._received, self.silence = True, 0.0
        value = min(max(message.data, 0.0), 1.0)
        # The ends of the range must be exact: at 0 nothing moves, at 1 nothing is slowed down.
        is_end = min(value, 1.0 - value) <= SCALING_TOLERANCE
        value = float(round(value)) if is_end else value
        if value != self.value and (is_end or abs(value - self.value) > SCALING_TOLERANCE):
            self.value = value
            self._on_change()
