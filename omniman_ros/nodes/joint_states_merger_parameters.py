"""Parameters of the node `joint_states_merger`."""

from dataclasses import dataclass

from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters


@dataclass(frozen=True, kw_only=True)
class JointStatesMergerParameters(Validated):
    """Parameters of the node: those of the URDF, its rate and its timeout."""

    description: DescriptionParameters = inline()
    rate: float = parameter(
        50.0, "Largest rate of joint_states.", unit="Hz", low=1, high=500, read_only=True
    )
    timeout: float = parameter(
        0.5,
        "Age at which wheels or arm are left out of joint_states.",
        unit="s",
        low=0.02,
        high=60,
    )
    publish_description: bool = parameter(
        True,
        "Whether to publish the URDF on robot_description; not where robot_state_publisher does.",
        read_only=True,
    )
