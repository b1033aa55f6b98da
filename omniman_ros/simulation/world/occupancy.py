"""Occupancy grid of what stands fixed in a scene."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.world.scene import Scene
from omniman_ros.simulation.world.solids import EllipticPrism, Solid, UprightBox, fixed_solids

MAX_CELLS = 4_000_000  #: Largest number of cells of a grid
MARGIN = 1.0  #: Free space around the elements and the robot's start [m]


@dataclass(frozen=True)
class Occupancy(Validated):
    """Cells that are occupied, as in `nav_msgs/OccupancyGrid`."""

    #: Whether each cell is occupied, (rows along y, columns along x)
    occupied: Annotated[NDArray[np.bool_], Shape("rows", "columns")]
    resolution: float  #: Edge of a cell [m]
    origin: Annotated[Array, Shape(2)]  #: Corner (x, y) of cell (0, 0) in the world [m], (2,)


def occupancy(scene: Scene, resolution: float = 0.05, height: float = 0.5) -> Occupancy:
    """Return the cells that fixed elements touch below a height: a high table leaves its legs.

    Args:
        resolution: Edge of a cell [m].
        height: Height of what shall pass, such as the platform's [m].

    Raises:
        ParameterError: The resolution is not positive, or makes too many cells.
    """
    solids = [
        solid
        for _, parts in fixed_solids(scene)
        for solid in parts
        if solid.centre[2] - 0.5 * solid.height < height
    ]
    boxes = np.array([_bounds(solid) for solid in solids] + [[*scene.start[:2]] * 2])
    low, high = boxes[:, :2].min(axis=0) - MARGIN, boxes[:, 2:].max(axis=0) + MARGIN
    if not resolution > 0.0:
        raise ParameterError("resolution", resolution, "must be above 0 m")
    low = np.floor(low / resolution) * resolution
    columns, rows = np.maximum(np.ceil((high - low) / resolution), 1.0).tolist()
    if rows * columns > MAX_CELLS:
        raise ParameterError(
            "resolution", resolution, f"makes more than {MAX_CELLS} cells of this scene"
        )
    occupied = np.zeros((int(rows), int(columns)), dtype=bool)
    for solid, bounds in zip(solids, boxes, strict=False):
        first = np.maximum(np.floor((bounds[:2] - low) / resolution).astype(int), 0)
        last = np.ceil((bounds[2:] - low) / resolution).astype(int)
        x = low[0] + resolution * (np.arange(first[0], last[0]) + 0.5)
        y = low[1] + resolution * (np.arange(first[1], last[1]) + 0.5)
        window = occupied[first[1] : last[1], first[0] : last[0]]
        window |= _touches(solid, x[None, :], y[:, None], 0.5 * resolution)
    occupied.setflags(write=False)
    low.setflags(write=False)
    return Occupancy(occupied, resolution, low)


def _bounds(solid: Solid) -> list[float]:
    """Return the smallest x and y of an obstacle, then the largest [m]."""
    x, y, _ = solid.centre
    if isinstance(solid, UprightBox):
        c, s = abs(math.cos(solid.yaw)), abs(math.sin(solid.yaw))
        dx = 0.5 * (c * solid.size[0] + s * solid.size[1])
        dy = 0.5 * (s * solid.size[0] + c * solid.size[1])
    elif isinstance(solid, EllipticPrism):
        dx, dy = solid.outline.max(axis=0).tolist()
    else:
        dx = dy = solid.radius
    return [x - dx, y - dy, x + dx, y + dy]


def _touches(solid: Solid, x: Array, y: Array, half: float) -> NDArray[np.bool_]:
    dx, dy = x - solid.centre[0], y - solid.centre[1]
    if isinstance(solid, UprightBox):
        c, s = math.cos(solid.yaw), math.sin(solid.yaw)
        along, across = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
        reach = half * (abs(c) + abs(s))
        inside = along < 0.5 * solid.size[0] + reach
        touched: NDArray[np.bool_] = inside & (across < 0.5 * solid.size[1] + reach)
        return touched
    if isinstance(solid, EllipticPrism):
        normals = solid.outline / np.hypot(*solid.outline.T)[:, None]
        reaches = (solid.outline @ normals.T).max(axis=0) + half * np.abs(normals).sum(axis=1)
        sides = [
            nx * dx + ny * dy < reach for (nx, ny), reach in zip(normals, reaches, strict=True)
        ]
        prism: NDArray[np.bool_] = np.logical_and.reduce(sides)
        return prism
    nearest = np.hypot(np.maximum(np.abs(dx) - half, 0.0), np.maximum(np.abs(dy) - half, 0.0))
    disc: NDArray[np.bool_] = nearest < solid.radius
    return disc
