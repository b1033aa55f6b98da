"""Planners, obstacles and a robot that does as it is told, for the tests of the planner."""

from collections.abc import Callable
from typing import Any

import numpy as np
import robots
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.parameters import build
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.planner import Measured, Planner, PlannerState

Array = NDArray[np.float64]

CYCLE = 0.05
"""Period of the planner [s]."""
SOLVING = 0.01
"""How long an answer takes [s]."""
TICK = 0.005
"""Time between two samples of what the robot did [s]."""


def parameters(name: str = "ig42", **changes: Any) -> PlannerParameters:
    """Of the planner; changes by name with `__` for the dot."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return build(PlannerParameters, robots.values(name, dotted))


def planner(name: str = "ig42", **changes: Any) -> Planner:
    """A planner with an anchor; changes as in `parameters`."""
    return Planner(parameters(name, **changes))


def model(name: str) -> PlanningModel:
    """Of one of the shared robots."""
    return PlanningModel.of(robots.robot(name))


def ellipses(
    *rows: tuple[float, ...], time: float = 0.0, velocities: Any = None, growth: float = 0.0
) -> Ellipses:
    """Obstacles of rows (x, y, a, b, angle), or (x, y, radius)."""
    full = np.array([row if len(row) == 5 else (*row, row[2], 0.0) for row in rows], float)
    full = full.reshape(-1, 5)
    speeds = np.zeros((len(full), 2)) if velocities is None else np.array(velocities, float)
    return Ellipses(
        time, full[:, :2], speeds.reshape(-1, 2), full[:, 2:4], full[:, 4],
        np.full(len(full), growth),
    )  # fmt: skip


def true_gaps(times: Array, poses: Array, half: Array, around: Ellipses) -> Array:
    """Gaps (K, M) [m] between box and ellipses without margin, from points on the ellipses.

    Zero where they overlap; too large by no more than the distance of two points allows.
    """
    if not len(around):
        return np.full((len(poses), 1), np.inf)
    turn = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    a, b = around.semi_axes.T[..., None]
    c, s = np.cos(around.angles)[:, None], np.sin(around.angles)[:, None]
    x = c * a * np.cos(turn) - s * b * np.sin(turn)
    y = s * a * np.cos(turn) + c * b * np.sin(turn)
    seen = around.centers_at(times) - poses[:, None, :2]
    result = np.empty(seen.shape[:2])
    for k in range(len(poses)):
        px, py = seen[k, :, :1] + x, seen[k, :, 1:] + y
        c_box, s_box = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        beyond_x = np.abs(c_box * px + s_box * py) - half[0]
        beyond_y = np.abs(c_box * py - s_box * px) - half[1]
        gap = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0)).min(axis=1)
        # The box in the ellipse has no point of the ellipse's edge within: its centre tells.
        cx, cy = np.cos(around.angles), np.sin(around.angles)
        u = (cx * -seen[k, :, 0] + cy * -seen[k, :, 1]) / around.semi_axes[:, 0]
        v = (cx * -seen[k, :, 1] + cy * seen[k, :, 0]) / around.semi_axes[:, 1]
        result[k] = np.where(u * u + v * v <= 1.0, 0.0, gap)
    return result


class Ride:
    """A planner and a robot that is always where the motion has it.

    Args:
        planner: The planner.
        pose: Where the robot stands at first.
        seen: What the planner knows of obstacles at a time [s].
        wrapped: Whether odometry's heading is in (-pi, pi].

    Attributes:
        now: Time [s].
        offset: (3,) by which the robot is away from its motion.
        times, poses: What it did, a row each tick.
        states: Of the planner, one each cycle.
    """

    def __init__(
        self,
        planner: Planner,
        pose: Any = (0.0, 0.0, 0.0),
        seen: Callable[[float], Ellipses] | Ellipses | None = None,
        wrapped: bool = False,
        now: float = 100.0,
    ) -> None:
        self.planner, self.now, self._wrapped = planner, now, wrapped
        known = ellipses() if seen is None else seen
        self.seen = known if callable(known) else lambda _: known
        self.offset = np.zeros(3)
        self._last = np.array(pose, float)
        self._followed = False
        self.times: list[float] = []
        self.poses: list[Array] = []
        self.states: list[PlannerState] = []

    def pose(self) -> Array:
        """Where the robot is, its heading not wrapped."""
        if self._followed:
            self._last = self.planner.motion.sample(self.now)[0]
        return self._last + self.offset

    def measured(self) -> Measured:
        """The robot as odometry has it."""
        pose = self.pose()
        velocity = self.planner.motion.sample(self.now)[1] if self._followed else np.zeros(3)
        twist = se2.to_robot(float(pose[2]), velocity)
        if self._wrapped:
            pose = np.append(pose[:2], se2.wrap(float(pose[2])))
        return Measured(self.now, pose, twist)

    def drive(self, goal: Goal) -> None:
        self.planner.drive(goal, self.measured(), self.seen(self.now))

    def cycle(self, solving: float = SOLVING) -> None:
        """One cycle; nothing is asked of a planner that is not active."""
        end = self.now + CYCLE
        planner = self.planner
        if planner.active:
            proposal = planner.propose(self.now, self.measured(), self.seen(self.now))
            self._move(self.now + solving)
            planner.take(proposal, self.now, self.measured(), self.seen(self.now))
            if planner.report.used:
                self._followed = True
                if proposal.fresh:
                    self.offset = np.zeros(3)
        self.states.append(planner.state)
        self._move(end)

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Cycle for so long, or until it is so, or until the goal is reached."""
        done = until or (lambda: self.planner.state is PlannerState.ARRIVED)
        end = self.now + seconds
        while self.now < end - 1e-6 and not done():
            self.cycle()

    def gaps(self, truth: Callable[[float], Ellipses] | Ellipses) -> Array:
        """True gaps (K, M) [m] of what the robot did."""
        known = truth if isinstance(truth, Ellipses) else truth(self.times[0])
        return true_gaps(
            np.array(self.times), np.array(self.poses), self.planner.model.half, known
        )

    def _move(self, end: float) -> None:
        while self.now < end - 1e-9:
            self.now = min(self.now + TICK, end)
            self.times.append(self.now)
            self.poses.append(self.pose())
