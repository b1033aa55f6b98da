"""Goals of `follow_joint_trajectory`: their tolerances, and how each comes to its end.

After control_msgs/action/FollowJointTrajectory, and joint_trajectory_controller of
ros2_controllers where that leaves it open.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.body.model import PLATFORM_AXES
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter

Array = NDArray[np.float64]

ERASED = -1.0
"""A tolerance that says this is none at all; 0 is the default."""
UNITS = {PLATFORM_AXES[0]: "m", PLATFORM_AXES[1]: "m"}
"""Of axes that do not turn."""
HEADING = PLATFORM_AXES[2]
"""The axis that may be measured whole turns away."""


class ErrorCode(IntEnum):
    """The `error_code` of a result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Ending(Enum):
    """The state a goal ends in."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class Verdict:
    """How a goal has ended: its last state, the result's code, and why in words."""

    ending: Ending
    code: ErrorCode
    text: str


@dataclass(frozen=True)
class TrajectoryActionOptions:
    """What goals that do not say otherwise are held to."""

    path_tolerance: float = parameter(
        0.0, "How far each axis may be from where it is to be on the way; 0: as far as it likes.",
        unit="m, rad", low=0, high=10,
    )  # fmt: skip
    goal_tolerance: float = parameter(
        0.01, "How far each axis may be from its goal at the end; 0: as far as it likes.",
        unit="m, rad", low=0, high=10,
    )  # fmt: skip
    stopped_velocity: float = parameter(
        0.02, "Speed of each axis that counts as rest at the end; 0: any.", unit="m/s, rad/s",
        low=0, high=1,
    )  # fmt: skip
    goal_time: float = parameter(
        2.0, "How long after the end of the trajectory the goal may be reached; 0: at any time.",
        unit="s", low=0, high=3600,
    )  # fmt: skip
    period: float = parameter(
        0.02, "Time between two looks at the tolerances, and between two feedbacks.",
        unit="s", low=0.005, high=1, read_only=True,
    )  # fmt: skip


