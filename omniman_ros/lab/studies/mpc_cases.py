"""The test cases of MPC 2021, section 4, and a workshop.

Starts, goals and obstacles of the cases are those of `omniman_ros.planning.cases`. The workshop
has four rooms: a dead end, and doors through which the robot fits lengthwise.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_geometry import (
    MovingObstacle,
    RectangularOutline,
    WallRectangle,
    wall_gap,
)
from omniman_ros.planning.cases import CASES, RADIUS, Pose
from omniman_ros.surroundings.grid_map import GridMap

RESOLUTION = 0.05  #: edge of a cell of the map [m]
AREA = (-1.5, -1.5, 11.0, 6.0)  #: area of the map: x_min, y_min, x_max, y_max in odom [m]
DOOR_WIDTH = 0.6  #: width of the doors [m]; the robot is 0.8 m long and 0.5 m wide
WALL_THICKNESS = 0.1  #: thickness of the walls [m]


@dataclass(frozen=True)
class MpcCase:
    """A test case: start, goal, and the fixed and moving obstacles between them."""

    name: str  #: name of the case
    goal: Pose  #: pose of the goal in odom [m, m, rad]
    start: Pose = (0.0, 0.0, 0.0)  #: pose of the start in odom [m, m, rad]
    obstacles: tuple[MovingObstacle, ...] = ()  #: obstacles as they truly are
    snapshots: tuple[float, ...] = ()  #: times that figures show, from the sending of the goal [s]
    noise: float = 0.0  #: standard deviation of the observed positions of obstacles [m]
    time_limit: float = 30.0  #: time within which the goal must be reached [s]
    walls: tuple[WallRectangle, ...] = ()  #: walls; touching one counts as a contact
    grid: GridMap | None = None  #: map of the walls that the planner receives, if any


def circle(radius: float, place: Callable[[float], Array]) -> MovingObstacle:
    """Return a circular obstacle, whose centre is at place(t) (2,) in odom [m]."""
    return MovingObstacle((radius, radius), place)


def case_of_paper(name: str, **more: Any) -> MpcCase:
    """Return the scene of a test case; `more` contains further fields of `MpcCase`."""
    case = CASES[name]
    circles = tuple(circle(RADIUS, path) for path in case.paths)
    return MpcCase(name, case.goal, case.start, circles, **more)


def _wall_along_y(x: float, low: float, high: float) -> WallRectangle:
    """Return a wall at x that runs along y from low to high, in odom [m]."""
    return WallRectangle(x, 0.5 * (low + high), math.pi / 2, high - low, WALL_THICKNESS)


def _wall_along_x(y: float, low: float, high: float) -> WallRectangle:
    """Return a wall at y that runs along x from low to high, in odom [m]."""
    return WallRectangle(0.5 * (low + high), y, 0.0, high - low, WALL_THICKNESS)


def walls() -> tuple[WallRectangle, ...]:
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
        WallRectangle(4.7, 2.9, 0.6, 1.8, 0.4),
        WallRectangle(5.2, 0.6, -0.3, 0.8, 0.5),
        WallRectangle(8.3, 0.8, 0.2, 0.9, 0.6),
        WallRectangle(9.2, 4.9, 0.9, 0.8, 0.4),
    )


def grid_map() -> GridMap:
    """Return the map of the workshop, in which each cell that overlaps with a wall is occupied."""
    x_min, y_min, x_max, y_max = AREA
    columns = np.arange(x_min, x_max - 1e-9, RESOLUTION) + 0.5 * RESOLUTION
    rows = np.arange(y_min, y_max - 1e-9, RESOLUTION) + 0.5 * RESOLUTION
    x, y = np.meshgrid(columns, rows)
    cells = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    # The box is a little smaller than a cell, so that a cell which only borders on a wall is free.
    cell = RectangularOutline(0.99 * RESOLUTION, 0.99 * RESOLUTION)
    occupied = np.any([wall_gap(cells, cell, wall.row) <= 0.0 for wall in walls()], axis=0)
    return GridMap(occupied.reshape(x.shape), RESOLUTION, np.array([x_min, y_min, 0.0]))


def workshop() -> MpcCase:
    """Return the scene: out of the dead end, through three doors, to a pose in the last room."""
    goal = (7.6, 4.6, math.pi / 2)
    return MpcCase("workshop", goal, walls=walls(), grid=grid_map(), time_limit=60.0)


SCENES: Mapping[str, Callable[[], MpcCase]] = {
    "free": partial(case_of_paper, "free", snapshots=(2.0, 3.5, 7.0)),
    "corridor": partial(case_of_paper, "corridor", snapshots=(0.8, 1.9, 2.7, 3.4, 4.8)),
    "moving": partial(case_of_paper, "moving", noise=0.01),
    "workshop": workshop,
}  #: Functions that return the scenes, by name
