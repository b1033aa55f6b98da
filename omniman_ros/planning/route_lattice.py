"""The lattice of a search: nodes on the floor by rows and columns, and headings at each."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route_problem import RouteProblem

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.intp]
Words = NDArray[np.uint64]
Work = Generator[int, None, None]
"""Work in pieces; each says how much it was, in expansions of a node."""

NEAR, NEAR_TURNS = 2.5, 2
"""A pose is joined to nodes within so many edges of the lattice, and headings within so many."""
STEPS = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
"""Columns and rows by which a move goes on; the first turns on the spot."""


@dataclass(frozen=True)
class Frame:
    """Where nodes are: at whole multiples of an edge, along axes of their own.

    Attributes:
        origin: (2,) in odom [m].
        yaw: Of the axes in odom [rad].
        edge: From a node to the next [m].
    """

    origin: Array
    yaw: float
    edge: float

    @staticmethod
    def of(start: Array, grid: GridMap | None, resolution: float) -> "Frame":
        """One along a map, or from the start (3,) on, its edge about the resolution [m] or less.

        Cells and nodes repeat together, so that few cells lie differently among the nodes.
        """
        if grid is None:
            return Frame(start[:2].copy(), 0.0, resolution)
        cell = grid.resolution
        fits = cell / math.ceil(cell / resolution - 1e-9)
        edge = fits if cell > resolution else cell * math.floor(resolution / cell + 1e-9)
        yaw = float(grid.origin[2])
        # A quarter of an edge beside the cells' sides: a door of any whole number of cells has
        # nodes no further than that from its middle.
        shift = 0.25 * edge * np.array([1.0, 1.0])
        return Frame(grid.origin[:2] + shift @ _turn(yaw), yaw, edge)

    def own(self, poses: Array) -> Array:
        """Poses (N, 3) or points (N, 2) of odom as seen from the lattice."""
        seen = (poses[:, :2] - self.origin) @ _turn(-self.yaw)
        return np.column_stack([seen, poses[:, 2:] - self.yaw])

    def odom(self, poses: Array) -> Array:
        """Poses (N, 3) of the lattice in odom."""
        return np.column_stack(
            [poses[:, :2] @ _turn(self.yaw) + self.origin, poses[:, 2:] + self.yaw]
        )

    def extent(self, problem: RouteProblem) -> tuple[Array, Array]:
        """Least and largest corner (2,) of all there may be to go round, within the workspace."""
        reach = problem.radius + problem.rooms.levels[-1] + 3.0 * self.edge
        ends = self.own(problem.ends)[:, :2]
        size = problem.around.semi_axes.max(axis=1, initial=0.0)[:, None]
        centers = self.own(problem.around.centers)
        points = [ends, centers - size, centers + size]
        if problem.grid is not None:
            width, height = problem.grid.size
            sides = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
            origin = problem.grid.origin
            points.append(self.own(origin[:2] + sides @ _turn(float(origin[2]))))
        every = np.concatenate(points)
        x_min, y_min, x_max, y_max = problem.workspace
        corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
        bounds = self.own(corners)
        low = np.maximum(every.min(axis=0) - reach, bounds.min(axis=0))
        high = np.minimum(every.max(axis=0) + reach, bounds.max(axis=0))
        return np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))


@dataclass(frozen=True)
class Region:
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
    def around(ends: Array, pad: float, everything: tuple[Array, Array], edge: float) -> "Region":
        """That around both ends by so much room, but not beyond everything.

        Args:
            ends: (2, 2) or (2, 3) start and goal on the lattice [m].
            pad: Room around them [m].
            everything: Corners as of `Frame.extent` [m].
            edge: Edge of the lattice [m].
        """
        low = np.maximum(ends[:, :2].min(axis=0) - pad, everything[0])
        high = np.minimum(ends[:, :2].max(axis=0) + pad, everything[1])
        whole = bool((low <= everything[0]).all() and (high >= everything[1]).all())
        first = np.floor(low / edge).astype(np.intp) - 1
        last = np.ceil(high / edge).astype(np.intp) + 1
        columns, rows = (last - first + 1).tolist()
        return Region(first, columns, rows, whole)

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.columns * self.rows

    @property
    def shape(self) -> Index:
        """Columns and rows (2,)."""
        return np.array([self.columns, self.rows])


class Lattice:
    """Nodes and headings; a node's number is that of its row times the columns plus its column.

    Args:
        frame: Where the nodes are.
        region: Which of them.
        headings: Headings a turn, even, up to 128.
        ends: (2, 3) start and goal in odom [m, m, rad].

    Attributes:
        ends: (2, 3) the same, as seen from the lattice.
        turn: From a heading to the next [rad].
        bits: Headings of half a turn: the box looks the same after that.
        turns: (bits,) these [rad].
        x: (columns,) of the nodes [m].
        y: (rows,) of the nodes [m].
        offsets: (9,) by which the node's number changes in a move, those of STEPS.
        ways: (9,) lengths of the moves [m].
    """

    def __init__(self, frame: Frame, region: Region, headings: int, ends: Array) -> None:
        self.frame, self.region, self.headings = frame, region, headings
        self.ends = frame.own(ends)
        self.turn = math.tau / headings
        self.bits = headings // 2
        self.turns = self.turn * np.arange(self.bits, dtype=np.float64)
        self.x = frame.edge * (region.first[0] + np.arange(region.columns))
        self.y = frame.edge * (region.first[1] + np.arange(region.rows))
        self.offsets = np.array([dx + region.columns * dy for dx, dy in STEPS])
        self.ways = frame.edge * np.array([math.hypot(*step) for step in STEPS])

    def poses(self, nodes: Index, headings: Index) -> Array:
        """Poses (N, 3) of the lattice [m, m, rad]."""
        y, x = np.divmod(nodes, self.region.columns)
        return np.column_stack([self.x[x], self.y[y], self.turn * headings])

    def nearest(self, poses: Array) -> Index:
        """Nodes (N,) that poses (N, 3) of the lattice are nearest to."""
        place = np.round(poses[:, :2] / self.frame.edge).astype(np.intp) - self.region.first
        place = np.clip(place, 0, self.region.shape - 1)
        result: Index = place[:, 1] * self.region.columns + place[:, 0]
        return result

    def near(self, pose: Array) -> tuple[Index, Index]:
        """Nodes (N,) and headings (N,), each with each, near a pose (3,) of the lattice."""
        region = self.region
        place = pose[:2] / self.frame.edge - region.first
        middle = np.round(place).astype(np.intp)
        span = np.arange(-math.ceil(NEAR), math.ceil(NEAR) + 1)
        x, y = np.meshgrid(middle[0] + span, middle[1] + span)
        fits = np.hypot(x - place[0], y - place[1]) <= NEAR
        fits &= (x > 0) & (x < region.columns - 1) & (y > 0) & (y < region.rows - 1)
        nodes = (y * region.columns + x)[fits]
        headings = round(float(pose[2]) / self.turn) + np.arange(-NEAR_TURNS, NEAR_TURNS + 1)
        return (
            np.repeat(nodes, len(headings)).astype(np.intp),
            np.tile(headings % self.headings, len(nodes)).astype(np.intp),
        )

    def rim(self, values: Words | Single) -> Words | Single:
        """Of values of all nodes those of the outermost that are used."""
        rows = values.reshape(self.region.rows, -1)
        return np.concatenate([rows[1], rows[-2], rows[:, 1], rows[:, -2]])


def _turn(angle: float) -> Array:
    """Matrix (2, 2) that turns rows of points by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])
