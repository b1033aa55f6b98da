"""Parameters of the tracker and its map."""

from dataclasses import dataclass

from omniman_ros.collision.parameters import PersonShape
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class MapParameters(Validated):
    """Extent of the rolling map."""

    size: float = parameter(
        12.0, "Edge of the map.", unit="m", low=1.0, high=100.0, read_only=True
    )
    resolution: float = parameter(
        0.05, "Edge of a cell.", unit="m", low=0.01, high=1.0, read_only=True
    )
    rate: float = parameter(
        10.0,
        "Largest rate at which the scans of each scanner are entered.",
        unit="Hz",
        low=0.5,
        high=100.0,
    )


@dataclass(frozen=True, kw_only=True)
class UnseenParameters(Validated):
    """People who are not seen."""

    speed: float = parameter(
        0.0,
        "Speed at which somebody may step out from where no scanner sees, for the topic unseen; "
        "0: it is not published.",
        unit="m/s",
        low=0.0,
        high=5.0,
    )
    person: PersonShape = inline()


@dataclass(frozen=True)
class TrackerParameters(Validated):
    """What counts as one thing, as moving, and as the same thing as before."""

    range: float = parameter(
        12.0, "Distance up to which things are tracked.", unit="m", low=0.5, high=100.0
    )
    gap: float = parameter(
        0.2,
        "Distance between two neighbouring points from which they belong to different things.",
        unit="m",
        low=0.01,
        high=2.0,
    )
    max_diameter: float = parameter(
        1.2,
        "Largest width of what is tracked; what is wider belongs to the map.",
        unit="m",
        low=0.1,
        high=5.0,
    )
    partial_radius: float = parameter(
        0.25,
        "Radius assumed for what is hidden in part, until it is seen whole.",
        unit="m",
        low=0.02,
        high=1.0,
    )
    least_speed: float = parameter(
        0.15,
        "Speed from which something that was not moving before counts as moving.",
        unit="m/s",
        low=0.02,
        high=2.0,
    )
    least_way: float = parameter(
        0.12,
        "Distance from where it was first seen from which something counts as moving.",
        unit="m",
        low=0.02,
        high=2.0,
    )
    rest_time: float = parameter(
        10.0,
        "Time at rest after which something that moved belongs to the map.",
        unit="s",
        low=0.5,
        high=3600.0,
    )
    occlusion_time: float = parameter(
        3.0,
        "Time for which something that is hidden stays known.",
        unit="s",
        low=0.1,
        high=60.0,
    )
    most: int = parameter(
        200, "Largest number of things that are tracked.", low=1, high=10_000, read_only=True
    )
