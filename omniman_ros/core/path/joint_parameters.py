"""Everything that joint trajectories are set by besides the arm's joints, declared once."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter


@dataclass(frozen=True)
class JointTrajectoryOptions:
    """How trajectories of the arm are taken."""

    reserve: float = parameter(
        0.1, "Share of the arm's limits that motions without times of their own leave unused.",
        low=0, high=0.9,
    )  # fmt: skip
    corner_tolerance: float = parameter(
        0.0, "How far each joint may be off the straight way at points without times; 0: the arm "
        "stops at each point.", unit="rad", low=0, high=1,
    )  # fmt: skip
    start_tolerance: float = parameter(
        0.02, "How far from the arm a first point with time 0 may be; the motion begins where the "
        "arm is.", unit="rad", low=0.0001, high=0.5,
    )  # fmt: skip
    jerk_scale: float = parameter(
        1.0, "Trajectories with times may have so many times arm.jerk: for planners that do not "
        "limit it.", low=1, high=1e6,
    )  # fmt: skip
    max_points: int = parameter(2000, "Most points of a trajectory.", low=1, high=100000)
    max_delay: float = parameter(
        60.0, "How far ahead the stamp of a trajectory may be; the arm waits until then.",
        unit="s", low=0, high=3600,
    )  # fmt: skip
    states_timeout: float = parameter(
        0.2, "Age at which arm/joint_states are too old to begin a trajectory, or to go on with "
        "one.", unit="s", low=0.02, high=10,
    )  # fmt: skip
    following_error: float = parameter(
        0.15, "Largest distance of a measured joint from where it was to be in the last 0.2 s.",
        unit="rad", low=0.005, high=3,
    )  # fmt: skip
