"""Node `collision_monitor`: limits the speed so that the robot stops before contact."""

from dataclasses import dataclass, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.collision.monitor import CollisionMonitor, SpeedLimit
from omniman_ros.collision.speed_limits import SpeedLimits
from omniman_ros.conversions.motion_limits import motion_limit_message
from omniman_ros.nodes.collision_monitor_inputs import CollisionMonitorInputs
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.unseen_interface import UnseenInterface


@dataclass(frozen=True)
class MonitorState:
    """What the monitor does, and why."""

    name: str  #: `free`, `slowing`, `stopping` or `blind`
    reason: str  #: Why it limits the speed; empty if it does not
    limit: SpeedLimit


class CollisionMonitorNode(OmnimanNode):
    """Connects a collision monitor to its topics."""

    def __init__(self, **options: Any) -> None:
        super().__init__("collision_monitor", **options)
        self.settings = ParameterSet(self, CollisionMonitorParameters)
        p = self.settings.value
        self._platform, self._whole = p.geometry(with_arm=False), p.geometry(with_arm=True)
        self.core = CollisionMonitor(self._platform, p.speed_limits, p.monitor)
        self.inputs = CollisionMonitorInputs(self, self.settings)
        self._unseen = UnseenInterface(self, self.settings, self.core)
        self.settings.on_change(self._configure)
        self._limits = self.create_publisher(JointState, "motion_limit", QoSProfile(depth=1))
        self._states = self.create_publisher(DiagnosticStatus, "collision_state", LATCHED)
        self.state = MonitorState("blind", "no odom", SpeedLimit())
        self._published: MonitorState | None = None
        self.every(1.0 / p.rate, self.tick)
        self.every(1.0 / p.state_rate, self._publish_state)

    def _configure(self, new: CollisionMonitorParameters) -> None:
        self._whole = new.geometry(with_arm=True)
        self.core.parameters = new.monitor
        self.inputs.configure(new)
        self._unseen.configure()

    def tick(self) -> None:
        """Publish the limit of the speed."""
        self.state = self._judge()
        limit = self.state.limit
        self._limits.publish(motion_limit_message(limit.platform, limit.arm, self.stamp()))
        if self._published is None or self._published.name != self.state.name:
            self._publish_state()

    def _judge(self) -> MonitorState:
        """Return the limit for the present motion, and why there is one."""
        inputs, robot = self.inputs, self.inputs.robot()
        blind, faults = self.settings.value.blind_speed, inputs.faults()
        if self._unseen.fault():
            faults.append(self._unseen.fault())
        if robot is None:
            return MonitorState("blind", "; ".join(faults), SpeedLimit(blind, blind))
        self.core.geometry = self._whole if inputs.sees_arm else self._platform
        self.core.limits = self._limits_left()
        limit = self.core.limit(robot, inputs.demands(), inputs.surroundings())
        if faults:
            bounded = SpeedLimit(min(limit.platform, blind), min(limit.arm, blind))
            return MonitorState("blind", "; ".join(faults), bounded)
        unseen = self._unseen.limit(robot, inputs.demands(), sees_arm=inputs.sees_arm)
        if unseen.place is not None and unseen.share < limit.platform:
            x, y = unseen.place
            reason = f"somebody whom no scanner sees may step out at ({x:.1f}, {y:.1f})"
            bounded = SpeedLimit(unseen.share, limit.arm)
            return MonitorState("slowing" if unseen.share else "stopping", reason, bounded)
        encounter = limit.encounter
        if encounter is None:
            return MonitorState("free", "", limit)
        reason = (
            f"{encounter.part} is {encounter.distance:.2f} m from {inputs.label(encounter.solid)}"
        )
        is_stopping = min(limit.platform, limit.arm) <= 0.0
        return MonitorState("stopping" if is_stopping else "slowing", reason, limit)

    def _limits_left(self) -> SpeedLimits:
        """Return the limits of the speed, with the deceleration of which the robot is capable."""
        limits, scale = self.settings.value.speed_limits, self.inputs.braking_scale
        linear, angular = limits.deceleration
        return replace(limits, deceleration=(scale * linear, scale * angular))

    # ---- status -------------------------------------------------------------------------------

    def _publish_state(self) -> None:
        """Publish what the monitor does if that has changed."""
        if self.state == self._published:
            return
        self._published = self.state
        self._states.publish(self.status_message(*self.status()))

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        state, limit = self.state, self.state.limit
        values: list[tuple[str, object]] = [
            ("state", state.name),
            ("reason", state.reason),
            ("platform", round(limit.platform, 3)),
            ("arm", round(limit.arm, 3)),
            ("watches", "platform and arm" if self.inputs.sees_arm else "platform"),
        ]
        if limit.encounter is not None:
            values += [
                ("part", limit.encounter.part),
                ("obstacle", self.inputs.label(limit.encounter.solid)),
                ("distance_m", round(limit.encounter.distance, 3)),
            ]
        if not state.reason:
            return DiagnosticStatus.OK, state.name, values
        return DiagnosticStatus.WARN, f"{state.name}: {state.reason}", values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros collision_monitor`."""
    return run(CollisionMonitorNode, args)
