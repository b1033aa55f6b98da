"""Bookkeeping of a search: lowest costs so far, the moves to them, and the queue."""

import heapq
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]  #: Array of single-precision floats: costs [s]
Index = NDArray[np.intp]  #: Array of numbers of nodes, headings or states
Moves = NDArray[np.int8]  #: Array of numbers of moves, -1 at the beginning of a path
Mask = NDArray[np.bool_]  #: Array of flags

BAND = 0.1  #: Width of the bands of cost in which the queue does not sort [s]
FIRST_ROWS = 1024  #: Initial number of nodes for which a tree has memory


class Tree:
    """States (node, heading) that were reached; each reached node has a row of all headings.

    The number of a state is its row times the number of headings plus its heading; its least cost
    so far [s] is infinite if it was not reached. The number of a move is three times that of its
    step, plus 0, 1 or 2 if the heading decreases by one, stays, or increases by one.
    """

    def __init__(self, nodes: int, headings: int) -> None:
        self._headings = headings
        self._row = np.full(nodes, -1, dtype=np.int32)
        self._node = np.zeros(FIRST_ROWS, dtype=np.intp)
        self._rows = 0
        self.cost = np.full(FIRST_ROWS * headings, np.inf, dtype=np.float32)
        self._move = np.full(FIRST_ROWS * headings, -1, dtype=np.int8)

    def ids(self, nodes: Index, headings: Index) -> Index:
        """Return the numbers (N,) of states; new ones get a number."""
        row = self._row[nodes]
        if (row < 0).any():
            self._add(np.unique(nodes[row < 0]))
            row = self._row[nodes]
        result: Index = row.astype(np.intp) * self._headings + headings
        return result

    def places(self, ids: Index) -> tuple[Index, Index]:
        """Return nodes (N,) and headings (N,) of states."""
        row, heading = np.divmod(ids, self._headings)
        return self._node[row], heading

    def begin(self, ids: Index, cost: Single) -> None:
        """Set the costs (N,) [s] of states at which paths begin, each once."""
        self.put(ids, cost, np.full(len(ids), -1, dtype=np.int8))

    def put(self, ids: Index, cost: Single, moves: Moves) -> Mask:
        """Lower costs (N,) [s] and set their moves (N,); return the mask of the lowest costs."""
        np.minimum.at(self.cost, ids, cost)
        lowest: Mask = self.cost[ids] == cost
        self._move[ids[lowest]] = moves[lowest]
        return lowest

    def back(self, state: int, offsets: Index) -> tuple[Index, Index]:
        """Return nodes and headings (N,) on the path to a state, by the offsets of the steps."""
        nodes, headings = [], []
        row, heading = divmod(state, self._headings)
        node = int(self._node[row])
        while True:
            nodes.append(node)
            headings.append(heading)
            move = int(self._move[int(self._row[node]) * self._headings + heading])
            if move < 0:
                break
            step, rotation = divmod(move, 3)
            node -= int(offsets[step])
            heading = (heading - (rotation - 1)) % self._headings
        return np.array(nodes[::-1], dtype=np.intp), np.array(headings[::-1], dtype=np.intp)

    def _add(self, nodes: Index) -> None:
        """Add rows for nodes, each once; the memory at least doubles if it is full."""
        count = self._rows + len(nodes)
        if count > len(self._node):
            extra = 2 * count - len(self._node)
            states = extra * self._headings
            self._node = np.append(self._node, np.zeros(extra, dtype=np.intp))
            self.cost = np.append(self.cost, np.full(states, np.inf, dtype=np.float32))
            self._move = np.append(self._move, np.full(states, -1, dtype=np.int8))
        self._row[nodes] = np.arange(self._rows, count, dtype=np.int32)
        self._node[self._rows : count] = nodes
        self._rows = count


class Queue:
    """Priority queue of states, sorted into bands of BAND [s]."""

    def __init__(self) -> None:
        self._bands: dict[int, list[tuple[Single, Index, Single]]] = {}
        self._heap: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    @property
    def rank(self) -> float:
        """Lower bound of the order of all queued states [s]."""
        return BAND * self._heap[0]

    def push(self, order: Single, guess: Single, ids: Index, cost: Single) -> None:
        """Add N states by order in the queue and guess of the cost to go, least first [s]."""
        band = (order / BAND).astype(np.intp)
        for k in _distinct(band):
            here = band == k
            self._add(k, (guess[here], ids[here], cost[here]))

    def pop(self, size: int, least: Single) -> Index:
        """Remove (N,) states from the first band, each once; if too many, the nearest to the goal.

        A state with another cost than its least was reached on a better path since, and is
        dropped.
        """
        band = heapq.heappop(self._heap)
        parts = self._bands.pop(band)
        guess, ids, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
        valid = least[ids] == cost
        guess, ids, cost = guess[valid], ids[valid], cost[valid]
        if len(ids) > size:
            order = np.argpartition(guess, size)
            late = order[size:]
            self._add(band, (guess[late], ids[late], cost[late]))
            ids = ids[order[:size]]
        result: Index = np.unique(ids)
        return result

    def _add(self, band: int, part: tuple[Single, Index, Single]) -> None:
        """Add cost to go, numbers and costs of states to a band."""
        if band not in self._bands:
            self._bands[band] = []
            heapq.heappush(self._heap, band)
        self._bands[band].append(part)


def _distinct(values: Index) -> Iterator[int]:
    if len(values):
        low = int(values.min())
        yield from (np.flatnonzero(np.bincount(values - low)) + low).tolist()
