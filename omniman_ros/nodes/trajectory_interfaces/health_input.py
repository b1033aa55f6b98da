"""Topic `wheel_health`: how much of the platform's limits dead wheels and the posture leave."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext


class HealthInput:
    """Scales the limits of the motions that move the platform."""

    def __init__(self, context: BodyContext, use: Callable[[float], None]) -> None:
        self._context, self._use = context, use
        self._scales = LimitScales()
        on_health = context.node.guarded("wheel_health", self._on_health)
        context.node.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)

    def _on_health(self, message: DiagnosticStatus) -> None:
        before, self._scales = self._scales, reported_limit_scales(message)
        if self._scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self._context.stream_monitor.restart(self._context.node.now())
        if self._scales.total != before.total:
            self._use(self._scales.total)
