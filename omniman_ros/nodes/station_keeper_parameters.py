"""Parameters of the node `station_keeper`."""

from dataclasses import dataclass

from omniman_ros.core.parameters import inline, parameter
from omniman_ros.motion.station.parameters import StationParameters
from omniman_ros.nodes.preview_parameters import PeriodicPreviewParameters


@dataclass(frozen=True, kw_only=True)
class StationKeeperParameters(PeriodicPreviewParameters):
    """Parameters of the node: those of its core, of its stream and of its frames."""

    core: StationParameters = inline()
    leader_topic: str = parameter("leader/odom", "Topic of the leader's odometry.", read_only=True)
    leader_frame: str = parameter(
        "odom", "Frame of the poses in the leader's odometry.", read_only=True
    )
    leader_base_frame: str = parameter(
        "base_link", "Frame of the leader in which a station is given.", read_only=True
    )
    odom_frame: str = parameter("odom", "Frame of odometry and references.", read_only=True)
    odom_timeout: float = parameter(
        0.5,
        "Age at which odom is too old to approach a station or to keep it.",
        unit="s",
        low=0.02,
        high=10,
    )
