"""Initial guesses from which the solver finds other paths around obstacles than the last plan."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap

RANKED_DIRECTIONS = 16  #: Number of directions that are compared to find the most promising one
DIRECTION_STEP = 0.625 * math.pi  #: Angle between successive directions [rad]
NEAREST_OBSTACLES = 24  #: Number of obstacles, the nearest ones, by which directions are compared


class EvasionGuesses:
    """Proposes currents that drive off in a direction, which differs on every call.

    The most promising direction alternates with one from a fixed sequence.
    """

    def __init__(self) -> None:
        self._count = 0

    def next(
        self, problem: Problem, solver: Solver, start: Array, due: float, pairs: Pairs
    ) -> Array:
        """Return the next guess.

        Args:
            solver: Solver that will start from the guess.
            start: (6,) state where the plan begins: pose in odom, body twist.
            due: Time at which it begins [s].
            pairs: Parts of the robot and obstacles, one pair or more.

        Returns:
            (N, n) motor currents [A].
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
