"""Parameters from which the description of a robot is made."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated
from omniman_ros.description.urdf import carries_arm, require_joint_names, urdf
from omniman_ros.motion.whole_body.model import Mount


@dataclass(frozen=True, kw_only=True)
class DescriptionParameters(Validated):
    """The platform, the arm's joints, and the pose of the arm on the platform."""

    robot: Platform = inline()
    arm: ArmParameters
    mount: Mount
    describe_arm: bool = parameter(
        True,
        "Whether the URDF has the arm of a robot that carries one; not where nothing moves it, as "
        "its joints are then in no joint_states.",
        read_only=True,
    )

    def __post_init__(self) -> None:
        """Check that the names of the joints are valid in a URDF and in joint states.

        Raises:
            ParameterError: A joint's name is used twice, or cannot be written.
        """
        super().__post_init__()
        require_joint_names(self.robot, self.arm)

    @property
    def urdf(self) -> str:
        """The URDF of this robot."""
        with_arm = self.describe_arm and carries_arm(self.robot)
        return urdf(self.robot, self.arm, self.mount, with_arm=with_arm)
