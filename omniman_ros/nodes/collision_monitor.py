"""Node `collision_monitor`: limits the speed so that the robot stops before contact."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.monitor import CollisionMonitor, RobotMotion, SpeedLimit
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.obstacle_shapes import ellipse_surroundings, grid_obstacles
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.speed_limits import SpeedLimits
from omniman_ros.collision.unseen import Arrivals, OcclusionLimit
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.motion_limits import demanded_motion, motion_limit_message
from omniman_ros.conversions.unseen import arrivals_from_message
from omniman_ros.conversions.wheels import reported_limit_scales
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.description.urdf import carries_arm
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.robot_streams import ArmFeed, OdomFeed
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.surroundings.grid_map import GridMap

JOINT_TOLERANCE = 0.02  #: Rotation of a joint up to which the robot's outline stays [rad]
MAP = "map"  #: What an occupied part of the map is called


class UnseenInterface:
    """Subscribes to `unseen`, and has a collision monitor respect it."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[CollisionMonitorParameters],
        core: CollisionMonitor,
    ) -> None:
        self._node, self._settings, self._core = node, settings, core
        self._latest: tuple[float, Arrivals] | None = None
        self._outline: tuple[Array, Rectangles] | None = None
        handler = node.guarded("unseen", self._receive)
        node.create_subscription(OccupancyGrid, "unseen", handler, QoSProfile(depth=1))

    def configure(self) -> None:
        """Look at the shape of the robot anew."""
        self._outline = None

    def _receive(self, message: OccupancyGrid) -> str | None:
        p, now = self._settings.value, self._node.now()
        check_frame(message.header.frame_id, p.frames.odom.odom_frame)
        sent = min(self._node.instant(message.header.stamp), now)
        if now - sent > p.unseen.timeout:
            return f"stale, {now - sent:.3f} s old"
        if self._latest is not None and 0.0 < self._latest[0] - sent <= p.unseen.timeout:
            return f"out of order, {self._latest[0] - sent:.3f} s before the last one"
        self._latest = sent, arrivals_from_message(message)
        return None

    def fault(self) -> str:
        """Return why the topic cannot be used, or an empty string if it can or need not be."""
        p = self._settings.value.unseen
        if not p.use:
            return ""
        if self._latest is None:
            return "no unseen"
        age = self._node.now() - self._latest[0]
        return "" if 0.0 <= age <= p.timeout else f"unseen is {age:.2f} s old"

    def limit(self, robot: RobotMotion, demands: list[Array], *, sees_arm: bool) -> OcclusionLimit:
        """Return the limit of the platform's speed for motions (9,) that are asked for."""
        p = self._settings.value.unseen
        if not p.use or self._latest is None:
            return OcclusionLimit()
        sent, arrivals = self._latest
        arrivals = arrivals.after(max(self._node.now() - sent, 0.0))
        outline = self._footprint(robot.joints, sees_arm)
        return self._core.unseen_limit(robot, demands, arrivals, outline, p)

    def _footprint(self, joints: Array, sees_arm: bool) -> Rectangles:
        """Return rectangles around the robot, without an arm whose posture is not known."""
        if self._outline is None or np.abs(joints - self._outline[0]).max() > JOINT_TOLERANCE:
            p = self._settings.value
            made = BodyOutline(p.description, p.tool, p.load).footprint(joints[None], 0.0)
            self._outline = joints, made.whole if sees_arm else made.platform
        return self._outline[1]


