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
        self._solvers = [InPlaceFunction(mode) for mode in modes]
        self.entries = tuple(self._solvers[0].arguments[: len(ARGUMENTS)])

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
        h, g, a, low, high, lower, upper = self.entries
        for name, entries in (("matrix H", h), ("gradient", g), ("matrix A", a)):
            if not np.isfinite(entries).all():
                raise SolverError(f"the {name} of the quadratic program is not finite")
        _require_consistent("row", low, high)
        _require_consistent("unknown", lower, upper)
        status = ""
        for solver in self._solvers:
            for argument, entries in zip(solver.arguments, self.entries, strict=False):
                if argument is not entries:
                    argument[:] = entries
            solver()
            stats, solution = solver.stats(), solver.results[0]
            if stats["success"] and np.isfinite(solution).all():
                return solution.copy()
            status = str(stats["return_status"])
        raise SolverError(f"the quadratic program was not solved ({status})")


def _require_consistent(name: str, least: Array, largest: Array) -> None:
    """Raise SolverError unless some finite value lies between the bounds (n,) in each place."""
    # NaN fails the first comparison.
    if not ((least <= largest).all() and least.max() < np.inf and largest.min() > -np.inf):
        is_possible = (least < np.inf) & (largest > -np.inf) & (least <= largest)
        k = int(np.flatnonzero(~is_possible)[0])
        raise SolverError(
            f"the bounds of {name} {k} of the quadratic program contradict each other: "
            f"{least[k]:g} and {largest[k]:g}"
        )
