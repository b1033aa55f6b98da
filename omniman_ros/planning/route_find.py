"""The search over (x, y, heading) within a lattice: which states lead from start to goal."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.planning.route import durations
from omniman_ros.planning.route_flood import cost_to_go, enclosed
from omniman_ros.planning.route_lattice import Lattice, Work
from omniman_ros.planning.route_marks import ONE, Marks
from omniman_ros.planning.route_problem import FACTORS, TURNING, RouteProblem
from omniman_ros.planning.route_tree import Queue, Tree

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

WEIGHT, HASTE, LARGEST_WEIGHT = 1.3, 3e-6, 4.0
"""Of the cost to go against the cost so far in the order of the search: above 1 it is quicker, and
not quite the best way; by how much it grows with each expansion, and its limit."""
BATCH, LARGEST_BATCH = 64, 1024
"""States that are expanded together, at first and at most."""
GROWTH = 50
"""Expansions by which a batch grows by one: what is not found soon needs a wide search."""
DOUBT = 20_000
"""Expansions after which it is checked that there is a way at all."""
SHARES = np.linspace(0.0, 1.0, 9)[1:-1]
"""Where the lines from an end to the lattice are checked."""
SIDES = np.array([-1, 0, 1])
"""By how many headings a move turns."""


@dataclass(frozen=True)
class Found:
    """A way from the start to the goal.

    Attributes:
        poses: (N, 3) of the lattice, both ends exact, headings not wrapped [m, m, rad].
        nodes: (N - 2,) of those between the ends.
        headings: (N - 2,) of these.
    """

    poses: Array
    nodes: Index
    headings: Index


@dataclass(frozen=True)
class Joints:
    """Free lines between an end and the lattice.

    Attributes:
        nodes: (N,) where they meet it.
        headings: (N,) there.
        cost: (N,) of the lines [s].
    """

    nodes: Index
    headings: Index
    cost: Single

    def of(self, mask: Mask) -> "Joints":
        """Those of a mask (N,)."""
        return Joints(self.nodes[mask], self.headings[mask], self.cost[mask])


class Finder:
    """Searches in one lattice; again, where states were forbidden since.

    Args:
        problem: What is asked.
        lattice: The states.
        marks: Where the box is free; filled before anything is looked for.

    Attributes:
        reason: Why nothing was found.
        at_edge: Whether the region's edge can be reached from the goal: a larger one may help.
    """

    def __init__(self, problem: RouteProblem, lattice: Lattice, marks: Marks) -> None:
        self._problem, self._lattice, self._marks = problem, lattice, marks
        self.reason = ""
        self.at_edge = False
        self._doubted = True
        v, w = problem.speeds
        turns = lattice.turn * np.abs(SIDES)
        self._costs = np.maximum(lattice.ways[:, None] / v, turns / w).astype(np.float32)
        self._penalty = problem.turning(turns).astype(np.float32)
        # Times to turn to the goal's heading: a bound of the cost to go, as is that by the places.
        goal = float(lattice.ends[1, 2])
        off = np.abs([se2.wrap(lattice.turn * k - goal) for k in range(lattice.headings)])
        self._spin = (off / w).astype(np.float32)
        self._extra = (TURNING * (off / w)).astype(np.float32)
        self._to_go: Single = np.zeros(0, dtype=np.float32)

    def prepare(self) -> Work:
        """Find the cost to go by the places, before anything else."""
        speed = self._problem.speeds[0]
        self._to_go = yield from cost_to_go(self._lattice, self._marks, speed)
        self.at_edge = bool(np.isfinite(self._lattice.rim(self._to_go)).any())

    def find(self) -> Generator[int, None, Found | None]:
        """Find a way; None, and the reason, where there is none."""
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
        """Those of the start, 0, or the goal, 1."""
        problem, pose = self._problem, self._lattice.ends[end]
        nodes, headings = self._lattice.near(pose)
        free = ~self._marks.taken(nodes, headings)
        nodes, headings = nodes[free], headings[free]
        if not len(nodes):
            return Joints(nodes, headings, np.zeros(0, dtype=np.float32))
        step = self._lattice.poses(nodes, headings) - pose
        step[:, 2] = _shorter(step[:, 2])
        between = (pose + SHARES[:, None] * step[:, None]).reshape(-1, 3)
        gaps = problem.clearance.gaps(self._lattice.frame.odom(between))
        clear = gaps >= self._marks.floor(between)
        fits = clear.reshape(len(nodes), len(SHARES)).all(axis=1)
        cost = durations(step, problem.speeds) + problem.turning(step[:, 2])
        return Joints(nodes[fits], headings[fits], cost[fits].astype(np.float32))

    def _search(self, tree: Tree, first: Joints, last: Joints) -> Generator[int, None, int | None]:
        """Fill the tree; the state next to the goal that the best way comes by, or None."""
        begin, exits = tree.ids(first.nodes, first.headings), tree.ids(last.nodes, last.headings)
        tree.begin(begin, first.cost)
        queue = Queue()
        guess = self._guess(first.nodes, first.headings)
        queue.push(first.cost / np.float32(WEIGHT) + guess, guess, begin, first.cost)
        expanded, weight = 0, WEIGHT
        while True:
            arrived = tree.cost[exits] + last.cost
            least = float(arrived.min())
            if not queue or least / weight <= queue.rank:
                break
            ids = queue.pop(min(BATCH + expanded // GROWTH, LARGEST_BATCH), tree.cost)
            if not len(ids):
                yield 5
                continue
            expanded += len(ids)
            weight = min(WEIGHT + HASTE * expanded, LARGEST_WEIGHT)
            self._expand(ids, weight, tree, queue)
            yield 40 + len(ids)
            if expanded > DOUBT and self._doubted and not math.isfinite(least):
                self._doubted = yield from self._no_way(first, last)
                if self._doubted:
                    self.reason = "there is no way"
                    return None
        if not math.isfinite(least):
            self.reason = "there is no way at this heading"
            return None
        return int(exits[np.argmin(arrived)])

    def _guess(self, nodes: Index, headings: Index) -> Single:
        """Cost to go (N,) from states [s]."""
        result: Single = np.maximum(self._to_go[nodes], self._spin[headings])
        return result + self._extra[headings]

    def _expand(self, ids: Index, weight: float, tree: Tree, queue: Queue) -> None:
        """Queue what is reached from these states at less cost than so far."""
        lattice, words = self._lattice, self._marks.words
        node, heading = tree.places(ids)
        beside = node[:, None] + lattice.offsets
        turned = (heading[:, None] + SIDES) % lattice.headings
        shift = (turned % lattice.bits).astype(np.uint64)
        taken = (words[0][beside][:, :, None] >> shift[:, None, :] & ONE).astype(bool)
        # A move that also turns must be free as a move alone and as a turn alone.
        taken[:, :, 0] |= taken[:, :, 1] | taken[:, :1, 0]
        taken[:, :, 2] |= taken[:, :, 1] | taken[:, :1, 2]
        taken[:, 0, 1] = True
        which, way, side = np.nonzero(~taken)
        there, then, bit = beside[which, way], turned[which, side], shift[which, side]
        level = sum((words[k][there] >> bit & ONE).astype(np.intp) for k in (1, 2, 3))
        price = self._costs[way, side] * FACTORS[level]
        cost = (tree.cost[ids][which] + price + self._penalty[side]).astype(np.float32)
        new = tree.ids(there, then)
        better = np.flatnonzero((cost < tree.cost[new]) & np.isfinite(self._to_go[there]))
        moves = (3 * way + side)[better].astype(np.int8)
        won = better[tree.put(new[better], cost[better], moves)]
        guess = self._guess(there[won], then[won])
        queue.push(cost[won] / np.float32(weight) + guess, guess, new[won], cost[won])

    def _no_way(self, first: Joints, last: Joints) -> Generator[int, None, bool]:
        """Whether the goal can't be reached at all, and the region's edge from it."""
        reached = yield from enclosed(
            self._lattice, self._marks, (first.nodes, first.headings), (last.nodes, last.headings)
        )
        if reached is None:
            return False
        self.at_edge = bool(self._lattice.rim(reached).any())
        return True


def _shorter(angles: Array) -> Array:
    """Angles (N,) turned the shorter way round [rad]."""
    return np.remainder(angles + math.pi, math.tau) - math.pi
