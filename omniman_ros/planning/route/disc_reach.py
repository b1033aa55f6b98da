"""Where a disc within the robot can get to: what a route cannot reach is known at once."""

import math

import numpy as np

from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.upright_obstacles import Mask
from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.separation import Workspace
from omniman_ros.surroundings.ellipses import Ellipses

EDGE = 0.05  #: Distance from a node to the next [m]


def reached_by_disc(
    start: Array, ends: Array, radius: float, discs: Ellipses, workspace: Workspace
) -> Mask:
    """Return which ends (n, 2) a disc may reach from a start (2,) without touching discs.

    No end that it can reach is left out: a node is occupied only if the disc touches something
    wherever it is nearest to that node.

    Args:
        radius: Radius of the disc [m].
        workspace: Sides that its middle does not leave [m].
    """
    low, high = np.array(workspace[:2]), np.array(workspace[2:])
    shape = np.ceil((high - low) / EDGE).astype(np.intp) + 1
    is_free: Mask = np.ones(shape, dtype=bool)
    reach = discs.semi_axes.min(axis=1) + radius - EDGE * math.sqrt(0.5)
    places = (discs.centers - low) / EDGE
    for (x, y), r in zip(places.tolist(), (reach / EDGE).tolist(), strict=True):
        if r <= 0.0:
            continue
        i, j = max(math.ceil(x - r), 0), max(math.ceil(y - r), 0)
        part = is_free[i : max(math.floor(x + r) + 1, 0), j : max(math.floor(y + r) + 1, 0)]
        dx = np.arange(i, i + part.shape[0]) - x
        dy = np.arange(j, j + part.shape[1]) - y
        part &= dx[:, None] ** 2 + dy**2 >= r * r

    wide = np.pad(is_free, 1)  # with a border that is never free
    row = wide.shape[1]
    left = wide.ravel()  # the nodes that are free and not reached yet
    steps = np.array([-row - 1, -row, -row + 1, -1, 1, row - 1, row, row + 1])
    owner = np.zeros(left.shape, dtype=np.intp)

    def numbers(points: Array) -> Indices:
        at = np.round((points - low) / EDGE).astype(np.intp)
        x, y = np.clip(at, 0, shape - 1).T + 1
        result: Indices = x * row + y
        return result

    reached: Mask = np.zeros(left.shape, dtype=bool)
    edge = numbers(start[None])
    while len(edge):
        reached[edge], left[edge] = True, False
        near = (edge[:, None] + steps).ravel()
        near = near[left[near]]
        owner[near] = np.arange(len(near))  # of several equal numbers, one is kept
        edge = near[owner[near] == np.arange(len(near))]
    result: Mask = reached[numbers(ends)]
    return result
