"""Parameters of the node `simulated_ur`."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.ur.arm import JOINTS, UrArmParameters
from omniman_ros.simulation.ur.faults import UrFaultParameters
from omniman_ros.simulation.ur.port_parameters import UrPortParameters


@dataclass(frozen=True, kw_only=True)
class ArmNames(Validated):
    """Names of the joints, under the parameter name that all nodes of the arm use."""

    joints: tuple[str, ...] = parameter(
        UR_JOINTS, "Names of the joints, from the base on; a prefix goes here.", read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.joints) != JOINTS or len(set(self.joints)) != JOINTS or not all(self.joints):
            raise self._refusal("joints", f"must be {JOINTS} different names")


@dataclass(frozen=True, kw_only=True)
class PendantParameters(Validated):
    """Settings of the teach pendant."""

    speed_slider: float = parameter(
        1.0, "Speed slider, while no RTDE client moves it.", low=0.01, high=1
    )


@dataclass(frozen=True, kw_only=True)
class SimulatedUrParameters(Validated):
    """Parameters of the node: ports, arm, pendant and faults."""

    arm: ArmNames
    ports: UrPortParameters
    simulated_arm: UrArmParameters
    pendant: PendantParameters
    faults: UrFaultParameters
    truth_rate: float = parameter(
        125.0,
        "Rate of ground_truth/arm_joint_states.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
