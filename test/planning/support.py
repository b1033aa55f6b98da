"""Planners, obstacles and a robot that does as it is told, for the tests of the planner."""

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import robots
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.parameters import build
from omniman_ros.planning.cycle import Measured, PlannerState
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.planner import ASTRAY, Planner

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
    built = _planner(name, tuple(sorted(changes.items())))
    result = copy.copy(built)  # its solvers are dear, and keep nothing from one call to the next
    result._problem = copy.copy(built._problem)
    return result


@cache
def _planner(name: str, changes: tuple[tuple[str, Any], ...]) -> Planner:
    return Planner(parameters(name, **dict(changes)))


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


def observed(known: Ellipses, now: float) -> Ellipses:
    """The same obstacles, as they are seen at a time [s]."""
    return replace(known, time=now, centers=known.centers_at(np.array([now]))[0])


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
    c_box, s_box = np.cos(poses[:, 2])[:, None, None], np.sin(poses[:, 2])[:, None, None]
    px, py = seen[..., :1] + x, seen[..., 1:] + y
    beyond_x = np.maximum(np.abs(c_box * px + s_box * py) - half[0], 0.0)
    beyond_y = np.maximum(np.abs(c_box * py - s_box * px) - half[1], 0.0)
    gaps: Array = np.sqrt((beyond_x**2 + beyond_y**2).min(axis=-1))
    # A box in the ellipse has no point of the ellipse's edge within: its centre tells.
    c, s = np.cos(around.angles), np.sin(around.angles)
    u = (c * seen[..., 0] + s * seen[..., 1]) / around.semi_axes[:, 0]
    v = (c * seen[..., 1] - s * seen[..., 0]) / around.semi_axes[:, 1]
    return np.where(u * u + v * v <= 1.0, 0.0, gaps)


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
        self.seen = known if callable(known) else lambda now: observed(known, now)
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
        astray = np.hypot(*self.offset[:2]) > ASTRAY[0] or abs(self.offset[2]) > ASTRAY[1]
        if planner.active:
            proposal = planner.propose(self.now, self.measured(), self.seen(self.now))
            self._move(self.now + solving)
            there = self.pose()
            planner.take(proposal, self.now, self.measured(), self.seen(self.now))
            planner.look(self.now, self.seen(self.now))
            if planner.report.used:
                self._followed = True
                if astray:  # the plan begins where the robot is, not where the last one was
                    self.offset = there - planner.motion.sample(self.now)[0]
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
