"""Bookkeeping of a search: the least costs so far and how they came, and what is to do next."""

import heapq
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
Index = NDArray[np.intp]
Moves = NDArray[np.int8]
Mask = NDArray[np.bool_]

BAND = 0.1
"""States whose order differs by less than this are of one rank [s]."""
FIRST_ROWS = 1024
"""A tree has memory for so many nodes at first."""


class Tree:
    """States (node, heading) that were reached; a row of all headings for each node that was.

    A state's number is that of its row times the headings plus its heading. A move's number is
    three times its way's plus 0, 1, 2 where the heading goes back, stays, goes on by one.

    Args:
        nodes: Nodes there are.
        headings: Headings at each.

    Attributes:
        cost: (rows * headings,) the least so far by the state's number [s]; infinity where it
            was not reached.
    """

    def __init__(self, nodes: int, headings: int) -> None:
        self._headings = headings
        self._row = np.full(nodes, -1, dtype=np.int32)
        self._node = np.zeros(FIRST_ROWS, dtype=np.intp)
        self._rows = 0
        self.cost = np.full(FIRST_ROWS * headings, np.inf, dtype=np.float32)
        self._move = np.full(FIRST_ROWS * headings, -1, dtype=np.int8)

    def ids(self, nodes: Index, headings: Index) -> Index:
        """Numbers (N,) of states, of new ones too."""
        row = self._row[nodes]
        if (row < 0).any():
            self._add(np.unique(nodes[row < 0]))
            row = self._row[nodes]
        result: Index = row.astype(np.intp) * self._headings + headings
        return result

    def places(self, ids: Index) -> tuple[Index, Index]:
        """Nodes (N,) and headings (N,) of states."""
        row, heading = np.divmod(ids, self._headings)
        return self._node[row], heading

    def begin(self, ids: Index, cost: Single) -> None:
        """Note the costs (N,) [s] of states that paths begin at, each once."""
        self.put(ids, cost, np.full(len(ids), -1, dtype=np.int8))

    def put(self, ids: Index, cost: Single, moves: Moves) -> Mask:
        """Note costs (N,) [s] and the moves (N,) that led there; which are the least now."""
        np.minimum.at(self.cost, ids, cost)
        won: Mask = self.cost[ids] == cost
        self._move[ids[won]] = moves[won]
        return won

    def back(self, state: int, offsets: Index) -> tuple[Index, Index]:
        """Nodes and headings (N,) from where a path began to a state.

        Args:
            state: Its number.
            offsets: By which the node's number changes, by the way's.
        """
        nodes, headings = [], []
        row, heading = divmod(state, self._headings)
        node = int(self._node[row])
        while True:
            nodes.append(node)
            headings.append(heading)
            move = int(self._move[int(self._row[node]) * self._headings + heading])
            if move < 0:
                break
            way, side = divmod(move, 3)
            node -= int(offsets[way])
            heading = (heading - (side - 1)) % self._headings
        return np.array(nodes[::-1], dtype=np.intp), np.array(headings[::-1], dtype=np.intp)

    def _add(self, nodes: Index) -> None:
        """Make rows for nodes, each once; the memory at least doubles where it is full."""
        count = self._rows + len(nodes)
        if count > len(self._node):
            more = 2 * count - len(self._node)
            states = more * self._headings
            self._node = np.append(self._node, np.zeros(more, dtype=np.intp))
            self.cost = np.append(self.cost, np.full(states, np.inf, dtype=np.float32))
            self._move = np.append(self._move, np.full(states, -1, dtype=np.int8))
        self._row[nodes] = np.arange(self._rows, count, dtype=np.int32)
        self._node[self._rows : count] = nodes
        self._rows = count


class Queue:
    """States in the order of their rank, in bands of BAND [s]."""

    def __init__(self) -> None:
        self._bands: dict[int, list[tuple[Single, Index, Single]]] = {}
        self._heap: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    @property
    def rank(self) -> float:
        """Nothing in it is before this [s]."""
        return BAND * self._heap[0]

    def push(self, order: Single, guess: Single, ids: Index, cost: Single) -> None:
        """Add states.

        Args:
            order: (N,) the less the sooner [s].
            guess: (N,) cost to go [s].
            ids: (N,) their numbers.
            cost: (N,) cost up to there [s].
        """
        band = (order / BAND).astype(np.intp)
        for k in _distinct(band):
            here = band == k
            self._add(k, (guess[here], ids[here], cost[here]))

    def pop(self, size: int, least: Single) -> Index:
        """Take states of the first band, each once; at most so many, the nearest to the goal.

        Args:
            size: How many.
            least: Costs by the state's number [s]; who has another has found a better way since,
                and is dropped.

        Returns:
            (N,) their numbers; none where all were dropped.
        """
        band = heapq.heappop(self._heap)
        parts = self._bands.pop(band)
        guess, ids, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
        now = least[ids] == cost
        guess, ids, cost = guess[now], ids[now], cost[now]
        if len(ids) > size:
            order = np.argpartition(guess, size)
            late = order[size:]
            self._add(band, (guess[late], ids[late], cost[late]))
            ids = ids[order[:size]]
        result: Index = np.unique(ids)
        return result

    def _add(self, band: int, part: tuple[Single, Index, Single]) -> None:
        if band not in self._bands:
            self._bands[band] = []
            heapq.heappush(self._heap, band)
        self._bands[band].append(part)


def _distinct(values: Index) -> Iterator[int]:
    """Each value once, the least first."""
    if len(values):
        low = int(values.min())
        yield from (np.flatnonzero(np.bincount(values - low)) + low).tolist()
