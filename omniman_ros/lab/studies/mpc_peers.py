"""The MPC's problem as a nonlinear program for general solvers, the reference of real-time steps.

Everything comes from the transcription's own functions and from the same table of parameters, so
that solvers differ only in how they solve. Steps are connected by multiple shooting, the first
state is fixed, and each stage has a slack of its own.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.mpc_scenes import Task, penalty
from omniman_ros.planning.mpc.model import STATES
from omniman_ros.planning.mpc.transcription import Stage, Transcription

Indices = NDArray[np.intp]

PUSH = 1e-3
"""Distance by which IPOPT moves a warm start off its bounds."""
OPTIONS: dict[str, dict[str, Any]] = {
    # On closed-loop steps, this initial barrier takes two thirds of the default's time.
    "ipopt": {
        "ipopt": {
            "linear_solver": "mumps",
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-6,
            "max_iter": 300,
            "mu_init": 1e-3,
            "warm_start_init_point": "yes",
            "warm_start_bound_push": PUSH,
            "warm_start_bound_frac": PUSH,
            "warm_start_slack_bound_push": PUSH,
            "warm_start_slack_bound_frac": PUSH,
            "warm_start_mult_bound_push": PUSH,
        },
    },
    # At 1e-4 it fails 5 times as often, at 1e-6 every other time.
    "fatrop": {
        "structure_detection": "manual",
        "fatrop": {"print_level": 0, "tol": 1e-3, "max_iter": 100},
    },
}
"""Options of each solver, in addition to those that follow from the problem."""


@dataclass(frozen=True)
class Value:
    """The value of a sequence of currents, whichever solver found it.

    Attributes:
        states: (N + 1, 6) states that follow from the currents, the first being the start.
        cost: Cost including the penalty of the slack [J].
        slack: (N,) least slack that satisfies obstacles and workspace [m].
        excess: Largest violation of a limit without slack, relative to the limit.
    """

    states: Array
    cost: float
    slack: Array
    excess: float


@dataclass(frozen=True)
class Multipliers:
    """The multipliers of bounds and constraints at a solver's solution."""

    bounds: Array
    constraints: Array


@dataclass(frozen=True)
class PeerAnswer:
    """The solution of a general solver.

    Attributes:
        currents: (N, n) motor currents [A].
        states: (N + 1, 6) the solver's states, which satisfy the model to its tolerance.
        slack: (N,) slacks [m].
        cost: Objective, including the penalty of the slack [J].
        solved: Whether the solver reports convergence.
        status: Status that the solver reports.
        iterations: Number of iterations.
        multipliers: Multipliers for a warm start of the next solution.
    """

    currents: Array
    states: Array
    slack: Array
    cost: float
    solved: bool
    status: str
    iterations: int
    multipliers: Multipliers


class Evaluator:
    """Judges currents by the transcription's functions, without any solver.

    Args:
        transcription: The problem.
    """

    def __init__(self, transcription: Transcription) -> None:
        t = self._transcription = transcription
        self._cost = t.stage_cost.map(t.steps)
        self._rows = t.stage_rows.map(t.steps)

    def value(self, start: Array, currents: Array, stage: Stage) -> Value:
        """Return cost and violations of currents (N, n) [A] from a start (6,)."""
        t = self._transcription
        table = stage.table().T
        ends = np.asarray(t.rollout(start, currents.T)).reshape(STATES, t.steps)
        states = np.vstack([start, ends.T])
        before = states[:-1].T
        costs = np.asarray(self._cost(before, currents.T, table))
        rows, low, high = (np.asarray(part) for part in self._rows(before, currents.T, table))
        short = np.maximum(low - rows, rows - high)
        slack = np.maximum(short[t.relaxed :], 0.0).max(axis=0, initial=0.0)
        excess = float(short[: t.relaxed].max(initial=0.0))
        return Value(states, float(costs.sum()) + penalty(stage, slack), slack, excess)


