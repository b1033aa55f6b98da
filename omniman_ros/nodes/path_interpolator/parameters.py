"""Parameters of the node `path_interpolator`, and those it shares with `whole_body_planner`."""

from dataclasses import dataclass

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.self_collision import SelfCollisionCheck, SelfCollisionOptions
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.motion_limit import MotionLimitParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.joint_parameters import ArmFollowing, JointTrajectoryOptions
from omniman_ros.motion.path.parameters import PathParameters, PlatformMotionParameters
from omniman_ros.motion.path.trajectory_goal import TrajectoryActionOptions
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.frame_parameters import FrameParameters
from omniman_ros.nodes.preview_parameters import PeriodicPreviewParameters, PreviewParameters


@dataclass(frozen=True, kw_only=True)
class StreamParameters(PreviewParameters):
    """Parameters of a node that streams motions of platform and arm on one time base."""

    core: PlatformMotionParameters = inline()
    arm: ArmParameters
    mount: Mount
    tool: ToolShape
    load: LoadShape
    joint_trajectory: ArmFollowing
    tool_path: ToolPathOptions
    collision_monitor: MotionLimitParameters
    odom_timeout: float = parameter(
        0.5,
        "Age at which odom is too old to start a path or to continue one.",
        unit="s",
        low=0.02,
        high=10,
    )
    odom_pause: float = parameter(
        0.1,
        "Age of odom from which a motion of platform and arm comes to rest on its path, until "
        "odom comes again: about the time after which the drives stop without commands.",
        unit="s",
        low=0.02,
        high=10,
    )
    scaling_timeout: float = parameter(
        0.5,
        "Silence of arm/speed_scaling, once received, after which a trajectory of the arm is "
        "given up and new motions are not slowed down.",
        unit="s",
        low=0.05,
        high=60,
    )
    frames: FrameParameters = inline()

    @property
    def description(self) -> DescriptionParameters:
        """Shapes of platform and arm, and where the arm is mounted."""
        return DescriptionParameters(robot=self.core.robot, arm=self.arm, mount=self.mount)


@dataclass(frozen=True, kw_only=True)
class PathInterpolatorParameters(StreamParameters, PeriodicPreviewParameters):
    """Parameters of the node: those of its cores, of its streams and of its frames."""

    core: PathParameters = inline()
    joint_trajectory: JointTrajectoryOptions
    self_collision: SelfCollisionOptions
    trajectory_action: TrajectoryActionOptions
    arm_action: str = parameter(
        "arm_controller/follow_joint_trajectory", "Name of the arm's action.", read_only=True
    )
    body_action: str = parameter(
        "body_controller/follow_joint_trajectory",
        "Name of the whole body's action.",
        read_only=True,
    )
    path_action: str = parameter(
        "~/follow_path", "Name of the action that takes paths of the platform.", read_only=True
    )
    takes_tool_paths: bool = parameter(
        True,
        "Whether the node takes `tool_path`; false where `whole_body_planner` does.",
        read_only=True,
    )

    def self_collision_check(self) -> SelfCollisionCheck:
        """Return the check of motions for collisions of a robot with itself."""
        geometry = BodyGeometry(self.description, self.tool, self.load)
        return SelfCollisionCheck(geometry, self.self_collision)
