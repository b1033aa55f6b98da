"""Topic `wheel_health`: how much of the platform's limits dead wheels and the posture leave."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext
from omniman_ros.nodes.trajectory_interfaces.whole_body_interface import WholeBodyInterface


class HealthInput:
    """Scales the limits of the motions that move the platform.

    Args:
        context: Services of the node.
        path: Interpolator of the platform's paths.
        whole_body: Motions of platform and arm together.
        on_change: Called when the limits have changed.
    """

    def __init__(
        self,
        context: MotionContext,
        path: PathInterpolator,
        whole_body: WholeBodyInterface,
        on_change: Callable[[], None],
    ) -> None:
        self._context, self._on_change = context, on_change
        self._path, self._whole_body = path, whole_body
        self._scales = LimitScales()
        on_health = context.node.guarded("wheel_health", self._on_health)
        context.node.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)

    def _on_health(self, message: DiagnosticStatus) -> None:
        before, self._scales = self._scales, reported_limit_scales(message)
        if self._scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self._context.stream_monitor.restart(self._context.node.now())
        limit_scale = self._scales.total
        if limit_scale != self._path.limit_scale:
            self._whole_body.limit_scale = limit_scale
            self._path.scale_limits(limit_scale, self._context.time_base.now())
            self._on_change()
