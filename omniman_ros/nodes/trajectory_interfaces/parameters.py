"""Parameters of the node `path_interpolator`."""

from dataclasses import dataclass

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.self_collision import SelfCollisionCheck, SelfCollisionOptions
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.motion_limit import MotionLimitParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.path.trajectory_goal import TrajectoryActionOptions
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.frame_parameters import FrameParameters


@dataclass(frozen=True, kw_only=True)
class PathInterpolatorParameters:
    """Parameters of the node: those of its cores, of its streams and of its frames."""

    core: PathParameters = inline()
    arm: ArmParameters
    mount: Mount
    tool: ToolShape
    load: LoadShape
    self_collision: SelfCollisionOptions
    joint_trajectory: JointTrajectoryOptions
    tool_path: ToolPathOptions
    trajectory_action: TrajectoryActionOptions
    collision_monitor: MotionLimitParameters
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
    horizon: float = parameter(
        0.4,
        "Length of each preview; at its end the robot ramps to rest.",
        unit="s",
        low=0.1,
        high=5,
        read_only=True,
    )
    period: float = parameter(
        0.04, "Period of the previews.", unit="s", low=0.008, high=1, read_only=True
    )
    restart: float = parameter(
        1.2,
        "Silence after control was lost; longer than the controller's timeouts.cancelled.",
        unit="s",
        low=0.05,
        high=60,
    )
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


def self_collision_check(parameters: PathInterpolatorParameters) -> SelfCollisionCheck:
    """Return the check of motions for collisions of a robot with itself."""
    p = parameters
    description = DescriptionParameters(robot=p.core.robot, arm=p.arm, mount=p.mount)
    return SelfCollisionCheck(BodyGeometry(description, p.tool, p.load), p.self_collision)
