"""The MPC problem as a nonlinear program for general solvers, for comparison with the planner's.

The program consists of the transcription's own functions and of the same table of parameters, so
that solvers differ only in how they solve it. Steps are connected by multiple shooting, the first
state is fixed, and each stage has its own slack.
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
"""Indices into the variables or the constraints of the nonlinear program."""

PUSH = 1e-3
"""Absolute and relative distance from the bounds to which IPOPT moves a warm start [-]."""
OPTIONS: dict[str, dict[str, Any]] = {
    # With this initial barrier parameter, closed-loop steps take two thirds of the time that
    # they take with the default.
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
    # With a tolerance of 1e-4 it fails 5 times as often, with 1e-6 every other time.
    "fatrop": {
        "structure_detection": "manual",
        "fatrop": {"print_level": 0, "tol": 1e-3, "max_iter": 100},
    },
}
"""Options of each solver, by its name in casadi, in addition to those that follow from the
problem."""


@dataclass(frozen=True)
class Evaluation:
    """The cost and the constraint violations of a sequence of currents, whichever solver found it.

    Attributes:
        states: (N + 1, 6) states that follow from the currents, the first being the start.
        cost: Cost including the penalty of the slack [J].
        slack: (N,) smallest slack of each stage that satisfies obstacles and workspace [m].
        excess: Largest violation of a limit that has no slack, relative to the limit [-].
    """

    states: Array
    cost: float
    slack: Array
    excess: float


@dataclass(frozen=True)
class Multipliers:
    """The multipliers at a solver's solution.

    Attributes:
        bounds: Multipliers of the bounds, one for each variable.
        constraints: Multipliers of the constraints, one for each constraint.
    """

    bounds: Array
    constraints: Array


@dataclass(frozen=True)
class GeneralSolution:
    """The solution of a general solver.

    Attributes:
        currents: (N, n) motor currents [A].
        states: (N + 1, 6) states, which satisfy the model up to the solver's tolerance.
        slack: (N,) slacks [m].
        cost: Objective, including the penalty of the slack [J].
        solved: Whether the solver reports convergence.
        status: Status that the solver reports.
        iterations: Number of iterations.
        multipliers: Multipliers for a warm start of the next solution; zeros if there are none.
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
    """Evaluates cost and violations of currents with the transcription's own functions.

    Args:
        transcription: The problem.
    """

    def __init__(self, transcription: Transcription) -> None:
        t = self._transcription = transcription
        self._cost = t.stage_cost.map(t.steps)
        self._rows = t.stage_rows.map(t.steps)

    def value(self, start: Array, currents: Array, stage: Stage) -> Evaluation:
        """Return the cost and the violations of a sequence of currents.

        Args:
            start: (6,) state at the start: pose in odom, twist in base_link.
            currents: (N, n) motor currents [A].
            stage: Parameters of the problem.
        """
        t = self._transcription
        table = stage.table().T
        ends = np.asarray(t.rollout(start, currents.T)).reshape(STATES, t.steps)
        states = np.vstack([start, ends.T])
        before = states[:-1].T
        costs = np.asarray(self._cost(before, currents.T, table))
        rows, low, high = (np.asarray(part) for part in self._rows(before, currents.T, table))
        violation = np.maximum(low - rows, rows - high)
        slack = np.maximum(violation[t.relaxed :], 0.0).max(axis=0, initial=0.0)
        excess = float(violation[: t.relaxed].max(initial=0.0))
        return Evaluation(states, float(costs.sum()) + penalty(stage, slack), slack, excess)


