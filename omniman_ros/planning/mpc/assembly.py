"""The quadratic program of all stages from the terms of each."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.planning.mpc.model import STATES

Indices = NDArray[np.intp]  #: Array of indices

NODE = slice(6, 17)  #: The parameters of a stage that belong to the state at its end


class StageTerms(NamedTuple):
    """Terms of one stage, whose blocks have the columns [x, u, s].

    Entries of a block are those of its structure, column by column. The rows of A are those of the
    motion of the stage before (6), of its own motion (6), and its limits.
    """

    #: (x, u, p, parameters of the node at its start) -> entries of H, gradient, entries of A,
    #: lower and upper bounds of its motion and its limits, cost
    stage: ca.Function
    last: ca.Function  #: (x_N, parameters of the node) -> entries of H, gradient, cost
    h: ca.Sparsity
    a: ca.Sparsity
    last_h: ca.Sparsity


def assembled_program(
    terms: StageTerms, rollout: ca.Function, max_current: Array, parameters: int
) -> ca.Function:
    """Return the function of all stages, see `Transcription.program`.

    The blocks of the stages follow each other in the columns of H and A, so that their entries are
    copied in their order. The state of the first stage is given: its columns are left out.
    """
    n, steps = rollout.size_in(1)
    x0, u = ca.MX.sym("x0", STATES), ca.MX.sym("u", n, steps)
    p = ca.MX.sym("p", parameters, steps)
    ends, nodes = rollout(x0, u), p[NODE, :]
    begins = ca.horzcat(ca.MX.zeros(nodes.size1(), 1), nodes[:, : steps - 1])
    starts = ca.horzcat(x0, ends[:, : steps - 1])
    h, g, a, low, high, cost = terms.stage.map(steps)(starts, u, p, begins)
    h_end, g_end, cost_end = terms.last(ends[:, -1], nodes[:, -1])
    first_h, first_a = (_kept(block).tolist() for block in (terms.h, terms.a))
    bound, free = ca.DM(max_current), ca.DM(np.full(STATES, np.inf))
    least = [ca.vertcat(-bound - u[:, k], 0, -free) for k in range(steps)]
    most = [ca.vertcat(bound - u[:, k], ca.inf, free) for k in range(steps)]
    outputs = [
        ca.vertcat(h[:, 0][first_h], ca.vec(h[:, 1:]), h_end),
        ca.vertcat(g[STATES:, 0], ca.vec(g[:, 1:]), g_end),
        ca.vertcat(a[:, 0][first_a], ca.vec(a[:, 1:]), -ca.DM.ones(STATES)),
        ca.vec(low),
        ca.vec(high),
        ca.vertcat(*least),
        ca.vertcat(*most),
        ca.sum2(cost) + cost_end,
        ends,
    ]
    return ca.Function("program", [x0, u, p], outputs)


def assembled_structure(
    terms: StageTerms, steps: int, controls: int, rows: int
) -> tuple[ca.Sparsity, ca.Sparsity]:
    """Return the structures of H and A."""
    width, height = controls + 1 + STATES, STATES + rows
    places_h: list[tuple[Indices, Indices]] = []
    places_a: list[tuple[Indices, Indices]] = []
    for k in range(steps):
        columns = width * k - STATES + np.arange(width)
        motions = height * (k - 1) + np.arange(STATES), height * k + np.arange(height)
        places_h.append(_placed(terms.h, columns, columns, is_first=not k))
        places_a.append(_placed(terms.a, np.concatenate(motions), columns, is_first=not k))
    end = width * steps - STATES + np.arange(STATES)
    places_h.append(_placed(terms.last_h, end, end))
    places_a.append((height * (steps - 1) + np.arange(STATES), end))
    total = width * steps
    return _pattern((total, total), places_h), _pattern((height * steps, total), places_a)


def _places(block: ca.Sparsity) -> Any:
    """Return rows and columns (2, nnz) of the entries of a block."""
    return np.array(block.get_triplet(), dtype=np.intp)


def _kept(block: ca.Sparsity) -> Indices:
    """Return the indices of the entries of a block that the first stage has.

    They are those of controls and slack, whose rows are never those of the motion before.
    """
    rows, columns = _places(block)
    return np.flatnonzero((rows >= STATES) & (columns >= STATES))


def _placed(
    block: ca.Sparsity, rows: Indices, columns: Indices, is_first: bool = False
) -> tuple[Indices, Indices]:
    """Return rows and columns of the entries of a block by those of the whole matrix."""
    own_rows, own_columns = _places(block)
    kept = _kept(block) if is_first else slice(None)
    return rows[own_rows[kept]], columns[own_columns[kept]]


def _pattern(shape: tuple[int, int], places: list[tuple[Indices, Indices]]) -> ca.Sparsity:
    """Return the structure of a matrix from rows and columns of its entries."""
    rows, columns = (np.concatenate(part).tolist() for part in zip(*places, strict=True))
    return ca.Sparsity.triplet(*shape, rows, columns)
