"""Topics from which a collision monitor learns about the robot and what is around it."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.collision.monitor import RobotMotion
from omniman_ros.collision.solids import UprightSolids
from omniman_ros.collision.surroundings import Surroundings
from omniman_ros.conversions.motion_limits import demanded_motion
from omniman_ros.conversions.wheels import reported_limit_scales
from omniman_ros.core import se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.description.urdf import carries_arm
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import ObstacleInterface
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.trajectory_interfaces.arm_feed import ArmFeed
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.planning.obstacles.grid_map import GridMap
from omniman_ros.planning.obstacles.surroundings import ellipse_surroundings, grid_solids

MAP = "map"  #: What an occupied part of the map is called


class CollisionMonitorInputs:
    """Subscribes to the state of the robot, its surroundings and `motion_demand`.

    Attributes:
        braking_scale: Share of the platform's deceleration that dead wheels and the arm's posture
            leave.
    """

    def __init__(
        self, node: OmnimanNode, settings: ParameterSet[CollisionMonitorParameters]
    ) -> None:
        self._node, self._settings = node, settings
        p = settings.value
        self._joints = p.description.arm.joints
        self._has_arm = carries_arm(p.description.robot)
        self._odom = OdomFeed(node, "odom", p.frames.odom.odom_frame, lambda pose, at: None)
        self._arm = ArmFeed(node, self._joints, lambda: False, lambda: None)
        frames = FrameTransforms(node, lambda: settings.value.frames)
        self._watch = SourceWatch(node, frames)
        self._obstacles = ObstacleInterface(node, frames, p.obstacles, self._watch)
        self._map = UprightSolids.join([])
        self._grid = MapInterface(node, frames, p.map_reading.rule, self._use_map, self._watch)
        self._demands: dict[tuple[str, ...], tuple[float, Array]] = {}
        self.braking_scale = 1.0
        for kind, topic, handler, qos in (
            (JointState, "motion_demand", self._on_demand, QoSProfile(depth=10)),
            (DiagnosticStatus, "wheel_health", self._on_health, LATCHED),
        ):
            node.create_subscription(kind, topic, node.guarded(topic, handler), qos)

    def configure(self, new: CollisionMonitorParameters) -> None:
        """Use other parameters."""
        self._obstacles.configure(new.obstacles)
        self._grid.configure(new.map_reading.rule)

    # ---- messages -------------------------------------------------------------------------------

    def _use_map(self, grid: GridMap) -> None:
        self._map = grid_solids(grid)

    def _on_demand(self, message: JointState) -> None:
        motion = demanded_motion(message, self._joints)
        sent, now = self._node.instant(message.header.stamp), self._node.now()
        if now - sent > self._settings.value.demand_timeout:
            raise InputError(f"stale, {now - sent:.3f} s old")
        self._demands[tuple(sorted(message.name))] = min(sent, now), motion

    def _on_health(self, message: DiagnosticStatus) -> None:
        self.braking_scale = reported_limit_scales(message).total

    # ---- state ----------------------------------------------------------------------------------

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
        blind = self._watch.blind_reason()
        return [*faults, blind] if blind else faults

    def robot(self) -> RobotMotion | None:
        """Return where the robot is and how it moves, as last measured; None without odometry."""
        if self._odom.pose is None:
            return None
        twist = se2.to_robot(self._odom.pose[2], self._odom.velocity)
        position = rates = np.zeros(JOINTS)
        state = self._arm.state() if self._has_arm else None
        if state is not None:
            position, rates = state
        return RobotMotion(np.array(self._odom.pose), position, np.append(twist, rates))

    def demands(self) -> list[Array]:
        """Return the motions (9,) that sources ask for now."""
        timeout, now = self._settings.value.demand_timeout, self._node.now()
        return [motion for at, motion in self._demands.values() if 0.0 <= now - at <= timeout]

    def surroundings(self) -> Surroundings:
        """Return the obstacles as they are predicted for now, and then the map."""
        if self._odom.pose is not None:
            x, y, theta = self._odom.pose
            self._grid.update((x, y, theta))
        ellipses = self._obstacles.ellipses()
        return Surroundings.join(
            [ellipse_surroundings(ellipses), Surroundings.standing(self._map)]
        )

    def label(self, solid: int) -> str:
        """Return what one of the surroundings is called."""
        keys = self._obstacles.keys
        if solid >= len(keys):
            return MAP
        namespace, number = keys[solid]
        return f"obstacle {namespace[:40]} {number}"
