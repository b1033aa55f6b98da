"""Parameters of the planner; those of obstacles are declared with the obstacle set."""

from dataclasses import dataclass

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated
from omniman_ros.surroundings.obstacles import ObstacleParameters


@dataclass(frozen=True)
class Horizon(Validated):
    """Length and resolution of the planning horizon."""

    steps: int = parameter(20, "Steps N of the horizon.", low=2, high=100, read_only=True)
    step: float = parameter(
        0.1,
        "Length of a step; controls are held over it.",
        unit="s",
        low=0.02,
        high=0.5,
        read_only=True,
    )
    slots: int = parameter(
        6,
        "Number of nearest obstacles in the optimisation; plans are checked against all.",
        low=0,
        high=40,
        read_only=True,
    )

    @property
    def duration(self) -> float:
        """Duration of the horizon [s]."""
        return self.steps * self.step


@dataclass(frozen=True)
class Weights(Validated):
    """Weights of the cost, MPC 2021 (25) and (31); energy counts in J."""

    position: float = parameter(
        600.0,
        "Weight W_pos of the distance at the end of the plan.",
        unit="J/m^2",
        low=0,
        high=1e6,
    )
    heading: float = parameter(
        150.0,
        "Weight W_ang of the heading error at the end of the plan.",
        unit="J/rad^2",
        low=0,
        high=1e6,
    )
    velocity: float = parameter(
        60.0,
        "Weight W_vel of the velocity error at the end of the plan, where the goal has a "
        "velocity.",
        unit="J s^2/m^2",
        low=0,
        high=1e6,
    )
    running: float = parameter(
        1.0,
        "Share of W_pos and W_ang that counts in each second before the end; 0 is the "
        "paper's cost.",
        unit="1/s",
        low=0,
        high=100,
    )
    energy: float = parameter(1.0, "Weight of the energy.", low=1e-3, high=1e3)
    reach: float = parameter(
        1.5,
        "Distance beyond the reach of the horizon from which a farther goal does not increase "
        "the cost.",
        unit="m",
        low=0.1,
        high=100,
    )


@dataclass(frozen=True)
class Workspace(Validated):
    """Region of odom in which the whole bounding box must stay, MPC 2021 (29), (30)."""

    x_min: float = parameter(-1e3, "Least x.", unit="m", low=-1e5, high=1e5)
    y_min: float = parameter(-1e3, "Least y.", unit="m", low=-1e5, high=1e5)
    x_max: float = parameter(1e3, "Largest x.", unit="m", low=-1e5, high=1e5)
    y_max: float = parameter(1e3, "Largest y.", unit="m", low=-1e5, high=1e5)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.x_max <= self.x_min:
            raise self._refusal("x_max", "must be above workspace.x_min")
        if self.y_max <= self.y_min:
            raise self._refusal("y_max", "must be above workspace.y_min")

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max [m]."""
        return self.x_min, self.y_min, self.x_max, self.y_max


@dataclass(frozen=True)
class Safety(Validated):
    """Clearances, and the deadline of plans."""

    clearance: float = parameter(
        0.05,
        "Gap that plans keep to obstacles and to the workspace's edge.",
        unit="m",
        low=0,
        high=2,
    )
    least_clearance: float = parameter(
        0.02,
        "Gap below which a plan is not used; the tracking error is added to it.",
        unit="m",
        low=0,
        high=2,
    )
    berth: float = parameter(
        0.6,
        "Additional gap to a moving obstacle per unit of its speed, at most 0.3 m.",
        unit="s",
        low=0,
        high=5,
    )
    deadline: float = parameter(
        0.04,
        "Time after which an answer is late; each plan begins by this time after its request.",
        unit="s",
        low=0.001,
        high=0.5,
    )
    slack: float = parameter(
        0.02,
        "Violation of the clearance by a plan from which evasions are tried as well.",
        unit="m",
        low=0,
        high=10,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least_clearance > self.clearance:
            raise self._refusal(
                "least_clearance",
                "must not be above safety.clearance",
            )


@dataclass(frozen=True)
class Arrival(Validated):
    """Tolerances within which a goal is reached."""

    position: float = parameter(
        0.02, "Distance from the goal at which it is reached.", unit="m", low=1e-4, high=10
    )
    heading: float = parameter(
        0.02, "Heading error at which it is reached.", unit="rad", low=1e-4, high=3.2
    )


@dataclass(frozen=True, kw_only=True)
class PlannerParameters(Validated):
    """All parameters of the planner, including those of the robot."""

    robot: Platform = inline()
    limits: TwistLimits
    horizon: Horizon
    weights: Weights
    workspace: Workspace
    safety: Safety
    arrival: Arrival
    obstacles: ObstacleParameters
    reserve: float = parameter(
        0.15,
        "Share of the limits that plans leave to the position controller.",
        low=0,
        high=0.9,
    )
