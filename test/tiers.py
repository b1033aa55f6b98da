"""Choice of what a test's parameter is tried with in the suite and in the exhaustive tier."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import pytest


def representative(values: Iterable[Any], every: int = 5) -> list[Any]:
    """Mark all but each `every`-th value of a test's parameter as exhaustive, beginning at 0."""
    return [
        value if k % every == 0 else pytest.param(value, marks=pytest.mark.exhaustive)
        for k, value in enumerate(values)
    ]


def combinations(*axes: Sequence[Any]) -> list[Any]:
    """Return all combinations of the values of several parameters of a test.

    The suite tries each value of each parameter at least once, with as few combinations as that
    takes; all others are marked as exhaustive.
    """
    count = max(map(len, axes))
    chosen = {tuple(k % len(axis) for axis in axes) for k in range(count)}
    return [
        pytest.param(
            *(axis[k] for axis, k in zip(axes, indices, strict=True)),
            marks=() if indices in chosen else pytest.mark.exhaustive,
        )
        for indices in itertools.product(*(range(len(axis)) for axis in axes))
    ]


def exhaustive(*values: Any) -> Any:
    """Mark a value of a test's parameters, or one value for each of them, as exhaustive."""
    return pytest.param(*values, marks=pytest.mark.exhaustive)
