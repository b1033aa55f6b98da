"""Parameters of the node `collision_monitor`."""

from dataclasses import dataclass, replace

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.monitor import MonitorParameters
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.speed_limits import SpeedLimits
from omniman_ros.collision.unseen import UnseenLimitParameters
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.nodes.frame_parameters import FrameParameters
from omniman_ros.nodes.surroundings_parameters import MapReading
from omniman_ros.surroundings.obstacles import ObstacleParameters


@dataclass(frozen=True, kw_only=True)
class CollisionMonitorParameters(Validated):
    """Parameters of the node: the shape and the limits of the robot, obstacles, and its own."""

    description: DescriptionParameters = inline()
    limits: TwistLimits
    tool: ToolShape
    load: LoadShape
    monitor: MonitorParameters
    unseen: UnseenLimitParameters
    obstacles: ObstacleParameters
    rate: float = parameter(
        40.0, "Rate of motion_limit.", unit="Hz", low=10, high=200, read_only=True
    )
    state_rate: float = parameter(
        5.0,
        "Largest rate of collision_state, which is published on change.",
        unit="Hz",
        low=0.2,
        high=50,
        read_only=True,
    )
    input_timeout: float = parameter(
        0.15,
        "Age from which odom and arm/joint_states are too old to judge the motion by.",
        unit="s",
        low=0.02,
        high=10,
    )
    demand_timeout: float = parameter(
        0.2,
        "Age from which a motion that was asked for no longer counts.",
        unit="s",
        low=0.02,
        high=10,
    )
    blind_speed: float = parameter(
        0.1,
        "Share of the speed limits that is left while an input is silent; 0: stop.",
        low=0.0,
        high=1.0,
    )
    frames: FrameParameters = inline()
    map_reading: MapReading = inline()

    @property
    def speed_limits(self) -> SpeedLimits:
        """Limits of the speed of platform and arm."""
        arm = self.description.arm
        return SpeedLimits(
            self.limits.velocity,
            self.limits.deceleration,
            arm.each("velocity"),
            arm.each("acceleration"),
        )

    def geometry(self, *, with_arm: bool) -> BodyGeometry:
        """Return the shape of the robot, or of its platform alone."""
        description = self.description
        if not with_arm:
            robot = description.robot
            platform = replace(robot, arm=replace(robot.arm, mass=0.0))
            description = replace(description, robot=platform)
        return BodyGeometry(description, self.tool, self.load)
