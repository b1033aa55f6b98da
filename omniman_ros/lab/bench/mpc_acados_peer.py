"""acados on the problem of the planner's transcription, in a process of its own.

It uses the casadi that acados brings along; acados' HPIPM does not share a process with that of
the planner's casadi. Over pipes it reads the problem once, then tasks, and answers each of them.
"""

import os
import pickle
import tempfile
import time
from ctypes import c_char_p, c_int, c_void_p
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.mpc.assembly import NODE
from omniman_ros.planning.mpc.model import STATES, PlanningModel
from omniman_ros.planning.mpc.quadratic_program import INFINITY, MODES
from omniman_ros.planning.mpc.solver import TRUST_RADIUS
from omniman_ros.planning.mpc.transcription import Transcription


class PeerProblem(NamedTuple):
    """What the process has to know to build its solver."""

    model: PlanningModel
    transcription: tuple[int, float, int, bool, float]  #: arguments after the model
    tolerances: dict[str, float]  #: residuals, by the names of the planner's quadratic programs


class Acados:
    """acados by the planner's scheme: one iteration from the guess and its states.

    The inputs of a stage are its currents and its slack. All rows of a stage are functions of its
    state and its inputs. The states of the result are not rolled out, unlike the planner's.
    """

    def __init__(self, problem: PeerProblem) -> None:
        t = self._t = Transcription(problem.model, *problem.transcription)
        solver = self._solver = _generated(t, problem.tolerances)
        self._states = np.zeros((t.steps + 1, STATES))
        self._inputs = np.zeros((t.steps, t.controls + 1))
        self._table = np.zeros((t.steps + 1, t.parameters))
        # acados' own methods to set and get a value take several times as long as these calls.
        library, nlp = solver.shared_lib, (solver.nlp_config, solver.nlp_dims)
        bound, put = library.ocp_nlp_constraints_model_set, library.ocp_nlp_out_set
        get, update = library.ocp_nlp_out_get, library.omniman_acados_update_params
        for function in (bound, put, get):
            function.argtypes = [c_void_p, c_void_p, c_void_p, c_int, c_char_p, c_void_p]
        update.argtypes = [c_void_p, c_int, c_void_p, c_int]
        values = [
            (*nlp, solver.nlp_out, k, name, c_void_p(row.ctypes.data))
            for name, rows in ((b"x", self._states), (b"u", self._inputs))
            for k, row in enumerate(rows)
        ]
        start = c_void_p(self._states.ctypes.data)
        self._sets: list[tuple[Any, tuple[Any, ...]]]
        self._sets = [(bound, (*nlp, solver.nlp_in, 0, name, start)) for name in (b"lbx", b"ubx")]
        self._sets += [(put, each) for each in values]
        for k, row in enumerate(self._table):
            self._sets.append((update, (solver.capsule, k, c_void_p(row.ctypes.data), len(row))))
        self._gets = [(get, each) for each in values]

    def plan(self, start: Array, guess: Array, states: Array, table: Array) -> tuple[Array, bool]:
        """Return currents (N, n) [A], or the guess if unsolved, and whether it was solved."""
        n, limit = self._t.controls, self._t.model.max_current
        self._states[:], self._states[0] = states, start
        self._inputs[:, :n], self._inputs[:, n] = guess, 0.0
        # The cost of a state is that of the stage that ends there; the start costs nothing.
        self._table[:-1], self._table[0, NODE], self._table[1:, NODE] = table, 0.0, table[:, NODE]
        for function, values in self._sets:
            function(*values)
        status = self._solver.solve()
        for function, values in self._gets:
            function(*values)
        if status or not np.isfinite(self._inputs).all():
            return guess, False
        change = float(np.abs(self._states[1:, :2] - states[1:, :2]).max())
        scale = min(1.0, TRUST_RADIUS / max(change, TRUST_RADIUS))
        currents = guess + scale * (self._inputs[:, :n] - guess)
        return np.clip(currents, -limit, limit), True

    def is_converged(self) -> bool:
        """Return whether the last quadratic program was solved within HPIPM's iterations."""
        return not self._solver.get_stats("statistics")[1].any()

    def reset(self) -> None:
        """Forget the last task: values that are not finite would stay."""
        self._solver.reset()


