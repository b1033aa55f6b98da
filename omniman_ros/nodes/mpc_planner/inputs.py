"""What the planner knows of the robot and its surroundings: topics in, state out."""

from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.footprint import Footprint
from omniman_ros.conversions.arm import joint_preview
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.arm_states import TOPIC as STATES
from omniman_ros.nodes.arm_states import ArmStatesReader
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.mpc_planner.parameters import MpcPlannerParameters, body_outline
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.robot_streams import OdomFeed
from omniman_ros.nodes.serialized import deserialized
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.planning.cycle import MeasuredState

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner

REFERENCE = "arm/joint_reference"  #: Name of the topic of the arm's previews


class ArmConfigurationSource(Enum):
    """Source of the arm's posture; the values are those of the key `arm` of `mpc/status`."""

    NO_ARM = "no arm"
    MEASURED = "measured"
    LAST_MEASURED = "last measured"
    ASSUMED = "assumed"


class ArmConfigurationInterface:
    """Subscribes to `arm/joint_states` and `arm/joint_reference`, read when a cycle needs them."""

    def __init__(self, node: OmnimanNode, settings: ParameterSet[MpcPlannerParameters]) -> None:
        self._node, self._settings = node, settings
        self._states = ArmStatesReader(node, settings.value.arm.joints)
        self._reference: bytes | None = None
        self._made: tuple[Array, Footprint] | None = None
        self._has_logged = False
        self.forget()
        self.configure(settings.value)
        handler = node.guarded(REFERENCE, self._on_reference)
        node.create_subscription(JointTrajectory, REFERENCE, handler, 1, raw=True)

    def configure(self, parameters: MpcPlannerParameters) -> None:
        """Use other shapes and another margin from the next cycle on."""
        self._outline: BodyOutline = body_outline(parameters)
        self._made = None

    def forget(self) -> None:
        """Forget all that was received, because time went back."""
        self._states.forget()
        self._reference = None
        self._expected: tuple[Array, Array] | None = None

    def source(self, now: float) -> ArmConfigurationSource:
        """Return where the posture comes from at the time `now` [s]."""
        if not self._outline.has_arm:
            return ArmConfigurationSource.NO_ARM
        if self._states.last is None:
            return ArmConfigurationSource.ASSUMED
        is_fresh = now - self._states.last.time <= self._settings.value.footprint.states_timeout
        return (
            ArmConfigurationSource.MEASURED if is_fresh else ArmConfigurationSource.LAST_MEASURED
        )

    def silence_reason(self, now: float) -> str:
        """Return why the robot must wait for the arm's posture, or an empty string."""
        if not self._settings.value.footprint.required:
            return ""
        if self.source(now) is ArmConfigurationSource.ASSUMED:
            return f"no {STATES} yet"
        last = self._states.last
        if last is None or self.source(now) is not ArmConfigurationSource.LAST_MEASURED:
            return ""
        return f"{STATES} are {now - last.time:.1f} s old"

    def footprint(self, now: float) -> Footprint:
        """Return the footprint of the robot, from now [s] on to the end of the known preview."""
        configurations = self._configurations(now)
        if self._made is None or not np.array_equal(self._made[0], configurations):
            margin = self._settings.value.footprint.height_margin
            self._made = configurations, self._outline.footprint(configurations, margin)
        return self._made[1]

    def _configurations(self, now: float) -> Array:
        """Return the measured or assumed posture, and those that the arm goes to, (k, 6)."""
        if not self._outline.has_arm:
            return np.zeros((0, 6))
        self._states.poll()
        self._read_reference(now)
        if self._states.last is None:
            self._log_assumption()
            here = np.array(self._settings.value.footprint.posture)
        else:
            here = self._states.last.position
        if self.source(now) is ArmConfigurationSource.LAST_MEASURED:
            self._node.warn(STATES, f"no {STATES}: the arm counts as being where it was last")
        if self._expected is None:
            return here[None]
        times, positions = self._expected
        return np.concatenate([here[None], positions[times > now]])

    def _log_assumption(self) -> None:
        if not self._has_logged:
            self._has_logged = True
            text = "footprint.posture is the arm's posture until arm/joint_states are received"
            self._node.get_logger().warning(text)

    def _on_reference(self, data: bytes) -> None:
        self._reference = data

    def _read_reference(self, now: float) -> None:
        """Read the reference that was received last, and drop one that has ended."""
        data, self._reference = self._reference, None
        if data is not None:
            try:
                message = deserialized(data, JointTrajectory)
                start = self._node.instant(message.header.stamp)
                names = self._settings.value.arm.joints
                times, positions, _, _ = joint_preview(message, start, names)
                plausible.demand(positions, plausible.ANGLE, "position")
                self._expected = times, positions
            except InputError as error:
                self._node.warn(REFERENCE, f"{REFERENCE} ignored: {error}")
        if self._expected is not None and self._expected[0][-1] < now:
            self._expected = None


class PlannerInputs:
    """Subscribes to `odom`, `obstacles`, `map` and `wheel_health`.

    Attributes:
        measured: Last measured state of the robot; None before the first.
        surroundings: What is around it.
    """

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        planner: "Planner",
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._settings = node, settings
        self._planner, self._monitor = planner, monitor
        self.measured: MeasuredState | None = None
        self._limit_scales = LimitScales()
        p = settings.value
        self._odom = OdomFeed(node, "odom", p.frames.odom.odom_frame, self._on_pose)
        self.surroundings = SurroundingsInterface(
            node, frames, p.core.obstacles, p.map_reading, planner.set_map
        )
        handler = node.guarded("wheel_health", self._on_health)
        node.create_subscription(DiagnosticStatus, "wheel_health", handler, LATCHED)

    def configure(self, new: MpcPlannerParameters) -> None:
        """Use other parameters."""
        self.surroundings.configure(new.core.obstacles, new.map_reading)

    def odom_fault(self, now: float) -> str:
        """Return why the odometry cannot be used at the time `now` [s], or an empty string."""
        if self.measured is None:
            return "no odom"
        age = now - self.measured.time
        return f"odom is {age:.2f} s old" if age > self._settings.value.odom_timeout else ""

    def update_map(self) -> None:
        """Move the map if its frame has moved against odom."""
        if self.measured is not None:
            x, y, theta = self.measured.pose.tolist()
            self.surroundings.update_map((x, y, theta))

    def _on_pose(self, pose: Array, time: float) -> None:
        self.measured = MeasuredState(time, pose, self._odom.twist)

    def _on_health(self, message: DiagnosticStatus) -> None:
        scales, before = reported_limit_scales(message), self._limit_scales
        self._limit_scales = scales
        # A scale that grows shows that the controller was reset and expects a pause of the stream.
        if scales.wheels > before.wheels:
            self._monitor.restart(self._node.now())
        self._planner.set_limit_scale(scales.total, scales.posture)
