"""Obstacles and maps as upright obstacles, for distances of the whole robot."""

import math

import numpy as np

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap

#: Height above the floor, and depth below it, that are beyond every part of the robot [m]: there,
#: an obstacle of unknown height and the cells of a map end.
FARTHEST = 10.0


def ellipse_surroundings(ellipses: Ellipses) -> MovingObstacles:
    """Return walls with round ends that contain obstacles, at their heights, and move like them.

    An ellipse with the semi-axes a >= b lies within the distance b of the segment from -(a - b) to
    a - b on its longer axis. A circle is contained exactly.
    """
    long, short = ellipses.semi_axes.max(axis=1), ellipses.semi_axes.min(axis=1)
    is_across = ellipses.semi_axes[:, 1] > ellipses.semi_axes[:, 0]
    obstacles = UprightObstacles(
        ellipses.centers.T,
        ellipses.angles + 0.5 * math.pi * is_across,
        np.stack((long - short, np.zeros(len(ellipses)))),
        short,
        np.clip(ellipses.lower, -FARTHEST, FARTHEST),
        np.clip(ellipses.upper, -FARTHEST, FARTHEST),
    )
    return MovingObstacles(obstacles, ellipses.velocities.T)


def grid_obstacles(grid: GridMap) -> UprightObstacles:
    """Return boxes that cover the occupied cells of a map exactly, at all heights.

    The cells of a row that follow one another are joined, and then rows that are occupied between
    the same columns. Walls along the axes of the map become one box each.
    """
    padded = np.pad(grid.occupied, ((0, 0), (1, 1))).astype(np.int8)
    edges = np.diff(padded, axis=1)
    rows, begins = np.nonzero(edges == 1)
    ends = np.nonzero(edges == -1)[1]
    # Runs between the same columns come together, in the order of their rows.
    order = np.lexsort((rows, ends, begins))
    rows, begins, ends = rows[order], begins[order], ends[order]
    follows = (np.diff(rows) == 1) & (np.diff(begins) == 0) & (np.diff(ends) == 0)
    is_first = np.concatenate(([True], ~follows))[: len(rows)]
    is_last = np.concatenate((~follows, [True]))[: len(rows)]
    low = np.stack((begins[is_first], rows[is_first]))
    high = np.stack((ends[is_first], rows[is_last] + 1))
    x, y, yaw = grid.origin.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    middle = 0.5 * grid.resolution * (low + high)
    count = middle.shape[1]
    return UprightObstacles(
        np.array([[x], [y]]) + np.array([[cos, -sin], [sin, cos]]) @ middle,
        np.full(count, yaw),
        0.5 * grid.resolution * (high - low).astype(np.float64),
        np.zeros(count),
        np.full(count, -FARTHEST),
        np.full(count, FARTHEST),
    )
