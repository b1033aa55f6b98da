"""Parameters of tool paths."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class ToolPathOptions(Validated):
    """Options of tool paths and of their correction."""

    linear_velocity: float = parameter(
        0.2, "Largest speed of the tool.", unit="m/s", low=0.001, high=5
    )
    angular_velocity: float = parameter(
        0.5, "Largest angular speed of the tool.", unit="rad/s", low=0.001, high=10
    )
    linear_acceleration: float = parameter(
        0.5, "Largest acceleration of the tool.", unit="m/s^2", low=0.01, high=20
    )
    angular_acceleration: float = parameter(
        1.0, "Largest angular acceleration of the tool.", unit="rad/s^2", low=0.01, high=50
    )
    tolerance: float = parameter(
        0.0005,
        "Largest distance by which corners of the path are cut.",
        unit="m",
        low=1e-5,
        high=0.1,
    )
    angular_tolerance: float = parameter(
        0.005,
        "Largest deviation of the tool's orientation at corners.",
        unit="rad",
        low=1e-5,
        high=0.5,
    )
    reserve: float = parameter(
        0.2, "Fraction of the axes' limits that is left to the correction.", low=0, high=0.9
    )
    start_distance: float = parameter(
        0.5,
        "Largest distance from the tool to the start of a path; it moves straight there.",
        unit="m",
        low=0.0001,
        high=10,
    )
    singularity: float = parameter(
        0.1,
        "Smallest margin to a singularity: sine of elbow and of wrist_2, and distance of the "
        "wrist from the arm's first axis over the arm's length.",
        low=0.01,
        high=0.5,
    )
    max_poses: int = parameter(20000, "Largest number of poses of a path.", low=1, high=1000000)
    max_length: float = parameter(
        100.0,
        "Largest length of a path; a rotation by 1 rad counts as 0.4 m.",
        unit="m",
        low=0.1,
        high=1000,
    )
    correction: bool = parameter(
        True, "Whether the arm corrects the platform's measured tracking error."
    )
    correction_bandwidth: float = parameter(
        20.0,
        "Bandwidth of the tracking error's filter; coarse encoders, which shake the arm, need a "
        "lower one.",
        unit="rad/s",
        low=0.5,
        high=100,
    )
    max_error: float = parameter(
        0.05,
        "Tracking error of the platform at which the path is abandoned; from half of it on "
        "the motion is slowed down.",
        unit="m",
        low=0.001,
        high=0.5,
    )
    max_heading_error: float = parameter(
        0.1,
        "Heading error of the platform at which the path is abandoned.",
        unit="rad",
        low=0.001,
        high=0.5,
    )