def _generated(t: Transcription, tolerances: dict[str, float]) -> Any:
    """Return acados' solver, generated and compiled in the current folder."""
    from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    x, u, s = ca.SX.sym("x", STATES), ca.SX.sym("u", t.controls), ca.SX.sym("s")
    p, limit, inputs = ca.SX.sym("p", t.parameters), t.model.max_current, t.controls + 1
    end = t.transition(x, u)
    rows, low, _ = t.inequalities(x, u, end, p)
    node = ca.sumsqr(t.node_residuals(x, p[NODE]))
    model = AcadosModel()
    model.name, model.x, model.u, model.p = "omniman", x, ca.vertcat(u, s), p
    model.disc_dyn_expr = end
    model.con_h_expr = ca.vertcat(rows[: t.relaxed], rows[t.relaxed :] + s)
    model.cost_expr_ext_cost = p[21] * t.losses(x, u) + node + p[22] * s + 0.5 * p[23] * s**2
    model.cost_expr_ext_cost_e = node
    # The transcription's Hessian has the order [x, u, s], that of acados [u, s, x].
    terms = t._terms(x, u, p)
    hessian = ca.densify(ca.SX(terms.h, terms.stage(x, u, p, p[NODE])[0]))
    order = [*range(STATES, STATES + inputs), *range(STATES)]
    model.cost_expr_ext_cost_custom_hess = hessian[order, order]
    last = ca.SX(terms.last_h, terms.last(x, p[NODE])[0])
    model.cost_expr_ext_cost_custom_hess_e = ca.densify(last)

    ocp = AcadosOcp()
    ocp.model, ocp.dims.N, ocp.parameter_values = model, t.steps, np.zeros(t.parameters)
    ocp.cost.cost_type = ocp.cost.cost_type_e = "EXTERNAL"
    bounds, options = ocp.constraints, ocp.solver_options
    bounds.x0, bounds.idxbu = np.zeros(STATES), np.arange(inputs)
    bounds.lbu, bounds.ubu = np.append(-limit, 0.0), np.append(limit, INFINITY)
    bounds.lh = np.asarray(ca.evalf(low)).ravel()
    bounds.uh = np.where(np.arange(t.rows) < t.relaxed, 1.0, INFINITY)
    options.tf = float(t.steps)  # acados multiplies the cost of a stage by its duration: one
    options.integrator_type, options.nlp_solver_type = "DISCRETE", "SQP_RTI"
    options.hessian_approx, options.hpipm_mode = "GAUSS_NEWTON", "SPEED"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    options.qp_solver_cond_N = t.steps // 2  # faster than all stages, and than fewer
    options.qp_solver_iter_max = MODES["speed"]["iter_max"]
    options.qp_solver_tol_stat = tolerances["res_g_max"]
    options.qp_solver_tol_eq = tolerances["res_b_max"]
    options.qp_solver_tol_ineq = tolerances["res_d_max"]
    options.qp_solver_tol_comp = tolerances["res_m_max"]
    return AcadosOcpSolver(ocp)


def main() -> None:
    """Answer each task by its currents, whether they solve it, and the CPU time of that [s]."""
    # What acados and the compiler print goes to standard error: the answers have the other pipe.
    tasks, answers = os.fdopen(0, "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        solver = Acados(pickle.load(tasks))
        while tasks.peek():
            task = pickle.load(tasks)
            before = time.process_time()
            currents, solved = solver.plan(*task)
            seconds = time.process_time() - before
            solved = solved and solver.is_converged()
            if not solved:
                solver.reset()
            pickle.dump((currents, solved, seconds), answers)
            answers.flush()


if __name__ == "__main__":
    main()
