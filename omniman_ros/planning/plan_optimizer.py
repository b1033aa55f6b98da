"""Optimisation of plans: the improved last plan and, if that is unsatisfactory, another one."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PlanTarget
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.mpc.solver import Solution, Solver
from omniman_ros.planning.mpc.transcription import Transcription
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.obstacles.walls import MAX_COMPUTED_GAP, Walls
from omniman_ros.planning.parameters import Horizon
from omniman_ros.surroundings.ellipses import Ellipses

WALL_SLOTS = 8  #: Number of additional obstacles in the optimisation where there are walls
#: Solver iterations on a problem without a warm start; with a warm start there is only one
COLD_ITERATIONS = 5
#: Distance from a plan's end to its target above which another is made from the targets [m]
LAG = 0.6
FRESH_ITERATIONS = 3  #: Solver iterations on a plan that is made from the targets
EVASION_ITERATIONS = 4  #: Solver iterations on an evasion
#: Solver iterations on an evasion near walls, which make each iteration slower
EVASION_ITERATIONS_AT_WALLS = 2
RANKED_DIRECTIONS = 16  #: Number of directions that are compared to find the most promising one
DIRECTION_STEP = 0.625 * math.pi  #: Angle between successive directions [rad]
NEAREST_OBSTACLES = 24  #: Number of obstacles, the nearest ones, by which directions are compared


class SolverPool:
    """Solvers with and without obstacles, walls and a border: empty rows cost time, too."""

    def __init__(self, model: PlanningModel, horizon: Horizon) -> None:
        self._slots = horizon.slots
        self._solvers = {
            (count, confined): Solver(
                Transcription(model, horizon.steps, horizon.step, count, confined)
            )
            for count in {0, horizon.slots, horizon.slots + WALL_SLOTS}
            for confined in (False, True)
        }

    def __iter__(self) -> Iterator[Solver]:
        return iter(self._solvers.values())

    def select(self, obstacles: bool, walls: bool, confined: bool) -> Solver:
        """Return the smallest solver with room for obstacles, for walls, or for neither.

        One that is not confined has no rows of the workspace.
        """
        slots = self._slots + WALL_SLOTS if walls else self._slots if obstacles else 0
        return self._solvers[slots, confined]


@dataclass(frozen=True)
class PlanRequest(Validated):
    """One planning problem."""

    #: (6,) state at which the plan begins: pose in odom, body twist
    start: Annotated[Array, Shape(6)]
    due: float  #: Time at which the plan begins [s]
    goal: PlanTarget
    footprint: Footprint  #: Outline of the robot
    obstacles: Ellipses  #: Obstacles as they are known now
    walls: Walls  #: Occupied cells of the map
    clearance: float | None = None  #: Gap to keep [m]; None means that of the parameters


class PlanOptimizer:
    """Solves planning problems, each with a warm start from the plan before.

    Attributes:
        solvers: Solvers of the present model.
    """

    def __init__(
        self, model: PlanningModel, limits: EffectiveLimits, solvers: SolverPool | None = None
    ) -> None:
        self.solvers = solvers or SolverPool(model, limits.parameters.horizon)
        self._problem = Problem(model, limits)
        self._evasions = EvasionGuesses()
        self._is_fresh_next = False
        self._warm_start: tuple[float, Array] | None = None
        self._failed = False

    def configure(self, model: PlanningModel, limits: EffectiveLimits) -> None:
        """Use other limits; another model discards the warm start."""
        if model is not self._problem.model:
            self.solvers = SolverPool(model, limits.parameters.horizon)
            self._problem = Problem(model, limits)
            self.discard_warm_start()
        self._problem.limits = limits

    def discard_warm_start(self) -> None:
        """Begin the next optimisation without a warm start."""
        self._warm_start = None

    def keep(self, due: float, solution: Solution) -> None:
        """Use a solution that begins at `due` [s] as the next warm start."""
        self._warm_start = due, solution.currents

    def note_failure(self) -> None:
        """Record a failed cycle: the warm start is used once more, and then discarded."""
        if self._failed:
            self.discard_warm_start()
        self._failed = True

    def note_success(self) -> None:
        """Record a cycle that did not fail."""
        self._failed = False

    def solve(self, request: PlanRequest, evade: bool) -> tuple[Solution, ...]:
        """Improve the last plan, and return it and another one, if found, by preference.

        A plan that lags behind its target may be caught on the wrong side of an obstacle: the
        other one then results from the targets alone. If asked for, it is an evasion; where both
        are wanted, they take turns. Without obstacles there is only one plan.

        Raises:
            SolverError: The last plan could not be improved.
        """
        start, due = request.start, request.due
        walls = self._walls_near(request)
        obstacles = request.obstacles
        confined = self._problem.is_confined(start, request.footprint, request.clearance)
        solver = self.solvers.select(len(obstacles) > 0, len(walls) > 0, confined)
        if len(walls):
            obstacles = obstacles.joined(walls.ellipses(obstacles.time))
        pairs = Pairs.of(request.footprint, obstacles)
        if self._warm_start is None:
            guess, iterations = solver.cold(), COLD_ITERATIONS
        else:
            since, currents = self._warm_start
            guess, iterations = solver.shifted(currents, due - since), 1
        plan = self._improved(solver, request, pairs, guess, iterations)
        self.keep(due, plan)
        if not len(pairs):
            return (plan,)
        lags = self._lags(request, plan)
        self._is_fresh_next = lags and not (evade and self._is_fresh_next)
        try:
            if self._is_fresh_next:
                fresh = self._fresh(solver, request, pairs)
                if not self._is_better(fresh, plan):
                    return (plan,)
                self.keep(due, fresh)
                return fresh, plan
            if not evade:
                return (plan,)
            guess = self._evasions.next(self._problem, solver, start, due, pairs)
            iterations = EVASION_ITERATIONS_AT_WALLS if len(walls) else EVASION_ITERATIONS
            return plan, self._improved(solver, request, pairs, guess, iterations)
        except SolverError:
            return (plan,)

    def _lags(self, request: PlanRequest, plan: Solution) -> bool:
        """Return whether a plan ends far from its target."""
        step = self._problem.limits.parameters.horizon.step
        ends = request.due + step * len(plan.currents)
        target = request.goal.targets(np.array([ends]))[0][0]
        return math.dist(plan.states[-1, :2].tolist(), target[:2].tolist()) > LAG

    def _fresh(self, solver: Solver, request: PlanRequest, pairs: Pairs) -> Solution:
        """Return the plan that results from its targets alone."""
        step = self._problem.limits.parameters.horizon.step
        times = request.due + step * np.arange(1.0, solver.transcription.steps + 1.0)
        guess = self._problem.along(request.start, request.goal.targets(times)[0])
        return self._improved(solver, request, pairs, guess, FRESH_ITERATIONS)

    def _is_better(self, plan: Solution, other: Solution) -> bool:
        """Return whether a plan is better than another: by too large a slack, then by its cost."""
        allowed = self._problem.limits.parameters.safety.slack
        overlaps, other_overlaps = (float(each.slack.max()) > allowed for each in (plan, other))
        return (overlaps, plan.cost) < (other_overlaps, other.cost)

    def _improved(
        self,
        solver: Solver,
        request: PlanRequest,
        pairs: Pairs,
        guess: Array,
        iterations: int,
    ) -> Solution:
        """Improve a guess (N, n) [A] by solver iterations."""
        start, step = request.start, self._problem.limits.parameters.horizon.step
        motion = HermiteTrajectory.of_states(request.due, step, solver.states(start, guess), guess)
        t = solver.transcription
        stage = self._problem.stage(
            start, motion, request.goal, pairs, t.slots, request.clearance, t.confined
        )
        return solver.solve(start, guess, stage, iterations)

    def _walls_near(self, request: PlanRequest) -> Walls:
        walls = request.walls
        if not len(walls):
            return walls
        p = self._problem.limits.parameters
        reach = p.limits.linear_velocity * p.horizon.duration
        return walls.near(request.start, reach + request.footprint.radius + MAX_COMPUTED_GAP)


class EvasionGuesses:
    """Proposes currents that drive off in a direction, which differs on every call.

    The most promising direction alternates with one from a fixed sequence.
    """

    def __init__(self) -> None:
        self._count = 0

    def next(
        self, problem: Problem, solver: Solver, start: Array, due: float, pairs: Pairs
    ) -> Array:
        """Return the next guess (N, n) of motor currents [A], for one pair or more.

        The plan begins at `due` [s] in the state `start` (6,): pose in odom, body twist.
        """
        self._count += 1
        if self._count % 2:
            return problem.evasion(start, self._count * DIRECTION_STEP)
        return _most_promising(problem, solver, start, due, pairs)


def _most_promising(
    problem: Problem, solver: Solver, start: Array, due: float, pairs: Pairs
) -> Array:
    """Return the guess (N, n) that touches an obstacle latest or, if equal, has the widest gap."""
    known = pairs.ellipses
    distances = np.hypot(*(known.centers - start[:2]).T) - known.semi_axes.max(axis=1)
    nearest = pairs.select(np.argsort(distances)[:NEAREST_OBSTACLES])
    near = nearest.ellipses
    guesses = [problem.evasion(start, k * DIRECTION_STEP) for k in range(RANKED_DIRECTIONS)]
    paths = [solver.states(start, guess)[1:, :3] for guess in guesses]
    step = problem.limits.parameters.horizon.step
    times: Array = due + step * np.arange(1.0, len(paths[0]) + 1.0)
    centers, axes = (
        np.tile(values, (RANKED_DIRECTIONS, 1, 1))
        for values in (near.centers_at(times), near.axes_at(times))
    )
    gaps = box_gap(np.concatenate(paths), nearest.boxes, centers, axes, near.angles)
    gaps = gaps.min(axis=1).reshape(RANKED_DIRECTIONS, -1)
    touched = gaps <= 0.0
    free_steps = np.where(touched.any(axis=1), touched.argmax(axis=1), gaps.shape[1])
    return guesses[int(np.lexsort((gaps.min(axis=1), free_steps))[-1])]
