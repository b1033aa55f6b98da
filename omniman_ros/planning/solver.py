"""Real-time iterations on the optimal control problem: from a guess to the next, better one."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import OmnimanError
from omniman_ros.planning.transcription import Stage, Transcription

Array = NDArray[np.float64]

ROUGH: dict[str, float] = {
    "res_g_max": 1e-3,
    "res_b_max": 1e-6,
    "res_d_max": 1e-6,
    "res_m_max": 1e-4,
}
"""Residuals at which a quadratic program counts as solved; the next iteration refines it."""
MODES: dict[str, dict[str, Any]] = {
    "speed": {"mode": "speed", "iter_max": 40},
    "balance": {"mode": "balance", "iter_max": 60},
}
"""How HPIPM is asked; the second where the first fails."""
TRUST = 0.3
"""No iteration moves the robot's place at any time by more: collision rows hold near by [m]."""
INFINITY = 1e4
"""Stands for infinity in the QP solver: larger ones spoil its scaling."""


class SolverError(OmnimanError):
    """The solver gave no usable answer; the message says what it said."""


@dataclass(frozen=True)
class Answer:
    """What the solver found.

    Attributes:
        currents: (N, n) of the motors over each step [A].
        states: (N + 1, 6) the states that follow from them; the first is where they begin.
        cost: Of the last iterate that was evaluated [J].
        slack: (N,) by which obstacles or workspace were opened at the steps' ends [m].
        step: Largest change of a current in the last iteration [A].
        iterations: How many were made.
    """

    currents: Array
    states: Array
    cost: float
    slack: Array
    step: float
    iterations: int


class Solver:
    """Sequential quadratic programming with Gauss-Newton Hessians, one program an iteration.

    Args:
        transcription: The problem.

    Raises:
        SolverError: casadi has no HPIPM.
    """

    def __init__(self, transcription: Transcription) -> None:
        self.transcription = transcription
        program = transcription.program
        shape = {"h": program.sparsity_out(0), "a": program.sparsity_out(2)}
        more: dict[str, Any] = {
            **transcription.sizes, "inf": INFINITY, "error_on_fail": False, "print_time": False,
        }  # fmt: skip
        try:
            self._qps = [
                ca.conic(mode, "hpipm", shape, more | {"hpipm": {**ROUGH, **options}})
                for mode, options in MODES.items()
            ]
        except RuntimeError as error:
            raise SolverError(f"casadi has no QP solver 'hpipm': {error}") from error

    def cold(self) -> Array:
        """Currents (N, n) to begin from when nothing is known: none."""
        return np.zeros((self.transcription.steps, self.transcription.controls))

    def shifted(self, currents: Array, time: float) -> Array:
        """Currents (N, n) seen `time` seconds later; the last are held."""
        ahead = np.arange(len(currents)) + time / self.transcription.step
        whole = np.floor(ahead).astype(int)
        part = (ahead - whole)[:, None]
        last = len(currents) - 1
        first, second = np.minimum(whole, last), np.minimum(whole + 1, last)
        result: Array = (1.0 - part) * currents[first] + part * currents[second]
        return result

    def states(self, start: Array, currents: Array) -> Array:
        """States (N + 1, 6) that follow from a start (6,) and currents (N, n)."""
        return np.vstack([start, np.asarray(self.transcription.rollout(start, currents.T)).T])

    def solve(self, start: Array, guess: Array, stage: Stage, iterations: int = 1) -> Answer:
        """Improve a guess.

        Args:
            start: (6,) state: pose in odom [m, m, rad], body twist [m/s, m/s, rad/s].
            guess: (N, n) currents [A].
            stage: Parameters of the problem.
            iterations: How many programs are solved at most; fewer where they change nothing.

        Raises:
            SolverError: No finite answer, or the program was not solved.
        """
        t = self.transcription
        table = stage.table().T
        if not (np.isfinite(start).all() and np.isfinite(guess).all()):
            raise SolverError("the start or the guess is not finite")
        currents, cost, slack, step, made = guess.T, np.nan, np.zeros(t.steps), np.inf, 0
        limit = t.model.max_current[:, None]
        for _ in range(iterations):
            *program, value, _ = t.program(start, currents, table)
            try:
                change = self._step(program)
            except SolverError:
                if not made:
                    raise
                break  # what was found before serves
            places = change[:, t.controls + 1 : t.controls + 3]
            trusted = min(1.0, TRUST / max(float(np.abs(places).max()), TRUST))
            moved = trusted * change[:, : t.controls].T
            currents = np.clip(currents + moved, -limit, limit)
            cost, slack = float(value), change[:, t.controls]
            step, made = float(np.abs(moved).max()), made + 1
            if step < 0.01 * float(limit.max()):
                break
        states = self.states(start, currents.T)
        if not np.isfinite(states).all():
            raise SolverError("the plan is not finite")
        return Answer(np.ascontiguousarray(currents.T), states, cost, slack, step, made)

    def _step(self, program: list[ca.DM]) -> Array:
        """Solve a quadratic program: a row (delta u, s, delta x) for each step."""
        h, g, a, low, high, least, most = program
        status = ""
        for qp in self._qps:
            found = qp(h=h, g=g, a=a, lba=low, uba=high, lbx=least, ubx=most)["x"]
            change: Array = np.asarray(found).reshape(self.transcription.steps, -1)
            stats = qp.stats()
            if stats["success"] and np.isfinite(change).all():
                return change
            status = str(stats["return_status"])
        raise SolverError(f"the quadratic program was not solved ({status})")
