"""Real-time iterations on the optimal control problem: each iteration improves a guess."""

from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.mpc.in_place import InPlaceFunction, is_same
from omniman_ros.planning.mpc.quadratic_program import ARGUMENTS, QuadraticProgram, SolverError
from omniman_ros.planning.mpc.transcription import Stage, Transcription

#: Largest change of a position in one iteration [m]: the linearised gaps hold nearby only
TRUST_RADIUS = 0.3
COST = len(ARGUMENTS)  #: Index of the cost in the results of a transcription's program


@dataclass(frozen=True)
class Solution(Validated):
    """Solution of an optimal control problem."""

    currents: Annotated[Array, Shape("N", "n")]  #: (N, n) motor currents over each step [A]
    #: (N + 1, 6) states that result from them, the first being the start
    states: Annotated[Array, Shape("N + 1", 6)]
    cost: float  #: Cost of the last iterate that was evaluated [J]
    #: (N,) slack of obstacles and workspace at the steps' ends [m]
    slack: Annotated[Array, Shape("N")]
    step: float  #: Largest change of a current in the last iteration [A]
    iterations: int  #: Number of iterations


class Solver:
    """Sequential quadratic programming with Gauss-Newton Hessians, one program per iteration.

    Raises:
        SolverError: casadi has no HPIPM.
    """

    def __init__(self, transcription: Transcription) -> None:
        t = self.transcription = transcription
        self._qp = QuadraticProgram(t.h, t.a, t.sizes)
        self._program = InPlaceFunction(t.program, self._qp.entries)
        self._rollout = InPlaceFunction(t.rollout)

    def take_over(self, program: ca.Function, rollout: ca.Function) -> bool:
        """Use compiled functions in place of those of the transcription, if they are the same.

        They are compared on random inputs, to the last bit. Returns whether they are used.
        """
        t = self.transcription
        if not (is_same(t.program, program) and is_same(t.rollout, rollout)):
            return False
        self._program = InPlaceFunction(program, self._qp.entries)
        self._rollout = InPlaceFunction(rollout)
        return True

    def cold(self) -> Array:
        """Return the guess (N, n) [A] for a cold start: zero currents."""
        return np.zeros((self.transcription.steps, self.transcription.controls))

    def shifted(self, currents: Array, time: float) -> Array:
        """Return currents (N, n) [A] shifted by a time [s]; the last ones are held."""
        ahead = np.arange(len(currents)) + time / self.transcription.step
        whole = np.floor(ahead).astype(int)
        part = (ahead - whole)[:, None]
        last = len(currents) - 1
        first, second = np.minimum(whole, last), np.minimum(whole + 1, last)
        result: Array = (1.0 - part) * currents[first] + part * currents[second]
        return result

    def states(self, start: Array, currents: Array) -> Array:
        """Return the states (N + 1, 6) that result from a start (6,) and currents (N, n) [A]."""
        own_start, own_currents = self._rollout.arguments
        own_start[:], own_currents[:] = start, currents.ravel()
        self._rollout()
        return np.concatenate([start, self._rollout.results[0]]).reshape(-1, len(start))

    def solve(self, start: Array, guess: Array, stage: Stage, iterations: int = 1) -> Solution:
        """Improve a guess (N, n) of currents [A]; iterations end early if they change little.

        The state `start` (6,) is pose in odom [m, m, rad] and body twist [m/s, m/s, rad/s].

        Raises:
            SolverError: The solution is not finite, or no program was solved.
        """
        t = self.transcription
        if not (np.isfinite(start).all() and np.isfinite(guess).all()):
            raise SolverError("the start or the guess is not finite")
        own_start, own_currents, own_table = self._program.arguments
        own_start[:], own_table[:] = start, stage.table().ravel()
        currents, cost, slack, step, count = guess, np.nan, np.zeros(t.steps), np.inf, 0
        limit = t.model.max_current
        for _ in range(iterations):
            own_currents[:] = currents.ravel()
            self._program()
            try:
                change = self._qp.solve().reshape(t.steps, -1)  # rows (delta u, s, delta x)
            except SolverError:
                if not count:
                    raise
                break  # the iterate before is still a solution
            positions = change[:, t.controls + 1 : t.controls + 3]
            scale = min(1.0, TRUST_RADIUS / max(float(np.abs(positions).max()), TRUST_RADIUS))
            current_change = scale * change[:, : t.controls]
            currents = np.maximum(np.minimum(currents + current_change, limit), -limit)
            cost, slack = float(self._program.results[COST][0]), change[:, t.controls]
            step, count = float(np.abs(current_change).max()), count + 1
            if step < 0.01 * float(limit.max()):
                break
        states = self.states(start, currents)
        if not np.isfinite(states).all():
            raise SolverError("the plan is not finite")
        return Solution.unchecked(
            currents=currents,
            states=states,
            cost=cost,
            slack=slack,
            step=step,
            iterations=count,
        )
