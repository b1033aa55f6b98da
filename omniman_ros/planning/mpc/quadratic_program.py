"""Quadratic programs with the structure of an optimal control problem, solved by HPIPM."""

from typing import Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError

TOLERANCES: dict[str, float] = {
    "res_g_max": 1e-3,
    "res_b_max": 1e-6,
    "res_d_max": 1e-6,
    "res_m_max": 1e-4,
}
"""Residuals below which a quadratic program counts as solved; the next iteration refines it."""
MODES: dict[str, dict[str, Any]] = {
    "speed": {"mode": "speed", "iter_max": 40},
    "balance": {"mode": "balance", "iter_max": 60},
}
"""Options of HPIPM by mode; the second mode is used if the first fails."""
INFINITY = 1e4
"""Value that represents infinity in the QP solver: a larger value degrades its scaling."""


class SolverError(OmnimanError):
    """The solver found no usable solution; the message gives the reason."""


class QuadraticProgram:
    """Minimises x' H x / 2 + g' x within lower <= x <= upper and low <= A x <= high.

    Args:
        h: Structure of H.
        a: Structure of A.
        sizes: Numbers of stages, states, controls and rows of each stage, for HPIPM.

    Raises:
        SolverError: casadi has no HPIPM.
    """

    def __init__(self, h: ca.Sparsity, a: ca.Sparsity, sizes: dict[str, Any]) -> None:
        self._h, self._a = h, a
        more: dict[str, Any] = {
            **sizes,
            "inf": INFINITY,
            "error_on_fail": False,
            "print_time": False,
        }
        try:
            self._modes = [
                ca.conic(
                    mode, "hpipm", {"h": h, "a": a}, more | {"hpipm": {**TOLERANCES, **options}}
                )
                for mode, options in MODES.items()
            ]
        except RuntimeError as error:
            raise SolverError(f"casadi has no QP solver 'hpipm': {error}") from error

    @staticmethod
    def of_masks(h: Array, a: Array, sizes: dict[str, Any]) -> "QuadraticProgram":
        """Return a program whose H and A have entries where matrices are not zero."""
        first, second = (ca.sparsify(ca.DM(np.asarray(m, dtype=float))).sparsity() for m in (h, a))
        return QuadraticProgram(first, second, sizes)

    def solve_entries(
        self, h: Array, g: Array, a: Array, bounds: tuple[Array, Array, Array, Array]
    ) -> Array:
        """Return the solution (n,) for the entries of H and A, column by column.

        Args:
            h: Entries of H.
            g: Gradient (n,).
            a: Entries of A.
            bounds: low, high (m,), lower and upper (n,).

        Raises:
            SolverError: The program was not solved.
        """
        return self.solve([ca.DM(self._h, h.tolist()), g, ca.DM(self._a, a.tolist()), *bounds])

    def solve(self, program: list[Any]) -> Array:
        """Return the solution (n,) of a program H, g, A, low, high, lower, upper.

        Raises:
            SolverError: The program was not solved.
        """
        h, g, a, low, high, lower, upper = program
        status = ""
        for qp in self._modes:
            found = qp(h=h, g=g, a=a, lba=low, uba=high, lbx=lower, ubx=upper)["x"]
            solution: Array = np.asarray(found).ravel()
            stats = qp.stats()
            if stats["success"] and np.isfinite(solution).all():
                return solution
            status = str(stats["return_status"])
        raise SolverError(f"the quadratic program was not solved ({status})")