class JointTolerance(Protocol):
    """What is read of a control_msgs/JointTolerance; 0 is the default, -1 is no bound.

    Accelerations are not measured, so that their tolerances are only looked through for values
    that mean nothing, as is done by joint_trajectory_controller.
    """

    name: str
    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class GoalTolerances:
    """Largest errors of each axis; infinity is no bound.

    Attributes:
        path: (2, n) of position [m, rad] and velocity [m/s, rad/s] on the way.
        goal: (2, n) the same at the end; the velocity is to be zero there.
        time: How long after the trajectory's end the goal may be reached [s].

    Raises:
        InputError: Shapes that do not fit, negative numbers, NaN.
    """

    path: Array
    goal: Array
    time: float

    def __post_init__(self) -> None:
        path, goal = (np.array(a, dtype=float) for a in (self.path, self.goal))
        if path.ndim != 2 or len(path) != 2 or path.shape != goal.shape:
            raise InputError(f"tolerances of shapes {path.shape} and {goal.shape}")
        if not ((path >= 0.0).all() and (goal >= 0.0).all() and self.time >= 0.0):
            raise InputError(f"tolerances {path.tolist()}, {goal.tolist()}, {self.time} s")
        for name, array in (("path", path), ("goal", goal)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @classmethod
    def of_goal(
        cls, names: Sequence[str], options: TrajectoryActionOptions,
        path: Iterable[JointTolerance] = (), goal: Iterable[JointTolerance] = (),
        time: float = 0.0,
    ) -> Self:  # fmt: skip
        """Those that a goal asks for, and the defaults for what it leaves open.

        Unlike in joint_trajectory_controller, where one that means nothing sets all back to the
        defaults, it is refused.

        Args:
            names: All axes (n).
            options: The defaults.
            path, goal: For some of the axes.
            time: `goal_time_tolerance` [s]; 0 is the default, -1 is no bound.

        Raises:
            InputError: An axis that there is not, or twice; NaN, or negative and not -1.
        """
        n = len(names)
        bounds = np.full((2, 2, n), math.inf)
        bounds[0, 0] = options.path_tolerance or math.inf
        bounds[1, 0] = options.goal_tolerance or math.inf
        bounds[1, 1] = options.stopped_velocity or math.inf
        for label, given, table in (("path", path, bounds[0]), ("goal", goal, bounds[1])):
            seen: set[str] = set()
            for one in given:
                if one.name not in names or one.name in seen:
                    why = "is given twice" if one.name in seen else "is for no axis here"
                    raise InputError(f"{label}_tolerance of {one.name[:64]!r} {why}")
                seen.add(one.name)
                i = names.index(one.name)
                where = f"{label}_tolerance of {one.name}"
                table[0, i] = _resolve(one.position, table[0, i], f"{where}: position")
                table[1, i] = _resolve(one.velocity, table[1, i], f"{where}: velocity")
                _resolve(one.acceleration, math.inf, f"{where}: acceleration")
        return cls(
            bounds[0],
            bounds[1],
            _resolve(time, options.goal_time or math.inf, "goal_time_tolerance"),
        )


def _resolve(value: float, default: float, what: str) -> float:
    if value > 0.0:
        return value
    if value == 0.0:
        return default
    if value == ERASED:
        return math.inf
    raise InputError(f"{what} {value:g}: it is to be 0 (the default), positive, or -1 (no bound)")


class GoalMonitor:
    """Watches one goal from its begin to its end.

    The way is followed until the motion ends; then the axes have some time to come to the goal.
    Where a tolerance is violated on the way, or the goal is cancelled, the motion is to be ended
    (:attr:`stop`), and the verdict waits until it has: all is at rest by then.

    Args:
        names: All axes (n).
        goal: (n,) where they are to be at the end [m, rad]; NaN for those that the goal does not
            name.
        tolerances: Of these axes.

    Raises:
        InputError: Shapes that do not fit, a goal that names no axis.
    """

    def __init__(self, names: Sequence[str], goal: Array, tolerances: GoalTolerances) -> None:
        n = len(names)
        if goal.shape != (n,) or tolerances.path.shape != (2, n):
            raise InputError(
                f"a goal of shape {goal.shape} with tolerances of shape {tolerances.path.shape} "
                f"for {n} axes"
            )
        self._names, self._tolerances = tuple(names), tolerances
        self._named = np.isfinite(goal)
        if not self._named.any():
            raise InputError("the goal names no axis")
        self._goal = np.where(self._named, goal, 0.0)
        self._turns = np.array([name == HEADING for name in names])
        self._cancelled = False
        self._violated = ""
        self._ended: float | None = None

    @property
    def stop(self) -> bool:
        """Whether the motion is to come to rest."""
        return self._cancelled or bool(self._violated)

    def cancel(self) -> None:
        """Hear that the goal is cancelled."""
        self._cancelled = True

    def error(self, desired: Array, actual: Array) -> Array:
        """Position errors (n,) [m, rad], of the heading the shortest turn."""
        return self._shortest(desired - actual)

    def update(
        self,
        now: float,
        desired: tuple[Array, ...] | None,
        actual: tuple[Array, ...] | None,
        outcome: str | None,
    ) -> Verdict | None:
        """Look at the axes; None while the goal goes on.

        Args:
            now: Time, of any clock [s].
            desired: Positions and velocities (n,) where the axes are to be, if known.
            actual: Those measured, at the same instant, if known.
            outcome: None while the motion goes on; empty: it has come to its end; else why it
                ended before.
        """
        if outcome is None:
            if desired is not None and actual is not None and not self.stop:
                self._look(desired, actual)
            return None
        if self._violated:
            return Verdict(Ending.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED, self._violated)
        if self._cancelled:
            return Verdict(Ending.CANCELED, ErrorCode.SUCCESSFUL, outcome or "it had arrived")
        if outcome:
            return Verdict(Ending.ABORTED, ErrorCode.INVALID_GOAL, outcome)
        return self._settle(now, actual)

    def _look(self, desired: tuple[Array, ...], actual: tuple[Array, ...]) -> None:
        errors = np.array([self.error(desired[0], actual[0]), desired[1] - actual[1]])
        self._violated = self._worst(errors, self._tolerances.path, "from where it is to be")

    def _settle(self, now: float, actual: tuple[Array, ...] | None) -> Verdict | None:
        if self._ended is None or now < self._ended:
            self._ended = now
        why = "its axes are not measured"
        if actual is not None:
            errors = np.array([self.error(self._goal, actual[0]), -actual[1]])
            errors[:, ~self._named] = 0.0
            why = self._worst(errors, self._tolerances.goal, "from its goal")
        if not why:
            return Verdict(Ending.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
        late = now - self._ended
        if late <= self._tolerances.time:
            return None
        text = f"{late:.2f} s after its end: {why}"
        return Verdict(Ending.ABORTED, ErrorCode.GOAL_TOLERANCE_VIOLATED, text)

    def _shortest(self, errors: Array) -> Array:
        turns = np.where(self._turns, np.rint(errors / (2.0 * math.pi)), 0.0)
        result: Array = errors - 2.0 * math.pi * turns
        return result

    def _worst(self, errors: Array, bounds: Array, whence: str) -> str:
        """What is furthest beyond its bound, in words; empty if nothing is."""
        beyond = np.where(np.isfinite(bounds), np.abs(errors) - bounds, -math.inf)
        beyond[np.isnan(beyond)] = math.inf
        row, i = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if not beyond[row, i] > 0.0:
            return ""
        name, unit = self._names[i], UNITS.get(self._names[i], "rad")
        value, bound = abs(errors[row, i]), bounds[row, i]
        if row == 0:
            return f"{name} is {value:.4g} {unit} {whence}, at most {bound:g} {unit} are allowed"
        kind = "speed" if whence.endswith("goal") else "speed error"
        return f"{name} has a {kind} of {value:.4g} {unit}/s, at most {bound:g} are allowed"