class GeneralSolver:
    """A general solver of nonlinear programs, applied to the problem of a transcription.

    The cost and the constraints at a node depend on the state variable of that node, rather than
    on the step that leads to it, which halves the effort for second derivatives. The variables are
    u_0; x_1, u_1, s_1; ...; x_N, s_N, with currents u, states x and slacks s; the constraints are
    ordered by stage in the same way.

    Args:
        transcription: The problem.
        solver: Name of the solver in casadi, "ipopt" or "fatrop".
        options: Options that replace those in `OPTIONS`; None for the latter.
        cse: Whether common subexpressions of the functions are eliminated. A solution then takes a
            tenth less time, and building the solver takes seconds longer.

    Raises:
        RuntimeError: casadi has no such solver.

    Attributes:
        constraints: Function from variables w and parameters p, see `packed`, to the
            (c,) constraints in the order of the nonlinear program.
        lower: (c,) lower bounds of the constraints.
        upper: (c,) upper bounds of the constraints.
        hard: (N, .) indices of each step's constraints without slack.
        soft: (N, .) indices of each step's constraints with slack.
    """

    def __init__(
        self,
        transcription: Transcription,
        solver: str,
        options: dict[str, Any] | None = None,
        cse: bool = False,
    ) -> None:
        t = self._transcription = transcription
        n, steps, hard, soft = t.controls, t.steps, t.relaxed, t.rows - t.relaxed
        stage, low, high = self._stage()
        # fatrop requires a stage structure: constraints of a stage must not depend on the state
        # of the next stage.
        substituted = solver == "fatrop"
        x, cost = ca.SX.sym("start", STATES), ca.SX(0)
        table = ca.SX.sym("table", *t.program.size_in(2))
        parameters = ca.vertcat(x, ca.vec(table))
        variables: list[ca.SX] = []
        constraints: list[ca.SX] = []
        delayed: list[ca.SX] = []  # soft constraints of the previous step, due in this stage
        slack: list[ca.SX] = []
        for k in range(steps):
            u, s = ca.SX.sym(f"u{k}", n), ca.SX.sym(f"s{k + 1}")
            y, p = ca.SX.sym(f"x{k + 1}", STATES), table[:, k]
            end = t.transition(x, u)
            losses, node_cost, hard_rows, soft_rows = stage(x, u, y, p)
            if substituted:
                _, _, hard_rows, _ = stage(x, u, end, p)
            cost += losses + node_cost + p[22] * s + 0.5 * p[23] * s**2
            variables += [u, *slack, y]
            constraints += [y - end, hard_rows, *delayed]
            slack, delayed, x = [s], [soft_rows + s], y
        variables += slack
        constraints += delayed
        self._currents, self._slack, self._states = self._variable_indices()
        size_g = steps * (STATES + hard + soft)
        # Each stage contains the constraints of motion and the hard constraints of the step that
        # leads to the next stage, then the soft constraints of its own node. The first stage lacks
        # the latter, the last stage has only them.
        first = STATES + hard
        begins = np.append(0, first + (first + soft) * np.arange(steps - 1))
        self._motion: Indices = begins[:, None] + np.arange(STATES)
        self.hard: Indices = begins[:, None] + np.arange(STATES, first)
        own = np.append(begins[1:] + first, size_g - soft)
        self.soft: Indices = own[:, None] + np.arange(soft)
        self.lower, self.upper = np.zeros(size_g), np.zeros(size_g)
        self.lower[self.hard], self.upper[self.hard] = low[:hard], high[:hard]
        self.lower[self.soft], self.upper[self.soft] = low[hard:], high[hard:]
        w, g = ca.vertcat(*variables), ca.vertcat(*constraints)
        self.constraints = ca.Function("constraints", [w, parameters], [g])
        limit = t.model.max_current
        self._least, self._most = np.full(w.numel(), -np.inf), np.full(w.numel(), np.inf)
        self._least[self._currents], self._most[self._currents] = -limit, limit
        self._least[self._slack] = 0.0
        chosen: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            # Multipliers of the parameters are not used, and roots of zero weights make them NaN.
            "calc_lam_p": False,
            **(OPTIONS[solver] if options is None else options),
        }
        if cse:
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
        """Return the function of one stage, and the lower and upper bounds of its constraints.

        The function maps the state x, currents u, next state y and parameters p of a stage to the
        losses, the cost of y, the constraints without slack and the constraints with slack. The
        bounds are of the constraints without slack, then of those with slack.
        """
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

    def _variable_indices(self) -> tuple[Indices, Indices, Indices]:
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
        """Return the variables w and the parameters p of the nonlinear program.

        Args:
            start: (6,) state at the start: pose in odom, twist in base_link.
            currents: (N, n) motor currents [A].
            states: (N + 1, 6) states, of which the first is not used.
            slack: (N,) slacks [m].
            stage: Parameters of the problem.
        """
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
    ) -> GeneralSolution:
        """Solve the problem, beginning with a guess.

        Args:
            start: (6,) state at the start: pose in odom, twist in base_link.
            currents: (N, n) guess of the motor currents [A].
            states: (N + 1, 6) states that follow from the guess, the first being the start.
            stage: Parameters of the problem.
            before: Multipliers of the solution of the previous step for a warm start, or None.

        Returns:
            The solution; if the solver raised an error, the guess, marked as not solved.
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
        except RuntimeError as error:  # fatrop raises an error where IPOPT reports failure
            none = Multipliers(np.zeros(w.size), np.zeros(self.lower.size))
            return GeneralSolution(
                inside, states, np.zeros(t.steps), np.nan, False, str(error), 0, none
            )
        stats = self._solve.stats()
        answer = np.asarray(found["x"]).ravel()
        return GeneralSolution(
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
        """Return initial multipliers, shifted by one step; those of the last step are repeated."""
        bounds, constraints = before.bounds.copy(), before.constraints.copy()
        for place in (self._currents, self._slack, self._states):
            bounds[place[:-1]] = before.bounds[place[1:]]
        for place in (self._motion, self.hard, self.soft):
            constraints[place[:-1]] = before.constraints[place[1:]]
        return {"lam_x0": bounds, "lam_g0": constraints}


class ConvergedController:
    """Controller that runs a general solver to convergence in each step of a drive.

    Args:
        solver: The solver.
        dual: Whether the solver is also warm-started with the multipliers of the previous step.
    """

    def __init__(self, solver: GeneralSolver, dual: bool) -> None:
        self._solver, self._dual = solver, dual
        self._before: Multipliers | None = None

    def plan(self, task: Task) -> tuple[Array, bool]:
        """Return currents (N, n) [A], or the guess if unsolved, and whether it was solved."""
        before = None if task.first else self._before
        found = self._solver.solve(task.start, task.guess, task.states, task.stage, before)
        self._before = found.multipliers if self._dual and found.solved else None
        return (found.currents if found.solved else task.guess), found.solved
