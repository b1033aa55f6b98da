"""Quadratic programs with the structure of an optimal control problem, solved by HPIPM."""

from typing import Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.planning.mpc.in_place import InPlaceFunction

TOLERANCES: dict[str, float] = {
    "res_g_max": 1e-3,
    "res_b_max": 1e-6,
    "res_d_max": 1e-6,
    "res_m_max": 1e-4,
}  #: Residuals below which a quadratic program counts as solved; the next iteration refines it
MODES: dict[str, dict[str, Any]] = {
    "speed": {"mode": "speed", "iter_max": 40},
    "balance": {"mode": "balance", "iter_max": 60},
}  #: Options of HPIPM by mode; the second mode is used if the first fails
#: Value that represents infinity in the QP solver: a larger value degrades its scaling
INFINITY = 1e4


#: Names of the parts of a program, in the order of casadi, which has others after them
ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")
LOW = ARGUMENTS.index("lba")


class SolverError(OmnimanError):
    """The solver found no usable solution; the message gives the reason."""


class QuadraticProgram:
    """Minimises x' H x / 2 + g' x within lower <= x <= upper and low <= A x <= high.

    H and A are given by their structures; `sizes` are the numbers of stages, states, controls and
    rows of each stage, for HPIPM.

    Attributes:
        entries: Arrays of the entries of H (column by column), g, A, low, high, lower and upper,
            to be written before :meth:`solve`.

    Raises:
        SolverError: casadi has no HPIPM.
    """

    def __init__(self, h: ca.Sparsity, a: ca.Sparsity, sizes: dict[str, Any]) -> None:
        more: dict[str, Any] = {
            **sizes,
            "inf": INFINITY,
            "error_on_fail": False,
            "print_time": False,
        }
        try:
            modes = [
                ca.conic(
                    mode, "hpipm", {"h": h, "a": a}, more | {"hpipm": {**TOLERANCES, **options}}
                )
                for mode, options in MODES.items()
            ]
        except RuntimeError as error:
            raise SolverError(f"casadi has no QP solver 'hpipm': {error}") from error
        # One array for all entries, which is checked at once; and one for each kind of bounds.
        (rows, unknowns), matrices = a.shape, (h.nnz(), h.shape[0], a.nnz())
        self._matrices = np.zeros(sum(matrices))
        self._least, self._largest = (np.zeros(rows + unknowns) for _ in range(2))
        low, lower = np.split(self._least, [rows])
        high, upper = np.split(self._largest, [rows])
        parts = np.split(self._matrices, np.cumsum(matrices)[:-1])
        self.entries = (*parts, low, high, lower, upper)
        self._solvers = [InPlaceFunction(mode, arguments=self.entries) for mode in modes]

    @staticmethod
    def of_masks(h: Array, a: Array, sizes: dict[str, Any]) -> "QuadraticProgram":
        """Return a program whose H and A have entries where matrices are not zero."""
        first, second = (ca.sparsify(ca.DM(np.asarray(m, dtype=float))).sparsity() for m in (h, a))
        return QuadraticProgram(first, second, sizes)

    def solve_entries(
        self, h: Array, g: Array, a: Array, bounds: tuple[Array, Array, Array, Array]
    ) -> Array:
        """Return the solution (n,) for the entries of H and A, column by column.

        The gradient is (n,); the bounds are low, high (m,), lower and upper (n,).

        Raises:
            SolverError: The program was refused, see :meth:`solve`, or not solved.
        """
        for own, values in zip(self.entries, (h, g, a, *bounds), strict=True):
            own[:] = values
        return self.solve()

    def solve(self) -> Array:
        """Return the solution (n,) of the program in `entries`.

        A program with entries that are not finite, or with bounds that contradict each other, is
        refused before the call: HPIPM may crash on the former, and casadi raises an error of its
        own on the latter.

        Raises:
            SolverError: The program was refused, or not solved.
        """
        if not np.isfinite(self._matrices).all():
            raise self._not_finite()
        # NaN fails the first comparison.
        least, largest = self._least, self._largest
        if not ((least <= largest).all() and least.max() < np.inf and largest.min() > -np.inf):
            raise self._contradictory()
        status = ""
        for solver in self._solvers:
            solver()
            stats, solution = solver.stats(), solver.results[0]
            if stats["success"] and np.isfinite(solution).all():
                return solution.copy()
            status = str(stats["return_status"])
        raise SolverError(f"the quadratic program was not solved ({status})")

    def _not_finite(self) -> SolverError:
        """Return the error of entries of which some are not finite."""
        parts = zip(("matrix H", "gradient", "matrix A"), self.entries, strict=False)
        names = [name for name, entries in parts if not np.isfinite(entries).all()]
        return SolverError(f"the {names[0]} of the quadratic program is not finite")

    def _contradictory(self) -> SolverError:
        """Return the error of bounds without a finite value between them."""
        least, largest = self._least, self._largest
        is_possible = (least < np.inf) & (largest > -np.inf) & (least <= largest)
        first, rows = int(np.flatnonzero(~is_possible)[0]), len(self.entries[LOW])
        place = f"row {first}" if first < rows else f"unknown {first - rows}"
        return SolverError(
            f"the bounds of {place} of the quadratic program contradict each other: "
            f"{least[first]:g} and {largest[first]:g}"
        )
