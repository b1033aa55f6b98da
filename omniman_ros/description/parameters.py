"""What the description of a robot is made from, as parameters."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import Mount
from omniman_ros.core.parameters import inline
from omniman_ros.core.robot import Robot
from omniman_ros.description.urdf import demand_joints, urdf


@dataclass(frozen=True, kw_only=True)
class DescriptionParameters:
    """The platform, the arm's joints, and where the arm stands."""

    robot: Robot = inline()
    arm: ArmParameters
    mount: Mount

    def __post_init__(self) -> None:
        """Refuse what makes no URDF and no joint states.

        Raises:
            ParameterError: A joint's name is there twice, or cannot be written.
        """
        demand_joints(self.robot, self.arm)

    @property
    def urdf(self) -> str:
        """The URDF of this robot."""
        return urdf(self.robot, self.arm, self.mount)
