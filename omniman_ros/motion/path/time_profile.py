"""Minimum time along a curve within limits on speed and acceleration.

The path is parametrised time-optimally by two passes over cells of the curve (backward: the
largest speed from which the rest of the curve can still be driven; forward: the largest speed that
can be reached). In a cell u'' is constant, so u'^2 is linear in u, and on a :class:`Curve`, whose
q'' is constant there, the acceleration q' u'' + q'' u'^2 is linear in u: its length is largest at
an end of the cell, and limits that hold at both ends of each cell hold everywhere.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.curve import MIN_PIECE, Curve

#: Returns the largest u' (k,) for q (k, d) and q' (k, d), beyond the limits of axis groups.
#:
#: It is evaluated at the ends of cells only; between them it may be exceeded by its change there.
SpeedCap = Callable[[Array, Array], Array]

CELL = 0.02  #: Length of the longest cell [s of u]
MAX_CELLS = 20_000  #: Approximate largest number of cells; the cells of longer curves are longer
#: Smallest number of cells of a piece, unless it is short and has neighbours
MIN_CELLS_PER_PIECE = 4
BISECTIONS = 30  #: Number of bisections that find the largest speed at the start of a cell
ROUND_OFF = 1e-6  #: Relative error of u'^2 that is accepted if it comes from another profile

#: Products for one limit at one end of a cell: `|q'|^2, q'.q'', |q''|^2, limit^2`
Row = tuple[float, float, float, float]


class TimeProfile:
    """Speed along a curve: u'^2 at nodes, u'' constant between them.

    The `times` (n + 1,) are from the start [s].

    Args:
        nodes: (n + 1,) u at the nodes [s].
        squares: (n + 1,) u'^2 at the nodes.
    """

    def __init__(self, nodes: Array, squares: Array) -> None:
        self.nodes, self.squares = nodes, squares
        rates = np.sqrt(squares)
        spans = np.diff(nodes)
        self.times: Array = np.concatenate(
            [[0.0], np.cumsum(2.0 * spans / (rates[:-1] + rates[1:]))]
        )
        self._curvature = 0.5 * np.diff(squares) / spans

    @property
    def duration(self) -> float:
        """Time from the start to rest [s]."""
        return float(self.times[-1])

    def at(self, time: Array) -> tuple[Array, Array]:
        """Return u [s] and u' (k,) at times (k,) [s]; at rest after the end."""
        i = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        t = np.clip(time - self.times[i], 0.0, None)
        rate = np.sqrt(self.squares[i])
        u = self.nodes[i] + t * (rate + 0.5 * t * self._curvature[i])
        over = time >= self.duration
        speed = np.where(over, 0.0, np.maximum(rate + t * self._curvature[i], 0.0))
        return np.where(over, self.nodes[-1], np.minimum(u, self.nodes[i + 1])), speed


class TimeProfiler:
    """Computes time profiles of curves.

    Args:
        groups: Limits; the curve's parameter already contains the velocity limits.
        cap: Bound on u' at points of the curve besides 1; None if there is none.
    """

    def __init__(self, groups: Sequence[AxisGroup], cap: SpeedCap | None = None) -> None:
        self._groups = groups
        self._cap = cap

    def fastest(self, curve: Curve, start: float = 0.0, rate: float = 0.0) -> TimeProfile | None:
        """Return the fastest profile from u = start, u' = rate to rest at the curve's end.

        The result is None if the curve cannot be driven from that rate.
        """
        cells = _Cells(curve, start, self._groups, self._cap)
        most = cells.backward()
        if rate * rate > most[0] * (1.0 + ROUND_OFF) + ROUND_OFF**2:
            return None
        return TimeProfile(cells.nodes, np.array(cells.forward(most, min(rate * rate, most[0]))))

    def quickest_stop(self, curve: Curve, start: float, rate: float) -> TimeProfile:
        """Return the profile from u = start, u' = rate to rest as soon as the limits allow."""
        cells = _Cells(curve, start, self._groups, self._cap)
        return cells.brake(rate * rate)


