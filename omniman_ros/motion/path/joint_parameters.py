"""Parameters of joint trajectories, besides those of the arm's joints."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class ArmFollowing(Validated):
    """How closely and how promptly the arm must follow a motion."""

    start_tolerance: float = parameter(
        0.02,
        "Largest distance from the arm to a first point with time 0, and to where its last motion "
        "ended: the motion starts there.",
        unit="rad",
        low=0.0001,
        high=0.5,
    )
    states_timeout: float = parameter(
        0.2,
        "Age at which arm/joint_states are too old to start or to continue a trajectory.",
        unit="s",
        low=0.02,
        high=10,
    )
    following_error: float = parameter(
        0.15,
        "Largest distance of a measured joint from its reference of the last 0.2 s.",
        unit="rad",
        low=0.005,
        high=3,
    )


@dataclass(frozen=True)
class JointTrajectoryOptions(ArmFollowing):
    """Options of trajectories of the arm."""

    reserve: float = parameter(
        0.1,
        "Fraction of the arm's limits that motions without given times leave unused.",
        low=0,
        high=0.9,
    )
    corner_tolerance: float = parameter(
        0.0,
        "Largest distance of a joint from the straight line at points without times; 0: the "
        "arm stops at each point.",
        unit="rad",
        low=0,
        high=1,
    )
    jerk_scale: float = parameter(
        1.0,
        "Factor on arm.jerk for trajectories with times, for planners that do not limit the jerk.",
        low=1,
        high=1e6,
    )
    stream_timeout: float = parameter(
        0.2,
        "Silence after which a stream of single points is stopped.",
        unit="s",
        low=0.04,
        high=2,
    )
    max_points: int = parameter(
        2000, "Largest number of points of a trajectory.", low=1, high=100000
    )
    max_delay: float = parameter(
        60.0,
        "Largest time from now to the stamp of a trajectory; the arm waits until then.",
        unit="s",
        low=0,
        high=3600,
    )
