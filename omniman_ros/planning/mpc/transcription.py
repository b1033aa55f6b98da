"""The optimal control problem of MPC 2021 (25) to (28) as one quadratic program per iteration.

States result from the controls (a rollout before each iteration), so the program has steps from
the last iterate only: delta u_0, s_0, delta x_1, delta u_1, s_1, ..., delta x_N. Each stage has a
slack s_k [m] that relaxes obstacles and workspace; motor and twist limits are hard.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.mpc.assembly import (
    NODE,
    StageTerms,
    assembled_program,
    assembled_structure,
)
from omniman_ros.planning.mpc.gap_rows import OBSTACLE, gap_rows
from omniman_ros.planning.mpc.model import STATES, PlanningModel, congruence, weighted_sum
from omniman_ros.planning.mpc.step import ModelStep, Sensitive, model_step, rotated, rotation

#: Number of points of the outline that are kept in the workspace: two for each of its sides
EXTREMES = 8
FIXED = 25  #: Number of a stage's parameters before those of its outline and its obstacles
#: Number of sides of the polygon inside the circle of a linear limit: it is at most 3.4 % smaller
SIDES = 12


@dataclass(frozen=True)
class Stage(Validated):
    """Parameters of all stages, each (N, ...); limits apply at the stage's end."""

    #: (N, 6) linear speed, yaw rate, wheel speed, voltage, linear and yaw acceleration
    limits: Annotated[Array, Shape("N", 6)]
    #: (4,) x_min, y_min, x_max, y_max [m], less the clearance
    workspace: Annotated[Array, Shape(4)]
    #: (N, 6) pose [m, m, rad] and velocity in odom [m/s, m/s, rad/s] at the stage's end
    target: Annotated[Array, Shape("N", 6)]
    #: (N, 5) weights of position, heading, linear and angular velocity, and kinetic energy there
    weights: Annotated[Array, Shape("N", 5)]
    energy: float  #: Weight of the losses
    slack: tuple[float, float]  #: Weights of the slack, linear [J/m] and quadratic [J/m^2]
    #: (N, M, 15) obstacles and boxes, see OBSTACLE
    obstacles: Annotated[Array, Shape("N", "M", 15)]
    #: (N, 8, 2) points of the robot in base_link that are the farthest towards x_min, x_max, y_min
    #: and y_max, two each [m]; (N, 0, 2) for a program without a workspace.
    extremes: Annotated[Array, Shape("N", "E", 2)]
    #: Direction in odom in which the limits of linear speed and acceleration are fully available
    #: [rad]; elsewhere a polygon replaces their circle.
    direction: float = 0.0

    def table(self) -> Array:
        """Return the parameters (N, p) in the layout of `Transcription.program`."""
        steps = len(self.limits)
        result = np.empty((steps, FIXED + self.extremes[0].size + self.obstacles[0].size))
        result[:, :6], result[:, 6:12], result[:, 12:17] = self.limits, self.target, self.weights
        result[:, 17:21], result[:, 21], result[:, 22:24] = self.workspace, self.energy, self.slack
        result[:, 24] = self.direction
        outline = FIXED + self.extremes[0].size
        result[:, FIXED:outline] = self.extremes.reshape(steps, -1)
        result[:, outline:] = self.obstacles.reshape(steps, -1)
        return result