class Peer:
    """A general solver for the problem of a transcription.

    Cost and rows of a place are written in the state there, not through the step that leads to
    it: that halves what second derivatives cost. The variables are u_0; x_1, u_1, s_1; ...; x_N,
    s_N, and the constraints follow them stage by stage.

    Args:
        transcription: The problem.
        solver: "ipopt" or "fatrop".
        options: In place of those in `OPTIONS`.
        folded: Whether common subexpressions of its functions are computed once: a tenth less
            time for a solution, seconds more to build.

    Raises:
        RuntimeError: casadi has no such solver.

    Attributes:
        constraints: (w, p) -> all constraints, as the solver has them; see `packed`.
        lower, upper: Their bounds.
        hard, opened: (N, .) which of them are the rows of each stage that no slack opens, and
            those that slack opens.
    """

    def __init__(
        self,
        transcription: Transcription,
        solver: str,
        options: dict[str, Any] | None = None,
        folded: bool = False,
    ) -> None:
        t = self._transcription = transcription
        n, steps, hard, soft = t.controls, t.steps, t.relaxed, t.rows - t.relaxed
        stage, low, high = self._stage()
        # Structure is all to fatrop: rows of a stage may not know the state of the next.
        substituted = solver == "fatrop"
        x, cost = ca.SX.sym("start", STATES), ca.SX(0)
        table = ca.SX.sym("table", *t.program.size_in(2))
        parameters = ca.vertcat(x, ca.vec(table))
        variables: list[ca.SX] = []
        constraints: list[ca.SX] = []
        due: list[ca.SX] = []
        slack: list[ca.SX] = []
        for k in range(steps):
            u, s = ca.SX.sym(f"u{k}", n), ca.SX.sym(f"s{k + 1}")
            y, p = ca.SX.sym(f"x{k + 1}", STATES), table[:, k]
            end = t.transition(x, u)
            spent, reached, kept, room = stage(x, u, y, p)
            if substituted:
                _, _, kept, _ = stage(x, u, end, p)
            cost += spent + reached + p[22] * s + 0.5 * p[23] * s**2
            variables += [u, *slack, y]
            constraints += [y - end, kept, *due]
            slack, due, x = [s], [room + s], y
        variables += slack
        constraints += due
        self._currents, self._slack, self._states = self._places()
        size_g = steps * (STATES + hard + soft)
        # Stages of the constraints: motion and hard rows (not the last), then the place's own.
        first = STATES + hard
        begins = np.append(0, first + (first + soft) * np.arange(steps - 1))
        self._motion: Indices = begins[:, None] + np.arange(STATES)
        self.hard: Indices = begins[:, None] + np.arange(STATES, first)
        own = np.append(begins[1:] + first, size_g - soft)
        self.opened: Indices = own[:, None] + np.arange(soft)
        self.lower, self.upper = np.zeros(size_g), np.zeros(size_g)
        self.lower[self.hard], self.upper[self.hard] = low[:hard], high[:hard]
        self.lower[self.opened], self.upper[self.opened] = low[hard:], high[hard:]
        w, g = ca.vertcat(*variables), ca.vertcat(*constraints)
        self.constraints = ca.Function("constraints", [w, parameters], [g])
        limit = t.model.max_current
        self._least, self._most = np.full(w.numel(), -np.inf), np.full(w.numel(), np.inf)
        self._least[self._currents], self._most[self._currents] = -limit, limit
        self._least[self._slack] = 0.0
        chosen: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            # Multipliers of the parameters: nobody asks, and roots of zero weights make them NaN.
            "calc_lam_p": False,
            **(OPTIONS[solver] if options is None else options),
        }
        if folded:
            chosen["common_options"] = {"final_options": {"cse": True}}
        if substituted:
            chosen |= {
                "N": steps,
                "nx": [0] + [STATES] * steps,
                "nu": [n] + [n + 1] * (steps - 1) + [1],
                "ng": [hard] + [hard + soft] * (steps - 1) + [soft],
                "equality": np.isin(np.arange(size_g), self._motion).tolist(),
            }
        program = {"x": w, "p": parameters, "f": cost, "g": g}
        self._solve = ca.nlpsol("peer", solver, program, chosen)

    def _stage(self) -> tuple[ca.Function, Array, Array]:
        """(x, u, y, p) -> losses, cost of y, rows without and with slack; and the rows' bounds."""
        t = self._transcription
        x, y, u = ca.SX.sym("x", STATES), ca.SX.sym("y", STATES), ca.SX.sym("u", t.controls)
        p = ca.SX.sym("p", t.program.size1_in(2))
        losses = p[21] * t.losses(x, u)
        value, low, high = t.inequalities(x, u, y, p)
        outputs = [
            losses,
            ca.sumsqr(t.node_residuals(y, p)),
            value[: t.relaxed],
            value[t.relaxed :],
        ]
        bounds = [np.asarray(ca.evalf(ca.densify(bound))).ravel() for bound in (low, high)]
        return ca.Function("stage", [x, u, y, p], outputs), bounds[0], bounds[1]

    def _places(self) -> tuple[Indices, Indices, Indices]:
        """Return the indices of currents (N, n), slack (N,) and states (N, 6) in the variables."""
        t, n = self._transcription, self._transcription.controls
        width = STATES + n + 1
        begins = n + width * np.arange(t.steps)  # of x_1, ..., x_N
        states: Indices = begins[:, None] + np.arange(STATES)
        currents: Indices = np.vstack([np.arange(n), (begins[:-1, None] + STATES) + np.arange(n)])
        slack: Indices = np.append(begins[:-1] + STATES + n, begins[-1] + STATES)
        return currents, slack, states

    def packed(
        self, start: Array, currents: Array, states: Array, slack: Array, stage: Stage
    ) -> tuple[Array, Array]:
        """Variables w and parameters p; see :meth:`solve`, slack (N,) [m]."""
        w = np.zeros(self._least.size)
        w[self._currents], w[self._slack], w[self._states] = currents, slack, states[1:]
        return w, np.concatenate([start, stage.table().ravel()])

    def solve(
        self,
        start: Array,
        currents: Array,
        states: Array,
        stage: Stage,
        before: Multipliers | None = None,
    ) -> PeerAnswer:
        """Solve from a guess.

        Args:
            start: (6,) state.
            currents: (N, n) guess [A].
            states: (N + 1, 6) that follow from them.
            stage: Parameters of the problem.
            before: Multipliers of the solution one step before, if there is one.
        """
        t = self._transcription
        limit = t.model.max_current
        inside = np.clip(currents, -limit, limit)
        w, p = self.packed(start, inside, states, np.zeros(t.steps), stage)
        warm = {} if before is None else self._shifted(before)
        try:
            found = self._solve(
                x0=w, p=p, lbg=self.lower, ubg=self.upper, lbx=self._least, ubx=self._most, **warm
            )
        except RuntimeError as error:  # fatrop throws where others report
            none = Multipliers(np.zeros(w.size), np.zeros(self.lower.size))
            return PeerAnswer(
                inside, states, np.zeros(t.steps), np.nan, False, str(error), 0, none
            )
        stats = self._solve.stats()
        answer = np.asarray(found["x"]).ravel()
        return PeerAnswer(
            currents=answer[self._currents],
            states=np.vstack([start, answer[self._states]]),
            slack=answer[self._slack],
            cost=float(found["f"]),
            solved=bool(stats["success"]) and bool(np.isfinite(answer).all()),
            status=str(stats["return_status"]),
            iterations=int(stats.get("iter_count", 0)),
            multipliers=Multipliers(
                np.asarray(found["lam_x"]).ravel(), np.asarray(found["lam_g"]).ravel()
            ),
        )

    def _shifted(self, before: Multipliers) -> dict[str, Array]:
        """Multipliers one step later; the last are kept."""
        bounds, constraints = before.bounds.copy(), before.constraints.copy()
        for place in (self._currents, self._slack, self._states):
            bounds[place[:-1]] = before.bounds[place[1:]]
        for place in (self._motion, self.hard, self.opened):
            constraints[place[:-1]] = before.constraints[place[1:]]
        return {"lam_x0": bounds, "lam_g0": constraints}


class Converged:
    """A peer until it converges, from the guess and, if that pays, the last multipliers."""

    def __init__(self, peer: Peer, dual: bool) -> None:
        self._peer, self._dual = peer, dual
        self._before: Multipliers | None = None

    def plan(self, task: Task) -> tuple[Array, bool]:
        """See `Controller`."""
        before = None if task.first else self._before
        found = self._peer.solve(task.start, task.guess, task.states, task.stage, before)
        self._before = found.multipliers if self._dual and found.solved else None
        return (found.currents if found.solved else task.guess), found.solved
