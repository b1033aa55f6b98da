"""The optimal control problem of MPC 2021 (25) to (28) as one quadratic program per iteration.

States result from the controls (a rollout before each iteration), so the program has steps from
the last iterate only: delta u_0, s_0, delta x_1, delta u_1, s_1, ..., delta x_N. Each stage has a
slack s_k [m] that relaxes obstacles and workspace; motor and twist limits are hard.
"""

from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.mpc.model import STATES, PlanningModel

Indices = NDArray[np.intp]  #: Array of indices into the entries of a program

#: Number of values of an obstacle at a node: centre, whitening matrix (row by row) and scale; and
#: of the box of the robot that keeps clear of it: centre, direction (cosine and sine), half length
#: and half width.
OBSTACLE = 13
#: Number of points of the outline that are kept in the workspace: two for each of its sides
EXTREMES = 8
FIXED = 25 + 2 * EXTREMES  #: Number of a stage's parameters before those of its obstacles
#: Number of sides of the polygon inside the circle of a linear limit: it is at most 3.4 % smaller
SIDES = 12
INACTIVE_GAP = 1e3  #: Gap of a row that constrains nothing [m]


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
    #: (N, M, 13) obstacles and boxes, see OBSTACLE
    obstacles: Annotated[Array, Shape("N", "M", 13)]
    #: (N, 8, 2) points of the robot in base_link that are the farthest towards x_min, x_max, y_min
    #: and y_max, two each [m].
    extremes: Annotated[Array, Shape("N", 8, 2)]
    #: Direction in odom in which the limits of linear speed and acceleration are fully available
    #: [rad]; elsewhere a polygon replaces their circle.
    direction: float = 0.0

    def table(self) -> Array:
        """Return the parameters (N, FIXED + 13 M) in the layout of `Transcription.program`."""
        steps = len(self.limits)
        same = np.concatenate([self.workspace, [self.energy], self.slack, [self.direction]])
        head = np.hstack([self.limits, self.target, self.weights, np.tile(same, (steps, 1))])
        rest = self.extremes.reshape(steps, -1), self.obstacles.reshape(steps, -1)
        return np.hstack([head, *rest])


