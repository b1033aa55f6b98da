"""Goals of `follow_joint_trajectory`: their tolerances and their results.

The behaviour follows control_msgs/action/FollowJointTrajectory, and joint_trajectory_controller of
ros2_controllers where the action leaves it open.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Annotated, Protocol, Self

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import Range, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.motion.axes import PLATFORM_AXES

NO_BOUND = -1.0  #: Value of a tolerance that means no bound; 0 means the default
#: Units of the positions of linear axes; those of the other axes are radians
UNITS = {PLATFORM_AXES[0]: "m", PLATFORM_AXES[1]: "m"}
#: Axis whose measurement may differ from its reference by whole revolutions
HEADING = PLATFORM_AXES[2]


class ErrorCode(IntEnum):
    """Values of `error_code` in a result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Ending(Enum):
    """Terminal states of a goal."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class GoalResult:
    """Result of a goal that has ended."""

    ending: Ending  #: Terminal state
    code: ErrorCode  #: Error code of the result
    text: str  #: Reason in words; may be empty


@dataclass(frozen=True)
class TrajectoryActionOptions(Validated):
    """Default tolerances, for goals without their own."""

    path_tolerance: float = parameter(
        0.0,
        "Largest distance of each axis from its reference during the motion; 0: no bound.",
        unit="m, rad",
        low=0,
        high=10,
    )
    goal_tolerance: float = parameter(
        0.01,
        "Largest distance of each axis from its goal at the end; 0: no bound.",
        unit="m, rad",
        low=0,
        high=10,
    )
    stopped_velocity: float = parameter(
        0.02,
        "Largest speed of each axis that counts as rest at the end; 0: no bound.",
        unit="m/s, rad/s",
        low=0,
        high=1,
    )
    goal_time: float = parameter(
        2.0,
        "Time after the end of the trajectory within which the goal must be reached; 0: no bound.",
        unit="s",
        low=0,
        high=3600,
    )
    period: float = parameter(
        0.02,
        "Period in which the tolerances are checked and feedback is published.",
        unit="s",
        low=0.005,
        high=1,
        read_only=True,
    )


class JointTolerance(Protocol):
    """Fields of a control_msgs/JointTolerance; 0 means the default, -1 means no bound.

    Accelerations are not measured, so that their tolerances are only checked for invalid values,
    as by joint_trajectory_controller.
    """

    name: str
    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class GoalTolerances(Validated):
    """Largest errors of each axis; infinity means no bound.

    Raises:
        InputError: Shapes do not match, or a value is negative or NaN.
    """

    #: (2, n) errors of position [m, rad] and velocity [m/s, rad/s] during the motion
    path: Annotated[Array, Shape(2, "n", low=0.0, finite=False)]
    #: (2, n) the same at the end, where the velocity should be zero
    goal: Annotated[Array, Shape(2, "n", low=0.0, finite=False)]
    #: Time after the trajectory's end within which the goal must be reached [s]
    time: Annotated[float, Range(low=0.0, unit="s", finite=False)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.isnan(self.path).any() or np.isnan(self.goal).any() or math.isnan(self.time):
            raise InputError("a tolerance is not a number")

    @classmethod
    def of_goal(
        cls,
        names: Sequence[str],
        options: TrajectoryActionOptions,
        path: Iterable[JointTolerance] = (),
        goal: Iterable[JointTolerance] = (),
        time: float = 0.0,
    ) -> Self:
        """Create the tolerances of a goal, with the defaults where it has none.

        An invalid tolerance is refused, while joint_trajectory_controller resets all tolerances
        to the defaults then.

        Args:
            time: `goal_time_tolerance` [s]; 0 means the default, -1 means no bound.

        Raises:
            InputError: An axis is unknown or given twice, or a value is NaN, or negative and not
                -1.
        """
        n = len(names)
        bounds = np.full((2, 2, n), math.inf)
        bounds[0, 0] = options.path_tolerance or math.inf
        bounds[1, 0] = options.goal_tolerance or math.inf
        bounds[1, 1] = options.stopped_velocity or math.inf
        for label, given, table in (("path", path, bounds[0]), ("goal", goal, bounds[1])):
            seen: set[str] = set()
            for axis in given:
                if axis.name not in names or axis.name in seen:
                    reason = "is given twice" if axis.name in seen else "is for an unknown axis"
                    raise InputError(f"{label}_tolerance of {axis.name[:64]!r} {reason}")
                seen.add(axis.name)
                i = names.index(axis.name)
                prefix = f"{label}_tolerance of {axis.name}"
                table[0, i] = _resolve(axis.position, table[0, i], f"{prefix}: position")
                table[1, i] = _resolve(axis.velocity, table[1, i], f"{prefix}: velocity")
                _resolve(axis.acceleration, math.inf, f"{prefix}: acceleration")
        return cls(
            bounds[0],
            bounds[1],
            _resolve(time, options.goal_time or math.inf, "goal_time_tolerance"),
        )


def _resolve(value: float, default: float, name: str) -> float:
    if value > 0.0:
        return value
    if value == 0.0:
        return default
    if value == NO_BOUND:
        return math.inf
    raise InputError(f"{name} {value:g}: must be 0 (the default), positive, or -1 (no bound)")


class GoalMonitor:
    """Monitors one goal from its start to its end.

    The path tolerances count until the motion ends; then the axes have time to reach the goal.
    If a path tolerance is violated, or the goal is cancelled, the motion must be ended by the
    caller (:attr:`stop`), and the verdict follows once it has ended and all axes are at rest.

    Args:
        goal: (n,) positions at the end [m, rad]; NaN for axes that the goal does not name.

    Raises:
        InputError: Shapes do not match, or the goal names no axis.
    """

    def __init__(self, names: Sequence[str], goal: Array, tolerances: GoalTolerances) -> None:
        n = len(names)
        if goal.shape != (n,) or tolerances.path.shape != (2, n):
            raise InputError(
                f"the goal has shape {goal.shape} and the tolerances {tolerances.path.shape}, "
                f"expected ({n},) and (2, {n}) for {n} axes"
            )
        self._names, self._tolerances = tuple(names), tolerances
        self._named = np.isfinite(goal)
        if not self._named.any():
            raise InputError("the goal names no axis")
        self._goal = np.where(self._named, goal, 0.0)
        self._is_heading = np.array([name == HEADING for name in names])
        self._cancelled = False
        self._violated = ""
        self._ended: float | None = None

    @property
    def stop(self) -> bool:
        """Whether the motion must come to rest."""
        return self._cancelled or bool(self._violated)

    def cancel(self) -> None:
        """Record that the goal is cancelled."""
        self._cancelled = True

    def error(self, desired: Array, actual: Array) -> Array:
        """Return position errors (n,) [m, rad]; that of the heading is the shortest rotation."""
        return self._shortest(desired - actual)

    def update(
        self,
        now: float,
        desired: tuple[Array, ...] | None,
        actual: tuple[Array, ...] | None,
        outcome: str | None,
    ) -> GoalResult | None:
        """Check the axes against the tolerances; return the result once the goal has ended.

        Args:
            desired: Reference positions and velocities (n,), if there are any.
            actual: Measured positions and velocities (n,) at the same instant, if known.
            outcome: Reason why the motion has ended: empty if it arrived; None while it goes on.
        """
        if outcome is None:
            if desired is not None and actual is not None and not self.stop:
                self._check_path(desired, actual)
            return None
        if self._violated:
            return GoalResult(Ending.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED, self._violated)
        if self._cancelled:
            return GoalResult(
                Ending.CANCELED, ErrorCode.SUCCESSFUL, outcome or "it had already arrived"
            )
        if outcome:
            return GoalResult(Ending.ABORTED, ErrorCode.INVALID_GOAL, outcome)
        return self._settle(now, actual)

    def _check_path(self, desired: tuple[Array, ...], actual: tuple[Array, ...]) -> None:
        errors = np.array([self.error(desired[0], actual[0]), desired[1] - actual[1]])
        self._violated = self._worst(errors, self._tolerances.path, "from its reference")

    def _settle(self, now: float, actual: tuple[Array, ...] | None) -> GoalResult | None:
        if self._ended is None or now < self._ended:
            self._ended = now
        reason = "its axes are not measured"
        if actual is not None:
            errors = np.array([self.error(self._goal, actual[0]), -actual[1]])
            errors[:, ~self._named] = 0.0
            reason = self._worst(errors, self._tolerances.goal, "from its goal")
        if not reason:
            return GoalResult(Ending.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
        late = now - self._ended
        if late <= self._tolerances.time:
            return None
        text = f"{late:.2f} s after its end: {reason}"
        return GoalResult(Ending.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED, text)

    def _shortest(self, errors: Array) -> Array:
        revolutions = np.where(self._is_heading, np.rint(errors / (2.0 * math.pi)), 0.0)
        result: Array = errors - 2.0 * math.pi * revolutions
        return result

    def _worst(self, errors: Array, bounds: Array, origin: str) -> str:
        excess = np.where(np.isfinite(bounds), np.abs(errors) - bounds, -math.inf)
        excess[np.isnan(excess)] = math.inf
        row, i = np.unravel_index(int(excess.argmax()), excess.shape)
        if not excess[row, i] > 0.0:
            return ""
        name, unit = self._names[i], UNITS.get(self._names[i], "rad")
        value, bound = abs(errors[row, i]), bounds[row, i]
        if row == 0:
            return f"{name} is {value:.4g} {unit} {origin}, at most {bound:g} {unit} are allowed"
        kind = "speed" if origin.endswith("goal") else "speed error"
        return f"{name} has a {kind} of {value:.4g} {unit}/s, at most {bound:g} are allowed"
