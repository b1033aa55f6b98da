"""Parameters of the node `simulated_drive`."""

from dataclasses import dataclass

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.nodes.clock_parameters import ClockParameters
from omniman_ros.simulation.plant.imu import ImuSensorParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

#: Rate of /clock [Hz] below which a step is longer than some nodes let it be ahead of them
SLOWEST_CLOCK = 100.0


@dataclass(frozen=True, kw_only=True)
class SimulatedDriveParameters(ClockParameters):
    """Parameters of the node: robot, simulation, rates and time."""

    robot: Platform = inline()
    arm: ArmParameters
    mount: Mount
    simulation: SimulationParameters = inline()
    imu: ImuMount
    imu_sensor: ImuSensorParameters
    state_rate: float = parameter(
        200.0, "Rate of wheel_states.", unit="Hz", low=10, high=1000, read_only=True
    )
    truth_rate: float = parameter(
        100.0,
        "Rate of ground_truth/odom, at most the state rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    electrical_rate: float = parameter(
        50.0,
        "Rate of wheel_electrical, at most the state rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    imu_rate: float = parameter(
        100.0,
        "Rate of imu, at most the state rate.",
        unit="Hz",
        low=1,
        high=1000,
        read_only=True,
    )
    command_timeout: float = parameter(
        0.1, "Age at which a stamped command is refused.", unit="s", low=0.005, high=10
    )
    world_frame: str = parameter("map", "Frame of the ground truth.", read_only=True)
    odom_frame: str = parameter(
        "odom",
        "Frame of odometry: another name of world_frame, as long as TF does not relate the two.",
        read_only=True,
    )
    base_frame: str = parameter(
        "base_link", "Frame of the twist of the ground truth.", read_only=True
    )
    seed: int = parameter(
        0, "Seed of the noise and of lost messages.", low=0, high=2**31, read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.publish_clock and self.state_rate < SLOWEST_CLOCK:
            reason = f"must be at least {SLOWEST_CLOCK:g} Hz with publish_clock"
            raise self._refusal("state_rate", reason)
