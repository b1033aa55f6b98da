"""Choice of what a test's parameter is tried with in the suite and in the exhaustive tier."""

from collections.abc import Iterable
from typing import Any

import pytest


def representative(values: Iterable[Any], every: int = 5) -> list[Any]:
    """Mark all but each `every`-th value of a test's parameter as exhaustive, beginning at 0."""
    return [
        value if k % every == 0 else pytest.param(value, marks=pytest.mark.exhaustive)
        for k, value in enumerate(values)
    ]


def exhaustive(*values: Any) -> Any:
    """Mark a value of a test's parameters, or one value for each of them, as exhaustive."""
    return pytest.param(*values, marks=pytest.mark.exhaustive)
