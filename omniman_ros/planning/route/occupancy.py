"""Occupancy of the route planner's lattice, as bit masks of headings ("words").

Each node has a word for each level of clearance. A set bit means that the robot at the node is
closer to an obstacle or the workspace's edge than the level allows: bit k stands for the heading k
and, if the robot covers the same area after half a revolution, for its opposite.
"""

import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.route.lattice import Lattice, Work
from omniman_ros.planning.route.problem import LEAST_ROOM, RouteProblem
from omniman_ros.surroundings.ellipses import inflated

Index = NDArray[np.intp]  #: Array of indices of nodes, headings, columns or rows
Words = NDArray[np.uint64]  #: Array of bit masks, one per node, with a bit for each heading
Mask = NDArray[np.bool_]  #: Array of flags

ONE = np.uint64(1)  #: Word whose first bit is set

#: Distance within which a tight start or goal lowers the margin [radii of the robot], which
#: suffices for the robot to leave it entirely.
EASED_RADII = 3.0
PIECE = 40_000  #: Approximate number of poses in each piece in which an obstacle is marked
#: Number of discs of one size from which they are marked together, with rounded offsets
CROWDED = 40
#: Number of different offsets of discs from their nodes above which they are rounded coarsely
MAX_KINDS = 200
#: Divisions of a lattice edge to which the offset of a disc from a node is first rounded
FINE_PARTS = 1000
#: Divisions of a lattice edge to which it is rounded if there are too many different offsets
COARSE_PARTS = 8


