"""Limits of the demo's figures."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Bound(Enum):
    """How a figure is compared with its limit; the values are the words of a report."""

    AT_MOST = "at most"
    AT_LEAST = "at least"
    ABOVE = "above"


@dataclass(frozen=True)
class Limit:
    """A limit of one figure of the demo's result.

    Attributes:
        figure: Keys of the figure in the result, separated by dots. Where a key holds a list,
            the limit applies to each of its items.
        name: Name of the quantity and its unit, for reports.
        value: The limit, in that unit.
        bound: The side of the limit on which the figure must be. If the limit is a maximum, it
            applies to the figure's magnitude.
    """

    figure: str
    name: str
    value: float
    bound: Bound = Bound.AT_MOST

    def holds(self, value: float) -> bool:
        """Return whether a value is within the limit; NaN never is."""
        if self.bound is Bound.AT_MOST:
            return abs(value) <= self.value
        return value >= self.value if self.bound is Bound.AT_LEAST else value > self.value

    def violations(self, result: Mapping[str, Any]) -> list[str]:
        """Return a sentence for each value in the result that is beyond the limit.

        Args:
            result: Figures by section. A figure that is missing violates nothing.
        """
        return [
            f"{self.name}: {value:.3g}, {self.bound.value} {self.value:g}"
            for value in _values(result, self.figure.split("."))
            if not self.holds(value)
        ]


def violations(result: Mapping[str, Any], limits: Iterable[Limit]) -> list[str]:
    """Return a sentence for each figure of the result that is beyond its limit."""
    return [text for limit in limits for text in limit.violations(result)]


def _values(item: Any, keys: list[str]) -> Iterator[float]:
    """Yield the values under the keys, through lists and mappings."""
    if isinstance(item, list):
        for inner in item:
            yield from _values(inner, keys)
    elif not keys:
        yield item
    elif keys[0] in item:
        yield from _values(item[keys[0]], keys[1:])
