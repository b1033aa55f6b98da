"""Search over (x, y, heading) within a lattice for the states from start to goal."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.route.lattice import Lattice, Work
from omniman_ros.planning.route.occupancy import ONE, HeadingOccupancy
from omniman_ros.planning.route.problem import FACTORS, TURNING, RouteProblem
from omniman_ros.planning.route.route import durations
from omniman_ros.planning.route.tree import Queue, Tree

Single = NDArray[np.float32]  #: Array of single-precision floats, such as costs [s]
Index = NDArray[np.intp]  #: Array of indices of nodes, headings or states
Words = NDArray[np.uint64]  #: Array of words, one per node, with a bit for each heading
Mask = NDArray[np.bool_]  #: Array of flags

#: Initial weight of the cost to go relative to the cost so far [-]; above 1 the search is faster,
#: and the path is not quite optimal.
HEURISTIC_WEIGHT = 1.3
WEIGHT_GROWTH = 3e-6  #: Increase of this weight with each expansion [-]
MAX_WEIGHT = 4.0  #: Largest weight of the cost to go [-]
BATCH = 64  #: Number of states that are expanded together at first
MAX_BATCH = 1024  #: Largest number of states that are expanded together
#: Number of expansions after which a batch grows by one state: a long search must become wide
BATCH_GROWTH = 50
NODES = 20_000  #: Number of nodes that a flood fill processes at once
CHECK_AFTER = 20_000  #: Number of expansions after which the search checks whether any path exists
#: Positions at which lines between an end and the lattice are checked, over their length [-]
LINE_SAMPLES = np.linspace(0.0, 1.0, 9)[1:-1]
#: Changes of the heading in a move, in headings of the lattice
HEADING_STEPS = np.array([-1, 0, 1])


@dataclass(frozen=True)
class Found:
    """A path from the start to the goal."""

    poses: Array  #: (N, 3) poses of the lattice, both ends exact, headings not wrapped [m, m, rad]
    nodes: Index  #: (N - 2,) nodes of the poses between the ends
    headings: Index  #: (N - 2,) headings at these nodes


@dataclass(frozen=True)
class Joints:
    """Free lines between an end and the lattice."""

    nodes: Index  #: (N,) nodes where the lines meet the lattice
    headings: Index  #: (N,) headings there
    cost: Single  #: (N,) costs of the lines [s]

    def of(self, mask: Mask) -> "Joints":
        """Return the lines that a mask (N,) selects."""
        return Joints(self.nodes[mask], self.headings[mask], self.cost[mask])


class LatticeSearch:
    """Searches one lattice, and searches it again after states were forbidden.

    Attributes:
        reason: Reason why no path was found, or an empty string.
        at_edge: Whether the region's edge can be reached from the goal: a larger region may help.
    """

    def __init__(self, problem: RouteProblem, lattice: Lattice, marks: HeadingOccupancy) -> None:
        self._problem, self._lattice, self._marks = problem, lattice, marks
        self.reason = ""
        self.at_edge = False
        self._doubted = True
        v, w = problem.speeds
        turns = lattice.heading_step * np.abs(HEADING_STEPS)
        self._costs = np.maximum(lattice.step_lengths[:, None] / v, turns / w).astype(np.float32)
        self._penalty = problem.turning(turns).astype(np.float32)
        # Times to rotate to the goal's heading: a lower bound of the cost to go, as the 2-D cost.
        goal = float(lattice.ends[1, 2])
        angles = np.abs(
            [se2.wrap(lattice.heading_step * k - goal) for k in range(lattice.headings)]
        )
        self._spin = (angles / w).astype(np.float32)
        self._extra = (TURNING * (angles / w)).astype(np.float32)
        self._to_go: Single = np.zeros(0, dtype=np.float32)

    def prepare(self) -> Work:
        """Compute the 2-D cost to go; needed before `find`."""
        speed = self._problem.speeds[0]
        self._to_go = yield from cost_to_go(self._lattice, self._marks, speed)
        self.at_edge = bool(np.isfinite(self._lattice.rim(self._to_go)).any())

    def find(self) -> Generator[int, None, Found | None]:
        """Find a path; return None, and set the reason, if there is none."""
        first, last = self._joints(0), self._joints(1)
        yield 700
        if not len(first.nodes) or not len(last.nodes):
            self.reason = f"no way out of the {'goal' if len(first.nodes) else 'start'}"
            return None
        first = first.of(np.isfinite(self._to_go[first.nodes]))
        if not len(first.nodes):
            self.reason = "there is no way"
            return None
        tree = Tree(self._lattice.region.size, self._lattice.headings)
        end = yield from self._search(tree, first, last)
        if end is None:
            return None
        nodes, headings = tree.back(end, self._lattice.offsets)
        poses = self._lattice.poses(nodes, headings)
        ends = self._lattice.ends
        whole = np.concatenate([ends[:1], poses, ends[1:]])
        whole[1:, 2] = whole[0, 2] + np.cumsum(_shorter(np.diff(whole[:, 2])))
        yield len(nodes)
        return Found(whole, nodes, headings)

    def _joints(self, end: int) -> Joints:
        problem, pose = self._problem, self._lattice.ends[end]
        nodes, headings = self._lattice.near(pose)
        free = ~self._marks.taken(nodes, headings)
        nodes, headings = nodes[free], headings[free]
        if not len(nodes):
            return Joints(nodes, headings, np.zeros(0, dtype=np.float32))
        step = self._lattice.poses(nodes, headings) - pose
        step[:, 2] = _shorter(step[:, 2])
        between = (pose + LINE_SAMPLES[:, None] * step[:, None]).reshape(-1, 3)
        gaps = problem.clearance.gaps(self._lattice.frame.odom(between))
        clear = gaps >= self._marks.floor(between)
        fits = clear.reshape(len(nodes), len(LINE_SAMPLES)).all(axis=1)
        cost = durations(step, problem.speeds) + problem.turning(step[:, 2])
        return Joints(nodes[fits], headings[fits], cost[fits].astype(np.float32))

    def _search(self, tree: Tree, first: Joints, last: Joints) -> Generator[int, None, int | None]:
        """Grow the tree; return the state next to the goal on the best path, or None."""
        begin, exits = tree.ids(first.nodes, first.headings), tree.ids(last.nodes, last.headings)
        tree.begin(begin, first.cost)
        queue = Queue()
        guess = self._guess(first.nodes, first.headings)
        queue.push(first.cost / np.float32(HEURISTIC_WEIGHT) + guess, guess, begin, first.cost)
        expanded, weight = 0, HEURISTIC_WEIGHT
        while True:
            arrived = tree.cost[exits] + last.cost
            least = float(arrived.min())
            if not queue or least / weight <= queue.rank:
                break
            ids = queue.pop(min(BATCH + expanded // BATCH_GROWTH, MAX_BATCH), tree.cost)
            if not len(ids):
                yield 5
                continue
            expanded += len(ids)
            weight = min(HEURISTIC_WEIGHT + WEIGHT_GROWTH * expanded, MAX_WEIGHT)
            self._expand(ids, weight, tree, queue)
            yield 40 + len(ids)
            if expanded > CHECK_AFTER and self._doubted and not math.isfinite(least):
                self._doubted = yield from self._no_path(first, last)
                if self._doubted:
                    self.reason = "there is no way"
                    return None
        if not math.isfinite(least):
            self.reason = "there is no way at this heading"
            return None
        return int(exits[np.argmin(arrived)])

    def _guess(self, nodes: Index, headings: Index) -> Single:
        result: Single = np.maximum(self._to_go[nodes], self._spin[headings])
        return result + self._extra[headings]

    def _expand(self, ids: Index, weight: float, tree: Tree, queue: Queue) -> None:
        """Queue the successors of states whose cost is lower than before."""
        lattice, words = self._lattice, self._marks.words
        node, heading = tree.places(ids)
        beside = node[:, None] + lattice.offsets
        turned = (heading[:, None] + HEADING_STEPS) % lattice.headings
        shift = (turned % lattice.bits).astype(np.uint64)
        taken = (words[0][beside][:, :, None] >> shift[:, None, :] & ONE).astype(bool)
        # A move that also rotates must be free as a move alone and as a rotation alone.
        taken[:, :, 0] |= taken[:, :, 1] | taken[:, :1, 0]
        taken[:, :, 2] |= taken[:, :, 1] | taken[:, :1, 2]
        taken[:, 0, 1] = True
        parent, step, rotation = np.nonzero(~taken)
        next_node, next_heading = beside[parent, step], turned[parent, rotation]
        bit = shift[parent, rotation]
        level = sum((words[k][next_node] >> bit & ONE).astype(np.intp) for k in (1, 2, 3))
        move_cost = self._costs[step, rotation] * FACTORS[level]
        cost = tree.cost[ids][parent] + move_cost + self._penalty[rotation]
        cost = cost.astype(np.float32)
        new = tree.ids(next_node, next_heading)
        better = np.flatnonzero((cost < tree.cost[new]) & np.isfinite(self._to_go[next_node]))
        moves = (3 * step + rotation)[better].astype(np.int8)
        lowered = better[tree.put(new[better], cost[better], moves)]
        guess = self._guess(next_node[lowered], next_heading[lowered])
        order = cost[lowered] / np.float32(weight) + guess
        queue.push(order, guess, new[lowered], cost[lowered])

    def _no_path(self, first: Joints, last: Joints) -> Generator[int, None, bool]:
        """Return whether the goal cannot be reached; if so, set `at_edge`."""
        reached = yield from enclosed(
            self._lattice, self._marks, (first.nodes, first.headings), (last.nodes, last.headings)
        )
        if reached is None:
            return False
        self.at_edge = bool(self._lattice.rim(reached).any())
        return True


def _shorter(angles: Array) -> Array:
    """Return angles (N,) [rad] wrapped to [-pi, pi)."""
    return np.remainder(angles + math.pi, math.tau) - math.pi


def cost_to_go(
    lattice: Lattice, marks: HeadingOccupancy, speed: float
) -> Generator[int, None, Single]:
    """Return the least costs (nodes,) to the goal's position with any heading, or infinity [s].

    Args:
        speed: Largest linear speed [m/s].
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
    step_lengths = (lattice.step_lengths[1:] / speed).astype(np.float32)
    offsets = lattice.offsets[1:]
    seeds = np.unique(lattice.near(lattice.ends[1])[0])
    pool = seeds[cost[seeds] > 0.0]
    cost[pool] = 0.0
    mark = np.zeros(size, dtype=np.int32)
    width = 1.5 * float(step_lengths.min())
    while len(pool):
        order = cost[pool]
        now = order < order.min() + width
        front, pool = pool[now], pool[~now]
        mark[front] = np.arange(len(front), dtype=np.int32)
        front = front[mark[front] == np.arange(len(front))]  # without repeats
        value = (cost[front, None] + factor[front, None] * step_lengths).ravel()
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
    """Return the headings (nodes,) that are reached from the last; None if there is a path.

    It is sought from nodes (N,) and headings (N,) to others. Opposite headings count as the same.
    All headings of a node are processed at once, which is much cheaper than an exhausted search.
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
