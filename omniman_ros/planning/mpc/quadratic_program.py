"""Quadratic programs with the structure of an optimal control problem, solved by HPIPM."""

from collections.abc import Iterable
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
}  #: Residuals below which a quadratic program counts as solved; the next iteration refines it
MODES: dict[str, dict[str, Any]] = {
    "speed": {"mode": "speed", "iter_max": 40},
    "balance": {"mode": "balance", "iter_max": 60},
}  #: Options of HPIPM by mode; the second mode is used if the first fails
#: Value that represents infinity in the QP solver: a larger value degrades its scaling
INFINITY = 1e4


#: Names of the parts of a program, in the order of casadi
ARGUMENTS = ("h", "g", "a", "lba", "uba", "lbx", "ubx")


class SolverError(OmnimanError):
    """The solver found no usable solution; the message gives the reason."""


class QuadraticProgram:
    """Minimises x' H x / 2 + g' x within lower <= x <= upper and low <= A x <= high.

    H and A are given by their structures; `sizes` are the numbers of stages, states, controls and
    rows of each stage, for HPIPM.

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
            self._modes = [
                ca.conic(
                    mode, "hpipm", {"h": h, "a": a}, more | {"hpipm": {**TOLERANCES, **options}}
                )
                for mode, options in MODES.items()
            ]
        except RuntimeError as error:
            raise SolverError(f"casadi has no QP solver 'hpipm': {error}") from error
        self._memory = [_Memory(mode) for mode in self._modes]

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
        for name, entries in (("matrix H", h), ("gradient", g), ("matrix A", a)):
            if not np.isfinite(entries).all():
                raise SolverError(f"the {name} of the quadratic program is not finite")
        low, high, lower, upper = bounds
        _require_consistent("row", low, high)
        _require_consistent("unknown", lower, upper)
        return _first_solved(memory.solve((h, g, a, *bounds)) for memory in self._memory)

    def solve(self, program: list[Any]) -> Array:
        """Return the solution (n,) of a program H, g, A, low, high, lower, upper.

        A program with entries that are not finite, or with bounds that contradict each other, is
        refused before the call: HPIPM may crash on the former, and casadi raises an error of its
        own on the latter.

        Raises:
            SolverError: The program was refused, or not solved.
        """
        h, g, a, low, high, lower, upper = program
        for name, entries in (("matrix H", h), ("gradient", g), ("matrix A", a)):
            if not ca.DM(entries).is_regular():
                raise SolverError(f"the {name} of the quadratic program is not finite")
        dense = [np.asarray(ca.DM(bound)).ravel() for bound in (low, high, lower, upper)]
        _require_consistent("row", *dense[:2])
        _require_consistent("unknown", *dense[2:])
        values = dict(zip(ARGUMENTS, program, strict=True))
        return _first_solved(
            (np.asarray(mode(**values)["x"]).ravel(), mode.stats()) for mode in self._modes
        )


class _Memory:
    """Arguments and results of a solver in arrays that it reads and writes in place.

    All arguments and results are given, as some solvers crash without.
    """

    def __init__(self, solver: ca.Function) -> None:
        # The stubs of casadi have the arguments of another language.
        buffer: tuple[Any, Any] = solver.buffer()
        self._buffer, self._run = buffer
        self._arguments = [np.zeros(solver.nnz_in(k)) for k in range(solver.n_in())]
        self._results = [np.zeros(solver.nnz_out(k)) for k in range(solver.n_out())]

    def solve(self, program: tuple[Array, ...]) -> tuple[Array, dict[str, Any]]:
        """Return what the solver found (n,) for the entries of a program, and its statistics."""
        for array, values in zip(self._arguments, program, strict=False):
            array[:] = values
        # Anew each time: the solver takes the places of its results away from the buffer.
        for k, array in enumerate(self._arguments):
            self._buffer.set_arg(k, array.data)
        for k, array in enumerate(self._results):
            self._buffer.set_res(k, array.data)
        self._run()
        return self._results[0].copy(), self._buffer.stats()


def _first_solved(attempts: Iterable[tuple[Array, dict[str, Any]]]) -> Array:
    """Return the first solution (n,) of attempts that succeeded; raise SolverError if none did."""
    status = ""
    for solution, stats in attempts:
        if stats["success"] and np.isfinite(solution).all():
            return solution
        status = str(stats["return_status"])
    raise SolverError(f"the quadratic program was not solved ({status})")


def _require_consistent(name: str, least: Array, largest: Array) -> None:
    """Raise SolverError unless some finite value lies between the bounds (n,) in each place."""
    is_possible = (least < np.inf) & (largest > -np.inf) & (least <= largest)
    if not is_possible.all():
        k = int(np.flatnonzero(~is_possible)[0])
        raise SolverError(
            f"the bounds of {name} {k} of the quadratic program contradict each other: "
            f"{least[k]:g} and {largest[k]:g}"
        )
