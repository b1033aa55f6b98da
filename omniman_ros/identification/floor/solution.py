"""Least squares for the unknowns of the floor model, and what the drive cannot tell apart.

Unknowns are counted from their configured values in units of the deviation that is expected. A
combination of them that the equations leave less certain than it was expected to be beforehand is
not determined: it keeps its configured value, and the unknowns in it are reported together.
"""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.identification.floor.regressor import Equations, FloorModel

WINDOW_WIDTH = 0.6  #: Width of the windows over which the equations are averaged [s]
WINDOW_STEP = 0.15  #: Distance between two windows [s]; the narrow weights overlap by half
PLANNED_NOISE = 0.02  #: Noise of an averaged equation over its value, for planning
MAX_DEVIATION = 0.5  #: Ratio to the expected deviation from which nothing is determined
NOISE_CORRELATION = 2.0  #: Factor on independent deviations, as neighbouring windows overlap
MIN_PART = 0.1  #: Part of an undetermined combination from which an unknown is named with it


@dataclass(frozen=True, eq=False)
class Directions:
    """The combinations of unknowns that equations determine, and the rest."""

    weights: Array  #: (3,) factors on the rows for the two forces and the torque
    determined: Array  #: (p, d) orthonormal combinations of scaled unknowns that are determined
    projector: Array  #: (p, p) projector onto all others

    def solve(self, model: FloorModel, equations: Equations, kept: Array | None = None) -> Array:
        """Return the unknowns (p,); combinations that are not determined stay as configured."""
        matrix, values = _rows(model, equations, self.weights)
        if kept is not None:
            rows = np.repeat(kept, 3)
            matrix, values = matrix[rows], values[rows]
        shift = np.linalg.lstsq(matrix @ self.determined, values, rcond=None)[0]
        result: Array = model.expected + model.spread * (self.determined @ shift)
        return result


def find_directions(model: FloorModel, equations: Equations) -> Directions:
    """Weigh the rows by their residuals, and separate what they determine from the rest."""
    typical = np.sqrt((equations.values**2).mean(axis=0))
    weights = 1.0 / np.maximum(PLANNED_NOISE * typical, 1e-9)
    for _ in range(2):
        directions = _separate(model, equations, weights)
        unknowns = directions.solve(model, equations)
        residuals = equations.matrix @ unknowns - equations.values
        noise = np.sqrt((residuals**2).mean(axis=0))
        weights = 1.0 / np.maximum(noise, 1e-4 * typical + 1e-9)
    return _separate(model, equations, weights)


def expected_variances(model: FloorModel, equations: Equations) -> Array:
    """Return the variances (p,) of scaled unknowns that planned equations promise, at most 1."""
    typical = np.sqrt((equations.values**2).mean(axis=0))
    matrix, _ = _rows(model, equations, 1.0 / (PLANNED_NOISE * typical))
    information = matrix.T @ matrix / NOISE_CORRELATION**2
    result: Array = np.diag(np.linalg.inv(information + np.eye(len(information))))
    return result


def groups(model: FloorModel, directions: Directions) -> list[tuple[str, ...]]:
    """Return the names of unknowns that cannot be told apart, by group.

    Two unknowns belong together if an undetermined combination changes both. An unknown by itself
    has too little effect.
    """
    linked = np.abs(directions.projector) > MIN_PART
    remaining = [k for k in range(len(model.names)) if linked[k, k]]
    found = []
    while remaining:
        group, queue = [], [remaining[0]]
        while queue:
            k = queue.pop()
            if k in remaining:
                remaining.remove(k)
                group.append(k)
                queue += [j for j in remaining if linked[k, j]]
        found.append(tuple(model.names[k] for k in sorted(group)))
    return found


def _rows(model: FloorModel, equations: Equations, weights: Array) -> tuple[Array, Array]:
    """Return the weighted rows (3 k, p) of scaled unknowns, and their values (3 k,)."""
    offset = equations.values - equations.matrix @ model.expected
    matrix = (equations.matrix * model.spread) * weights[:, None]
    return matrix.reshape(-1, len(model.names)), (offset * weights).ravel()


def _separate(model: FloorModel, equations: Equations, weights: Array) -> Directions:
    matrix, _ = _rows(model, equations, weights)
    if model.is_gear_known:
        matrix[:, -1] = 0.0
    _, values, rows = np.linalg.svd(matrix, full_matrices=False)
    deviations = NOISE_CORRELATION / np.maximum(values, 1e-12)
    determined = rows[deviations <= MAX_DEVIATION].T
    projector = np.eye(len(model.names)) - determined @ determined.T
    return Directions(weights, determined, projector)
