"""Everything the node is set by, declared once."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import Mount
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.parameters import PathParameters
from omniman_ros.core.path.trajectory_goal import TrajectoryActionOptions


@dataclass(frozen=True, kw_only=True)
class PathInterpolatorParameters:
    """Parameters of the node: those of its cores, of the stream, and frames."""

    core: PathParameters = inline()
    arm: ArmParameters
    mount: Mount
    joint_trajectory: JointTrajectoryOptions
    tool_path: ToolPathOptions
    trajectory_action: TrajectoryActionOptions
    arm_action: str = parameter(
        "arm_controller/follow_joint_trajectory", "Name of the arm's action.", read_only=True
    )
    body_action: str = parameter(
        "body_controller/follow_joint_trajectory", "Name of the whole body's action.",
        read_only=True,
    )  # fmt: skip
    horizon: float = parameter(
        0.4, "How far each preview reaches; at its end the robot ramps to rest.",
        unit="s", low=0.1, high=5, read_only=True,
    )  # fmt: skip
    period: float = parameter(
        0.04, "Period of the previews.", unit="s", low=0.008, high=1, read_only=True
    )
    restart: float = parameter(
        1.2, "Silence after control was lost: longer than the controller's timeouts.cancelled.",
        unit="s", low=0.05, high=60,
    )  # fmt: skip
    odom_timeout: float = parameter(
        0.5, "Age at which odom is too old to begin a path, or to go on with one.",
        unit="s", low=0.02, high=10,
    )  # fmt: skip
    scaling_timeout: float = parameter(
        0.5, "Silence of arm/speed_scaling, once heard, after which a trajectory of the arm is "
        "given up, and new motions are not slowed.", unit="s", low=0.05, high=60,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of odometry and references.", read_only=True)
    map_is_odom: bool = parameter(False, "Whether paths in `map` are taken for odom.")

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames that are taken for odom."""
        return (self.odom_frame, "map") if self.map_is_odom else (self.odom_frame,)
