"""Everything the planner is set by, declared once; obstacles have theirs beside them."""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.robot import Robot
from omniman_ros.planning.obstacles import ObstacleParameters


@dataclass(frozen=True)
class Horizon:
    """How far and how finely is planned."""

    steps: int = parameter(20, "Steps N of the horizon.", low=2, high=100, read_only=True)
    step: float = parameter(
        0.1, "Length of a step; controls are held over it.",
        unit="s", low=0.02, high=0.5, read_only=True,
    )  # fmt: skip
    slots: int = parameter(
        6, "Obstacles in the optimisation, the nearest; the check of the plan knows all.",
        low=0, high=40, read_only=True,
    )  # fmt: skip

    @property
    def duration(self) -> float:
        """How far is planned [s]."""
        return self.steps * self.step


@dataclass(frozen=True)
class Weights:
    """What the plan is judged by, MPC 2021 (25) and (31); energy counts as it is, in J."""

    position: float = parameter(
        600.0, "Weight W_pos of the distance at the end of the plan.",
        unit="J/m^2", low=0, high=1e6,
    )  # fmt: skip
    heading: float = parameter(
        150.0, "Weight W_ang of the heading error at the end of the plan.",
        unit="J/rad^2", low=0, high=1e6,
    )  # fmt: skip
    velocity: float = parameter(
        60.0, "Weight W_vel of the velocity error at the end of the plan, where the goal has a "
        "velocity.", unit="J s^2/m^2", low=0, high=1e6,
    )  # fmt: skip
    running: float = parameter(
        1.0, "Share of W_pos and W_ang that counts in each second before the end; 0 is the "
        "paper's cost.", unit="1/s", low=0, high=100,
    )  # fmt: skip
    energy: float = parameter(1.0, "Weight of the energy.", low=1e-3, high=1e3)
    reach: float = parameter(
        1.5, "A goal that is further beyond what can be driven within the horizon than this pulls "
        "no harder.", unit="m", low=0.1, high=100,
    )  # fmt: skip


@dataclass(frozen=True)
class Workspace:
    """Where the whole bounding box must stay, in odom; MPC 2021 (29), (30)."""

    x_min: float = parameter(-1e3, "Least x.", unit="m", low=-1e5, high=1e5)
    y_min: float = parameter(-1e3, "Least y.", unit="m", low=-1e5, high=1e5)
    x_max: float = parameter(1e3, "Largest x.", unit="m", low=-1e5, high=1e5)
    y_max: float = parameter(1e3, "Largest y.", unit="m", low=-1e5, high=1e5)

    def __post_init__(self) -> None:
        if self.x_max <= self.x_min:
            raise ParameterError("workspace.x_max", self.x_max, "not above workspace.x_min")
        if self.y_max <= self.y_min:
            raise ParameterError("workspace.y_max", self.y_max, "not above workspace.y_min")

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max [m]."""
        return self.x_min, self.y_min, self.x_max, self.y_max


@dataclass(frozen=True)
class Safety:
    """Room around the robot, and when an answer counts."""

    clearance: float = parameter(
        0.05, "Gap that plans keep to obstacles and to the workspace's edge.",
        unit="m", low=0, high=2,
    )  # fmt: skip
    least_clearance: float = parameter(
        0.02, "Gap below which a plan is not used; tracking errors come on top.",
        unit="m", low=0, high=2,
    )  # fmt: skip
    berth: float = parameter(
        0.6, "Plans keep away from what moves by so much more of its way, up to 0.3 m: it may "
        "turn.",
        unit="s", low=0, high=5,
    )  # fmt: skip
    deadline: float = parameter(
        0.04, "Time after which an answer is late: each plan begins so far ahead.",
        unit="s", low=0.001, high=0.5,
    )  # fmt: skip
    slack: float = parameter(
        0.02, "Overlap of a plan with what it must keep clear of, clearance included, from which "
        "on evasions are tried beside it.", unit="m", low=0, high=10,
    )  # fmt: skip

    def __post_init__(self) -> None:
        if self.least_clearance > self.clearance:
            raise ParameterError(
                "safety.least_clearance", self.least_clearance, "above safety.clearance"
            )


@dataclass(frozen=True)
class Arrival:
    """When a goal is reached."""

    position: float = parameter(
        0.02, "Distance from the goal at which it is reached.", unit="m", low=1e-4, high=10
    )
    heading: float = parameter(
        0.02, "Heading error at which it is reached.", unit="rad", low=1e-4, high=3.2
    )


@dataclass(frozen=True, kw_only=True)
class PlannerParameters:
    """Everything the planner is set by, the robot included."""

    robot: Robot = inline()
    limits: TwistLimits
    horizon: Horizon
    weights: Weights
    workspace: Workspace
    safety: Safety
    arrival: Arrival
    obstacles: ObstacleParameters
    reserve: float = parameter(
        0.15, "Share of the limits that plans leave to the position controller.",
        low=0, high=0.9,
    )  # fmt: skip

    def speeds(self, share: float = 1.0) -> tuple[float, float]:
        """Largest linear [m/s] and angular speed [rad/s] of plans, with a share of the limits."""
        room = (1.0 - self.reserve) * share
        return room * self.limits.linear_velocity, room * self.limits.angular_velocity