class _Cells:
    def __init__(
        self, curve: Curve, start: float, groups: Sequence[AxisGroup], cap: SpeedCap | None
    ) -> None:
        self.nodes = _nodes(curve, start)
        slopes = curve.slope(self.nodes)
        bends = curve.bends[curve.piece(0.5 * (self.nodes[1:] + self.nodes[:-1]))]
        spans = np.diff(self.nodes)
        self._spans = spans.tolist()
        caps = np.ones(len(self.nodes))
        if cap is not None:
            caps = np.minimum(cap(curve.at(self.nodes), slopes), 1.0) ** 2
            if start > 0.0:
                # The start is inside a cell, where a profile keeps the bound at the ends only.
                caps[0] = 1.0
        rows, reach, tops = [], np.full(len(spans), np.inf), np.full(len(spans), np.inf)
        straight = ~(np.abs(bends) > 0.0).any(axis=1)
        for group in groups:
            part = np.array(group.columns)
            bend, limit = bends[:, part], group.acceleration
            for slope in (slopes[:-1, part], slopes[:-1, part] + 3.0 * spans[:, None] * bend):
                row = _products(slope, bend, limit)
                rows.append(row)
                tops = np.minimum(tops, _top(row))
                with np.errstate(divide="ignore"):
                    reach = np.minimum(reach, limit / np.sqrt(row[:, 0]))
        self._caps = caps.tolist()
        self._tops = tops.tolist()
        self._reach = np.where(straight, reach, -1.0).tolist()
        packed = np.stack(rows, axis=1).tolist()
        self._rows: list[list[Row]] = [] if straight.all() else packed

    def backward(self) -> list[float]:
        """Return the largest u'^2 (n + 1 values) from which rest at the end can be reached."""
        most = [0.0] * len(self._caps)
        for i in range(len(self._spans) - 1, -1, -1):
            after, double = most[i + 1], 2.0 * self._spans[i]
            if self._reach[i] >= 0.0:
                most[i] = min(self._caps[i], after + double * self._reach[i])
                continue
            top = min(self._caps[i], self._tops[i])
            if not self._possible(i, top, after, double):
                low, high = 0.0, top
                for _ in range(BISECTIONS):
                    middle = 0.5 * (low + high)
                    if self._possible(i, middle, after, double):
                        low = middle
                    else:
                        high = middle
                top = low
            most[i] = top
        return most

    def forward(self, most: list[float], square: float) -> list[float]:
        """Return the largest u'^2 (n + 1 values) that can be reached from the first."""
        squares = [square]
        for i, span in enumerate(self._spans):
            rate = self._reach[i] if self._reach[i] >= 0.0 else self._range(i, square)[1]
            square = max(min(most[i + 1], square + 2.0 * span * rate), 0.0)
            squares.append(square)
        return squares

    def brake(self, square: float) -> TimeProfile:
        """Return the profile of the hardest braking from u'^2 at the first node on."""
        squares, nodes = [square], [float(self.nodes[0])]
        for i, span in enumerate(self._spans):
            rate = -self._reach[i] if self._reach[i] >= 0.0 else self._range(i, square)[0]
            after = min(square + 2.0 * span * rate, self._caps[i + 1])
            if after <= 0.0:
                nodes.append(nodes[-1] + max(-0.5 * square / rate, 1e-12))
                squares.append(0.0)
                break
            square = after
            nodes.append(float(self.nodes[i + 1]))
            squares.append(square)
        squares[-1] = 0.0
        return TimeProfile(np.array(nodes), np.array(squares))

    def _possible(self, i: int, square: float, after: float, double: float) -> bool:
        """Return whether cell i, of half the length `double`, can lead from u'^2 to `after`."""
        low, high = self._range(i, square)
        return low <= high and square + double * low <= after and square + double * high >= 0.0

    def _range(self, i: int, square: float) -> tuple[float, float]:
        """Return the range of u'' in cell i if it starts with u'^2; empty if low > high."""
        low, high = -math.inf, math.inf
        for slope2, mixed, bend2, limit2 in self._rows[i]:
            spare = limit2 - bend2 * square * square
            if slope2 <= 1e-12 * limit2:
                if spare < 0.0:
                    return math.inf, -math.inf
                continue
            middle = mixed * square
            root = middle * middle + slope2 * spare
            if root < 0.0:
                # At the limit of what is possible, only one u'' is left.
                if root < -1e-9 * slope2 * limit2:
                    return math.inf, -math.inf
                root = 0.0
            root = math.sqrt(root)
            low = max(low, (-middle - root) / slope2)
            high = min(high, (-middle + root) / slope2)
        return low, high


def _nodes(curve: Curve, start: float) -> Array:
    """Return the nodes (n + 1,) of cells: all knots after the start, and equal parts between them.

    Except for the first node they are the same for every start: what is possible in a cell is
    possible in a part of it, so that a profile can be left in the middle of a cell.
    """
    spans = np.diff(curve.knots)
    cell = max(CELL, curve.end / MAX_CELLS)
    parts = np.ceil(spans / cell).astype(int)
    parts = np.maximum(
        parts,
        np.where(
            (spans < 0.25 * cell) & (len(spans) > MIN_CELLS_PER_PIECE), 1, MIN_CELLS_PER_PIECE
        ),
    )
    ends = np.cumsum(parts)
    inside = np.arange(ends[-1]) - np.repeat(ends - parts, parts)
    nodes = np.repeat(curve.knots[:-1], parts) + inside * np.repeat(spans / parts, parts)
    later = np.append(nodes[nodes > start + MIN_PIECE], curve.knots[-1])
    if len(later) == 1:  # a profile from rest to rest needs a node in between
        later = np.array([0.5 * (start + later[0]), later[0]])
    return np.concatenate([[start], later])


def _products(slope: Array, bend: Array, limit: float) -> Array:
    rows = [(slope * slope).sum(1), (slope * bend).sum(1), (bend * bend).sum(1)]
    return np.column_stack([*rows, np.full(len(slope), limit * limit)])


def _top(row: Array) -> Array:
    """Return the largest u'^2 for which the acceleration limit leaves any u''."""
    slope2, mixed, bend2, limit2 = row.T
    cross2 = slope2 * bend2 - mixed * mixed  # |q' x q''|^2
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.sqrt(limit2 * slope2 / cross2)
        without_slope = np.sqrt(limit2 / bend2)
    top = np.where(cross2 > 1e-12 * slope2 * bend2, top, np.inf)
    return np.where((slope2 <= 1e-12 * limit2) & (bend2 > 0.0), without_slope, top)
