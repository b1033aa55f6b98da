"""Where the box is free on a lattice: words of headings, a node and a level of room each.

A bit of a word says that the box at the node is closer to something than the level allows: bit k
stands for the heading k and, as the box looks the same after half a turn, for its opposite.
"""

import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import inflated
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route_lattice import Lattice, Work
from omniman_ros.planning.route_problem import LEAST_ROOM, RouteProblem
from omniman_ros.planning.separation import box_gap

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Words = NDArray[np.uint64]
Mask = NDArray[np.bool_]

ONE = np.uint64(1)

EASED = 3.0
"""Within so many radii of the box a tight start or goal eases the margin: it can get all out."""
PIECE = 40_000
"""An obstacle is marked in pieces of about so many poses."""
KINDS = 200
"""More ways than this in which cells lie among the nodes are rounded coarsely."""
EXACTLY, COARSELY = 1000, 8
"""Parts of an edge that the way in which a cell lies among the nodes is rounded to."""


class Marks:
    """Words of all nodes of a lattice; empty until they are filled.

    Levels are those of `Rooms`, and where the start or the goal is closer to something than the
    margin, a fifth for what is eased around it.

    Args:
        problem: What stands, and what is kept from it.
        lattice: The nodes.
        room: (2,) gaps at the start and the goal [m].

    Attributes:
        words: (levels, nodes) by the node's number.
        full: The word of a node at which no heading is free.
    """

    def __init__(self, problem: RouteProblem, lattice: Lattice, room: Array) -> None:
        self._problem, self._lattice = problem, lattice
        region, rooms = lattice.region, problem.rooms
        tight = room < max(problem.margin, LEAST_ROOM)
        self._tight = lattice.ends[tight, :2]
        self._eased = float(0.5 * room[tight].min(initial=2.0 * rooms.floor))
        self._thresholds = np.array([*rooms.levels, self._eased][: 5 if tight.any() else 4])
        self._far = problem.radius + float(self._thresholds.max())
        self.full = np.uint64((1 << lattice.bits) - 1)
        self.words: Words = np.zeros((len(self._thresholds), region.size), dtype=np.uint64)
        self._view = self.words.reshape(-1, region.rows, region.columns)

    def fill(self) -> Work:
        """Mark all there is."""
        problem, frame = self._problem, self._lattice.frame
        known = problem.obstacles
        centers, angles = frame.own(known.centers), known.angles - frame.yaw
        for center, axes, angle in zip(centers, known.semi_axes, angles, strict=True):
            yield from self._stamp(center, axes, float(angle))
        if problem.grid is not None:  # nothing gets past the cells at the boundary to those behind
            yield from self._stamp_cells(problem.grid)
        self._bound()
        self._ease()
        least = self._view[0]
        for edge in (least[0], least[-1], least[:, 0], least[:, -1]):
            edge[...] = self.full
        yield self._lattice.region.size // 100

    def taken(self, nodes: Index, headings: Index) -> Mask:
        """Whether the box is too close to something (N,) at nodes (N,) and headings (N,)."""
        shift = (headings % self._lattice.bits).astype(np.uint64)
        result: Mask = (self.words[0, nodes] >> shift & ONE).astype(bool)
        return result

    def forbid(self, nodes: Index, headings: Index) -> None:
        """Take states (N,) out of the lattice."""
        bits = (headings % self._lattice.bits).astype(np.uint64)
        np.bitwise_or.at(self.words[0], nodes, ONE << bits)

    def floor(self, poses: Array) -> Array:
        """Gaps (N,) that are kept at least at poses (N, 3) of the lattice [m]."""
        least = self._problem.rooms.floor
        result = np.full(len(poses), least)
        for x, y in self._tight:
            near = np.hypot(poses[:, 0] - x, poses[:, 1] - y) < EASED * self._problem.radius
            result[near] = min(0.5 * self._eased, least)
        return result

    # ---- one obstacle -----------------------------------------------------------------------

    def _stamp(self, center: Array, axes: Array, angle: float) -> Work:
        """Mark what an ellipse takes: its centre (2,), semi-axes (2,) and angle on the lattice."""
        edge, region = self._lattice.frame.edge, self._lattice.region
        a, b = inflated(axes, self._far)
        c, s = math.cos(angle), math.sin(angle)
        extent = np.array([math.hypot(a * c, b * s), math.hypot(a * s, b * c)])
        low = np.ceil((center - extent) / edge).astype(np.intp) - region.first
        high = np.floor((center + extent) / edge).astype(np.intp) - region.first + 1
        low, high = np.maximum(low, 0), np.minimum(high, region.shape)
        if not (low < high).all():
            yield 5
            return
        # Row by row where it is large; what is known of an ellipse costs more than of a disc.
        dear = 1 if axes[0] == axes[1] else 4
        rows = max(1, PIECE // (dear * self._lattice.bits * int(high[0] - low[0])))
        for first in range(int(low[1]), int(high[1]), rows):
            last = min(first + rows, int(high[1]))
            marks, work = self._marks(
                center, axes, angle, np.array([low[0], first]), np.array([high[0], last])
            )
            self._view[:, first:last, low[0] : high[0]] |= marks
            yield 50 + dear * work

    def _marks(
        self, center: Array, axes: Array, angle: float, low: Index, high: Index
    ) -> tuple[Words, int]:
        """What an ellipse takes of some nodes.

        Args:
            center: (2,) on the lattice [m].
            axes: (2,) semi-axes [m].
            angle: Of its x axis on the lattice [rad].
            low: (2,) column and row of the first node.
            high: (2,) column and row after those of the last one.

        Returns:
            Words (levels, rows, columns), and the work that it was.
        """
        lattice, half = self._lattice, self._problem.half
        edge, first = lattice.frame.edge, lattice.region.first
        x = edge * (first[0] + np.arange(low[0], high[0])) - center[0]
        y = edge * (first[1] + np.arange(low[1], high[1])) - center[1]
        c, s = math.cos(angle), math.sin(angle)
        u, v = c * x + s * y[:, None], c * y[:, None] - s * x
        a, b = inflated(axes, self._far)
        # The box holds a disc: the ellipse of the axes plus its radius lies in what it touches.
        inner = axes + 0.999 * half.min()
        within = (u / inner[0]) ** 2 + (v / inner[1]) ** 2 < 1.0
        ring = ~within & ((u / a) ** 2 + (v / b) ** 2 < 1.0)
        result: Words = np.zeros((len(self._thresholds), len(y), len(x)), dtype=np.uint64)
        result[:, within] = self.full
        gap = _gaps(u[ring], v[ring], lattice.turns - angle, half, axes)
        for level, threshold in enumerate(self._thresholds):
            result[level, ring] = _packed(gap < threshold)
        return result, gap.size // 80

    # ---- the cells of a map -----------------------------------------------------------------

    def _stamp_cells(self, grid: GridMap) -> Work:
        """Mark what the occupied cells take; those that lie alike among the nodes at once."""
        edge, region = self._lattice.frame.edge, self._lattice.region
        reach = math.ceil((self._far + grid.radius) / edge) + 1
        corners, kind, shifts = yield from self._kinds(reach)
        axes = np.array([grid.radius, grid.radius])
        low = np.array([-reach, -reach])
        for number, shift in enumerate(shifts):
            center = edge * (shift + region.first)
            marks, work = self._marks(center, axes, 0.0, low, low + 2 * reach + 1)
            yield 50 + work
            yield from self._repeat(marks, corners[kind == number])

    def _kinds(self, reach: int) -> Generator[int, None, tuple[Index, Index, Array]]:
        """How the occupied cells lie among the nodes, as far as they matter.

        Args:
            reach: Nodes so many columns or rows away are still marked.

        Returns:
            First column and row (N, 2) of the nodes that a cell marks, the number (N,) of its
            kind, and how far cells of each kind (K, 2) are beside a node, in edges.
        """
        region, cells = self._lattice.region, self._problem.cells
        place = self._lattice.frame.own(cells) / self._lattice.frame.edge - region.first
        base = np.floor(place + 1e-6)
        inside = ((base + reach >= 0) & (base - reach < region.shape)).all(axis=1)
        place, base = place[inside], base[inside]
        yield 20 + len(cells) // 6
        # As one number each: exactly where they repeat, else nearly.
        for parts in (EXACTLY, COARSELY):
            shifts = np.round(parts * (place - base)).astype(np.intp)
            numbers = (EXACTLY + 1) * shifts[:, 0] + shifts[:, 1]
            kinds, kind = np.unique(numbers, return_inverse=True)
            yield 20 + len(cells) // 6
            if len(kinds) <= KINDS:
                break
        beside = np.stack(np.divmod(kinds, EXACTLY + 1), axis=1) / parts
        return base.astype(np.intp) - reach, kind.ravel(), beside

    def _repeat(self, marks: Words, corners: Index) -> Work:
        """Mark the same (levels, size, size) from each first column and row (N, 2) on."""
        last, size = self._lattice.region.shape, marks.shape[1]
        whole = ((corners >= 0) & (corners + size <= last)).all(axis=1)
        for k, (x, y) in enumerate(corners[whole].tolist()):
            self._view[:, y : y + size, x : x + size] |= marks
            if k % 50 == 49:
                yield 200
        for x, y in corners[~whole].tolist():
            x0, y0 = max(x, 0), max(y, 0)
            x1, y1 = np.minimum([x + size, y + size], last).tolist()
            self._view[:, y0:y1, x0:x1] |= marks[:, y0 - y : y1 - y, x0 - x : x1 - x]
            yield 5

    # ---- the edges, and what is tight -------------------------------------------------------

    def _bound(self) -> None:
        """Mark what is beyond the workspace."""
        lattice, half = self._lattice, self._problem.half
        yaw = lattice.frame.yaw
        x_min, y_min, x_max, y_max = self._problem.workspace
        turned = lattice.turns + yaw
        cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
        along_x, along_y = half[0] * cos + half[1] * sin, half[0] * sin + half[1] * cos
        corner = lattice.frame.odom(np.array([[lattice.x[0], lattice.y[0], 0.0]]))[0]
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = lattice.x - lattice.x[0], (lattice.y - lattice.y[0])[:, None]
        sides = (
            (corner[0] - x_min, c, -s, along_x), (x_max - corner[0], -c, s, along_x),
            (corner[1] - y_min, s, c, along_y), (y_max - corner[1], -s, -c, along_y),
        )  # fmt: skip
        for base, by_x, by_y, extents in sides:
            inward = base + by_x * dx + by_y * dy
            if inward.min() > extents.max() + self._thresholds.max():
                continue
            order = np.argsort(extents)
            bits = ONE << order.astype(np.uint64)
            # Of the n nearest to fit, the others don't.
            table = np.append(np.cumsum(bits[::-1])[::-1], np.uint64(0))
            for level, threshold in enumerate(self._thresholds):
                fit = np.searchsorted(extents[order], inward - threshold, side="right")
                self._view[level] |= table[fit]

    def _ease(self) -> None:
        """Around a tight start or goal less room is kept."""
        for x, y in self._tight:
            away = np.hypot(self._lattice.x - x, self._lattice.y[:, None] - y)
            near = away < EASED * self._problem.radius
            self._view[0][near] = self._view[4][near]


def _packed(bits: Mask) -> Words:
    """Words (N,) of bits (N, n), n <= 64, the first the least."""
    wide = np.zeros((len(bits), 64), dtype=bool)
    wide[:, : bits.shape[1]] = bits
    joined = np.packbits(wide, axis=1, bitorder="little")
    return joined.view("<u8")[:, 0].astype(np.uint64)


def _gaps(u: Array, v: Array, headings: Array, half: Array, axes: Array) -> Array:
    """Gaps (N, n) from the box to an ellipse that it is outside of [m].

    Args:
        u: (N,) of the box along the ellipse's own x axis [m].
        v: (N,) along its y axis [m].
        headings: (n,) of the box as seen from these [rad].
        half: (2,) half length and half width of the box [m].
        axes: (2,) semi-axes [m].
    """
    if axes[0] == axes[1]:
        cos, sin = np.cos(headings), np.sin(headings)
        ahead = np.abs(np.outer(u, cos) + np.outer(v, sin)) - half[0]
        aside = np.abs(np.outer(v, cos) - np.outer(u, sin)) - half[1]
        gap: Array = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0)) - axes[0]
        return gap
    count = len(headings)
    poses = np.column_stack([np.repeat(u, count), np.repeat(v, count), np.tile(headings, len(u))])
    center = np.zeros((1, 1, 2))
    return box_gap(poses, half, center, axes[None, None], np.zeros(1)).reshape(-1, count)
