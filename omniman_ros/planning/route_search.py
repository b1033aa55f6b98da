"""Search of a route over (x, y, heading) around everything that stands, in slices of time.

The floor is a lattice of nodes. A word a node and level of room says at which headings the box
there is closer to an obstacle than that: bit k stands for the heading k, and, as the box looks
the same after half a turn, for its opposite. Over the nodes at which any heading is free the
cost to the goal is found first (2-D); it guides the search over (x, y, heading), which finds the
same whatever the slices. What it finds is checked and straightened with exact gaps.
"""

import heapq
import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.planning.ellipses import Ellipses, inflated
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route import Clearance, Route, along, durations, refined, straight
from omniman_ros.planning.separation import Workspace, box_gap, outside_by

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.intp]
Words = NDArray[np.uint64]
Mask = NDArray[np.bool_]
Work = Generator[int, None, None]
"""Work in pieces; each says how much it was, in expansions of a node."""

UNLIMITED: Workspace = (-1e3, -1e3, 1e3, 1e3)

LEAST_SHARE = 0.75
"""Of the margin is kept at the nodes at least: routes may be so tight where they must ..."""
FLOOR_SHARE = 0.5
"""... and on the way between the nodes so much of it."""
LEAST_ROOM = 1e-3
"""Gap below which the box counts as touching, without any margin [m]."""
ROOM = (0.05, 0.15)
"""Gaps beyond the margin below which a route is dearer [m]."""
FACTORS = np.array([1.0, 1.25, 1.75, 3.0], dtype=np.float32)
"""What time costs, by how many of the gaps margin, margin + ROOM a node falls short of."""
TURNING = 0.1
"""What a turn costs beside the time, as a share of the time that it takes."""
WEIGHT, HASTE, LARGEST_WEIGHT = 1.3, 3e-6, 4.0
"""Of the cost to go against the cost so far in the order of the search: above 1 it is quicker, and
not quite the best way; by how much it grows with each expansion, and its limit."""
BAND = 0.1
"""States whose order differs by less than this are of one rank [s]."""
BATCH, LARGEST_BATCH = 64, 1024
"""States that are expanded together, at first and at most."""
GROWTH = 50
"""Expansions by which a batch grows by one: what is not found soon needs a wide search."""
DOUBT = 20_000
"""Expansions after which it is checked that there is a way at all."""
NEAR = 2.5
"""Start and goal are joined to nodes within so many edges of the lattice, and headings."""
EASED = 3.0
"""Within so many radii of the box a tight start or goal eases the margin: it can get all out."""
SLOT = 0.1
"""A start or goal with less room may stand in a slot [m]: lattices along it are tried."""
KINDS = 200
"""More ways than this in which cells lie among the nodes are rounded to an eighth of an edge."""
PAD = 2.0
"""Room around start and goal that is searched first [m]; then twice that, and so on."""
MOST_NODES = 4_000_000
"""A lattice has at most so many nodes."""
RETRIES = 40
"""So often a route that is too tight between two nodes is sought anew without those."""
ASTRAY = 0.2
"""A start may be so much outside of the workspace [m]."""
WORSE = 0.003
"""A straight line may be dearer by this share than the path that it replaces."""
PIECE = 40_000
"""An obstacle is marked in pieces of about so many poses."""
NODES = 20_000
"""So many nodes are looked at at once."""
PART = 50
"""So many poses of a path are checked at once."""
FIRST_LOOKS = 16
"""So many poses of a line are looked at before all of them."""
ONE = np.uint64(1)


