"""Lattice of a search: nodes in rows and columns, and headings at each node."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.surroundings.grid_map import GridMap

Single = NDArray[np.float32]  #: Array of single-precision floats: costs [s]
Index = NDArray[np.intp]  #: Array of indices of nodes, headings, columns or rows
Words = NDArray[np.uint64]  #: Array of words, one per node, with a bit for each heading
Work = Generator[int, None, None]  #: Work in pieces; each yields its amount [expansions]

JOINING_DISTANCE = 2.5  #: Distance within which a pose is joined to nodes [edges of the lattice]
JOINING_HEADINGS = 2  #: Number of headings to either side that a pose is joined to
#: Columns and rows by which moves advance; the first move only rotates
STEPS = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]


@dataclass(frozen=True)
class LatticeFrame:
    """Frame of a lattice: its nodes are at whole multiples of an edge."""

    origin: Array  #: (2,) origin in odom [m]
    yaw: float  #: Angle of the axes in odom [rad]
    edge: float  #: Distance from a node to the next [m]

    @staticmethod
    def of(start: Array, grid: GridMap | None, resolution: float) -> "LatticeFrame":
        """Return a frame along a map, or at the start (3,) without one.

        Its edge is about the resolution [m] or less. Cells and nodes repeat together, so that
        only few different offsets between cells and nodes occur.
        """
        if grid is None:
            return LatticeFrame(start[:2].copy(), 0.0, resolution)
        cell = grid.resolution
        divided = cell / math.ceil(cell / resolution - 1e-9)
        edge = divided if cell > resolution else cell * math.floor(resolution / cell + 1e-9)
        yaw = float(grid.origin[2])
        # The nodes are a quarter of an edge beside the sides of the cells: a door of any whole
        # number of cells has nodes no further than that from its middle.
        shift = 0.25 * edge * np.array([1.0, 1.0])
        return LatticeFrame(grid.origin[:2] + shift @ _rotation(yaw), yaw, edge)

    def own(self, poses: Array) -> Array:
        """Return poses (N, 3) or points (N, 2) of odom in this frame."""
        positions = (poses[:, :2] - self.origin) @ _rotation(-self.yaw)
        return np.column_stack([positions, poses[:, 2:] - self.yaw])

    def odom(self, poses: Array) -> Array:
        """Return poses (N, 3) of this frame in odom."""
        return np.column_stack(
            [poses[:, :2] @ _rotation(self.yaw) + self.origin, poses[:, 2:] + self.yaw]
        )

    def extent(self, problem: RouteProblem) -> tuple[Array, Array]:
        """Return the corners (2,) of the area that paths may need, within the workspace."""
        reach = problem.radius + problem.rooms.levels[-1] + 3.0 * self.edge
        ends = self.own(problem.ends)[:, :2]
        size = problem.around.semi_axes.max(axis=1, initial=0.0)[:, None]
        centers = self.own(problem.around.centers)
        points = [ends, centers - size, centers + size]
        if problem.grid is not None:
            width, height = problem.grid.size
            sides = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
            origin = problem.grid.origin
            points.append(self.own(origin[:2] + sides @ _rotation(float(origin[2]))))
        every = np.concatenate(points)
        x_min, y_min, x_max, y_max = problem.workspace
        corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
        bounds = self.own(corners)
        low = np.maximum(every.min(axis=0) - reach, bounds.min(axis=0))
        high = np.minimum(every.max(axis=0) + reach, bounds.max(axis=0))
        return np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))


@dataclass(frozen=True)
class Region:
    """Nodes of a lattice, row by row; the outermost rows and columns are not used."""

    first: Index  #: (2,) column and row of the first node
    columns: int  #: Number of nodes in a row
    rows: int  #: Number of rows
    whole: bool  #: Whether it contains all of the area that paths may need

    @staticmethod
    def around(ends: Array, pad: float, everything: tuple[Array, Array], edge: float) -> "Region":
        """Return the region around both ends, but not beyond the area that paths may need.

        It extends `pad` [m] around the ends (2, 2) or (2, 3) on the lattice.
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
    """Nodes and headings; a node's number is its row times the number of columns plus its column.

    Args:
        headings: Number of headings per revolution, even, up to 128, or 64 without symmetry.
        ends: (2, 3) start and goal in odom [m, m, rad].
        is_symmetric: Whether the robot covers the same area after half a revolution.

    Attributes:
        ends: (2, 3) start and goal in the frame of the lattice.
        heading_step: Angle from a heading to the next [rad].
        bits: Number of headings after which the robot covers the same area: those in half a
            revolution with symmetry, else all.
        heading_angles: (bits,) these headings [rad].
        x: (columns,) x of the nodes [m].
        y: (rows,) y of the nodes [m].
        offsets: (9,) changes of the node's number in the moves of STEPS.
        step_lengths: (9,) lengths of these moves [m].
    """

    def __init__(
        self,
        frame: LatticeFrame,
        region: Region,
        headings: int,
        ends: Array,
        is_symmetric: bool = True,
    ) -> None:
        self.frame, self.region, self.headings = frame, region, headings
        self.ends = frame.own(ends)
        self.heading_step = math.tau / headings
        self.bits = headings // 2 if is_symmetric else headings
        self.heading_angles = self.heading_step * np.arange(self.bits, dtype=np.float64)
        self.x = frame.edge * (region.first[0] + np.arange(region.columns))
        self.y = frame.edge * (region.first[1] + np.arange(region.rows))
        self.offsets = np.array([dx + region.columns * dy for dx, dy in STEPS])
        self.step_lengths = frame.edge * np.array([math.hypot(*step) for step in STEPS])

    def poses(self, nodes: Index, headings: Index) -> Array:
        """Return the poses (N, 3) of nodes and headings in the lattice's frame [m, m, rad]."""
        y, x = np.divmod(nodes, self.region.columns)
        return np.column_stack([self.x[x], self.y[y], self.heading_step * headings])

    def nearest(self, poses: Array) -> Index:
        """Return the nodes (N,) nearest to poses (N, 3) of the lattice's frame."""
        place = np.round(poses[:, :2] / self.frame.edge).astype(np.intp) - self.region.first
        place = np.clip(place, 0, self.region.shape - 1)
        result: Index = place[:, 1] * self.region.columns + place[:, 0]
        return result

    def near(self, pose: Array) -> tuple[Index, Index]:
        """Return all pairs of nodes (N,) and headings (N,) near a pose (3,) of the frame."""
        region = self.region
        place = pose[:2] / self.frame.edge - region.first
        middle = np.round(place).astype(np.intp)
        span = np.arange(-math.ceil(JOINING_DISTANCE), math.ceil(JOINING_DISTANCE) + 1)
        x, y = np.meshgrid(middle[0] + span, middle[1] + span)
        fits = np.hypot(x - place[0], y - place[1]) <= JOINING_DISTANCE
        fits &= (x > 0) & (x < region.columns - 1) & (y > 0) & (y < region.rows - 1)
        nodes = (y * region.columns + x)[fits]
        headings = round(float(pose[2]) / self.heading_step) + np.arange(
            -JOINING_HEADINGS, JOINING_HEADINGS + 1
        )
        return (
            np.repeat(nodes, len(headings)).astype(np.intp),
            np.tile(headings % self.headings, len(nodes)).astype(np.intp),
        )

    def rim(self, values: Words | Single) -> Words | Single:
        """Return the values of the outermost nodes that are used."""
        rows = values.reshape(self.region.rows, -1)
        return np.concatenate([rows[1], rows[-2], rows[:, 1], rows[:, -2]])


def _rotation(angle: float) -> Array:
    """Return the matrix (2, 2) that rotates points in rows by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])
