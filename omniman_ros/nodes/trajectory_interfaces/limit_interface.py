"""Limits of the speed: before contact, and by what dead wheels and the posture leave."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.conversions.motion_limits import motion_demand_message
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core import se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.motion_limit import MotionLimit
from omniman_ros.motion.axes import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.speed_bound import SpeedBound
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext
from omniman_ros.nodes.trajectory_interfaces.parameters import StreamParameters

#: Times from now at which the speed of a motion is compared with the limit [s]
LOOK_AHEAD = np.linspace(0.0, 0.4, 9)
#: Smallest change of a fraction that is acted upon at once; others wait for the next tick
CHANGE = 0.01
REST = 1e-6  #: Speed up to which a motion rests [m/s, rad/s]


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


class SampledMotion(Protocol):
    """Motion of the platform, the arm or both."""

    state: PathState

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at motion times (k,) [s]."""


class LimitInterface:
    """Subscribes to `motion_limit`, and publishes the demand of motions on `motion_demand`.

    A motion that stands because of the limit still asks for its direction: the limit depends on
    it.

    Args:
        motions: Motions, each with the axes of the whole body that it moves.
    """

    def __init__(
        self,
        node: OmnimanNode,
        read_options: Callable[[], StreamParameters],
        motions: Sequence[tuple[SampledMotion, slice]],
        on_change: Callable[[], None],
    ) -> None:
        self._node, self._read_options = node, read_options
        self._motions, self._on_change = tuple(motions), on_change
        options = read_options().collision_monitor
        self._platform, self._arm = MotionLimit(options), MotionLimit(options)
        self._acted_on = (1.0, 1.0)
        subscribe_to_motion_limit(
            node, platform=self._platform, arm=self._arm, on_update=self._act
        )
        self._demands = node.create_publisher(JointState, "motion_demand", QoSProfile(depth=1))

    def configure(self, new: StreamParameters) -> None:
        """Use other parameters."""
        self._platform.parameters = self._arm.parameters = new.collision_monitor

    def _act(self) -> None:
        """Report a change of a fraction that is large enough."""
        change = np.abs(np.array(self.fractions) - self._acted_on).max()
        if change > CHANGE:
            self._acted_on = self.fractions
            self._on_change()

    @property
    def fractions(self) -> tuple[float, float]:
        """Fractions of the speed limits that platform and arm may use now, 0 to 1."""
        now = self._node.now()
        return self._platform.fraction(now), self._arm.fraction(now)

    def max_pace(self, motion_time: float) -> float:
        """Return the highest pace, 0 to 1, within the limit from a motion time [s]."""
        fractions = self.fractions
        if min(fractions) >= 1.0:
            return 1.0
        p = self._read_options()
        bound = SpeedBound(*p.core.limits.velocity, np.array(p.arm.each("velocity")))
        return bound.pace(self._velocities(motion_time)[1], *fractions)

    def publish_demand(self, motion_time: float) -> None:
        """Publish what the motions ask for at full pace, where a limit is used."""
        p = self._read_options()
        if not p.collision_monitor.use:
            return
        heading, velocities = self._velocities(motion_time)
        # At its begin a motion rests: it asks for what comes next.
        moving = np.flatnonzero(np.abs(velocities).max(axis=1) > REST)
        k = int(moving[0]) if len(moving) else 0
        twist = se2.to_robot(float(heading[k]), velocities[k, PLATFORM_COLUMNS])
        motion = [*twist.tolist(), *velocities[k, JOINT_COLUMNS].tolist()]
        message = motion_demand_message(p.arm.joints, motion, self._node.stamp(), "base_link")
        self._demands.publish(message)

    def _velocities(self, motion_time: float) -> tuple[Array, Array]:
        """Return headings (k,) [rad] and velocities (k, 9) in odom over the next times."""
        times = motion_time + LOOK_AHEAD
        heading = np.zeros(len(times))
        velocities = np.zeros((len(times), PLATFORM_COLUMNS.stop + JOINTS))
        for motion, columns in self._motions:
            if motion.state is not PathState.IDLE:
                position, velocity, _ = motion.sample(times)
                velocities[:, columns] = velocity
                if columns.start is None:
                    heading = position[:, HEADING_COLUMN]
        return heading, velocities
