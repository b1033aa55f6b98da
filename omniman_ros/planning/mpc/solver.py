"""Real-time iterations on the optimal control problem: each iteration improves a guess."""

from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.mpc.quadratic_program import QuadraticProgram, SolverError
from omniman_ros.planning.mpc.transcription import Stage, Transcription

#: Largest change of a position in one iteration [m]: the linearised gaps hold nearby only
TRUST_RADIUS = 0.3


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
        self.transcription = transcription
        program = transcription.program
        self._qp = QuadraticProgram(
            program.sparsity_out(0), program.sparsity_out(2), transcription.sizes
        )

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
        return np.vstack([start, np.asarray(self.transcription.rollout(start, currents.T)).T])

    def solve(self, start: Array, guess: Array, stage: Stage, iterations: int = 1) -> Solution:
        """Improve a guess (N, n) of currents [A]; iterations end early if they change little.

        The state `start` (6,) is pose in odom [m, m, rad] and body twist [m/s, m/s, rad/s].

        Raises:
            SolverError: The solution is not finite, or no program was solved.
        """
        t = self.transcription
        table = stage.table().T
        if not (np.isfinite(start).all() and np.isfinite(guess).all()):
            raise SolverError("the start or the guess is not finite")
        currents, cost, slack, step, count = guess.T, np.nan, np.zeros(t.steps), np.inf, 0
        limit = t.model.max_current[:, None]
        for _ in range(iterations):
            *program, value, _ = t.program(start, currents, table)
            try:
                change = self._step(program)
            except SolverError:
                if not count:
                    raise
                break  # the iterate before is still a solution
            positions = change[:, t.controls + 1 : t.controls + 3]
            scale = min(1.0, TRUST_RADIUS / max(float(np.abs(positions).max()), TRUST_RADIUS))
            current_change = scale * change[:, : t.controls].T
            currents = np.clip(currents + current_change, -limit, limit)
            cost, slack = float(value), change[:, t.controls]
            step, count = float(np.abs(current_change).max()), count + 1
            if step < 0.01 * float(limit.max()):
                break
        states = self.states(start, currents.T)
        if not np.isfinite(states).all():
            raise SolverError("the plan is not finite")
        return Solution.unchecked(
            currents=np.ascontiguousarray(currents.T),
            states=states,
            cost=cost,
            slack=slack,
            step=step,
            iterations=count,
        )

    def _step(self, program: list[ca.DM]) -> Array:
        """Solve a quadratic program; return a row (delta u, s, delta x) for each step."""
        return self._qp.solve(program).reshape(self.transcription.steps, -1)