class CollisionMonitorInputs:
    """Subscribes to the state of the robot, its surroundings and `motion_demand`.

    Attributes:
        braking_scale: Fraction of the deceleration that dead wheels and the arm's posture leave.
    """

    def __init__(
        self, node: OmnimanNode, settings: ParameterSet[CollisionMonitorParameters]
    ) -> None:
        self._node, self._settings = node, settings
        p = settings.value
        self._joints = p.description.arm.joints
        self._has_arm = carries_arm(p.description.robot)
        self._odom = OdomFeed(node, "odom", p.frames.odom.odom_frame)
        self._arm = ArmFeed(node, self._joints)
        frames = FrameTransforms(node, lambda: settings.value.frames)
        self._map = UprightObstacles.join([])
        self._surroundings = SurroundingsInterface(
            node, frames, p.obstacles, p.map_reading, self._use_map
        )
        self._demands: dict[tuple[str, ...], tuple[float, Array]] = {}
        self.braking_scale = 1.0
        for kind, topic, handler, qos in (
            (JointState, "motion_demand", self._on_demand, QoSProfile(depth=10)),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            node.create_subscription(kind, topic, node.guarded(topic, handler), qos)

    def configure(self, new: CollisionMonitorParameters) -> None:
        """Use other parameters."""
        self._surroundings.configure(new.obstacles, new.map_reading)

    def _use_map(self, grid: GridMap) -> None:
        self._map = grid_obstacles(grid)

    def _on_demand(self, message: JointState) -> None:
        motion = demanded_motion(message, self._joints)
        sent, now = self._node.instant(message.header.stamp), self._node.now()
        if now - sent > self._settings.value.demand_timeout:
            raise InputError(f"stale, {now - sent:.3f} s old")
        self._demands[tuple(sorted(message.name))] = min(sent, now), motion

    def _on_health(self, message: DiagnosticStatus) -> None:
        self.braking_scale = reported_limit_scales(message).total

    @property
    def sees_arm(self) -> bool:
        """Whether the robot has an arm whose joint angles are known."""
        return self._has_arm and self._arm.state() is not None

    def faults(self) -> list[str]:
        """Return which inputs are missing or silent, and how long they have been."""
        timeout = self._settings.value.input_timeout
        faults = []
        if self._odom.pose is None:
            faults.append("no odom")
        elif self._odom.age > timeout:
            faults.append(f"odom is {self._odom.age:.2f} s old")
        if self.sees_arm and self._arm.age > timeout:
            faults.append(f"arm/joint_states are {self._arm.age:.2f} s old")
        blind = self._surroundings.blind_reason()
        return [*faults, blind] if blind else faults

    def robot(self) -> RobotMotion | None:
        """Return where the robot is and how it moves, as last measured; None without odometry."""
        if self._odom.pose is None:
            return None
        position = rates = np.zeros(JOINTS)
        state = self._arm.state() if self._has_arm else None
        if state is not None:
            position, rates = state
        return RobotMotion(np.array(self._odom.pose), position, np.append(self._odom.twist, rates))

    def demands(self) -> list[Array]:
        """Return the motions (9,) that sources ask for now."""
        timeout, now = self._settings.value.demand_timeout, self._node.now()
        return [motion for at, motion in self._demands.values() if 0.0 <= now - at <= timeout]

    def surroundings(self) -> MovingObstacles:
        """Return the obstacles as they are predicted for now, and then the map."""
        if self._odom.pose is not None:
            self._surroundings.update_map(self._odom.pose)
        ellipses = self._surroundings.obstacles.ellipses()
        return MovingObstacles.join(
            [ellipse_surroundings(ellipses), MovingObstacles.standing(self._map)]
        )

    def label(self, obstacle: int) -> str:
        """Return what one of the surroundings is called."""
        keys = self._surroundings.obstacles.keys
        if obstacle >= len(keys):
            return MAP
        namespace, number = keys[obstacle]
        return f"obstacle {namespace[:40]} {number}"


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
        if unseen.position is not None and unseen.fraction < limit.platform:
            x, y = unseen.position
            reason = f"somebody whom no scanner sees may step out at ({x:.1f}, {y:.1f})"
            bounded = SpeedLimit(unseen.fraction, limit.arm)
            return MonitorState("slowing" if unseen.fraction else "stopping", reason, bounded)
        encounter = limit.encounter
        if encounter is None:
            return MonitorState("free", "", limit)
        other = inputs.label(encounter.obstacle)
        reason = f"{encounter.part} is {encounter.distance:.2f} m from {other}"
        is_stopping = min(limit.platform, limit.arm) <= 0.0
        return MonitorState("stopping" if is_stopping else "slowing", reason, limit)

    def _limits_left(self) -> SpeedLimits:
        """Return the limits of the speed, with the deceleration of which the robot is capable."""
        limits, scale = self.settings.value.speed_limits, self.inputs.braking_scale
        linear, angular = limits.deceleration
        return replace(limits, deceleration=(scale * linear, scale * angular))

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
                ("obstacle", self.inputs.label(limit.encounter.obstacle)),
                ("distance_m", round(limit.encounter.distance, 3)),
            ]
        if not state.reason:
            return DiagnosticStatus.OK, state.name, values
        return DiagnosticStatus.WARN, f"{state.name}: {state.reason}", values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros collision_monitor`."""
    return run(CollisionMonitorNode, args)
