"""Random posts on a field, after the BARN benchmark of navigation in clutter.

Source: D. Perille, A. Truong, X. Xiao and P. Stone, "Benchmarking Metric Ground Navigation"
(SSRR 2020), section III: a cellular automaton on a grid of cells as wide as a post. Cells are
filled at random; then, in each pass, a cell with five or more filled ones among its eight
neighbours is filled, and one with at most one is emptied. A field through which the robot does not
fit is drawn anew.
"""

import math
import random
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import REQUIRED, parameter
from omniman_ros.simulation.world.scene import Element, Post

FILLING, CLEARING = 5, 1  #: Filled neighbours that fill a cell, and up to which it empties
MAX_DRAWS = 2000  #: Largest number of draws of a field
MAX_CELLS = 100_000  #: Largest number of cells of a field

Cells = NDArray[np.bool_]  #: Flags of the cells, rows along x, columns along y


@dataclass(frozen=True, kw_only=True)
class Clutter(Element):
    """A field of random posts along x, from end to end of which a passage leads.

    Raises:
        ParameterError: The field is empty or has too many cells, or the passage is wider than the
            field; see also :class:`Element`.
    """

    seed: int = parameter(0, "Seed of the field.", low=0)
    fill: float = parameter(0.2, "Share of cells that are filled at first.", low=0, high=0.9)
    smoothing: int = parameter(3, "Number of passes of the automaton.", low=0, high=20)
    x_min: float = parameter(REQUIRED, "Field, x from.", unit="m", low=-1000, high=1000)
    x_max: float = parameter(REQUIRED, "Field, x to.", unit="m", low=-1000, high=1000)
    y_min: float = parameter(REQUIRED, "Field, y from.", unit="m", low=-1000, high=1000)
    y_max: float = parameter(REQUIRED, "Field, y to.", unit="m", low=-1000, high=1000)
    radius: float = parameter(
        0.075, "Radius of the posts, half the edge of a cell.", unit="m", low=0.005, high=10
    )
    height: float = parameter(1.0, "Height of the posts.", unit="m", low=0.01, high=100)
    passage: float = parameter(
        1.0, "Diameter of a disc that gets from end to end.", unit="m", low=0, high=100
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.x_min < self.x_max or not self.y_min < self.y_max:
            raise self._refusal("x_max", "the field is empty")
        if self.passage > self.y_max - self.y_min:
            raise self._refusal("passage", "is wider than the field")
        rows, columns = self.shape
        if not 0 < rows * columns <= MAX_CELLS:
            reason = f"makes {rows} x {columns} cells, expected 1 to {MAX_CELLS}"
            raise self._refusal("radius", reason)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and along y."""
        edge = 2.0 * self.radius
        extents = self.x_max - self.x_min, self.y_max - self.y_min
        along, across = (int(extent / edge + 1e-9) for extent in extents)
        return along, across


def clutter_posts(field: Clutter) -> tuple[Post, ...]:
    """Return the posts of a field; the same field always has the same posts.

    Raises:
        ParameterError: In all draws the passage was blocked: there is too much in the field.
    """
    generator = random.Random(field.seed)
    for _ in range(MAX_DRAWS):
        cells = _drawn(field, generator)
        if _is_passable(cells, field):
            break
    else:
        reason = f"leaves no passage of {field.passage:g} m in {MAX_DRAWS} draws"
        raise ParameterError(f"{field.name}.fill", field.fill, reason)
    edge = 2.0 * field.radius
    return tuple(
        Post(
            name=f"{field.name}_{k}",
            x=field.x_min + edge * (row + 0.5),
            y=field.y_min + edge * (column + 0.5),
            radius=field.radius,
            height=field.height,
        )
        for k, (row, column) in enumerate(np.argwhere(cells).tolist())
    )


def _drawn(field: Clutter, generator: random.Random) -> Cells:
    rows, columns = field.shape
    drawn = [generator.random() < field.fill for _ in range(rows * columns)]
    cells: Cells = np.array(drawn).reshape(rows, columns)
    for _ in range(field.smoothing):
        padded = np.pad(cells, 1).astype(int)
        neighbours = sum(
            padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if i or j
        )
        cells = (neighbours >= FILLING) | (cells & (neighbours > CLEARING))
    return cells


def _is_passable(cells: Cells, field: Clutter) -> bool:
    """Return whether a disc of the passage's diameter gets through the cells along x.

    It keeps within the field, and moves from cell to cell.
    """
    rows, columns = cells.shape
    edge, reach = 2.0 * field.radius, 0.5 * field.passage + field.radius
    span = math.ceil(reach / edge)
    blocked = np.zeros_like(cells)
    padded = np.pad(cells, span)
    for i in range(-span, span + 1):
        for j in range(-span, span + 1):
            if edge * math.hypot(i, j) < reach:
                blocked |= padded[span + i : span + i + rows, span + j : span + j + columns]
    middles = edge * (np.arange(columns) + 0.5)
    beside = 0.5 * field.passage
    blocked |= (middles < beside) | (middles > field.y_max - field.y_min - beside)
    reached = np.zeros_like(cells)
    reached[0] = ~blocked[0]
    while True:
        grown = np.pad(reached, 1)
        more = ~blocked & (
            reached | grown[:-2, 1:-1] | grown[2:, 1:-1] | grown[1:-1, :-2] | grown[1:-1, 2:]
        )
        if (more == reached).all():
            return bool(reached[-1].any())
        reached = more
