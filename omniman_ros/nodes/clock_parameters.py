"""Parameters of nodes that give simulated time."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class ClockParameters(Validated):
    """Whether a node gives simulated time, and its pace."""

    publish_clock: bool = parameter(
        False,
        "Whether the node publishes simulated time on /clock, for nodes with use_sim_time.",
        read_only=True,
    )
    real_time_factor: float = parameter(
        1.0, "Speed of /clock over real time.", low=0.01, high=100, read_only=True
    )
    clock_patience: float = parameter(
        5.0,
        "Real time for which /clock waits for a node that does not keep up with it.",
        unit="s",
        low=0,
        high=3600,
        read_only=True,
    )
