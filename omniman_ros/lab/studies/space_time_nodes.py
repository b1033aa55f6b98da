"""The nodes of a space-time search: poses on a grid, whether they are free, and steps between.

A state is a set of nodes: an array (W, Y, X) of 64-bit words, in which each bit represents one
heading at a position. Along the border of the grid, no node is ever free.
"""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_geometry import Area, Box, Ellipse, Wall, World
from omniman_ros.lab.studies.scene_judge import judge
from omniman_ros.lab.studies.space_time_grid import SAFETY, Grid, Mover
from omniman_ros.lab.studies.space_time_masks import (
    Mask,
    MovingMask,
    Words,
    blocked_poses,
    pack_free,
)

Node = tuple[int, int, int]
"""A node: its indices of heading, row (y) and column (x)."""
ESCAPE_CELLS = 4
"""Length of the longest first move of a robot that is nearer to an obstacle than nodes may be
[cells]."""


class SearchNodes:
    """The nodes that a robot may occupy in the layers of a search, and the steps between layers.

    The pose at the start is one of the nodes.

    Args:
        mover: The robot.
        world: Obstacles and walls, and the area that the robot must not leave.
        start: (3,) pose at the time `since` in odom [m, m, rad].
        since: Begin of the search [s].
        until: End of the search [s].
        grid: Resolution of the search.
        bounds: Area in odom within which the robot's centre is searched if the world has no area
            [m].

    Attributes:
        times: (L,) times of the layers [s].
        step: Time between two layers [s].
        turn: Largest number of headings by which the robot rotates in a step.
        widths: Largest distance of a step in x for each distance in y, from 0 on [cells].
        reach: Largest distance of a step in y [cells].
        origin: (2,) position of the first node in odom [m].
        shape: Shape (W, Y, X) of a state.
        home: Node of the start.
        half_turn: (H,) headings of the nodes in the first half of a revolution in odom [rad].
        xs: (X,) x coordinates of the columns in odom [m].
        ys: (Y,) y coordinates of the rows in odom [m].
        free: (Y, X) words of the nodes that keep their gap to all fixed obstacles and walls.
        turning: (Y, X) words of the nodes that keep the larger gap for steps in which the robot
            rotates while it drives; the same array as `free` without walls.
        moving: Masks of the moving obstacles.
    """

    def __init__(
        self,
        mover: Mover,
        world: World,
        start: Array,
        since: float,
        until: float,
        grid: Grid,
        bounds: Area,
    ) -> None:
        self.mover, self.world, self.grid, self.start = mover, world, grid, start
        self.step, self.turn, self.until = grid.step(mover), grid.turn(mover), until
        count = math.ceil((until - since) / self.step - 1e-9)
        self.times: Array = since + self.step * np.arange(count + 1, dtype=float)
        self.widths = self._reach_per_row()
        self.reach = len(self.widths) - 1

        area = bounds if world.area is None else world.area
        farthest = mover.speed * (until - since)
        low = np.maximum(np.array(area[:2]) - start[:2], -farthest) / grid.cell
        high = np.minimum(np.array(area[2:]) - start[:2], farthest) / grid.cell
        first = np.floor(np.minimum(low, 0.0)).astype(int) - self.reach - 1
        last = np.ceil(np.maximum(high, 0.0)).astype(int) + self.reach + 1
        self.origin = start[:2] + grid.cell * first
        columns, rows = (last - first + 1).tolist()
        self.shape = (grid.headings // 64, rows, columns)
        self.home: Node = (0, -int(first[1]), -int(first[0]))
        half = grid.headings // 2
        self.half_turn = start[2] + grid.angle * np.arange(half)
        self.xs = self.origin[0] + grid.cell * np.arange(columns)
        self.ys = self.origin[1] + grid.cell * np.arange(rows)

        self.free = self._free_of_fixed(turning=False)
        self.turning = self._free_of_fixed(turning=True) if world.walls else self.free
        self.moving = [
            MovingMask(mover, grid, self.times, self.origin, self.half_turn, obstacle)
            for obstacle in world.obstacles
            if not obstacle.fixed
        ]

    def _reach_per_row(self) -> list[int]:
        """Return the largest distance of a step in x for each distance in y, from 0 on [cells]."""
        far = self.mover.speed * self.step / self.grid.cell + 1e-9
        return [math.floor(math.sqrt(far * far - i * i)) for i in range(math.floor(far) + 1)]

    # ---- nodes ------------------------------------------------------------------------------

    def pose(self, node: Node) -> Array:
        """Return the pose (3,) of a node in odom; its heading is within pi of the start's."""
        heading, row, column = node
        turn = (heading + self.grid.headings // 2) % self.grid.headings - self.grid.headings // 2
        return np.array([self.xs[column], self.ys[row], self.start[2] + self.grid.angle * turn])

    def is_inside(self, node: Node) -> bool:
        """Return whether the grid contains the row and the column of a node."""
        return bool(0 <= node[1] < self.shape[1] and 0 <= node[2] < self.shape[2])

    @staticmethod
    def contains(state: Words, node: Node) -> bool:
        """Return whether a state contains a node."""
        heading, row, column = node
        return bool(int(state[heading // 64, row, column]) >> (heading % 64) & 1)

    @staticmethod
    def add(state: Words, node: Node) -> None:
        """Add a node to a state."""
        heading, row, column = node
        state[heading // 64, row, column] |= np.uint64(1 << (heading % 64))

    def empty(self) -> Words:
        """Return a state without nodes."""
        return np.zeros(self.shape, dtype=np.uint64)

    def free_at(self, state: Words, layer: int) -> Words:
        """Return the nodes of a state that are free in a layer."""
        result: Words = state & self.free
        for obstacle in self.moving:
            obstacle.apply(result, layer)
        return result

    def is_clear(self, times: Array, poses: Array) -> bool:
        """Return whether a move touches nothing and stays in the area, by exact gaps.

        Args:
            times: (K,) times [s].
            poses: (K, 3) poses in odom [m, m, rad].
        """
        verdict = judge(times, poses, self.mover.box, self.world)
        return not verdict.collided and verdict.outside <= 0.0

    def may_turn(self, *nodes: Node) -> bool:
        """Return whether the robot may rotate while it drives between these nodes."""
        return all(
            int(self.turning[row, column]) >> (heading % 64) & 1 for heading, row, column in nodes
        )

    # ---- fixed obstacles and walls ----------------------------------------------------------

    def _free_of_fixed(self, turning: bool) -> Words:
        """Return words (Y, X) of the nodes in the area that keep their gap to all fixed bodies.

        Args:
            turning: Whether the gaps are for steps in which the robot rotates while it drives.
        """
        blocked = np.zeros((len(self.ys), len(self.xs), len(self.half_turn)), dtype=bool)
        self._block_outside(blocked)
        bodies: tuple[Ellipse | Wall, ...] = (*self.world.obstacles, *self.world.walls)
        for body in bodies:
            if isinstance(body, Wall) or body.fixed:
                self._block_near(blocked, body, turning)
        border = self.reach
        blocked[:border] = blocked[-border:] = True
        blocked[:, :border] = blocked[:, -border:] = True
        return pack_free(blocked, self.grid.headings)

    def _block_outside(self, blocked: Mask) -> None:
        """Block the poses (Y, X, H) at which the box would leave the area, in place."""
        if self.world.area is None:
            return
        box: Box = self.mover.box
        c, s = np.abs(np.cos(self.half_turn)), np.abs(np.sin(self.half_turn))
        edge = SAFETY + self.grid.bulge(self.mover)
        wide = box.half[0] * c + box.half[1] * s + edge
        high = box.half[0] * s + box.half[1] * c + edge
        x_min, y_min, x_max, y_max = self.world.area
        xs, ys = self.xs[:, None], self.ys[:, None]
        blocked |= (xs < x_min + wide) | (xs > x_max - wide)
        blocked |= ((ys < y_min + high) | (ys > y_max - high))[:, None]

    def _block_near(self, blocked: Mask, body: Ellipse | Wall, turning: bool) -> None:
        """Block the poses (Y, X, H) that are too near to a fixed body, in place."""
        mover, grid = self.mover, self.grid
        if isinstance(body, Wall):
            center = np.array((body.x, body.y))
            size = 0.5 * math.hypot(body.length, body.width)
            margin = grid.wall_margin(mover, turning)
        else:
            center, size = body.place(0.0), max(body.semi_axes)
            margin = grid.ellipse_margin(mover, body.semi_axes, 0.0)
        far = size + mover.box.radius + margin
        columns = slice(*np.searchsorted(self.xs, (center[0] - far, center[0] + far)))
        rows = slice(*np.searchsorted(self.ys, (center[1] - far, center[1] + far)))
        xs, ys = self.xs[columns] - center[0], self.ys[rows] - center[1]
        if len(xs) and len(ys):
            blocked[rows, columns] |= blocked_poses(
                body, mover.box, self.half_turn, margin, xs, ys
            )

    # ---- steps ------------------------------------------------------------------------------

    def advance(self, state: Words, layer: int) -> Words:
        """Return the state of the next layer: the free nodes that a step from a state reaches.

        Args:
            state: (W, Y, X) state of a layer.
            layer: Index of that layer.
        """
        result = np.zeros_like(state)
        _, row, column = self.home
        far, edge = self.reach * (layer + 1) + ESCAPE_CELLS, self.reach
        rows = slice(max(row - far, edge), min(row + far + 1, self.shape[1] - edge))
        columns = slice(max(column - far, edge), min(column + far + 1, self.shape[2] - edge))
        driven = self._driven(state, rows, columns)
        free, turning = self.free[rows, columns], self.turning[rows, columns]
        window = result[:, rows, columns]
        if self.turning is self.free:
            np.bitwise_or(driven, self._turned(driven), out=window)
            window &= free
        else:
            np.bitwise_or(driven, self._turned(state[:, rows, columns]), out=window)
            window &= free
            both = self._turned(self._driven(state & self.turning, rows, columns))
            both &= turning
            window |= both
        for obstacle in self.moving:
            obstacle.apply(result, layer + 1)
        return result

    def _driven(self, state: Words, rows: slice, columns: slice) -> Words:
        """Return the nodes that driving for a step reaches, in a window of rows and columns."""
        reach, count = self.reach, rows.stop - rows.start
        high = slice(rows.start - reach, rows.stop + reach)
        wide = state[:, high, columns].copy()
        spread = [wide]
        for i in range(1, max(self.widths) + 1):
            wide = wide | state[:, high, columns.start - i : columns.stop - i]
            wide |= state[:, high, columns.start + i : columns.stop + i]
            spread.append(wide)
        result: Words = spread[self.widths[0]][:, reach : reach + count].copy()
        for i in range(1, reach + 1):
            source = spread[self.widths[i]]
            result |= source[:, reach - i : reach - i + count]
            result |= source[:, reach + i : reach + i + count]
        return result

    def _turned(self, state: Words) -> Words:
        """Return the nodes that rotating for a step reaches, without those of no rotation."""
        one, top = np.uint64(1), np.uint64(63)
        result = np.zeros_like(state)
        left = right = state
        for _ in range(self.turn):
            left = (left << one) | (np.roll(left, 1, axis=0) >> top)
            right = (right >> one) | (np.roll(right, -1, axis=0) << top)
            result |= left
            result |= right
        return result
