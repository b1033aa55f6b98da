"""Everything that paths of the tool are set by, declared once."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter


@dataclass(frozen=True)
class ToolPathOptions:
    """How paths of the tool are taken."""

    linear_velocity: float = parameter(
        0.2, "Largest speed of the tool.", unit="m/s", low=0.001, high=5
    )
    angular_velocity: float = parameter(
        0.5, "Largest turn rate of the tool.", unit="rad/s", low=0.001, high=10
    )
    linear_acceleration: float = parameter(
        0.5, "Largest acceleration of the tool.", unit="m/s^2", low=0.01, high=20
    )
    angular_acceleration: float = parameter(
        1.0, "Largest angular acceleration of the tool.", unit="rad/s^2", low=0.01, high=50
    )
    tolerance: float = parameter(
        0.0005, "How far corners of the path are cut at most.", unit="m", low=1e-5, high=0.1
    )
    angular_tolerance: float = parameter(
        0.005, "The same for the tool's turns.", unit="rad", low=1e-5, high=0.5
    )
    reserve: float = parameter(
        0.2, "Share of the axes' limits that is left to the correction.", low=0, high=0.9
    )
    start_distance: float = parameter(
        0.5, "How far from the tool a path may begin; it goes straight there.", unit="m",
        low=0.0001, high=10,
    )  # fmt: skip
    singularity: float = parameter(
        0.1, "Nearest to a singularity: least sine of elbow and wrist_2, and of the wrist's "
        "distance from the arm's first axis over the arm's length.", low=0.01, high=0.5,
    )  # fmt: skip
    max_poses: int = parameter(20000, "Most poses of a path.", low=1, high=1000000)
    max_length: float = parameter(
        100.0, "Longest path; a turn of 1 rad counts as 0.4 m.", unit="m", low=0.1, high=1000
    )
    correction: bool = parameter(
        True, "Whether the arm takes the platform's measured tracking error out."
    )
    correction_bandwidth: float = parameter(
        20.0, "Bandwidth of the filter of that error; lower where coarse encoders shake the arm.",
        unit="rad/s", low=0.5, high=100,
    )  # fmt: skip
    max_error: float = parameter(
        0.05, "Tracking error of the platform at which the path is given up; from half of it on "
        "the motion is slowed.", unit="m", low=0.001, high=0.5,
    )  # fmt: skip
    max_heading_error: float = parameter(
        0.1, "The same for its heading.", unit="rad", low=0.001, high=0.5
    )
