"""Planners, obstacles and an ideal robot for the tests of the planner."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.planning.cycle import MeasuredState, PlannerState
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.motion_selection import REPLAN_HEADING_ERROR, REPLAN_POSITION_ERROR
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.plan_optimizer import SolverPool
from omniman_ros.planning.planner import Planner
from omniman_ros.surroundings.ellipses import Ellipses
from test import robots

CYCLE = 0.05  #: Period of the planner [s]
SOLVING = 0.01  #: How long an answer takes [s]
TICK = 0.005  #: Time between two samples of what the robot did [s]


def parameters(name: str = "ig42", **changes: Any) -> PlannerParameters:
    """Return planner parameters; changes are given by name with `__` for the dot."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return build(PlannerParameters, robots.values(name, dotted))


def planner(name: str = "ig42", **changes: Any) -> Planner:
    """Return a planner with an anchor; changes as in `parameters`."""
    given = parameters(name, **changes)
    # Solvers take long to build and keep no state between calls.
    return Planner(given, solvers=solver_pool(name, tuple(sorted(changes.items()))))


@cache
def solver_pool(name: str, changes: tuple[tuple[str, Any], ...] = ()) -> SolverPool:
    """Return the shared solvers of a robot with changed parameters."""
    given = parameters(name, **dict(changes))
    return SolverPool(PlanningModel.of(given.robot), given.horizon)


def model(name: str) -> PlanningModel:
    """Return the model of one of the shared robots."""
    return PlanningModel.of(robots.robot(name))


def ellipses(
    *rows: tuple[float, ...], time: float = 0.0, velocities: Any = None, growth: float = 0.0
) -> Ellipses:
    """Return obstacles from rows (x, y, a, b, angle) or (x, y, radius)."""
    full = np.array([row if len(row) == 5 else (*row, row[2], 0.0) for row in rows], float)
    full = full.reshape(-1, 5)
    speeds = np.zeros((len(full), 2)) if velocities is None else np.array(velocities, float)
    return Ellipses(
        time,
        full[:, :2],
        speeds.reshape(-1, 2),
        full[:, 2:4],
        full[:, 4],
        np.full(len(full), growth),
    )


def crowd(rng: np.random.Generator, count: int, spread: float = 6.0) -> Ellipses:
    """Draw obstacles within +-`spread` [m] of the origin, half of which are discs."""
    rows = []
    for k in range(count):
        x, y = rng.uniform(-spread, spread, 2)
        a, b = rng.uniform(0.02, 0.6, 2)
        rows.append((x, y, a, a, 0.0) if k % 2 else (x, y, a, b, rng.uniform(-3, 3)))
    return ellipses(*rows)


def observed(known: Ellipses, now: float) -> Ellipses:
    """Return the obstacles as observed at a time [s]."""
    return replace(known, time=now, centers=known.centers_at(np.array([now]))[0])


def true_gaps(times: Array, poses: Array, half: Array, around: Ellipses) -> Array:
    """Return gaps (K, M) [m] between box and ellipses without margin, from sampled points.

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
    # A box inside the ellipse contains no point of its boundary: test the box centre.
    c, s = np.cos(around.angles), np.sin(around.angles)
    u = (c * seen[..., 0] + s * seen[..., 1]) / around.semi_axes[:, 0]
    v = (c * seen[..., 1] - s * seen[..., 0]) / around.semi_axes[:, 1]
    return np.where(u * u + v * v <= 1.0, 0.0, gaps)


class SimulatedRun:
    """A planner with a robot that follows the planned motion exactly.

    Args:
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
        """Pose of the robot, its heading not wrapped."""
        if self._followed:
            self._last = self.planner.motion.sample(self.now)[0]
        return self._last + self.offset

    def measured(self) -> MeasuredState:
        """State of the robot as odometry reports."""
        pose = self.pose()
        velocity = self.planner.motion.sample(self.now)[1] if self._followed else np.zeros(3)
        twist = se2.to_robot(float(pose[2]), velocity)
        if self._wrapped:
            pose = np.append(pose[:2], se2.wrap(float(pose[2])))
        return MeasuredState(self.now, pose, twist)

    def drive(self, goal: Goal) -> None:
        self.planner.drive(goal, self.measured(), self.seen(self.now))

    def cycle(self, solving: float = SOLVING) -> None:
        """Run one cycle; a planner that is not active is not called."""
        end = self.now + CYCLE
        planner = self.planner
        off = np.hypot(*self.offset[:2]) > REPLAN_POSITION_ERROR
        off = off or abs(self.offset[2]) > REPLAN_HEADING_ERROR
        if planner.active:
            proposal = planner.propose(self.now, self.measured(), self.seen(self.now))
            self._move(self.now + solving)
            there = self.pose()
            planner.take(proposal, self.now, self.measured(), self.seen(self.now))
            planner.update_route(self.now, self.seen(self.now))
            if planner.report.used:
                self._followed = True
                if off:  # the plan begins at the robot, not at the last plan
                    self.offset = there - planner.motion.sample(self.now)[0]
        self.states.append(planner.state)
        self._move(end)

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Run cycles for a time, until a condition holds or until the goal is reached."""
        done = until or (lambda: self.planner.state is PlannerState.ARRIVED)
        end = self.now + seconds
        while self.now < end - 1e-6 and not done():
            self.cycle()

    def gaps(self, truth: Callable[[float], Ellipses] | Ellipses) -> Array:
        """Return the true gaps (K, M) [m] along the driven motion."""
        known = truth if isinstance(truth, Ellipses) else truth(self.times[0])
        return true_gaps(
            np.array(self.times), np.array(self.poses), self.planner.model.half, known
        )

    def _move(self, end: float) -> None:
        while self.now < end - 1e-9:
            self.now = min(self.now + TICK, end)
            self.times.append(self.now)
            self.poses.append(self.pose())