class RouteSearch:
    """Search from a pose to a pose, a slice at a time.

    Obstacles stand where they are at their time. A start or a goal that is closer to one than the
    margin is left and reached with what room there is. A start that is outside of the workspace
    by less than ASTRAY widens it by that.

    Args:
        start: (3,) in odom [m, m, rad].
        goal: (3,) in odom [m, m, rad], its heading on any branch.
        half: (2,) half length and half width of the box [m].
        margin: Gap kept around the box where there is room; never less than FLOOR_SHARE of it,
            but near a start or goal that has less [m].
        speeds: Largest v and w [m/s, rad/s].
        obstacles: All that stand.
        grid: A map, if there is one; the lattice is along its axes.
        workspace: (x_min, y_min, x_max, y_max) in odom where the box must stay [m].
        resolution: Edge of the lattice [m], or less, to fit the map's cells.
        headings: Headings a turn, even, up to 120. Where no way is found, both are made finer by
            two once, headings up to 120.

    Attributes:
        route: What was found, or None.
        finished: Whether there is nothing more to do.
        reason: Why nothing was found, or empty.
        worked: What was done, in expansions.

    Raises:
        InputError: A value is not finite or out of its range.
    """

    def __init__(
        self,
        start: Array,
        goal: Array,
        half: Array,
        margin: float,
        speeds: tuple[float, float],
        obstacles: Ellipses | None = None,
        grid: GridMap | None = None,
        workspace: Workspace = UNLIMITED,
        resolution: float = 0.05,
        headings: int = 120,
    ) -> None:
        for name, pose in (("start", start), ("goal", goal)):
            if pose.shape != (3,):
                raise InputError(f"route: {name} of shape {pose.shape}, expected (3,)")
            plausible.demand(pose[:2], plausible.LENGTH, f"route: {name}")
            plausible.demand(pose[2:], plausible.ANGLE, f"route: heading of the {name}")
        if half.shape != (2,) or not (half.min() >= 0.01 and half.max() <= 10.0):
            raise InputError(f"route: half extents {half.tolist()} m, expected two of 0.01 to 10")
        if not 0.0 <= margin <= 2.0:
            raise InputError(f"route: margin {margin} m, expected 0 to 2")
        if not all(0.0 < speed < math.inf for speed in speeds):
            raise InputError(f"route: speeds {speeds} m/s, rad/s, expected above 0")
        if not 0.01 <= resolution <= 1.0:
            raise InputError(f"route: resolution {resolution} m, expected 0.01 to 1")
        if headings % 2 or not 8 <= headings <= 120:
            raise InputError(f"route: {headings} headings, expected an even number of 8 to 120")
        known = Ellipses.none() if obstacles is None else obstacles
        plausible.demand(known.centers, plausible.LENGTH, "route: obstacles")
        self._start, self._goal, self._half, self._speeds = start, goal, half, speeds
        self._grid, self._resolution, self._headings = grid, resolution, headings
        over = float(outside_by(start[None], half, workspace)[0])
        widened = over + LEAST_ROOM if 0.0 < over <= ASTRAY else 0.0
        x_min, y_min, x_max, y_max = workspace
        self._workspace = x_min - widened, y_min - widened, x_max + widened, y_max + widened
        self._known = known
        cells = Ellipses.none() if grid is None else grid.ellipses()
        self._cells, self._all = cells.centers, _joined(known, cells)
        self._rooms = _Rooms.of(margin)
        reach = self._rooms.levels[-1] + LEAST_ROOM
        self._gaps = Clearance(half, self._all, self._workspace, reach).gaps
        self.route: Route | None = None
        self.finished = False
        self.reason = ""
        self.worked = 0
        self._left = 0
        self._work = self._run()

    @property
    def failed(self) -> bool:
        """Whether there is no route."""
        return self.finished and self.route is None

    def advance(self, nodes: int) -> bool:
        """Do as much work as about so many expansions, 1.5 us each; whether it is finished.

        What one slice does too much the next does less.
        """
        self._left += nodes
        while self._left > 0 and not self.finished:
            try:
                done = next(self._work)
            except StopIteration:
                self.finished, self._left = True, 0
                break
            self._left -= done
            self.worked += done
        return self.finished

    def _run(self) -> Work:
        ends = np.stack([self._start, self._goal])
        room = self._gaps(ends)
        yield 100
        if self._grid is not None:
            room[self._grid.occupied_at(ends[:, :2])] = -1.0
        for name, gap in zip(("start", "goal"), room, strict=True):
            if not gap > 0.0:
                self.reason = f"the {name} touches an obstacle or the workspace's edge"
                return
        line = straight(self._start, self._goal, self._speeds)
        _, poses = line.samples(self._half)
        free = True
        for k in range(0, len(poses), PART):
            free = bool((self._gaps(poses[k : k + PART]) >= self._rooms.levels[-1]).all())
            yield 400
            if not free:
                break
        if free:
            self.route = line
            return
        for frame, headings in self._frames(room):
            yield from self._on_lattice(frame, headings, room)
            if self.route is not None:
                return

    def _frames(self, room: Array) -> Iterator[tuple["_Frame", int]]:
        """Lattices to try: the usual one, those along a start or goal in a slot, a finer one."""
        yield _Frame.of(self._start, self._grid, self._resolution), self._headings
        for pose, gap in zip((self._start, self._goal), room, strict=True):
            if gap < SLOT:
                yield _Frame(pose[:2].copy(), float(pose[2]), self._resolution), self._headings
        frame = _Frame.of(self._start, self._grid, 0.5 * self._resolution)
        yield frame, min(2 * self._headings, 120)

    def _on_lattice(self, frame: "_Frame", headings: int, room: Array) -> Work:
        """Search ever larger regions, until one holds everything or its edge is not reached."""
        reach = math.hypot(*self._half) + self._rooms.levels[-1] + 3.0 * frame.edge
        ends = frame.own(np.stack([self._start, self._goal]))[:, :2]
        everything = frame.extent(ends, self._all, self._grid, reach, self._workspace)
        pad = PAD
        while True:
            region = _Region.around(ends, pad, everything, frame.edge)
            if region.size > MOST_NODES:
                self.reason = f"the region to search has {region.size} nodes, too many"
                return
            attempt = _Attempt(self, frame, region, headings, room)
            yield from attempt.run()
            self.route, self.reason = attempt.route, attempt.reason
            if self.route is not None or region.whole or not attempt.at_edge:
                return
            pad *= 2.0


@dataclass(frozen=True)
class _Rooms:
    """Gaps that count [m].

    Attributes:
        margin: What is kept where there is room.
        floor: What is kept everywhere on the way.
        levels: At the nodes: what is kept, the margin, and what is dear below.
    """

    margin: float
    floor: float
    levels: tuple[float, float, float, float]

    @staticmethod
    def of(margin: float) -> "_Rooms":
        least = max(LEAST_SHARE * margin, LEAST_ROOM)
        levels = least, max(margin, least), margin + ROOM[0], margin + ROOM[1]
        return _Rooms(margin, max(FLOOR_SHARE * margin, 0.5 * LEAST_ROOM), levels)

    def factors(self, gap: Array) -> Array:
        """What time costs at gaps (N,): as FACTORS at nodes, without steps."""
        low = np.array(self.levels) + 1e-9 * np.arange(4)  # without a margin two are equal
        return np.interp(gap, low, FACTORS[::-1].astype(np.float64))


