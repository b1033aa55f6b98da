"""The optimal control problem of MPC 2021 itself, (20) to (28) with (31) and (32), no obstacles.

Controls are the motor voltages, constant over each stage, and their limits are the only
inequalities. The cost is (31), with the goal as it is, and (32) as printed: v_k i_k at the start
of each stage, times its duration. There are n = 10 stages of 0.1 s, and (31) applies at the end of
the last: as printed, (25) to (27) would end with a control that moves nothing.

Model (13) to (24) is that of `omniman_ros.planning.mpc.model`, with its differentiable sign for
(24), and without the drag of rollers, which the paper does not have. The state is pose and body
twist instead of pose and its rate in odom.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.mpc.model import STATES, PlanningModel

STAGES = 10
"""Number of stages n of the horizon (MPC 2021, 4)."""
STAGE = 0.1
"""Duration of a stage (MPC 2021, 4) [s]."""
SUBSTEPS = 2
"""Number of Runge-Kutta steps per stage: with twice the friction, one is unstable in rotation."""
OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "calc_lam_p": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6, "mu_init": 1e-2, "max_iter": 300},
}
"""Options of IPOPT, an interior-point solver like the paper's."""


@dataclass(frozen=True)
class PaperWeights:
    """Weights of (31); energy counts in J.

    Attributes:
        position: W_pos [J/m^2].
        heading: W_ang [J/rad^2].
    """

    position: float
    heading: float


@dataclass(frozen=True)
class PaperPlan:
    """A solution.

    Attributes:
        voltages: (n, w) voltages of w motors over each stage [V].
        states: (n + 1, 6) states, the first being the present one: pose in odom, body twist.
        cost: Cost J of (25) [J].
        solved: Whether the solver has converged.
    """

    voltages: Array
    states: Array
    cost: float
    solved: bool


class VoltageModel:
    """The model (20), whose inputs are motor voltages, in casadi's symbols.

    Args:
        model: Model of the robot, whose inputs are motor currents.

    Attributes:
        rate: (x, v) -> (derivative of x, electric power of all motors by (32) [W]).
    """

    def __init__(self, model: PlanningModel) -> None:
        x, v = ca.SX.sym("x", STATES), ca.SX.sym("v", model.wheel_count)
        twist = x[3:]
        currents = (v - model.emf * (ca.DM(model.J) @ twist)) / model.resistance  # (21), L = 0
        c, s = ca.cos(x[2]), ca.sin(x[2])
        pose_rate = ca.vertcat(c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2])
        derivative = ca.vertcat(pose_rate, model.twist_rate(twist, currents))
        self.rate = ca.Function("rate", [x, v], [derivative, ca.dot(v, currents)])

    def transition(self, duration: float, steps: int) -> ca.Function:
        """Return (x, v) -> (x at the end, energy consumed [J]) at constant voltages v.

        Both are integrated by the Runge-Kutta method of order 4 (MPC 2021, 3.1).

        Args:
            duration: Duration [s].
            steps: Number of Runge-Kutta steps.
        """
        x, v = ca.SX.sym("x", self.rate.size1_in(0)), ca.SX.sym("v", self.rate.size1_in(1))
        h, end, energy = duration / steps, x, ca.SX(0)
        for _ in range(steps):
            a1, p1 = self.rate(end, v)
            a2, p2 = self.rate(end + 0.5 * h * a1, v)
            a3, p3 = self.rate(end + 0.5 * h * a2, v)
            a4, p4 = self.rate(end + h * a3, v)
            end = end + h / 6.0 * (a1 + 2 * a2 + 2 * a3 + a4)
            energy = energy + h / 6.0 * (p1 + 2 * p2 + 2 * p3 + p4)
        return ca.Function("transition", [x, v], [end, energy])


class PaperProblem:
    """The problem, solved to convergence by IPOPT.

    Args:
        model: Model of the robot.
        weights: Weights of (31).
        integrated: Whether the energy is integrated within the stages, instead of (32) as printed.

    Attributes:
        cost: (voltages (w, n), state (6,), goal (3,)) -> J of (25).
        limit: Largest voltage [V].
    """

    def __init__(
        self, model: PlanningModel, weights: PaperWeights, integrated: bool = False
    ) -> None:
        self.limit = model.max_voltage
        self._controls = n = model.wheel_count
        voltage_model = VoltageModel(model)
        transition = voltage_model.transition(STAGE, SUBSTEPS)
        x, v = ca.SX.sym("x", STATES), ca.SX.sym("v", n)
        end, energy = transition(x, v)
        if not integrated:
            energy = STAGE * voltage_model.rate(x, v)[1]
        stage = ca.Function("stage", [x, v], [end, energy])
        start, goal = ca.SX.sym("start", STATES), ca.SX.sym("goal", 3)

        def terminal(last: ca.SX) -> ca.SX:
            """Return (31)."""
            position, heading = ca.sumsqr(goal[:2] - last[:2]), (goal[2] - last[2]) ** 2
            return weights.position * position + weights.heading * heading

        table, reached, total = ca.SX.sym("voltages", n, STAGES), start, ca.SX(0)
        for k in range(STAGES):
            reached, energy = stage(reached, table[:, k])
            total += energy
        self.cost = ca.Function("cost", [table, start, goal], [total + terminal(reached)])
        self._solver = self._program(stage, terminal, start, goal)
        row = np.concatenate([np.full(n, self.limit), np.full(STATES, np.inf)])
        self._bound = np.tile(row, STAGES)

    def _program(
        self, stage: ca.Function, terminal: Callable[[ca.SX], ca.SX], start: ca.SX, goal: ca.SX
    ) -> ca.Function:
        """Return the solver of the problem by multiple shooting: v_1, x_2, ..., v_n, x_n+1."""
        x, cost = start, ca.SX(0)
        variables: list[ca.SX] = []
        defects: list[ca.SX] = []
        for k in range(STAGES):
            v, y = ca.SX.sym(f"v{k}", self._controls), ca.SX.sym(f"x{k}", STATES)
            end, energy = stage(x, v)
            cost += energy
            variables += [v, y]
            defects.append(y - end)
            x = y
        program = {
            "x": ca.vertcat(*variables),
            "p": ca.vertcat(start, goal),
            "f": cost + terminal(x),
            "g": ca.vertcat(*defects),
        }
        return ca.nlpsol("paper", "ipopt", program, OPTIONS)

    def solve(self, state: Array, goal: Array, last: PaperPlan | None = None) -> PaperPlan:
        """Solve the problem.

        Args:
            state: (6,) present state: pose in odom [m, m, rad], body twist [m/s, m/s, rad/s].
            goal: (3,) pose of the goal in odom [m, m, rad], its heading on the branch of the
                state's.
            last: Plan of the stage before for a warm start; None for zero voltages at rest.
        """
        n = self._controls
        if last is None:
            guess = np.hstack([np.zeros((STAGES, n)), np.tile(state, (STAGES, 1))])
        else:
            guess = np.hstack([last.voltages, last.states[1:]])
            guess = np.vstack([guess[1:], guess[-1:]])
        found = self._solver(
            x0=guess.ravel(),
            p=np.concatenate([state, goal]),
            lbx=-self._bound,
            ubx=self._bound,
            lbg=0.0,
            ubg=0.0,
        )
        rows = np.asarray(found["x"]).reshape(STAGES, n + STATES)
        voltages = np.clip(rows[:, :n], -self.limit, self.limit)
        states = np.vstack([state, rows[:, n:]])
        return PaperPlan(
            voltages, states, float(found["f"]), bool(self._solver.stats()["success"])
        )