class Transcription:
    """Casadi functions of the problem with N steps of h seconds and M obstacles.

    Args:
        slots: Number M of obstacles.
        confined: Whether the robot can reach the border of its workspace; without, the program has
            no rows of it.
        damping: Weight of a change of the currents, in terms of that of the copper's losses [-].

    Attributes:
        transition: (x, u) -> x after one step.
        rollout: (x_0 (6,), U (n, N)) -> X (6, N), states at the ends of the steps.
        stage_cost: (x, u, p) -> cost of a stage and of the state at its end [J].
        stage_rows: (x, u, p) -> inequalities low <= value <= high of a stage.
        relaxed: Index of the first row that the slack relaxes: value + s >= low.
        program: (x_0, U, P (p, N)) -> the entries of H, g and A, column by column, lower and upper
            bounds of A, lower and upper bounds of the step; cost, X.
        h, a: Structures of H and A.
        sizes: Structure of the program for the QP solver: N, nx, nu, ng.
        rows: Number of inequality rows of each stage.
    """

    def __init__(
        self,
        model: PlanningModel,
        steps: int,
        step: float,
        slots: int,
        confined: bool = True,
        damping: float = 8.0,
    ) -> None:
        self.model, self.steps, self.step = model, steps, step
        self.slots, self.confined, self.damping = slots, confined, damping
        self._outline = 2 * EXTREMES * confined
        self.parameters = FIXED + self._outline + OBSTACLE * slots
        n = self.controls = model.wheel_count
        angles = (np.arange(SIDES // 2) + 0.5) * (2 * np.pi / SIDES)
        self._spokes = ca.DM(np.column_stack([np.cos(angles), np.sin(angles)]))
        self._spokes /= np.cos(np.pi / SIDES)
        x, u, p = ca.SX.sym("x", STATES), ca.SX.sym("u", n), ca.SX.sym("p", self.parameters)
        end = self._end(x, self._step(x, u))
        self.transition = ca.Function("transition", [x, u], ca.cse([end]))
        self.rollout = self.transition.mapaccum("rollout", steps)
        rows, low, high = self.inequalities(x, u, end, p)
        self.rows, self.relaxed = rows.size1(), int(ca.sum1(ca.evalf(low) < 0))
        self.stage_rows = ca.Function("stage_rows", [x, u, p], [rows, low, high])
        cost = p[21] * self.losses(x, u) + ca.sumsqr(self.node_residuals(end, p[NODE]))
        self.stage_cost = ca.Function("stage_cost", [x, u, p], [cost])
        terms = self._terms(x, u, p)
        self.program = assembled_program(terms, self.rollout, model.max_current, self.parameters)
        self.h, self.a = assembled_structure(terms, steps, n, self.rows)
        inputs = n + 1  # the slack counts as an input
        self.sizes = {
            "N": steps,
            "nx": [0] + [STATES] * steps,
            "nu": [inputs] * steps + [0],
            "ng": [self.rows] * steps + [0],
        }

    def c_code(self) -> str:
        """Return C code of `program` and `rollout`, the functions that a solver calls."""
        generator = ca.CodeGenerator("functions.c")
        generator.add(self.program)
        generator.add(self.rollout)
        code: str = generator.dump()
        return code

    # ---- costs ------------------------------------------------------------------------------

    def losses(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """Return the losses of a step [J], (32) rewritten, by Simpson's rule."""
        m, step = self.model, self._step(x, u)
        total = m.resistance * self.step * ca.sumsqr(u)
        twists = x[3:], step.middle.value, step.end.value
        for twist, weight in zip(twists, self._simpson, strict=True):
            dry, strength, width = m.dry_speeds(twist)
            viscous = m.viscous * (ca.DM(m.J) @ twist) ** 2
            dry_power = ca.DM(strength) * (ca.sqrt(dry**2 + width**2) - width)
            total += weight * (ca.sum1(viscous) + ca.sum1(dry_power))
        return total

    @property
    def _simpson(self) -> tuple[float, float, float]:
        """Weights of start, middle and end of a step over eta [s]."""
        weight = self.step / (6.0 * self.model.efficiency)
        return weight, 4.0 * weight, weight

    def _loss_derivatives(self, step: ModelStep) -> tuple[ca.SX, ca.SX]:
        """Return gradient (6,) and Gauss-Newton Hessian (6, 6) of the mechanical losses.

        They are by twist and added acceleration at the start. All speeds are linear in the twist,
        so each instant contributes a 3 x 3 matrix. The curvature of dry friction is that of the
        tangent parabola above it.
        """
        m = self.model
        each = np.vstack([m.J, m.rolling])
        speeds, viscous = ca.DM(each), ca.DM(2.0 * m.J.T @ (m.viscous[:, None] * m.J))
        gradient, hessian = ca.SX(6, 1), ca.SX(6, 6)
        instants = step.start, step.middle, step.end
        for (twist, slope), weight in zip(instants, self._simpson, strict=True):
            dry, strength, width = m.dry_speeds(twist)
            bend = ca.DM(strength) / ca.sqrt(dry**2 + width**2)
            gradient += weight * slope.T @ (viscous @ twist + speeds.T @ (bend * dry))
            curvature = viscous + weighted_sum([np.outer(row, row) for row in each], bend)
            hessian += congruence(weight * curvature, slope)
        return gradient, hessian

    def node_residuals(self, y: ca.SX, node: ca.SX) -> ca.SX:
        """Return residuals of the state y at a step's end: their squares are its cost.

        The cost is (31) with W_vel. The last residuals are those of the kinetic energy. `node` are
        target and weights there (11,).
        """
        target, weights = node[:6], node[6:]
        velocity = ca.vertcat(rotated(y[2], y[3:5]), y[5])
        error = ca.vertcat(y[:3] - target[:3], velocity - target[3:])
        scale = ca.sqrt(
            ca.vertcat(weights[0], weights[0], weights[1], weights[2], weights[2], weights[3])
        )
        root = np.linalg.cholesky(0.5 * self.model.inertia).T
        kinetic = ca.sqrt(weights[4]) * (ca.DM(root) @ y[3:])
        return ca.vertcat(scale * error, kinetic)

    def _node_terms(self, y: ca.SX, node: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return Gauss-Newton Hessian, gradient and cost of the state at a node."""
        residuals = self.node_residuals(y, node)
        by_y = ca.jacobian(residuals, y)
        return 2 * by_y.T @ by_y, 2 * by_y.T @ residuals, ca.sumsqr(residuals)

    # ---- rows -------------------------------------------------------------------------------

    def inequalities(self, x: ca.SX, u: ca.SX, y: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return inequalities low <= row <= high; y is the state at the stage's end.

        The rows that the slack relaxes are the last, see `relaxed`.
        """
        hard = self._hard_rows(x, u, self.model.twist_rate(x[3:], u), y, p)
        soft, _ = self._soft_rows(y, p)
        one, zero = ca.SX.ones(hard.shape), ca.SX.zeros(soft.shape)
        low, high = ca.vertcat(-one, zero), ca.vertcat(one, zero + ca.inf)
        return ca.vertcat(hard, soft), low, high

    def _hard_rows(self, x: ca.SX, u: ca.SX, rate: ca.SX, y: ca.SX, p: ca.SX) -> ca.SX:
        """Return the parts of their limits that motors and twists use, -1 to 1.

        `rate` is the derivative of the twist at the start.
        """
        m, jacobian = self.model, ca.DM(self.model.J)
        speed, yaw_rate, wheels, volts, acceleration, yaw_acceleration = ca.vertsplit(p[:6])
        push = ca.vertcat(rate[0] - x[5] * x[4], rate[1] + x[5] * x[3])
        rows = [
            y[5] / yaw_rate,
            (jacobian @ y[3:]) / wheels,
            (self._spokes @ rotated(y[2] - p[24], y[3:5])) / speed,
            (self._spokes @ rotated(x[2] - p[24], push)) / acceleration,
            rate[2] / yaw_acceleration,
        ]
        if m.is_voltage_limited:
            for twist in (x[3:], y[3:]):
                rows.append((m.resistance * u + m.emf * (jacobian @ twist)) / volts)
        return ca.vertcat(*rows)

    def _soft_rows(self, y: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the gaps to workspace and obstacles [m], and their derivatives (r, 6) by y."""
        gaps, slopes = [ca.SX(0, 1)], [ca.SX(0, STATES)]
        low, high = p[17:19], p[19:21]
        for k in range(self._outline // 2):
            at, (axis, side) = FIXED + 2 * k, divmod(k // 2, 2)
            arm, sign, slope = rotated(y[2], p[at : at + 2]), 1 - 2 * side, ca.SX(1, STATES)
            border = high[axis] if side else low[axis]
            gaps.append(sign * (y[axis] + arm[axis] - border))
            slope[axis], slope[2] = sign, sign * (arm[0] if axis else -arm[1])
            slopes.append(slope)
        for k in range(self.slots):
            at = FIXED + self._outline + OBSTACLE * k
            pair, by_y = gap_rows(y, p[at : at + OBSTACLE], self.step)
            gaps.append(pair)
            slopes.append(by_y)
        return ca.vertcat(*gaps), ca.vertcat(*slopes)

    # ---- one stage --------------------------------------------------------------------------

    def _step(self, x: ca.SX, u: ca.SX) -> ModelStep:
        return model_step(self.model, x[3:], ca.DM(self.model.drive) @ u, self.step)

    def _end(self, x: ca.SX, step: ModelStep) -> ca.SX:
        """Return the state after a step."""
        return ca.vertcat(x[:3] + rotation(x[2]) @ step.displacement.value, step.end.value)

    def _terms(self, x: ca.SX, u: ca.SX, p: ca.SX) -> StageTerms:
        """Return all terms of a stage: by state, control and parameters."""
        n, step, node = self.controls, self._step(x, u), ca.SX.sym("node", 11)
        energy = p[21]
        # Twist and added acceleration at the start, by [x, u].
        start = ca.diagcat(ca.horzcat(ca.DM(3, 3), ca.DM.eye(3)), ca.DM(self.model.drive))
        end = Sensitive(self._end(x, step), _by_start(x, step, start))
        rate = Sensitive(step.rate.value, step.rate.slope @ start)
        rows, by_rows = self._row_derivatives(x, u, rate, end, p)
        gradient, hessian = self._loss_derivatives(step)
        copper = 2.0 * self.model.resistance * self.step
        node_hessian, node_gradient, node_cost = self._node_terms(x, node)
        gradient = energy * (start.T @ gradient) + ca.vertcat(node_gradient, copper * energy * u)
        hessian = energy * (start.T @ hessian @ start) + ca.diagcat(
            node_hessian, copper * (energy + self.damping) * ca.SX.eye(n)
        )
        zero, soft = ca.SX(STATES, 1), ca.SX.ones(self.rows - self.relaxed)
        h = ca.diagcat(hessian, p[23])
        a = ca.vertcat(
            ca.horzcat(-ca.SX.eye(STATES), ca.SX(STATES, n + 1)),
            ca.horzcat(end.slope, zero),
            ca.horzcat(by_rows, ca.vertcat(ca.SX(self.relaxed, 1), soft)),
        )
        _, low, high = self.inequalities(x, u, end.value, p)
        still = ca.SX.zeros(STATES)
        outputs = [
            _entries(h),
            ca.densify(ca.vertcat(gradient, p[22])),
            _entries(a),
            ca.vertcat(still, low - rows),
            ca.vertcat(still, high - rows),
            energy * self.losses(x, u) + node_cost,
        ]
        last = [_entries(node_hessian), ca.densify(node_gradient), node_cost]
        return StageTerms(
            ca.Function("stage", [x, u, p, node], ca.cse(outputs)),
            ca.Function("last", [x, node], ca.cse(last)),
            h.sparsity(),
            a.sparsity(),
            node_hessian.sparsity(),
        )

    def _row_derivatives(
        self, x: ca.SX, u: ca.SX, rate: Sensitive, y: Sensitive, p: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Return the rows, and their derivatives (r, 6 + n) by [x, u].

        Those of the rate at the start and of the state y at the end are by [x, u], too.
        """
        z, given = ca.vertcat(x, u), (ca.SX.sym("rate", 3), ca.SX.sym("end", STATES))
        rows = self._hard_rows(x, u, *given, p)
        slopes = (ca.jacobian(rows, of) for of in (z, *given))
        parts = ca.Function("parts", [x, u, *given, p], [rows, *slopes])
        hard, direct, by_rate, by_end = parts(x, u, rate.value, y.value, p)
        by_hard = direct + by_rate @ rate.slope + by_end @ y.slope
        soft, by_y = self._soft_rows(y.value, p)
        return ca.vertcat(hard, soft), ca.vertcat(by_hard, by_y @ y.slope)


def _by_start(x: ca.SX, step: ModelStep, start: ca.DM) -> ca.SX:
    """Return the derivatives (6, 6 + n) of the state after a step by [x, u].

    `start` are those of twist and added acceleration at its start.
    """
    turn, moved = rotation(x[2]), step.displacement
    way = turn @ moved.value
    result = ca.vertcat(turn @ (moved.slope @ start), step.end.slope @ start)
    result[0, 0] = result[1, 1] = result[2, 2] = 1
    result[0, 2], result[1, 2] = -way[1], way[0]
    return result


def _entries(matrix: ca.SX) -> ca.SX:
    """Return the entries of a sparse matrix, column by column."""
    entries: list[Any] = matrix.nonzeros()
    result: ca.SX = ca.vertcat(*entries)
    return result