@dataclass(frozen=True)
class _Frame:
    """The lattice: nodes at whole multiples of its edge [m] from an origin, turned by yaw."""

    origin: Array
    yaw: float
    edge: float

    @staticmethod
    def of(start: Array, grid: GridMap | None, resolution: float) -> "_Frame":
        if grid is None:
            return _Frame(start[:2].copy(), 0.0, resolution)
        # Cells and nodes repeat together, so that few discs lie differently among the nodes.
        cell = grid.resolution
        fits = cell / math.ceil(cell / resolution - 1e-9)
        edge = fits if cell > resolution else cell * math.floor(resolution / cell + 1e-9)
        yaw = float(grid.origin[2])
        # A quarter of an edge beside the cells' sides: a door of any whole number of cells has
        # nodes no further than that from its middle.
        shift = 0.25 * edge * np.array([1.0, 1.0])
        return _Frame(grid.origin[:2] + shift @ _turn(yaw), yaw, edge)

    def own(self, poses: Array) -> Array:
        """Poses (N, 3) or points (N, 2) of odom as seen from the lattice."""
        seen = (poses[:, :2] - self.origin) @ _turn(-self.yaw)
        return np.column_stack([seen, poses[:, 2:] - self.yaw])

    def odom(self, poses: Array) -> Array:
        """Poses (N, 3) of the lattice in odom."""
        return np.column_stack(
            [poses[:, :2] @ _turn(self.yaw) + self.origin, poses[:, 2:] + self.yaw]
        )

    def extent(
        self,
        ends: Array,
        around: Ellipses,
        grid: GridMap | None,
        reach: float,
        workspace: Workspace,
    ) -> tuple[Array, Array]:
        """Least and largest corner of all there may be to go round, within the workspace."""
        size = around.semi_axes.max(axis=1, initial=0.0)[:, None]
        centers = self.own(around.centers)
        points = [ends, centers - size, centers + size]
        if grid is not None:
            width, height = grid.size
            sides = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
            points.append(self.own(grid.origin[:2] + sides @ _turn(float(grid.origin[2]))))
        every = np.concatenate(points)
        x_min, y_min, x_max, y_max = workspace
        corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
        bounds = self.own(corners)
        low = np.maximum(every.min(axis=0) - reach, bounds.min(axis=0))
        high = np.minimum(every.max(axis=0) + reach, bounds.max(axis=0))
        return np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))


@dataclass(frozen=True)
class _Region:
    """Nodes of a lattice, row by row, with one row or column more than is used on each side.

    Attributes:
        first: (2,) column and row of the first node.
        columns: Nodes in a row.
        rows: Rows.
        whole: Whether it holds everything there may be to go round.
    """

    first: Index
    columns: int
    rows: int
    whole: bool

    @staticmethod
    def around(ends: Array, pad: float, everything: tuple[Array, Array], edge: float) -> "_Region":
        low = np.maximum(ends.min(axis=0) - pad, everything[0])
        high = np.minimum(ends.max(axis=0) + pad, everything[1])
        whole = bool((low <= everything[0]).all() and (high >= everything[1]).all())
        first = np.floor(low / edge).astype(np.intp) - 1
        last = np.ceil(high / edge).astype(np.intp) + 1
        columns, rows = (last - first + 1).tolist()
        return _Region(first, columns, rows, whole)

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.columns * self.rows


