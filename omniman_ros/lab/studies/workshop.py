"""A workshop of four rooms: a dead end, and doors through which the robot fits lengthwise."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.scene_gaps import wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, Wall
from omniman_ros.planning.obstacles.grid_map import GridMap

RESOLUTION = 0.05  # edge of a cell of the map [m]
AREA = (-1.5, -1.5, 11.0, 6.0)  # area of the map: x_min, y_min, x_max, y_max in odom [m]
DOOR_WIDTH = 0.6  # width of the doors [m]; the robot is 0.8 m long and 0.5 m wide
WALL_THICKNESS = 0.1  # thickness of the walls [m]


def _wall_along_y(x: float, low: float, high: float) -> Wall:
    """Return a wall at x that runs along y from low to high, in odom [m]."""
    return Wall(x, 0.5 * (low + high), math.pi / 2, high - low, WALL_THICKNESS)


def _wall_along_x(y: float, low: float, high: float) -> Wall:
    """Return a wall at y that runs along x from low to high, in odom [m]."""
    return Wall(0.5 * (low + high), y, 0.0, high - low, WALL_THICKNESS)


def walls() -> tuple[Wall, ...]:
    """Return the outer walls, three inner walls with a door each, a dead end and four machines."""
    x_min, y_min, x_max, y_max = AREA
    edge, half = 0.5 * WALL_THICKNESS, 0.5 * DOOR_WIDTH
    return (
        _wall_along_x(y_min + edge, x_min, x_max),
        _wall_along_x(y_max - edge, x_min, x_max),
        _wall_along_y(x_min + edge, y_min, y_max),
        _wall_along_y(x_max - edge, y_min, y_max),
        _wall_along_y(3.05, y_min, 4.4 - half),
        _wall_along_y(3.05, 4.4 + half, y_max),
        _wall_along_y(6.55, y_min, 0.2 - half),
        _wall_along_y(6.55, 0.2 + half, y_max),
        _wall_along_x(2.85, 6.6, 9.4 - half),
        _wall_along_x(2.85, 9.4 + half, x_max),
        _wall_along_x(-0.65, -0.5, 1.0),
        _wall_along_x(0.65, -0.5, 1.0),
        _wall_along_y(1.0, -0.7, 0.7),
        Wall(4.7, 2.9, 0.6, 1.8, 0.4),
        Wall(5.2, 0.6, -0.3, 0.8, 0.5),
        Wall(8.3, 0.8, 0.2, 0.9, 0.6),
        Wall(9.2, 4.9, 0.9, 0.8, 0.4),
    )


@cache
def grid() -> GridMap:
    """Return the map of the workshop, in which each cell that overlaps with a wall is occupied."""
    return map_of(walls())


def map_of(mapped: Sequence[Wall]) -> GridMap:
    """Return a map of `AREA`, in which each cell that overlaps with a wall is occupied."""
    x_min, y_min, x_max, y_max = AREA
    columns = np.arange(x_min, x_max - 1e-9, RESOLUTION) + 0.5 * RESOLUTION
    rows = np.arange(y_min, y_max - 1e-9, RESOLUTION) + 0.5 * RESOLUTION
    x, y = np.meshgrid(columns, rows)
    cells = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    occupied = np.zeros(x.size, dtype=bool)
    # The box is a little smaller than a cell, so that a cell which only borders on a wall is free.
    cell = Box(0.99 * RESOLUTION, 0.99 * RESOLUTION)
    for wall in mapped:
        row = np.array([wall.x, wall.y, wall.heading, wall.length, wall.width])
        occupied |= wall_gap(cells, cell, np.tile(row, (len(cells), 1))) <= 0.0
    return GridMap(occupied.reshape(x.shape), RESOLUTION, np.array([x_min, y_min, 0.0]))


def workshop() -> Scene:
    """Return the scene: out of the dead end, through three doors, to a pose in the last room."""
    return Scene(
        "workshop",
        (7.6, 4.6, math.pi / 2),
        (0.0, 0.0, 0.0),
        walls=walls(),
        grid=grid(),
        time_limit=60.0,
    )