class HeadingOccupancy:
    """Words of all nodes of a lattice; empty until `fill` is done.

    Levels are those of `Rooms`, and a fifth one around a start or a goal whose gap, of both (2,)
    [m], is smaller than the margin.

    Attributes:
        words: (levels, nodes) words by the number of the node.
        full: Word of a node at which no heading is free.
    """

    def __init__(self, problem: RouteProblem, lattice: Lattice, room: Array) -> None:
        self._problem, self._lattice = problem, lattice
        region, rooms = lattice.region, problem.rooms
        tight = room < max(problem.margin, LEAST_ROOM)
        self._tight = lattice.ends[tight, :2]
        self._eased = float(0.5 * room[tight].min(initial=2.0 * rooms.floor))
        self._thresholds = np.array([*rooms.levels, self._eased][: 5 if tight.any() else 4])
        self._reach = float(self._thresholds.max())
        self.full = np.uint64((1 << lattice.bits) - 1)
        self.words: Words = np.zeros((len(self._thresholds), region.size), dtype=np.uint64)
        self._view = self.words.reshape(-1, region.rows, region.columns)

    def fill(self) -> Work:
        """Mark the states that are too close to an obstacle, the map or the workspace's edge."""
        problem, frame = self._problem, self._lattice.frame
        pairs = Pairs.of(problem.footprint, problem.obstacles)
        known = pairs.ellipses
        centers, angles = frame.own(known.centers), known.angles - frame.yaw
        for alike in _alike(pairs):
            box, axes = pairs.boxes.select(alike[0]), known.semi_axes[alike[0]]
            if len(alike) >= CROWDED and axes[0] == axes[1]:
                yield from self._stamp_discs(box, float(axes[0]), centers[alike])
                continue
            for center, angle in zip(centers[alike], angles[alike].tolist(), strict=True):
                yield from self._stamp(box, center, axes, angle)
        if problem.grid is not None:  # the robot cannot pass the cells at the boundary
            cells = frame.own(problem.cells)
            for box in problem.footprint.whole.each():
                yield from self._stamp_discs(box, problem.grid.radius, cells)
        self._bound()
        self._ease()
        least = self._view[0]
        for edge in (least[0], least[-1], least[:, 0], least[:, -1]):
            edge[...] = self.full
        yield self._lattice.region.size // 100

    def taken(self, nodes: Index, headings: Index) -> Mask:
        """Return (N,) bool: nodes (N,) and headings (N,) at which the robot is too close."""
        shift = (headings % self._lattice.bits).astype(np.uint64)
        result: Mask = (self.words[0, nodes] >> shift & ONE).astype(bool)
        return result

    def forbid(self, nodes: Index, headings: Index) -> None:
        """Remove states (N,) from the lattice."""
        bits = (headings % self._lattice.bits).astype(np.uint64)
        np.bitwise_or.at(self.words[0], nodes, ONE << bits)

    def floor(self, poses: Array) -> Array:
        """Return the least gaps (N,) [m] to keep at poses (N, 3) of the lattice."""
        least = self._problem.rooms.floor
        result = np.full(len(poses), least)
        for x, y in self._tight:
            near = np.hypot(poses[:, 0] - x, poses[:, 1] - y) < EASED_RADII * self._problem.radius
            result[near] = min(0.5 * self._eased, least)
        return result

    # ---- one obstacle -----------------------------------------------------------------------

    def _stamp(self, box: Rectangles, center: Array, axes: Array, angle: float) -> Work:
        """Mark an ellipse by its centre (2,), semi-axes (2,) and angle in the lattice's frame."""
        edge, region = self._lattice.frame.edge, self._lattice.region
        a, b = inflated(axes, self._far(box))
        c, s = math.cos(angle), math.sin(angle)
        extent = np.array([math.hypot(a * c, b * s), math.hypot(a * s, b * c)])
        low = np.ceil((center - extent) / edge).astype(np.intp) - region.first
        high = np.floor((center + extent) / edge).astype(np.intp) - region.first + 1
        low, high = np.maximum(low, 0), np.minimum(high, region.shape)
        if not (low < high).all():
            yield 5
            return
        # A large obstacle is marked a few rows at a time; an ellipse needs more work than a disc.
        effort = 1 if axes[0] == axes[1] else 4
        rows = max(1, PIECE // (effort * self._lattice.bits * int(high[0] - low[0])))
        for first in range(int(low[1]), int(high[1]), rows):
            last = min(first + rows, int(high[1]))
            nodes = np.array([[low[0], first], [high[0], last]])
            marks, work = self._marks(box, center, axes, angle, nodes)
            self._view[:, first:last, low[0] : high[0]] |= marks
            yield 50 + effort * work

    def _far(self, box: Rectangles) -> float:
        """Return the distance from base_link beyond which an obstacle marks nothing [m]."""
        return float(box.radius) + self._reach

    def _marks(
        self, box: Rectangles, center: Array, axes: Array, angle: float, nodes: Index
    ) -> tuple[Words, int]:
        """Return the words of an ellipse for some nodes, and the work that was done [expansions].

        Centre (2,) [m] and angle of the x axis are in the lattice's frame; `nodes` (2, 2) are
        column and row of the first node, and those after the last one. The words are (levels,
        rows, columns).
        """
        lattice, (low, high) = self._lattice, nodes
        edge, first = lattice.frame.edge, lattice.region.first
        x = edge * (first[0] + np.arange(low[0], high[0])) - center[0]
        y = edge * (first[1] + np.arange(low[1], high[1])) - center[1]
        c, s = math.cos(angle), math.sin(angle)
        u, v = c * x + s * y[:, None], c * y[:, None] - s * x
        a, b = inflated(axes, self._far(box))
        # A centred box contains a disc: within the axes plus its radius it touches the ellipse.
        inner = axes + 0.999 * float(box.half.min())
        within = (u / inner[0]) ** 2 + (v / inner[1]) ** 2 < float(not box.centre.any())
        ring = ~within & ((u / a) ** 2 + (v / b) ** 2 < 1.0)
        result: Words = np.zeros((len(self._thresholds), len(y), len(x)), dtype=np.uint64)
        result[:, within] = self.full
        gap = _gaps(u[ring], v[ring], lattice.heading_angles - angle, box, axes)
        for level, threshold in enumerate(self._thresholds):
            result[level, ring] = _packed(gap < threshold)
        return result, gap.size // 80

    # ---- many discs, such as the cells of a map ---------------------------------------------

    def _stamp_discs(self, box: Rectangles, radius: float, centers: Array) -> Work:
        """Mark discs of one radius [m], all with the same offset from a node together.

        Centres (N, 2) are in the lattice's frame.
        """
        edge, region = self._lattice.frame.edge, self._lattice.region
        reach = math.ceil((self._far(box) + radius) / edge) + 1
        corners, kind, shifts = yield from self._kinds(centers, reach)
        axes = np.array([radius, radius])
        nodes = np.array([[-reach, -reach], [reach + 1, reach + 1]])
        for number, shift in enumerate(shifts):
            center = edge * (shift + region.first)
            marks, work = self._marks(box, center, axes, 0.0, nodes)
            yield 50 + work
            yield from self._repeat(marks, corners[kind == number])

    def _kinds(
        self, centers: Array, reach: int
    ) -> Generator[int, None, tuple[Index, Index, Array]]:
        """Group the discs near the region by their offsets from the nodes.

        A disc marks nodes up to a reach of columns or rows. First column and row (N, 2) of these
        nodes and the number (N,) of its kind are returned, and the offsets (K, 2) of all kinds
        from a node [edges].
        """
        region = self._lattice.region
        place = centers / self._lattice.frame.edge - region.first
        base = np.floor(place + 1e-6)
        inside = ((base + reach >= 0) & (base - reach < region.shape)).all(axis=1)
        place, base = place[inside], base[inside]
        yield 20 + len(centers) // 6
        # Each offset becomes one number, which is exact if offsets repeat, otherwise rounded.
        for parts in (FINE_PARTS, COARSE_PARTS):
            shifts = np.round(parts * (place - base)).astype(np.intp)
            numbers = (FINE_PARTS + 1) * shifts[:, 0] + shifts[:, 1]
            kinds, kind = np.unique(numbers, return_inverse=True)
            yield 20 + len(centers) // 6
            if len(kinds) <= MAX_KINDS:
                break
        beside = np.stack(np.divmod(kinds, FINE_PARTS + 1), axis=1) / parts
        return base.astype(np.intp) - reach, kind.ravel(), beside

    def _repeat(self, marks: Words, corners: Index) -> Work:
        """Mark the same words (levels, size, size) from each first column and row (N, 2) on."""
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

    # ---- the workspace's edges, and tight ends ----------------------------------------------

    def _bound(self) -> None:
        """Mark everything beyond the workspace."""
        lattice, whole = self._lattice, self._problem.footprint.whole
        yaw = lattice.frame.yaw
        x_min, y_min, x_max, y_max = self._problem.workspace
        headings = lattice.heading_angles + yaw
        towards = [whole.support(0.5 * math.pi * quarter - headings) for quarter in range(4)]
        corner = lattice.frame.odom(np.array([[lattice.x[0], lattice.y[0], 0.0]]))[0]
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = lattice.x - lattice.x[0], (lattice.y - lattice.y[0])[:, None]
        sides = (
            (corner[0] - x_min, c, -s, towards[2]),
            (x_max - corner[0], -c, s, towards[0]),
            (corner[1] - y_min, s, c, towards[3]),
            (y_max - corner[1], -s, -c, towards[1]),
        )
        for base, by_x, by_y, extents in sides:
            inward = base + by_x * dx + by_y * dy
            if inward.min() > extents.max() + self._thresholds.max():
                continue
            order = np.argsort(extents)
            bits = ONE << order.astype(np.uint64)
            # The headings with the n least extents fit, the others do not.
            table = np.append(np.cumsum(bits[::-1])[::-1], np.uint64(0))
            for level, threshold in enumerate(self._thresholds):
                fit = np.searchsorted(extents[order], inward - threshold, side="right")
                self._view[level] |= table[fit]

    def _ease(self) -> None:
        """Lower the gap to keep around a tight start or goal."""
        for x, y in self._tight:
            distance = np.hypot(self._lattice.x - x, self._lattice.y[:, None] - y)
            near = distance < EASED_RADII * self._problem.radius
            self._view[0][near] = self._view[4][near]


def _alike(pairs: Pairs) -> list[Index]:
    """Return the numbers of the pairs that have the same box, and the same axes of the ellipse."""
    rows = np.broadcast_to(pairs.boxes.rows, (len(pairs), 5))
    each = np.column_stack([pairs.ellipses.semi_axes, rows]).round(9)
    _, kind = np.unique(each, axis=0, return_inverse=True)
    order = np.argsort(kind.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(kind.ravel()))
    return np.split(order, ends[:-1]) if len(order) else []


def _packed(bits: Mask) -> Words:
    """Return words (N,) of bits (N, n), n <= 64, the first being the least significant."""
    wide = np.zeros((len(bits), 64), dtype=bool)
    wide[:, : bits.shape[1]] = bits
    joined = np.packbits(wide, axis=1, bitorder="little")
    return joined.view("<u8")[:, 0].astype(np.uint64)


def _gaps(u: Array, v: Array, headings: Array, box: Rectangles, axes: Array) -> Array:
    """Return gaps (N, n) [m] from a box at u, v (N,) in headings (n,) to an ellipse at zero."""
    if axes[0] == axes[1]:
        cos, sin = np.cos(headings + box.yaw), np.sin(headings + box.yaw)
        ahead, beside = box.own_centre
        forward = np.abs(np.outer(u, cos) + np.outer(v, sin) + ahead) - box.half[0]
        lateral = np.abs(np.outer(v, cos) - np.outer(u, sin) + beside) - box.half[1]
        gap: Array = np.hypot(np.maximum(forward, 0.0), np.maximum(lateral, 0.0)) - axes[0]
        return gap
    count = len(headings)
    poses = np.column_stack([np.repeat(u, count), np.repeat(v, count), np.tile(headings, len(u))])
    center = np.zeros((1, 1, 2))
    return box_gap(poses, box, center, axes[None, None], np.zeros(1)).reshape(-1, count)
