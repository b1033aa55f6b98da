"""The quadratic program of a cycle: one Gauss-Newton step in the redundancy.

The unknowns are changes of a guess: of the accelerations u_k that are held over a step, of the
states x_k = (z_k, z'_k) that follow from them exactly, and a slack of each class for every stage.
Their order is u_0, slack_0, x_1, u_1, slack_1, ..., x_N. Rows of stage k hold at node k + 1.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.planning.mpc.quadratic_program import INFINITY, QuadraticProgram, SolverError
from omniman_ros.planning.whole_body.redundancy import COORDINATES

#: Number of classes of slack: what stands and the robot itself; limits of the arm and wheels,
#: singularities; what moves.
CLASSES = 3
STANDING, LIMITS, MOVING = range(CLASSES)
CRITICAL = 14  #: Number of rows of each stage with which a program is solved first
#: Changes of states and accelerations by which rows are ranked; steps seldom have larger ones
RANKED_BY_X = np.array([[0.06, 0.06, 0.1, 0.06], [0.15, 0.15, 0.2, 0.15]])
RANKED_FREE = 0.1, 0.2  #: Those of the coordinates of a free orientation [rad, rad/s]
RANKED_BY_U = 0.5
BROKEN = 1e-5  #: Excess over a row above which a solution does not obey it


@dataclass(frozen=True)
class StageRows(Validated):
    """Rows value + by_x dx + by_u du + slack >= 0 of N stages, R each.

    There are d redundancy coordinates, and X = 2 d states: the coordinates and their rates.
    """

    value: Annotated[Array, Shape("N", "R")]  #: (N, R) values at the guess
    #: (N, R, X) derivatives by the state at the stage's end
    by_x: Annotated[Array, Shape("N", "R", "X")]
    #: (N, R, d) derivatives by the stage's accelerations
    by_u: Annotated[Array, Shape("N", "R", "d")]
    slack: Annotated[Indices, Shape("N", "R")]  #: (N, R) numbers of the classes of slack

    @staticmethod
    def join(parts: "list[StageRows]") -> "StageRows":
        """Return all rows of several sets."""
        return StageRows.unchecked(
            **{
                name: np.concatenate([getattr(part, name) for part in parts], axis=1)
                for name in ("value", "by_x", "by_u", "slack")
            }
        )

    def selected(self, index: Indices) -> "StageRows":
        """Return the rows with numbers (N, n) of each stage."""
        return StageRows.unchecked(
            value=np.take_along_axis(self.value, index, axis=1),
            by_x=np.take_along_axis(self.by_x, index[..., None], axis=1),
            by_u=np.take_along_axis(self.by_u, index[..., None], axis=1),
            slack=np.take_along_axis(self.slack, index, axis=1),
        )


@dataclass(frozen=True)
class Quadratic(Validated):
    """Cost of a step, and its bounds."""

    #: (N, X, X) matrices of the states at the stages' ends
    hessian: Annotated[Array, Shape("N", "X", "X")]
    gradient: Annotated[Array, Shape("N", "X")]  #: (N, X) their gradients
    #: (d,) diagonal of the matrix of the accelerations
    control_hessian: Annotated[Array, Shape("d")]
    control_gradient: Annotated[Array, Shape("N", "d")]  #: (N, d) their gradients
    #: (2, N, d) least and largest changes of the accelerations
    control_bounds: Annotated[Array, Shape(2, "N", "d")]
    #: (2, N, X) least and largest changes of the states
    state_bounds: Annotated[Array, Shape(2, "N", "X")]


@dataclass(frozen=True)
class ProgramSolution(Validated):
    """Solution of a program."""

    controls: Annotated[Array, Shape("N", "d")]  #: (N, d) changes of the accelerations
    states: Annotated[Array, Shape("N", "X")]  #: (N, X) changes of the states at the stages' ends
    slack: Annotated[Array, Shape("N", 3)]  #: (N, 3) slack of each class


def transition(step: float, coordinates: int) -> tuple[Array, Array]:
    """Return A (2 d, 2 d) and B (2 d, d) of the exact dynamics over a step [s]."""
    eye, zero = np.eye(coordinates), np.zeros((coordinates, coordinates))
    a = np.block([[eye, step * eye], [zero, eye]])
    b = np.vstack([0.5 * step**2 * eye, step * eye])
    return a, b


class RedundancyProgram:
    """Solves the programs of all cycles, which have the same structure.

    They have N steps of a length [s], each with a stage of R rows, weights (3,) of the slack and
    of its squares, and d redundancy coordinates.
    """

    def __init__(
        self,
        steps: int,
        step: float,
        rows: int,
        linear: Array,
        quadratic: Array,
        coordinates: int = COORDINATES,
    ) -> None:
        self._steps, self._rows, self._coordinates = steps, rows, coordinates
        self._a, self._b = transition(step, coordinates)
        self._linear, self._quadratic = linear, quadratic
        states = 2 * coordinates
        inputs = self._inputs = coordinates + CLASSES
        width = self._width = inputs + states
        height = states + rows
        total = steps * width
        # Positions of a stage's block [x_k, u_k, slack_k] and of -x_(k+1) in A.
        block = np.zeros((steps * height, total), dtype=np.intp)
        count = height * width
        for k in range(steps):
            numbers = 1 + k * count + np.arange(count).reshape(height, width)
            first = k * width - states
            top = slice(k * height, (k + 1) * height)
            if k:
                block[top, first : first + width] = numbers
            else:
                block[top, :inputs] = numbers[:, states:]
            end = first + width
            for row in range(states):
                block[k * height + row, end + row] = -1
        hessian = np.zeros((total, total), dtype=np.intp)
        for k in range(steps):
            at = k * width
            for i in range(inputs):
                hessian[at + i, at + i] = 1 + i
            square = 1 + inputs + k * states**2 + np.arange(states**2)
            of_state = slice(at + inputs, at + width)
            hessian[of_state, of_state] = square.reshape(states, states)
        self._of_a, self._of_h = block.T[block.T != 0], hessian.T[hessian.T != 0]
        self._qp = QuadraticProgram.of_masks(
            hessian != 0,
            block != 0,
            {
                "N": steps,
                "nx": [0] + [states] * steps,
                "nu": [inputs] * steps + [0],
                "ng": [rows] * steps + [0],
            },
        )

    def solve(self, rows: StageRows, cost: Quadratic) -> ProgramSolution:
        """Return the step that minimises a cost within bounds and rows.

        Raises:
            SolverError: The program was not solved.
        """
        n, inputs, d = self._steps, self._inputs, self._coordinates
        states = 2 * d
        blocks = np.zeros((n, states + self._rows, self._width))
        blocks[:, :states, :states] = self._a
        blocks[:, :states, states : states + d] = self._b
        blocks[:, states:, :states] = rows.by_x @ self._a
        blocks[:, states:, states : states + d] = rows.by_x @ self._b + rows.by_u
        blocks[:, states:, states + d :] = rows.slack[..., None] == np.arange(CLASSES)
        source = np.concatenate([[0.0], blocks.ravel(), [-1.0]])
        diagonal = np.concatenate([cost.control_hessian, self._quadratic])
        hessian = np.concatenate([[0.0], diagonal, cost.hessian.ravel()])
        gradient, lower, upper = (np.empty((n, self._width)) for _ in range(3))
        gradient[:, :d] = cost.control_gradient
        gradient[:, d:inputs] = self._linear
        gradient[:, inputs:] = cost.gradient
        lower[:, :d], upper[:, :d] = cost.control_bounds
        lower[:, d:inputs], upper[:, d:inputs] = 0.0, np.inf
        lower[:, inputs:], upper[:, inputs:] = cost.state_bounds
        low = np.concatenate([np.zeros((n, states)), -rows.value], axis=1)
        high = np.concatenate([np.zeros((n, states)), np.full(rows.value.shape, np.inf)], axis=1)
        low = np.clip(low, -INFINITY, INFINITY)
        bounds = low.ravel(), high.ravel(), lower.ravel(), upper.ravel()
        found = self._qp.solve_entries(
            hessian[self._of_h], gradient.ravel(), source[self._of_a], bounds
        ).reshape(n, self._width)
        return ProgramSolution.unchecked(
            controls=found[:, :d],
            states=found[:, inputs:],
            slack=found[:, d:inputs],
        )


class ReducedProgram:
    """Solves programs of which most rows cannot bind, in 0.6 of the time of all rows.

    At first, a program has the `CRITICAL` rows of each stage that may come nearest to their
    limits. A solution that obeys the others, too, is that of the whole program; else that one is
    solved. Arguments are those of `RedundancyProgram`.
    """

    def __init__(
        self,
        steps: int,
        step: float,
        rows: int,
        linear: Array,
        quadratic: Array,
        coordinates: int = COORDINATES,
    ) -> None:
        self._all = RedundancyProgram(steps, step, rows, linear, quadratic, coordinates)
        self._count = min(rows, CRITICAL)
        self._critical = RedundancyProgram(
            steps, step, self._count, linear, quadratic, coordinates
        )
        free = np.ones(coordinates - COORDINATES)
        position, rate = RANKED_BY_X
        self._ranked_by_x: Array = np.concatenate(
            [position, RANKED_FREE[0] * free, rate, RANKED_FREE[1] * free]
        )
        self._ranked_by_u: Array = np.full(coordinates, RANKED_BY_U)

    def solve(self, rows: StageRows, cost: Quadratic) -> ProgramSolution:
        """Return the step that minimises a cost within bounds and rows.

        Raises:
            SolverError: The program was not solved.
        """
        reach = np.abs(rows.by_x) @ self._ranked_by_x + np.abs(rows.by_u) @ self._ranked_by_u
        order = np.argpartition(rows.value - reach, self._count - 1, axis=1)
        try:
            found = self._critical.solve(rows.selected(order[:, : self._count]), cost)
        except SolverError:
            return self._all.solve(rows, cost)
        left = rows.value + (rows.by_x @ found.states[..., None])[..., 0]
        left += (rows.by_u @ found.controls[..., None])[..., 0]
        left += np.take_along_axis(found.slack, rows.slack, axis=1)
        return found if left.min() >= -BROKEN else self._all.solve(rows, cost)
