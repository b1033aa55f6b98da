"""IPOPT on the problem of the planner's transcription: the peer in `omniman bench mpc`."""

from typing import Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.bench.mpc_rig import Task
from omniman_ros.planning.mpc.assembly import NODE
from omniman_ros.planning.mpc.model import STATES
from omniman_ros.planning.mpc.transcription import Transcription

# With this initial barrier parameter, closed-loop steps take two thirds of the time that they take
# with the default. A warm start is moved by 1e-3 from the bounds, absolute and relative.
OPTIONS: dict[str, Any] = {
    "linear_solver": "mumps",
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-6,
    "max_iter": 300,
    "mu_init": 1e-3,
    "warm_start_init_point": "yes",
}
PUSHED = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
OPTIONS |= {f"warm_start_{name}": 1e-3 for name in PUSHED}


class Ipopt:
    """IPOPT by multiple shooting, run to convergence in each step of a drive.

    The variables of stage k are its currents, its next state and its slack. Cost and constraints
    at a node depend on the state variable of that node, rather than on the step that leads to it,
    which halves the effort for second derivatives. Solutions are warm-started with the multipliers
    of the previous step, shifted by one stage.
    """

    def __init__(self, transcription: Transcription) -> None:
        t = self._t = transcription
        stage, low, high = self._stage()
        x, cost = ca.SX.sym("start", STATES), ca.SX(0)
        table = ca.SX.sym("table", *t.program.size_in(2))
        parameters = ca.vertcat(x, ca.vec(table))
        variables: list[ca.SX] = []
        constraints: list[ca.SX] = []
        for k in range(t.steps):
            u, y, s = ca.SX.sym("u", t.controls), ca.SX.sym("x", STATES), ca.SX.sym("s")
            p = table[:, k]
            costs, hard, soft = stage(x, u, y, p)
            cost += costs + p[22] * s + 0.5 * p[23] * s**2
            variables += [u, y, s]
            constraints += [y - t.transition(x, u), hard, soft + s]
            x = y
        limit, inf = t.model.max_current, np.full(STATES, np.inf)
        self._low = np.tile(np.concatenate([-limit * np.ones(t.controls), -inf, [0.0]]), t.steps)
        self._high = np.tile(np.concatenate([limit * np.ones(t.controls), inf, [inf[0]]]), t.steps)
        self._least = np.tile(np.concatenate([np.zeros(STATES), low]), t.steps)
        self._most = np.tile(np.concatenate([np.zeros(STATES), high]), t.steps)
        # Multipliers of the parameters are not used, and roots of zero weights make them NaN.
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False}
        options |= {"calc_lam_p": False, "ipopt": OPTIONS}
        options["common_options"] = {"final_options": {"cse": True}}
        g = ca.vertcat(*constraints)
        program = {"x": ca.vertcat(*variables), "p": parameters, "f": cost, "g": g}
        self._solve = ca.nlpsol("peer", "ipopt", program, options)
        self._multipliers: dict[str, Array] = {}

    def _stage(self) -> tuple[ca.Function, Array, Array]:
        """Return a stage's costs and constraints, without and with slack, and their bounds."""
        t = self._t
        x, y, u = ca.SX.sym("x", STATES), ca.SX.sym("y", STATES), ca.SX.sym("u", t.controls)
        p = ca.SX.sym("p", t.program.size1_in(2))
        costs = p[21] * t.losses(x, u) + ca.sumsqr(t.node_residuals(y, p[NODE]))
        value, low, high = t.inequalities(x, u, y, p)
        outputs = [costs, value[: t.relaxed], value[t.relaxed :]]
        bounds = [np.asarray(ca.evalf(ca.densify(bound))).ravel() for bound in (low, high)]
        return ca.Function("stage", [x, u, y, p], outputs), bounds[0], bounds[1]

    def plan(self, task: Task) -> tuple[Array, bool]:
        """Return currents (N, n) [A], or the guess if unsolved, and whether it was solved."""
        t = self._t
        inside = np.clip(task.guess, -t.model.max_current, t.model.max_current)
        guess = np.column_stack([inside, task.states[1:], np.zeros(t.steps)]).ravel()
        found = self._solve(
            x0=guess,
            p=np.concatenate([task.start, task.stage.table().ravel()]),
            lbx=self._low,
            ubx=self._high,
            lbg=self._least,
            ubg=self._most,
            **({} if task.first else self._multipliers),
        )
        answer = np.asarray(found["x"]).ravel()
        solved = bool(self._solve.stats()["success"]) and bool(np.isfinite(answer).all())
        self._multipliers = {}
        if not solved:
            return task.guess, False
        for name in ("lam_x", "lam_g"):
            rows = np.asarray(found[name]).reshape(t.steps, -1)
            self._multipliers[f"{name}0"] = np.vstack([rows[1:], rows[-1:]]).ravel()
        return answer.reshape(t.steps, -1)[:, : t.controls], True
