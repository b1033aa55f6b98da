"""Parameters of the node `obstacle_tracker`."""

from dataclasses import dataclass

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.rigid import UPSIDE_DOWN, Transform
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.nodes.frame_parameters import FrameParameters
from omniman_ros.perception.no_return import NO_RETURN, REP_117
from omniman_ros.perception.parameters import (
    MapParameters,
    TrackerParameters,
    UnseenParameters,
)
from omniman_ros.perception.scan_check import ScanCheckParameters
from omniman_ros.surroundings.tracking import TrackingParameters

LASER, CLOUD = "laser", "cloud"
"""Kinds of scanners: they send LaserScan or PointCloud2."""


@dataclass(frozen=True, kw_only=True)
class ScannerInput(Validated):
    """Topic and mounting of a scanner."""

    topic: str = parameter("scan", "Topic of its scans or clouds.", read_only=True)
    kind: str = parameter(
        LASER,
        "What it sends: laser is LaserScan, cloud is PointCloud2.",
        choices=(LASER, CLOUD),
        read_only=True,
    )
    x: float = parameter(
        0.55,
        "Position in base_link, forward; without scanners_by_tf.",
        unit="m",
        low=-10,
        high=10,
    )
    y: float = parameter(0.0, "Position in base_link, left.", unit="m", low=-10, high=10)
    z: float = parameter(0.2, "Height above the floor.", unit="m", low=0, high=10)
    yaw: float = parameter(0.0, "Direction of its x axis.", unit="rad", low=-6.3, high=6.3)
    upside_down: bool = parameter(
        False, "Whether it is turned over about its x axis, so that its angles grow to the right."
    )
    no_return: str = parameter(
        REP_117,
        "What a laser sends where a beam meets nothing up to range_max: infinity only (rep_117), "
        "or also zero, not_a_number, or range_max and more. Else 0 and NaN are no measurement.",
        choices=NO_RETURN,
    )

    @property
    def mount(self) -> Transform:
        """Its pose in base_link."""
        flat = Transform.of_planar((self.x, self.y, self.yaw))
        upright = Transform((self.x, self.y, self.z), flat.rotation)
        return upright @ UPSIDE_DOWN if self.upside_down else upright


@dataclass(frozen=True)
class CloudSlice(Validated):
    """Part of a cloud that counts."""

    low: float = parameter(
        0.1, "Height above the floor from which points count.", unit="m", low=-1, high=10
    )
    high: float = parameter(
        1.6, "Height above the floor up to which points count.", unit="m", low=-1, high=10
    )
    range_max: float = parameter(
        15.0, "Distance from the sensor up to which points count.", unit="m", low=0.5, high=200
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise self._refusal("high", f"must be above low, {self.low:g} m")


@dataclass(frozen=True, kw_only=True)
class ObstacleTrackerParameters(Validated):
    """Parameters of the node: the robot's shape, its scanners, tracks, map, and frames."""

    description: DescriptionParameters = inline()
    tool: ToolShape
    load: LoadShape
    scanners: tuple[ScannerInput, ...]
    scanners_by_tf: bool = parameter(
        True,
        "Whether TF has the poses of the scanners; if not, the parameters of scanners do.",
        read_only=True,
    )
    base_frame: str = parameter("base_link", "Frame of the robot.", read_only=True)
    cloud: CloudSlice
    scan_check: ScanCheckParameters
    tracker: TrackerParameters
    tracks: TrackingParameters
    local_map: MapParameters
    unseen: UnseenParameters
    map_rate: float = parameter(
        5.0, "Rate of map; 0: no map.", unit="Hz", low=0.0, high=50.0, read_only=True
    )
    height: float = parameter(
        2.0,
        "Height above the floor up to which obstacles are reported to reach: a scanner sees a "
        "slice of them only.",
        unit="m",
        low=0.1,
        high=10.0,
    )
    frames: FrameParameters = inline()

    def __post_init__(self) -> None:
        super().__post_init__()
        topics = tuple(scanner.topic for scanner in self.scanners)
        if len(set(topics)) < len(topics):
            raise ParameterError("scanners.topic", topics, "two scanners have the same topic")
