"""Parameters of the node `mpc_planner`."""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.planning.parameters import PlannerParameters


@dataclass(frozen=True, kw_only=True)
class MpcPlannerParameters:
    """Parameters of the planner, of the streams, and of frames and maps."""

    core: PlannerParameters = inline()
    output: str = parameter(
        "reference",
        "What drives the robot: `mpc/reference`, which the platform controller "
        "follows, or `mpc/voltages`. Only at rest.",
        choices=("reference", "voltages"),
    )
    period: float = parameter(
        0.05, "Period of the planning.", unit="s", low=0.01, high=1, read_only=True
    )
    voltages_period: float = parameter(
        0.01, "Period of the voltages.", unit="s", low=0.005, high=0.05, read_only=True
    )
    restart: float = parameter(
        1.2,
        "Silence after control was lost: longer than the controller's timeouts.cancelled.",
        unit="s",
        low=0.05,
        high=60,
    )
    odom_timeout: float = parameter(
        0.3,
        "Age at which odom is too old to drive by: the goal is given up.",
        unit="s",
        low=0.02,
        high=10,
    )
    odom_frame: str = parameter("odom", "Frame of odometry and references.", read_only=True)
    map_is_odom: bool = parameter(
        False, "Whether goals, obstacles and maps in `map` are treated as in odom."
    )
    map_threshold: int = parameter(
        50,
        "Occupancy from which on a cell of the map counts as occupied.",
        unit="%",
        low=1,
        high=100,
        read_only=True,
    )
    map_unknown_is_free: bool = parameter(
        False, "Whether the robot may drive through cells of unknown occupancy.", read_only=True
    )

    def __post_init__(self) -> None:
        if self.core.safety.deadline > self.period:
            raise ParameterError(
                "safety.deadline",
                self.core.safety.deadline,
                f"must be <= the period {self.period:g} s",
            )

    @property
    def input_frames(self) -> tuple[str, ...]:
        """Frames that goals, obstacles and maps may be in."""
        return (self.odom_frame, "map") if self.map_is_odom else (self.odom_frame,)
