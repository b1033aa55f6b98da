"""Masks of the poses at which the robot's box would be too near to a body, and their bit sets."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_geometry import Box, Ellipse, Wall
from omniman_ros.lab.studies.space_time_grid import SUBCELLS, Grid, Mover

Words = NDArray[np.uint64]
"""Words of 64 bits, each of which represents a heading."""
Mask = NDArray[np.bool_]
"""An element is true where a pose is blocked."""

NORMALS = 64
"""Number of evenly spaced tangents of the polygon that the robot's centre must not enter, besides
those parallel to the box and to the wall."""


def blocked_poses(
    body: Ellipse | Wall, box: Box, headings: Array, margin: float, xs: Array, ys: Array
) -> Mask:
    """Find the poses at which the box would be nearer to a body than a margin.

    For each heading, the positions of these poses form a convex region. It is replaced here by the
    circumscribed polygon of some of its tangents.

    Args:
        body: The ellipse or wall.
        box: The robot's outline.
        headings: (H,) headings of the box in odom [rad].
        margin: Gap to keep [m].
        xs: (X,) x coordinates of the box relative to the body's centre [m].
        ys: (Y,) y coordinates of the box relative to the body's centre [m].

    Returns:
        (Y, X, H) mask, true where the pose is blocked.
    """
    if isinstance(body, Ellipse):
        (along, across), turn = body.semi_axes, body.angle
    else:
        along, across, turn = 0.5 * body.length, 0.5 * body.width, body.heading
    right = np.arange(4) * 0.5 * math.pi
    angles = np.arange(NORMALS) * math.tau / NORMALS
    if isinstance(body, Wall):
        angles = np.concatenate((angles, turn + right))
    angles = np.concatenate(
        (np.tile(angles, (len(headings), 1)), headings[:, None] + right), axis=1
    )
    nx, ny = np.cos(angles), np.sin(angles)
    to_box, to_body = angles - headings[:, None], angles - turn
    reach = box.half[0] * np.abs(np.cos(to_box)) + box.half[1] * np.abs(np.sin(to_box)) + margin
    if isinstance(body, Ellipse):
        reach += np.hypot(along * np.cos(to_body), across * np.sin(to_body))
    else:
        reach += along * np.abs(np.cos(to_body)) + across * np.abs(np.sin(to_body))
    upright = np.abs(nx) < 1e-9
    room = reach[:, None] - ys[:, None] * ny[:, None]  # (H, Y, normals)
    border = room / np.where(upright, 1.0, nx)[:, None]
    last = np.where((nx >= 1e-9)[:, None], border, np.inf).min(axis=2)
    first = np.where((nx <= -1e-9)[:, None], border, -np.inf).max(axis=2)
    beyond = (upright[:, None] & (room <= 0.0)).any(axis=2)
    last[beyond] = -np.inf
    result: Mask = (xs[:, None] > first.T[:, None]) & (xs[:, None] < last.T[:, None])
    return result


def pack_free(blocked: Mask, headings: int) -> Words:
    """Pack the free headings of each position into a word.

    A box rotated by pi covers the same area, so the headings of half a revolution suffice. With 64
    headings, a word contains both halves of the revolution; with 128 headings, a word of 64 bits
    is the same for both halves.

    Args:
        blocked: (Y, X, H) mask, true where a pose is blocked, for H headings of half a revolution.
        headings: Number of headings in a revolution, 64 or 128.

    Returns:
        (Y, X) words with a bit set where a heading is free.
    """
    free = np.concatenate((~blocked, ~blocked), axis=2) if headings == 64 else ~blocked
    words: Words = np.packbits(free, axis=2, bitorder="little").view("<u8")[..., 0]
    return words.astype(np.uint64)


class MovingMask:
    """Removes the nodes that are too near to a moving obstacle in a layer of a search.

    Args:
        mover: The robot.
        grid: Resolution of the search.
        times: (L,) times of the layers [s].
        origin: (2,) position of the first node in odom [m].
        headings: (H,) headings of the nodes in half a revolution [rad].
        obstacle: The moving obstacle.
    """

    def __init__(
        self,
        mover: Mover,
        grid: Grid,
        times: Array,
        origin: Array,
        headings: Array,
        obstacle: Ellipse,
    ) -> None:
        self._body, self._box, self._half_turn = obstacle, mover.box, headings
        self._headings = grid.headings
        speed = obstacle.place.speed
        subcell = grid.cell / SUBCELLS
        margin = grid.ellipse_margin(mover, obstacle.semi_axes, speed)
        # If it changes its velocity within a step, it leaves its chord by up to half its travel.
        self._margins = (margin, margin + 0.5 * speed * grid.step(mover))
        farthest = mover.box.radius + max(obstacle.semi_axes) + self._margins[1]
        self._size = math.ceil(farthest / subcell)
        self._offsets: Array = subcell * np.arange(-self._size, self._size + 1, dtype=float)
        self._places = np.round((obstacle.place.at(times) - origin) / subcell).astype(int)
        self._bends = np.zeros(len(times), dtype=bool)
        for knot in obstacle.place.times:
            first = int(np.searchsorted(times, knot)) - 1
            if 0 <= first < len(times):
                self._bends[first : first + 2] = True
        self._free: dict[bool, Words] = {}

    def apply(self, state: Words, layer: int) -> None:
        """Remove the nodes that are too near to the obstacle from a state, in place.

        Args:
            state: (W, Y, X) state of a layer.
            layer: Index of the layer.
        """
        slices, cut = [], []
        for place, count in zip(self._places[layer].tolist(), state.shape[:0:-1], strict=True):
            first = max(-((self._size - place) // SUBCELLS), 0)
            last = min((place + self._size) // SUBCELLS, count - 1)
            if last < first:
                return
            slices.append(slice(first, last + 1))
            begin = first * SUBCELLS - place + self._size
            cut.append(slice(begin, begin + (last - first) * SUBCELLS + 1, SUBCELLS))
        free = self._free_around(bool(self._bends[layer]))
        state[:, slices[1], slices[0]] &= free[cut[1], cut[0]]

    def _free_around(self, bends: bool) -> Words:
        """Return the words of the free poses around the obstacle, a part of a cell apart.

        Args:
            bends: Whether the obstacle changes its velocity within a step to or from the layer.
        """
        if bends not in self._free:
            blocked = blocked_poses(
                self._body,
                self._box,
                self._half_turn,
                self._margins[bends],
                self._offsets,
                self._offsets,
            )
            self._free[bends] = pack_free(blocked, self._headings)
        return self._free[bends]
