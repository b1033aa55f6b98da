"""Casadi functions that read and write arrays in place."""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from omniman_ros.core.arrays import Array

CHECKS = 4  #: Number of random inputs on which two functions are compared


class InPlaceFunction:
    """A function whose arguments and results are arrays that stay, without conversions.

    All arguments and results are given, as some solvers crash without. They are the entries of the
    function's matrices, column by column.

    Args:
        results: Arrays for the first results, such as the arguments of another function.
        arguments: Arrays for the first arguments.

    Attributes:
        arguments: An array (k,) for each argument; write them before a call.
        results: An array (k,) for each result.
    """

    def __init__(
        self,
        function: ca.Function,
        results: Sequence[Array] = (),
        arguments: Sequence[Array] = (),
    ) -> None:
        # The stubs of casadi have the arguments of another language.
        buffer: tuple[Any, Any] = function.buffer()
        self._buffer, self._run = buffer
        taken, given = (
            [size(k) for k in range(count)]
            for size, count in (
                (function.nnz_in, function.n_in()),
                (function.nnz_out, function.n_out()),
            )
        )
        self.arguments = [*arguments, *map(np.zeros, taken[len(arguments) :])]
        self.results = [*results, *map(np.zeros, given[len(results) :])]
        assert [*map(len, self.arguments), *map(len, self.results)] == [*taken, *given]
        self._places = [array.data for array in self.arguments], [a.data for a in self.results]

    def __call__(self) -> None:
        """Compute the results."""
        # Anew each time: a solver takes the places of its results away from the buffer.
        arguments, results = self._places
        for k, place in enumerate(arguments):
            self._buffer.set_arg(k, place)
        for k, place in enumerate(results):
            self._buffer.set_res(k, place)
        self._run()

    def stats(self) -> dict[str, Any]:
        """Return the statistics of a solver's last call."""
        found: dict[str, Any] = self._buffer.stats()
        return found


def is_same(function: ca.Function, other: ca.Function) -> bool:
    """Return whether two functions return the same on random inputs, to the last bit."""
    random = np.random.default_rng(1)
    first, second = InPlaceFunction(function), InPlaceFunction(other)
    for _ in range(CHECKS):
        for mine, theirs in zip(first.arguments, second.arguments, strict=True):
            mine[:] = random.uniform(0.1, 1.0, mine.shape)
            theirs[:] = mine
        first()
        second()
        pairs = zip(first.results, second.results, strict=True)
        if not all(np.array_equal(mine, theirs, equal_nan=True) for mine, theirs in pairs):
            return False
    return True