class Transcription:
    """Casadi functions of the problem with N steps of h seconds and M obstacles.

    Attributes:
        transition: (x, u) -> x after one step.
        rollout: (x_0 (6,), U (n, N)) -> X (6, N), states at the ends of the steps.
        stage_cost: (x, u, p) -> cost of a stage and of the state at its end [J].
        stage_rows: (x, u, p) -> inequalities low <= value <= high of a stage.
        relaxed: Index of the first row that the slack relaxes: value + s >= low.
        program: (x_0, U, P (p, N)) -> H, g, A, lower and upper bounds of A, lower and upper bounds
            of the step, cost, X.
        sizes: Structure of the program for the QP solver: N, nx, nu, ng.
        rows: Number of inequality rows of each stage.
    """

    def __init__(
        self, model: PlanningModel, steps: int, step: float, slots: int, damping: float = 8.0
    ) -> None:
        self.model, self.steps, self.step, self.slots = model, steps, step, slots
        self.damping = damping
        n = self.controls = model.wheel_count
        angles = (np.arange(SIDES // 2) + 0.5) * (2 * np.pi / SIDES)
        self._spokes = ca.DM(np.column_stack([np.cos(angles), np.sin(angles)]))
        self._spokes /= np.cos(np.pi / SIDES)
        x, u = ca.SX.sym("x", STATES), ca.SX.sym("u", n)
        p = ca.SX.sym("p", FIXED + OBSTACLE * slots)
        end, _, _ = self._transition(x, u)
        self.transition = ca.Function("transition", [x, u], [end])
        self.rollout = self.transition.mapaccum("rollout", steps)
        stage = self._stage(x, u, p)
        self.rows = stage.size1_out(4)
        self.program = self._assemble(stage)
        rows, inputs = self.rows, n + 1  # the slack counts as an input
        self.sizes = {
            "N": steps,
            "nx": [0] + [STATES] * steps,
            "nu": [inputs] * steps + [0],
            "ng": [rows] * steps + [0],
        }

    # ---- one stage --------------------------------------------------------------------------

    def _transition(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the state after a step (Runge-Kutta 4), and the twists at its middle and end."""
        h, twist, rate = self.step, x[3:], self.model.twist_rate

        def rotated(angle: ca.SX, v: ca.SX) -> ca.SX:
            """Return a twist of a frame at an angle in the unrotated frame."""
            c, s = ca.cos(angle), ca.sin(angle)
            return ca.vertcat(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])

        a1 = rate(twist, u)
        v2 = twist + 0.5 * h * a1
        a2 = rate(v2, u)
        v3 = twist + 0.5 * h * a2
        a3 = rate(v3, u)
        v4 = twist + h * a3
        a4 = rate(v4, u)
        last = twist + h / 6.0 * (a1 + 2 * a2 + 2 * a3 + a4)
        # Stages of the pose in the frame of the pose at the start, rotated to odom at the end.
        zero = ca.SX(0)
        p1 = rotated(zero, twist)
        p2 = rotated(0.5 * h * twist[2], v2)
        p3 = rotated(0.5 * h * v2[2], v3)
        p4 = rotated(h * v3[2], v4)
        displacement = h / 6.0 * (p1 + 2 * p2 + 2 * p3 + p4)
        pose = x[:3] + rotated(x[2], displacement)
        return ca.vertcat(pose, last), 0.5 * (v2 + v3), last

    def losses(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """Return the losses of a step [J], (32) rewritten, by Simpson's rule."""
        m, h = self.model, self.step
        total = m.resistance * h * ca.sumsqr(u)
        for twist, weight in self._instants(x, u):
            dry, strength, width = m.dry_speeds(twist)
            viscous = m.viscous * (ca.DM(m.J) @ twist) ** 2
            dry_power = ca.DM(strength) * (ca.sqrt(dry**2 + width**2) - width)
            total += weight * (ca.sum1(viscous) + ca.sum1(dry_power))
        return total

    def _instants(self, x: ca.SX, u: ca.SX) -> list[tuple[ca.SX, float]]:
        """Return twists at start, middle and end of a step, and Simpson's weights over eta [s]."""
        _, middle, last = self._transition(x, u)
        weight = self.step / (6.0 * self.model.efficiency)
        return [(x[3:], weight), (middle, 4.0 * weight), (last, weight)]

    def _loss_derivatives(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return gradient and Gauss-Newton Hessian of :meth:`losses` with respect to (x, u).

        All speeds are linear in the twist, so each instant contributes a 3 x 3 matrix. The
        curvature of dry friction is that of the tangent parabola above it.
        """
        m, z = self.model, ca.vertcat(x, u)
        speeds = ca.DM(np.vstack([m.J, m.rolling]))
        viscous = ca.DM(2.0 * m.J.T @ (m.viscous[:, None] * m.J))
        copper = ca.vertcat(
            ca.DM.zeros(STATES), 2.0 * m.resistance * self.step * ca.DM.ones(u.numel())
        )
        gradient, hessian = copper * z, ca.SX(ca.diag(copper))
        for twist, weight in self._instants(x, u):
            by_z = ca.jacobian(twist, z)
            dry, strength, width = m.dry_speeds(twist)
            bend = ca.DM(strength) / ca.sqrt(dry**2 + width**2)
            gradient += weight * by_z.T @ (viscous @ twist + speeds.T @ (bend * dry))
            hessian += weight * by_z.T @ ((viscous + speeds.T @ ca.diag(bend) @ speeds) @ by_z)
        return gradient, hessian

    def node_residuals(self, y: ca.SX, p: ca.SX) -> ca.SX:
        """Return residuals of the state y at a step's end: their squares are its cost.

        The cost is (31) with W_vel. The last residuals are those of the kinetic energy.
        """
        target, weights = p[6:12], p[12:17]
        c, s = ca.cos(y[2]), ca.sin(y[2])
        velocity = ca.vertcat(c * y[3] - s * y[4], s * y[3] + c * y[4], y[5])
        error = ca.vertcat(y[:3] - target[:3], velocity - target[3:])
        scale = ca.sqrt(
            ca.vertcat(weights[0], weights[0], weights[1], weights[2], weights[2], weights[3])
        )
        root = np.linalg.cholesky(0.5 * self.model.inertia).T
        kinetic = ca.sqrt(weights[4]) * (ca.DM(root) @ y[3:])
        return ca.vertcat(scale * error, kinetic)

    def _stage(self, x: ca.SX, u: ca.SX, p: ca.SX) -> ca.Function:
        """Return the function of one stage: all its terms by state, control and parameters."""
        m, z = self.model, ca.vertcat(x, u)
        end, _, _ = self._transition(x, u)
        ab = ca.jacobian(end, z)
        energy = p[21]
        gradient, hessian = self._loss_derivatives(x, u)
        gradient, hessian = energy * gradient, energy * hessian
        damped = self.damping * 2 * m.resistance * self.step
        hessian += damped * ca.diag(ca.vertcat(ca.DM.zeros(STATES), ca.DM.ones(u.numel())))
        y = ca.SX.sym("y", STATES)
        residuals = self.node_residuals(y, p)
        of_y = ca.jacobian(residuals, y)
        node = ca.Function("node", [y, p], [2 * of_y.T @ residuals, 2 * of_y.T @ of_y, residuals])
        node_gradient, node_hessian, at_end = node(end, p)
        rows, low, high = self.inequalities(x, u, y, p)
        row = ca.Function(
            "row", [x, u, y, p], [rows, ca.jacobian(rows, z), ca.jacobian(rows, y), low, high]
        )
        value, direct, through, low, high = row(x, u, end, p)
        cost = energy * self.losses(x, u) + ca.sumsqr(at_end)
        self.stage_cost = ca.Function("stage_cost", [x, u, p], [cost])
        self.stage_rows = ca.Function("stage_rows", [x, u, p], [value, low, high])
        outputs = [
            ab,
            gradient,
            hessian,
            node_gradient,
            ca.densify(low - value),
            ca.densify(high - value),
            direct + through @ ab,
            node_hessian,
            cost,
        ]
        return ca.Function("stage", [x, u, p], ca.cse([ca.densify(out) for out in outputs]))

    def inequalities(self, x: ca.SX, u: ca.SX, y: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return inequalities low <= row <= high; y is the state at the stage's end.

        The rows that the slack relaxes are the last, see `relaxed`.
        """
        m, limits = self.model, p[:6]
        rows: list[tuple[ca.SX, ca.SX, ca.SX]] = []

        def within(value: ca.SX, limit: ca.SX) -> None:
            """Add rows -1 <= value / limit <= 1."""
            scaled = value / limit
            rows.append((scaled, -ca.SX.ones(scaled.shape), ca.SX.ones(scaled.shape)))

        jacobian = ca.DM(m.J)
        for twist in (x[3:], y[3:]):
            within(m.resistance * u + m.emf * (jacobian @ twist), limits[3])
        within(y[5], limits[1])
        within(jacobian @ y[3:], limits[2])
        within(self._spokes @ _rotated(y[2] - p[24], y[3:5]), limits[0])
        rate = m.twist_rate(x[3:], u)
        acceleration = ca.vertcat(rate[0] - x[5] * x[4], rate[1] + x[5] * x[3])
        within(self._spokes @ _rotated(x[2] - p[24], acceleration), limits[4])
        within(rate[2], limits[5])
        self.relaxed = sum(entry[0].size1() for entry in rows)
        low, high = p[17:19], p[19:21]
        for k in range(EXTREMES):
            at, (axis, side) = 25 + 2 * k, divmod(k // 2, 2)
            point = y[:2] + _rotated(y[2], p[at : at + 2])
            gap = high[axis] - point[axis] if side else point[axis] - low[axis]
            rows.append((gap, ca.SX(0), ca.SX(ca.inf)))
        for k in range(self.slots):
            at = FIXED + OBSTACLE * k
            for gap in self._gaps(y, p[at : at + OBSTACLE]):
                rows.append((gap, ca.SX(0), ca.SX(ca.inf)))
        value, low_end, high_end = (ca.vertcat(*part) for part in zip(*rows, strict=True))
        return value, low_end, high_end

    def _gaps(self, y: ca.SX, obstacle: ca.SX) -> list[ca.SX]:
        """Return the gap between each edge of the obstacle's box and the ellipse [m], four rows.

        In the plane whitened by the ellipse, the distance of its centre from an edge, which is a
        segment, is exact. If the centre is inside the box, only the nearest edge counts, which has
        to move beyond the centre.
        """
        centre, scale = obstacle[:2], obstacle[6]
        white = ca.reshape(obstacle[2:6], 2, 2).T
        c, s = ca.cos(y[2]), ca.sin(y[2])
        # Direction of the box in odom, and its centre.
        along = ca.vertcat(c * obstacle[9] - s * obstacle[10], s * obstacle[9] + c * obstacle[10])
        across = ca.vertcat(-along[1], along[0])
        middle = y[:2] + ca.vertcat(
            c * obstacle[7] - s * obstacle[8], s * obstacle[7] + c * obstacle[8]
        )
        a, b = obstacle[11], obstacle[12]
        corners = [
            middle + side * a * along + edge * b * across
            for side, edge in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        body = ca.vertcat(ca.dot(along, centre - middle), ca.dot(across, centre - middle))
        depths = ca.vertcat(b - body[1], a + body[0], b + body[1], a - body[0])
        nearest = ca.mmin(depths)
        inside = nearest > 0
        gaps = []
        for k in range(4):
            start = white @ (corners[k] - centre)
            edge = white @ (corners[(k + 1) % 4] - corners[k])
            fraction = ca.fmin(ca.fmax(-ca.dot(start, edge) / ca.dot(edge, edge), 0), 1)
            distance = ca.sqrt(ca.sumsqr(start + fraction * edge) + 1e-9)
            within = ca.if_else(depths[k] <= nearest, -distance, INACTIVE_GAP)
            gaps.append(scale * (ca.if_else(inside, within, distance) - 1))
        return gaps

    # ---- all stages -------------------------------------------------------------------------

    def _assemble(self, stage: ca.Function) -> ca.Function:
        """Return the quadratic program of all stages, gathered from the stages' outputs."""
        steps, n, rows = self.steps, self.controls, self.rows
        width = STATES + n
        x0, u = ca.MX.sym("x0", STATES), ca.MX.sym("u", n, steps)
        p = ca.MX.sym("p", FIXED + OBSTACLE * self.slots, steps)
        ends = self.rollout(x0, u)
        starts = ca.horzcat(x0, ends[:, : steps - 1])
        outputs = stage.map(steps)(starts, u, p)
        ab, gradient, hessian, node_gradient, low, high, by_z, node_hessian, cost = outputs
        source = ca.vertcat(
            *map(ca.vec, (ab, gradient, hessian, node_gradient, low, high, by_z, node_hessian)),
            ca.MX([0.0, 1.0, -1.0]),
            ca.vec(p[22:24, :]),
        )
        sizes = [STATES * width, width, width * width, STATES, rows, rows, rows * width]
        begins = np.cumsum([0] + [size * steps for size in (*sizes, STATES * STATES)])
        zero, one, minus, slack = begins[-1] + np.arange(4)

        def block(output: int, k: int, height: int, columns: int) -> Indices:
            """Return the indices (height, columns) of an output of stage k in `source`."""
            first = begins[output] + k * height * columns
            indices: Indices = first + np.arange(height * columns).reshape(columns, height).T
            return indices

        total = steps * (width + 1)  # without x_0, with x_N
        size_a = steps * (STATES + rows)
        hess, cons = _Entries((total, total)), _Entries((size_a, total))
        lower, upper = np.full(size_a, zero), np.full(size_a, zero)
        for k in range(steps):
            # Columns of x_k (none at the start), u_k, s_k, x_k+1 and this stage's rows.
            at = k * (width + 1) - STATES
            of_x, of_u = np.arange(at, at + STATES), np.arange(at + STATES, at + width)
            of_s, of_next = at + width, np.arange(at + width + 1, at + width + 1 + STATES)
            z = np.concatenate([of_x, of_u])
            keep = z >= 0
            top = k * (STATES + rows)
            motion, limits = (
                np.arange(top, top + STATES),
                np.arange(top + STATES, top + STATES + rows),
            )
            cons.add(motion, z[keep], block(0, k, STATES, width)[:, keep])
            cons.diagonal(motion, of_next, minus)
            cons.add(limits, z[keep], block(6, k, rows, width)[:, keep])
            relaxed = limits[self.relaxed :]
            cons.add(relaxed, np.array([of_s]), np.full((len(relaxed), 1), one))
            hess.add(z[keep], z[keep], block(2, k, width, width)[np.ix_(keep, keep)])
            hess.add(np.array([of_s]), np.array([of_s]), np.array([[slack + 2 * k + 1]]))
            hess.add(of_next, of_next, block(7, k, STATES, STATES))
            lower[limits] = block(4, k, rows, 1)[:, 0]
            upper[limits] = block(5, k, rows, 1)[:, 0]
        # Two terms add up at a node: the cost of the stage that begins there, and that of the
        # stage that ends there.
        starting, ending = np.full(total, zero), np.full(total, zero)
        for k in range(steps):
            at = k * (width + 1) - STATES
            z = np.arange(at, at + width)
            keep = z >= 0
            starting[z[keep]] = block(1, k, width, 1)[keep, 0]
            ending[at + width + 1 : at + width + 1 + STATES] = block(3, k, STATES, 1)[:, 0]
            starting[at + width] = slack + 2 * k
        g = source[starting.tolist()] + source[ending.tolist()]
        bounds = ca.DM(self.model.max_current)
        lower_step, upper_step = [], []
        for k in range(steps):
            lower_step += [-bounds - u[:, k], ca.MX(0), ca.MX(-ca.inf * ca.DM.ones(STATES))]
            upper_step += [bounds - u[:, k], ca.MX(ca.inf), ca.MX(ca.inf * ca.DM.ones(STATES))]
        return ca.Function(
            "program",
            [x0, u, p],
            [
                hess.gather(source),
                g,
                cons.gather(source),
                source[lower.tolist()],
                source[upper.tolist()],
                ca.vertcat(*lower_step),
                ca.vertcat(*upper_step),
                ca.sum2(cost),
                ends,
            ],
        )


def _rotated(angle: ca.SX, vector: ca.SX) -> ca.SX:
    """Return a vector (2,), given in a frame rotated by an angle, in the unrotated frame."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1])


class _Entries:
    """Entries of a sparse matrix as indices into a vector; entries at the same position add up."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._sources: dict[tuple[int, int], list[int]] = {}

    def add(self, rows: Indices, columns: Indices, source: Indices) -> None:
        """Add a block: `source` (rows, columns) indexes the vector."""
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                self._sources.setdefault((int(column), int(row)), []).append(int(source[i, j]))

    def diagonal(self, rows: Indices, columns: Indices, source: int) -> None:
        """Add the same element of the vector at each pair of a row and a column."""
        for row, column in zip(rows, columns, strict=True):
            self._sources.setdefault((int(column), int(row)), []).append(int(source))

    def gather(self, source: ca.MX) -> ca.MX:
        """Return the matrix with the entries of the vector `source`."""
        places = sorted(self._sources)
        sparsity = ca.Sparsity.triplet(
            *self._shape, [row for _, row in places], [column for column, _ in places]
        )
        depth = max(len(self._sources[place]) for place in places)
        zero = source.numel()
        padded = ca.vertcat(source, 0)
        values = ca.MX.zeros(len(places))
        for layer in range(depth):
            index = [
                indices[layer] if layer < len(indices) else zero
                for indices in (self._sources[place] for place in places)
            ]
            values = values + padded[index]
        return ca.MX(sparsity, values)
