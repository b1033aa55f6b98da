"""Flood fills over the nodes of a lattice, all headings of a node at once."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.route.lattice import Lattice
from omniman_ros.planning.route.occupancy import ONE, HeadingOccupancy
from omniman_ros.planning.route.problem import FACTORS

Single = NDArray[np.float32]  #: Array of single-precision floats: costs [s]
Index = NDArray[np.intp]  #: Array of indices of nodes or headings
Words = NDArray[np.uint64]  #: Array of words, one per node, with a bit for each heading

NODES = 20_000  #: Number of nodes that are processed at once


def cost_to_go(
    lattice: Lattice, marks: HeadingOccupancy, speed: float
) -> Generator[int, None, Single]:
    """Return the lowest cost from each node to the goal's position if any heading is allowed.

    Args:
        speed: Largest linear speed [m/s].

    Returns:
        (nodes,) costs [s]; infinity where there is no path.
    """
    words, full, size = marks.words, marks.full, lattice.region.size
    factor = np.full(size, FACTORS[0])
    cost = np.full(size, np.inf, dtype=np.float32)
    for first in range(0, size, NODES):
        part = slice(first, first + NODES)
        for level in (3, 2, 1):
            factor[part][(words[level, part] | words[0, part]) == full] = FACTORS[4 - level]
        cost[part][words[0, part] == full] = -1.0  # no cost is lower: the node is never entered
        yield 1000
    ways = (lattice.ways[1:] / speed).astype(np.float32)
    offsets = lattice.offsets[1:]
    seeds = np.unique(lattice.near(lattice.ends[1])[0])
    pool = seeds[cost[seeds] > 0.0]
    cost[pool] = 0.0
    mark = np.zeros(size, dtype=np.int32)
    width = 1.5 * float(ways.min())
    while len(pool):
        order = cost[pool]
        now = order < order.min() + width
        front, pool = pool[now], pool[~now]
        mark[front] = np.arange(len(front), dtype=np.int32)
        front = front[mark[front] == np.arange(len(front))]  # without repeats
        value = (cost[front, None] + factor[front, None] * ways).ravel()
        beside = (front[:, None] + offsets).ravel()
        better = value < cost[beside]
        beside, value = beside[better], value[better]
        np.minimum.at(cost, beside, value)
        pool = np.concatenate([pool, beside[cost[beside] == value]])
        yield 15 + len(front) // 4
    cost[cost < 0.0] = np.inf
    return cost


def enclosed(
    lattice: Lattice,
    marks: HeadingOccupancy,
    first: tuple[Index, Index],
    last: tuple[Index, Index],
) -> Generator[int, None, Words | None]:
    """Check whether there is no path from first to last; opposite headings count as the same.

    All headings of a node are processed at once, which is much cheaper than an exhausted search.

    Args:
        first: Nodes (N,) and headings (N,) where paths begin.
        last: Nodes (N,) and headings (N,) where they end.

    Returns:
        None if there is a path, else the headings (nodes,) that are reached from the last.
    """
    free = ~marks.words[0] & marks.full
    reached = np.zeros(lattice.region.size, dtype=np.uint64)
    np.bitwise_or.at(reached, last[0], ONE << (last[1] % lattice.bits).astype(np.uint64))
    front = np.unique(last[0])
    goals = ONE << (first[1] % lattice.bits).astype(np.uint64)
    end = np.uint64(lattice.bits - 1)
    while len(front):
        word = reached[front]
        word = word | (word << ONE | word >> end) | (word >> ONE | word << end)
        touched = []
        for offset in lattice.offsets:
            beside = front + offset
            grown = word & free[beside] & ~reached[beside]
            fresh = grown != 0
            beside = beside[fresh]
            reached[beside] |= grown[fresh]
            touched.append(beside)
        front = np.unique(np.concatenate(touched))
        if (reached[first[0]] & goals).any():
            return None
        yield 40 + len(front) // 6
    return reached