class _Attempt:
    """A search within one region of one lattice."""

    def __init__(
        self, search: RouteSearch, frame: _Frame, region: _Region, headings: int, room: Array
    ) -> None:
        self.route: Route | None = None
        self.reason = ""
        self.at_edge = False
        self._doubted = True
        self._s, self._frame, self._region, self._room = search, frame, region, room
        self._headings, self._bits = headings, headings // 2
        self._full = np.uint64((1 << self._bits) - 1)
        self._turns = math.tau / headings * np.arange(self._bits)
        self._ends = frame.own(np.stack([search._start, search._goal]))
        rooms, margin = search._rooms, search._rooms.margin
        tight = room < max(margin, LEAST_ROOM)
        self._eased = float(0.5 * room[tight].min(initial=2.0 * rooms.floor))
        self._tight = self._ends[tight, :2]
        self._thresholds = np.array([*rooms.levels, self._eased][: 5 if tight.any() else 4])
        self._words: Words = np.zeros((len(self._thresholds), region.size), dtype=np.uint64)
        self._view = self._words.reshape(-1, region.rows, region.columns)
        column, row = np.arange(region.columns), np.arange(region.rows)
        self._x = frame.edge * (region.first[0] + column)
        self._y = frame.edge * (region.first[1] + row)
        stride = region.columns
        steps = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
        self._offsets = np.array([dx + stride * dy for dx, dy in steps])
        self._ways = frame.edge * np.array([math.hypot(*step) for step in steps])
        v, w = search._speeds
        turn = math.tau / headings
        turns = turn * np.array([1.0, 0.0, 1.0])
        self._costs = np.maximum(self._ways[:, None] / v, turns / w).astype(np.float32)
        self._penalty = (TURNING * turns / w).astype(np.float32)

    def run(self) -> Work:
        """Find a route in this region."""
        yield from self._fill()
        self._bound()
        yield self._region.size // 100
        yield from self._cost_to_go()
        for _ in range(RETRIES):
            path: list[Array] = []
            yield from self._find(path)
            if not path:
                self.reason = self.reason or "there is no way"
                return
            tight = yield from self._validated(path[0])
            if not len(tight):
                yield from self._straighten(path[0])
                return
            self._forbid(tight)
        self.reason = "what was found is too tight between the nodes"

    # ---- where the box is free --------------------------------------------------------------

    def _fill(self) -> Work:
        """Mark at each node the headings at which the box is closer to something than allowed."""
        grid, frame, known = self._s._grid, self._frame, self._s._known
        centers = frame.own(known.centers)
        angles = known.angles - frame.yaw
        for center, axes, angle in zip(centers, known.semi_axes, angles, strict=True):
            yield from self._stamp(center, axes, float(angle))
        if grid is not None:  # nothing gets past the cells at the boundary to those behind
            yield from self._stamp_cells(grid)

    def _stamp(self, center: Array, axes: Array, angle: float) -> Work:
        """Mark what one obstacle takes."""
        edge, region = self._frame.edge, self._region
        far = math.hypot(*self._s._half) + float(self._thresholds.max())
        a, b = inflated(axes, far)
        c, s = math.cos(angle), math.sin(angle)
        extent = np.array([math.hypot(a * c, b * s), math.hypot(a * s, b * c)])
        low = np.ceil((center - extent) / edge).astype(np.intp) - region.first
        high = np.floor((center + extent) / edge).astype(np.intp) - region.first + 1
        low, high = np.maximum(low, 0), np.minimum(high, [region.columns, region.rows])
        if not (low < high).all():
            yield 5
            return
        # Row by row where it is large; what is known of an ellipse costs more than of a disc.
        dear = 1 if axes[0] == axes[1] else 4
        rows = max(1, PIECE // (dear * self._bits * int(high[0] - low[0])))
        for first in range(int(low[1]), int(high[1]), rows):
            last = min(first + rows, int(high[1]))
            marks, work = self._marks(
                center, axes, angle, np.array([low[0], first]), np.array([high[0], last])
            )
            self._view[:, first:last, low[0] : high[0]] |= marks
            yield 50 + dear * work

    def _stamp_cells(self, grid: GridMap) -> Work:
        """Mark what the occupied cells take; those that lie alike among the nodes at once."""
        edge, region = self._frame.edge, self._region
        cells, radius = self._s._cells, grid.radius
        far = math.hypot(*self._s._half) + float(self._thresholds.max()) + radius
        place = self._frame.own(cells) / edge - region.first
        base = np.floor(place + 1e-6)
        reach = math.ceil(far / edge) + 1
        size = 2 * reach + 1
        last = np.array([region.columns, region.rows])
        inside = ((base + reach >= 0) & (base - reach < last)).all(axis=1)
        place, base = place[inside], base[inside]
        yield 20 + len(cells) // 6
        # How they lie among the nodes, as one number each: exactly where they repeat, else nearly.
        for parts in (1000, 8):
            shifts = np.round(parts * (place - base)).astype(np.intp)
            kinds, kind = np.unique(1001 * shifts[:, 0] + shifts[:, 1], return_inverse=True)
            yield 20 + len(cells) // 6
            if len(kinds) <= KINDS:
                break
        axes = np.array([radius, radius])
        for number, shift in enumerate(np.stack(np.divmod(kinds, 1001), axis=1) / parts):
            low = np.array([-reach, -reach])
            center = edge * (shift + region.first)
            marks, work = self._marks(center, axes, 0.0, low, low + size)
            yield 50 + work
            # Only what there is to mark: the corners of the square are empty.
            corners = base[kind.ravel() == number].astype(np.intp) - reach
            whole = ((corners >= 0) & (corners + size <= last)).all(axis=1)
            for k, (x, y) in enumerate(corners[whole].tolist()):
                self._view[:, y : y + size, x : x + size] |= marks
                if k % 50 == 49:
                    yield 200
            for x, y in corners[~whole].tolist():
                x0, y0 = max(x, 0), max(y, 0)
                x1, y1 = min(x + size, region.columns), min(y + size, region.rows)
                self._view[:, y0:y1, x0:x1] |= marks[:, y0 - y : y1 - y, x0 - x : x1 - x]
                yield 5

    def _marks(
        self, center: Array, axes: Array, angle: float, low: Index, high: Index
    ) -> tuple[Words, int]:
        """Words (levels, rows, columns) of an obstacle on the nodes low to high - 1; work done."""
        edge, half = self._frame.edge, self._s._half
        x = edge * (self._region.first[0] + np.arange(low[0], high[0])) - center[0]
        y = edge * (self._region.first[1] + np.arange(low[1], high[1])) - center[1]
        c, s = math.cos(angle), math.sin(angle)
        u, v = c * x + s * y[:, None], c * y[:, None] - s * x
        far = math.hypot(*half) + float(self._thresholds.max())
        a, b = inflated(axes, far)
        # The box holds a disc: the ellipse of the axes plus its radius lies in what it touches.
        inner = axes + 0.999 * half.min()
        within = (u / inner[0]) ** 2 + (v / inner[1]) ** 2 < 1.0
        ring = ~within & ((u / a) ** 2 + (v / b) ** 2 < 1.0)
        shape = len(self._thresholds), len(y), len(x)
        result: Words = np.zeros(shape, dtype=np.uint64)
        result[:, within] = self._full
        u, v = u[ring], v[ring]
        heading = self._turns - angle
        if axes[0] == axes[1]:
            cos, sin = np.cos(heading), np.sin(heading)
            ahead = np.abs(np.outer(u, cos) + np.outer(v, sin)) - half[0]
            aside = np.abs(np.outer(v, cos) - np.outer(u, sin)) - half[1]
            gap = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0)) - axes[0]
        else:
            poses = np.column_stack(
                [np.repeat(u, self._bits), np.repeat(v, self._bits), np.tile(heading, len(u))]
            )
            flat = np.zeros((1, 1, 2))
            gap = box_gap(poses, half, flat, axes[None, None], np.zeros(1)).reshape(-1, self._bits)
        for level, threshold in enumerate(self._thresholds):
            result[level, ring] = _packed(gap < threshold)
        return result, gap.size // 80

    def _bound(self) -> None:
        """Mark what is beyond the workspace and the region; ease what is tight."""
        frame, half = self._frame, self._s._half
        x_min, y_min, x_max, y_max = self._s._workspace
        turned = self._turns + frame.yaw
        cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
        along_x, along_y = half[0] * cos + half[1] * sin, half[0] * sin + half[1] * cos
        words = self._view
        corner = frame.odom(np.array([[self._x[0], self._y[0], 0.0]]))[0]
        c, s = math.cos(frame.yaw), math.sin(frame.yaw)
        dx, dy = self._x - self._x[0], (self._y - self._y[0])[:, None]
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
                words[level] |= table[fit]
        if len(self._tight):
            reach = EASED * math.hypot(*half)
            for x, y in self._tight:
                near = np.hypot(self._x - x, self._y[:, None] - y) < reach
                words[0][near] = words[4][near]
        for edge in (words[0, 0], words[0, -1], words[0, :, 0], words[0, :, -1]):
            edge[...] = self._full

    def _floor(self, poses: Array) -> Array:
        """Gaps (N,) that are kept at least at poses of the lattice (N, 3) [m]."""
        result = np.full(len(poses), self._s._rooms.floor)
        reach = EASED * math.hypot(*self._s._half)
        for x, y in self._tight:
            near = np.hypot(poses[:, 0] - x, poses[:, 1] - y) < reach
            result[near] = min(0.5 * self._eased, self._s._rooms.floor)
        return result

    # ---- the cost to go, by the places alone ------------------------------------------------

    def _cost_to_go(self) -> Work:
        """Least cost from each node to the goal's place, were the heading free to choose."""
        words, full, size = self._words, self._full, self._region.size
        factor = np.full(size, FACTORS[0])
        cost = np.full(size, np.inf, dtype=np.float32)
        for first in range(0, size, NODES):
            part = slice(first, first + NODES)
            for level in (3, 2, 1):
                factor[part][(words[level, part] | words[0, part]) == full] = FACTORS[4 - level]
            cost[part][words[0, part] == full] = -1.0
            yield 1000
        ways = (self._ways[1:] / self._s._speeds[0]).astype(np.float32)
        offsets = self._offsets[1:]
        seeds = self._near(self._ends[1])[0]
        seeds = np.unique(seeds[cost[seeds] > 0.0])
        cost[seeds] = 0.0
        pool, mark = seeds, np.zeros(size, dtype=np.int32)
        width = 1.5 * float(ways.min())
        while len(pool):
            order = cost[pool]
            now = order < order.min() + width
            front, pool = pool[now], pool[~now]
            mark[front] = np.arange(len(front), dtype=np.int32)
            front = front[mark[front] == np.arange(len(front))]
            value = (cost[front, None] + factor[front, None] * ways).ravel()
            beside = (front[:, None] + offsets).ravel()
            better = value < cost[beside]
            beside, value = beside[better], value[better]
            np.minimum.at(cost, beside, value)
            pool = np.concatenate([pool, beside[cost[beside] == value]])
            yield 15 + len(front) // 4
        cost[cost < 0.0] = np.inf
        self._to_go = cost
        inner = cost.reshape(self._region.rows, -1)
        edges = inner[1], inner[-2], inner[:, 1], inner[:, -2]
        self.at_edge = any(bool(np.isfinite(edge).any()) for edge in edges)

    # ---- the search over (x, y, heading) ----------------------------------------------------

    def _near(self, pose: Array) -> tuple[Index, Index]:
        """Nodes (N,) and headings (N,) near a pose of the lattice."""
        region, edge = self._region, self._frame.edge
        place = pose[:2] / edge - region.first
        middle = np.round(place).astype(np.intp)
        span = np.arange(-math.ceil(NEAR), math.ceil(NEAR) + 1)
        x, y = np.meshgrid(middle[0] + span, middle[1] + span)
        fits = np.hypot(x - place[0], y - place[1]) <= NEAR
        fits &= (x > 0) & (x < region.columns - 1) & (y > 0) & (y < region.rows - 1)
        nodes = (y * region.columns + x)[fits]
        turn = math.tau / self._headings
        headings = round(float(pose[2]) / turn) + np.arange(-2, 3)
        return (
            np.repeat(nodes, len(headings)).astype(np.intp),
            np.tile(headings % self._headings, len(nodes)).astype(np.intp),
        )

    def _poses(self, nodes: Index, headings: Index) -> Array:
        """Poses (N, 3) of the lattice."""
        y, x = np.divmod(nodes, self._region.columns)
        return np.column_stack([self._x[x], self._y[y], math.tau / self._headings * headings])

    def _joints(self, end: int) -> tuple[Index, Index, Array]:
        """Nodes, headings and cost (N,) of the free lines from an end to the lattice."""
        nodes, headings = self._near(self._ends[end])
        free = ~self._bit(0, nodes, headings)
        nodes, headings = nodes[free], headings[free]
        if not len(nodes):
            return nodes, headings, np.zeros(0)
        poses = self._poses(nodes, headings)
        step = poses - self._ends[end]
        step[:, 2] = np.remainder(step[:, 2] + math.pi, math.tau) - math.pi
        shares = np.linspace(0.0, 1.0, 9)[1:-1]
        between = self._ends[end] + shares[:, None] * step[:, None]
        flat = between.reshape(-1, 3)
        clear = self._s._gaps(self._frame.odom(flat)) >= self._floor(flat)
        fits = clear.reshape(len(nodes), -1).all(axis=1)
        cost = durations(step, self._s._speeds) + TURNING * np.abs(step[:, 2]) / self._s._speeds[1]
        return nodes[fits], headings[fits], cost[fits]

    def _bit(self, level: int, nodes: Index, headings: Index) -> Mask:
        shift = (headings % self._bits).astype(np.uint64)
        result: Mask = (self._words[level, nodes] >> shift & ONE).astype(bool)
        return result

    def _find(self, path: list[Array]) -> Work:
        """Search; appends the poses (N, 3) of the lattice found, both ends exact."""
        first, last = self._joints(0), self._joints(1)
        yield 700
        if not len(first[0]) or not len(last[0]):
            self.reason = f"no way out of the {'goal' if len(first[0]) else 'start'}"
            return
        if not np.isfinite(self._to_go[first[0]]).any():
            self.reason = "there is no way"
            return
        tree = _Tree(self._region.size, self._headings)
        turn = math.tau / self._headings
        goal_heading = float(self._ends[1, 2])
        off = np.abs([se2.wrap(turn * k - goal_heading) for k in range(self._headings)])
        turning = off / self._s._speeds[1]
        spin, extra = turning.astype(np.float32), (TURNING * turning).astype(np.float32)
        to_go, words, bits = self._to_go, self._words, self._bits
        costs, penalty = self._costs, self._penalty
        fresh = np.array([-1, 0, 1])

        ids = tree.ids(first[0], first[1])
        tree.put(ids, first[2].astype(np.float32), np.full(len(ids), -1, dtype=np.int8))
        exits, exit_costs = tree.ids(last[0], last[1]), last[2].astype(np.float32)
        queue = _Queue()
        guess = np.maximum(to_go[first[0]], spin[first[1]]) + extra[first[1]]
        queue.push(tree.cost[ids] / np.float32(WEIGHT) + guess, guess, ids, tree.cost[ids])
        expanded, weight = 0, WEIGHT
        while True:
            arrived = float((tree.cost[exits] + exit_costs).min())
            if not queue or arrived / weight <= queue.rank:
                break
            size = min(BATCH + expanded // GROWTH, LARGEST_BATCH)
            ids = queue.pop(size, tree)
            if not len(ids):
                yield 5
                continue
            expanded += len(ids)
            weight = min(WEIGHT + HASTE * expanded, LARGEST_WEIGHT)
            node, heading = tree.places(ids)
            beside = node[:, None] + self._offsets
            turned = (heading[:, None] + fresh) % self._headings
            shift = (turned % bits).astype(np.uint64)
            taken = (words[0][beside][:, :, None] >> shift[:, None, :] & ONE).astype(bool)
            # A move that also turns must be free as a move alone and as a turn alone.
            taken[:, :, 0] |= taken[:, :, 1] | taken[:, :1, 0]
            taken[:, :, 2] |= taken[:, :, 1] | taken[:, :1, 2]
            taken[:, 0, 1] = True
            which, way, side = np.nonzero(~taken)
            there, then, bit = beside[which, way], turned[which, side], shift[which, side]
            level = sum((words[k][there] >> bit & ONE).astype(np.intp) for k in (1, 2, 3))
            value = (
                tree.cost[ids][which] + costs[way, side] * FACTORS[level] + penalty[side]
            ).astype(np.float32)
            new = tree.ids(there, then)
            rest = to_go[there]
            better = (value < tree.cost[new]) & np.isfinite(rest)
            new, value, rest, then = new[better], value[better], rest[better], then[better]
            won = tree.put(new, value, (3 * way + side)[better].astype(np.int8))
            new, value, rest, then = new[won], value[won], rest[won], then[won]
            guess = np.maximum(rest, spin[then]) + extra[then]
            queue.push(value / np.float32(weight) + guess, guess, new, value)
            yield 40 + len(ids)
            if expanded > DOUBT and self._doubted and not math.isfinite(arrived):
                self._doubted = yield from self._unreachable(first, last)
                if self._doubted:
                    self.reason = "there is no way"
                    return
        if not math.isfinite(arrived):
            self.reason = "there is no way at this heading"
            return
        best = int(np.argmin(tree.cost[exits] + exit_costs))
        nodes, turns = tree.back(int(exits[best]), self._offsets)
        poses = self._poses(nodes, turns)
        whole = np.concatenate([self._ends[:1], poses, self._ends[1:]])
        steps = np.remainder(np.diff(whole[:, 2]) + math.pi, math.tau) - math.pi
        whole[1:, 2] = whole[0, 2] + np.cumsum(steps)
        self._path = nodes, turns
        path.append(whole)
        yield len(nodes)

    def _unreachable(
        self, first: tuple[Index, Index, Array], last: tuple[Index, Index, Array]
    ) -> Generator[int, None, bool]:
        """Whether no way leads to the goal, headings that are opposite being one.

        All headings of a node at once: much cheaper than a search that finds nothing.
        """
        free = ~self._words[0] & self._full
        reached = np.zeros(self._region.size, dtype=np.uint64)
        mark = np.zeros(self._region.size, dtype=bool)
        np.bitwise_or.at(reached, last[0], ONE << (last[1] % self._bits).astype(np.uint64))
        front = np.unique(last[0])
        goals = ONE << (first[1] % self._bits).astype(np.uint64)
        end = np.uint64(self._bits - 1)
        while len(front):
            word = reached[front]
            word = word | (word << ONE | word >> end) | (word >> ONE | word << end)
            touched = []
            for offset in self._offsets:
                beside = front + offset
                grown = word & free[beside] & ~reached[beside]
                fresh = grown != 0
                beside = beside[fresh]
                reached[beside] |= grown[fresh]
                touched.append(beside)
            every = np.concatenate(touched)
            mark[every] = True
            front = every[mark[every]]
            front = np.unique(front)
            mark[front] = False
            if (reached[first[0]] & goals).any():
                return False
            yield 40 + len(front) // 6
        inner = reached.reshape(self._region.rows, -1)
        edges = inner[1], inner[-2], inner[:, 1], inner[:, -2]
        self.at_edge = any(bool(edge.any()) for edge in edges)
        return True

    # ---- exact checks -----------------------------------------------------------------------

    def _exact(self, poses: Array) -> Array:
        """Gaps (N,) at poses of the lattice; infinity where the nodes tell that there is room."""
        place = np.round(poses[:, :2] / self._frame.edge).astype(np.intp) - self._region.first
        last = np.array([self._region.columns - 1, self._region.rows - 1])
        place = np.clip(place, 0, last)
        near = self._words[3, place[:, 1] * self._region.columns + place[:, 0]] != 0
        result = np.full(len(poses), np.inf)
        if near.any():
            result[near] = self._s._gaps(self._frame.odom(poses[near]))
        return result

    def _validated(self, path: Array) -> Generator[int, None, Index]:
        """Which poses of a path must not be used, as it is too tight before or after them."""
        fine = refined(path, self._s._half)
        poses = along(path, fine)
        gap = np.empty(len(poses))
        for k in range(0, len(poses), PART):
            part = slice(k, k + PART)
            gap[part] = self._exact(poses[part])
            yield 200
        self._fine = fine, gap
        tight = fine[gap < self._floor(poses)]
        if not len(tight) or len(path) < 3:
            return np.zeros(0, dtype=np.intp)
        # Of the two poses around a place, the one that is closer itself.
        at = gap[np.searchsorted(fine, np.arange(len(path)))]
        before = np.clip(np.floor(tight).astype(np.intp), 1, len(path) - 2)
        after = np.clip(np.ceil(tight).astype(np.intp), 1, len(path) - 2)
        return np.unique(np.where(at[before] < at[after], before, after))

    def _forbid(self, poses: Index) -> None:
        """Take poses of the last path out of the lattice."""
        nodes, headings = self._path
        bits = (headings[poses - 1] % self._bits).astype(np.uint64)
        np.bitwise_or.at(self._words[0], nodes[poses - 1], ONE << bits)

    def _cost(self, line: Array, least: float) -> tuple[float, float]:
        """Cost [s] of a line (2, 3), and its least gap [m]; infinity if that is below `least`."""
        index = refined(line, self._s._half)
        poses = along(line, index)
        stride = max(len(index) // FIRST_LOOKS, 1)
        some = self._exact(poses[stride // 2 :: stride])
        if some.min() < least:
            return math.inf, float(some.min())
        gap = self._exact(poses)
        if gap.min() < least:
            return math.inf, float(gap.min())
        factor = self._s._rooms.factors(gap)
        step = np.diff(line, axis=0)
        lasts = float(durations(step, self._s._speeds)[0])
        turning = TURNING * abs(float(step[0, 2])) / self._s._speeds[1]
        mean = 0.5 * float((factor[1:] + factor[:-1]).mean())
        return lasts * mean + turning, float(gap.min())

    def _straighten(self, path: Array) -> Work:
        """Join poses of the path by straight lines wherever that is no dearer, nor closer."""
        fine, gap = self._fine
        poses = along(path, fine)
        factor = self._s._rooms.factors(gap)
        step = np.diff(poses, axis=0)
        each = durations(step, self._s._speeds) * 0.5 * (factor[1:] + factor[:-1])
        each += TURNING * np.abs(step[:, 2]) / self._s._speeds[1]
        total = np.concatenate([[0.0], np.cumsum(each)])
        whole = np.searchsorted(fine, np.arange(len(path)))
        cost = total[whole]
        room = np.minimum.reduceat(gap, whole[:-1])
        room = np.minimum(room, gap[whole[1:]])
        for _ in range(2):
            path, cost, room = yield from self._shortened(path, cost, room)
            path, cost, room = path[::-1], cost[-1] - cost[::-1], room[::-1]
        poses = self._frame.odom(path)
        poses[0], heading = self._s._start, self._s._start[2] - poses[0, 2]
        poses[1:, 2] += heading
        poses[-1, :2] = self._s._goal[:2]
        self.route = Route(poses, self._s._speeds)

    def _shortened(
        self, path: Array, cost: Array, room: Array
    ) -> Generator[int, None, tuple[Array, Array, Array]]:
        """One pass over a path: cost (N,) up to each pose, room (N - 1,) on each piece."""
        margin, last = self._s._rooms.margin, len(path) - 1
        kept, costs, rooms = [0], [0.0], []
        i, step = 0, last
        while i < last:
            step = min(step, last - i)
            while True:
                j = i + step
                if step == 1:
                    lasts, gap = cost[j] - cost[i], room[i]
                    break
                least = min(margin, float(room[i:j].min())) - 1e-9
                lasts, gap = self._cost(path[[i, j]], least)
                yield 350
                if lasts <= (1.0 + WORSE) * (cost[j] - cost[i]):
                    break
                step = (step + 1) // 2
            kept.append(j)
            costs.append(costs[-1] + float(lasts))
            rooms.append(float(gap))
            i, step = j, 2 * step
        return path[kept], np.array(costs), np.array(rooms)


class _Tree:
    """States that were reached; a row of all headings for each node that was."""

    def __init__(self, nodes: int, headings: int) -> None:
        self._headings = headings
        self._row = np.full(nodes, -1, dtype=np.int32)
        self._node = np.zeros(1024, dtype=np.intp)
        self._rows = 0
        self.cost = np.full(1024 * headings, np.inf, dtype=np.float32)
        self._move = np.zeros(1024 * headings, dtype=np.int8)

    def ids(self, nodes: Index, headings: Index) -> Index:
        """Numbers (N,) of states."""
        row = self._row[nodes]
        if (row < 0).any():
            self._add(np.unique(nodes[row < 0]))
            row = self._row[nodes]
        result: Index = row.astype(np.intp) * self._headings + headings
        return result

    def _add(self, nodes: Index) -> None:
        count = self._rows + len(nodes)
        if count > len(self._node):
            more = 2 * count - len(self._node)
            self._node = np.append(self._node, np.zeros(more, dtype=np.intp))
            inf = np.full(more * self._headings, np.inf, dtype=np.float32)
            self.cost = np.append(self.cost, inf)
            self._move = np.append(self._move, np.zeros(len(inf), dtype=np.int8))
        self._row[nodes] = np.arange(self._rows, count, dtype=np.int32)
        self._node[self._rows : count] = nodes
        self._rows = count

    def places(self, ids: Index) -> tuple[Index, Index]:
        """Nodes and headings of states."""
        row, heading = np.divmod(ids, self._headings)
        return self._node[row], heading

    def put(self, ids: Index, value: Single, move: NDArray[np.int8]) -> Mask:
        """Note costs and the moves that led there; which of them are the least now."""
        np.minimum.at(self.cost, ids, value)
        won: Mask = self.cost[ids] == value
        self._move[ids[won]] = move[won]
        return won

    def back(self, state: int, offsets: Index) -> tuple[Index, Index]:
        """Nodes and headings from the start to a state."""
        nodes, headings = [], []
        row, heading = divmod(state, self._headings)
        node = int(self._node[row])
        while True:
            nodes.append(node)
            headings.append(heading)
            move = int(self._move[int(self._row[node]) * self._headings + heading])
            if move < 0:
                break
            node -= int(offsets[move // 3])
            heading = (heading - (move % 3 - 1)) % self._headings
        return np.array(nodes[::-1], dtype=np.intp), np.array(headings[::-1], dtype=np.intp)


class _Queue:
    """States in the order of their rank, in bands of BAND [s]."""

    def __init__(self) -> None:
        self._bands: dict[int, list[tuple[Single, Index, Single]]] = {}
        self._heap: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    @property
    def rank(self) -> float:
        """Nothing in it is before this [s]."""
        return BAND * self._heap[0]

    def push(self, order: Single, guess: Single, ids: Index, cost: Single) -> None:
        """Add states by their order, with the cost to go and the cost up to there."""
        band = (order / BAND).astype(np.intp)
        for k in _distinct(band):
            here = band == k
            self._add(k, (guess[here], ids[here], cost[here]))

    def _add(self, band: int, part: tuple[Single, Index, Single]) -> None:
        if band not in self._bands:
            self._bands[band] = []
            heapq.heappush(self._heap, band)
        self._bands[band].append(part)

    def pop(self, size: int, tree: _Tree) -> Index:
        """States of the first band, at most about so many, the nearest to the goal first."""
        band = heapq.heappop(self._heap)
        parts = self._bands.pop(band)
        guess, ids, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
        now = tree.cost[ids] == cost  # the others have found a better way since
        guess, ids, cost = guess[now], ids[now], cost[now]
        if len(ids) > size:
            order = np.argpartition(guess, size)
            late = order[size:]
            self._add(band, (guess[late], ids[late], cost[late]))
            ids = ids[order[:size]]
        result: Index = np.unique(ids)
        return result


def _distinct(values: Index) -> Iterator[int]:
    """Each value once, the least first."""
    if len(values):
        low = int(values.min())
        yield from (np.flatnonzero(np.bincount(values - low)) + low).tolist()


def _packed(bits: Mask) -> Words:
    """Words (N,) of bits (N, n), n <= 64, the first the least."""
    wide = np.zeros((len(bits), 64), dtype=bool)
    wide[:, : bits.shape[1]] = bits
    packed = np.packbits(wide, axis=1, bitorder="little")
    return packed.view("<u8")[:, 0].astype(np.uint64)


def _turn(angle: float) -> Array:
    """Matrix (2, 2) that turns rows of points by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])


def _joined(one: Ellipses, other: Ellipses) -> Ellipses:
    """Obstacles of both."""
    return Ellipses(
        one.time,
        np.concatenate([one.centers, other.centers]),
        np.concatenate([one.velocities, other.velocities]),
        np.concatenate([one.semi_axes, other.semi_axes]),
        np.concatenate([one.angles, other.angles]),
        np.concatenate([one.growth, other.growth]),
    )
