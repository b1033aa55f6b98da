"""Search in space-time: propagates the reachable nodes layer by layer, then traces a path back."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.space_time_masks import Words
from omniman_ros.lab.studies.space_time_nodes import ESCAPE_CELLS, Node, SearchNodes

CHECKPOINT_LAYERS = 32
"""Number of layers from one stored layer to the next; layers in between are computed again when a
path is traced back."""
ESCAPE_TURNS = 2
"""Largest rotation of the first move of a robot that is nearer to an obstacle than nodes may be
[headings]."""


@dataclass(frozen=True)
class TimedPath:
    """A timed path of the robot: poses, and motion at a constant velocity from each to the next.

    Attributes:
        times: (K,) times [s].
        poses: (K, 3) poses in odom, headings not wrapped [m, m, rad].
    """

    times: Array
    poses: Array

    @property
    def speeds(self) -> tuple[float, float]:
        """Largest speed [m/s] and largest yaw rate [rad/s]."""
        steps = np.abs(np.diff(self.poses, axis=0)) / np.diff(self.times)[:, None]
        drive = np.hypot(steps[:, 0], steps[:, 1])
        return float(drive.max(initial=0.0)), float(steps[:, 2].max(initial=0.0))


EMPTY_PATH = TimedPath(np.empty(0), np.empty((0, 3)))
"""A path without poses."""


class ReachSearch:
    """Searches for a path along the nodes that the robot can reach from its start.

    Args:
        nodes: The nodes and the steps between them.

    Attributes:
        seeds: Nodes from which the search begins, by layer: the start or, if it is nearer to a
            body than nodes may be, the nodes that the robot reaches by a first move without
            contact.
    """

    def __init__(self, nodes: SearchNodes) -> None:
        self.nodes = nodes
        self.seeds: dict[int, set[Node]] = {}
        self._seed()

    def _seed(self) -> None:
        """Find the seeds; there is none if every first move leads to a contact."""
        nodes = self.nodes
        at_home = nodes.empty()
        nodes.add(at_home, nodes.home)
        if nodes.free_at(at_home, 0).any():
            self.seeds[0] = {nodes.home}
            return
        _, row, column = nodes.home
        free: dict[int, Words] = {}
        size = range(-ESCAPE_CELLS, ESCAPE_CELLS + 1)
        turns = range(-ESCAPE_TURNS, ESCAPE_TURNS + 1)
        for i, j, k in ((i, j, k) for i in size for j in size for k in turns):
            if i * i + j * j > ESCAPE_CELLS**2:
                continue
            layer = self._escape_layer(i, j, k)
            node = (k % nodes.grid.headings, row + i, column + j)
            if layer >= len(nodes.times) or not nodes.is_inside(node):
                continue
            if layer not in free:
                full = np.full(nodes.shape, ~np.uint64(0), dtype=np.uint64)
                free[layer] = nodes.free_at(full, layer)
            if nodes.contains(free[layer], node) and self._escapes(layer, node):
                self.seeds.setdefault(layer, set()).add(node)

    def _escape_layer(self, rows: int, columns: int, turns: int) -> int:
        """Return the first layer by which a move by cells and headings can be complete."""
        nodes = self.nodes
        drive = math.hypot(rows, columns) * nodes.grid.cell / nodes.mover.speed
        turn = abs(turns) * nodes.grid.angle / nodes.mover.yaw_rate
        return max(math.ceil(max(drive, turn) / nodes.step - 1e-9), 1)

    def _escapes(self, layer: int, node: Node) -> bool:
        """Return whether the robot touches nothing on a first move to a node in a layer."""
        nodes = self.nodes
        return nodes.is_clear(
            np.array([nodes.times[0], nodes.times[layer]]),
            np.stack((nodes.start, nodes.pose(node))),
        )

    # ---- forward ----------------------------------------------------------------------------

    def run(self, goal: Array | None = None) -> TimedPath | None:
        """Search for a path.

        Args:
            goal: (3,) pose to reach in odom at any time [m, m, rad]; None to reach any node of the
                last layer.

        Returns:
            The path; None if there is none on this grid.
        """
        if not self.seeds:
            return None
        nodes = self.nodes
        state = nodes.empty()
        for node in self.seeds.get(0, ()):
            nodes.add(state, node)
        stored = {0: state}
        last = len(nodes.times) - 1
        for layer in range(last + 1):
            if layer:
                before, state = state, self.advance(state, layer - 1)
                if layer % CHECKPOINT_LAYERS == 0:
                    stored[layer] = state
                if layer > max(self.seeds) and self._is_exhausted(before, state, goal):
                    return None
            end = None if goal is None else self._arrival(layer, state, goal)
            if end is not None:
                return self._trace_back(stored, layer, *end)
        if goal is not None or not state.any():
            return None
        return self._trace_back(stored, last, _first_node(state), EMPTY_PATH)

    def advance(self, state: Words, layer: int) -> Words:
        """Return the state of the layer that follows a state's layer, including its seeds."""
        result = self.nodes.advance(state, layer)
        for node in self.seeds.get(layer + 1, ()):
            self.nodes.add(result, node)
        return result

    def _is_exhausted(self, before: Words, state: Words, goal: Array | None) -> bool:
        """Return whether no later layer can contain a node that this one does not."""
        if not state.any():
            return True
        unchanging = goal is not None and not self.nodes.moving
        return unchanging and np.array_equal(before, state)

    def _arrival(self, layer: int, state: Words, goal: Array) -> tuple[Node, TimedPath] | None:
        """Return a node of a layer's state and the move from it to the goal, or None."""
        for node in self._nodes_around(goal):
            if self.nodes.contains(state, node):
                move = self._final_move(layer, node, goal)
                if move is not None:
                    return node, move
        return None

    def _nodes_around(self, pose: Array) -> list[Node]:
        """Return the up to eight nodes that surround a pose in x, y and heading."""
        nodes = self.nodes
        turns = (pose[2] - nodes.start[2]) / nodes.grid.angle
        column, row = ((pose[:2] - nodes.origin) / nodes.grid.cell).tolist()
        around = [
            (i % nodes.grid.headings, j, k)
            for i in {math.floor(turns), math.ceil(turns)}
            for j in {math.floor(row), math.ceil(row)}
            for k in {math.floor(column), math.ceil(column)}
        ]
        return [node for node in around if nodes.is_inside(node)]

    def _final_move(self, layer: int, node: Node, goal: Array) -> TimedPath | None:
        """Return the move from a node of a layer to the goal; None if there is no such move."""
        nodes = self.nodes
        pose, end = nodes.pose(node), goal.copy()
        end[2] = pose[2] + math.remainder(goal[2] - pose[2], math.tau)
        move = np.abs(end - pose)
        duration = max(math.hypot(*move[:2]) / nodes.mover.speed, move[2] / nodes.mover.yaw_rate)
        if duration < 1e-9:
            return EMPTY_PATH
        now = float(nodes.times[layer])
        times = np.array([now, now + duration])
        if times[1] <= nodes.until + 1e-9 and nodes.is_clear(times, np.stack((pose, end))):
            return TimedPath(times[1:], end[None])
        return None

    # ---- backward ---------------------------------------------------------------------------

    def _trace_back(
        self, stored: dict[int, Words], layer: int, node: Node, tail: TimedPath
    ) -> TimedPath:
        """Return the path from the start to a node of a layer, followed by a tail.

        Layers between two stored layers are computed again.

        Args:
            stored: States of the stored layers.
            layer: Index of the node's layer.
            node: The node.
            tail: Move that follows the node.
        """
        path, layers = [node], [layer]
        block: list[Words] = []
        begin = layer + 1
        while layer > 0 and node not in self.seeds.get(layer, ()):
            layer -= 1
            if layer < begin:
                top, begin = layer, layer - layer % CHECKPOINT_LAYERS
                block = [stored[begin]]
                for i in range(begin, top):
                    block.append(self.advance(block[-1], i))
            node = self._predecessor(block[layer - begin], node)
            path.append(node)
            layers.append(layer)
        nodes = self.nodes
        times: Array = nodes.times[layers[::-1]]
        poses = np.array([nodes.pose(n) for n in path[::-1]])
        if layers[-1] > 0:  # prepend the start, from which a first move leads to a seed
            times = np.concatenate((nodes.times[:1], times))
            poses = np.concatenate((nodes.start[None], poses))
        times, poses = np.concatenate((times, tail.times)), np.concatenate((poses, tail.poses))
        poses[:, 2] = np.unwrap(poses[:, 2])
        return TimedPath(times, poses)

    def _predecessor(self, state: Words, node: Node) -> Node:
        """Return the node of a state from which a step leads to a node.

        Of all such nodes, the one that requires the smallest rotation is returned and, among
        these, the nearest.
        """
        nodes = self.nodes
        heading, row, column = node
        moves = [
            (i, j)
            for i in range(-nodes.reach, nodes.reach + 1)
            for j in range(-nodes.widths[abs(i)], nodes.widths[abs(i)] + 1)
        ]
        moves.sort(key=lambda move: move[0] ** 2 + move[1] ** 2)
        for turn in sorted(range(-nodes.turn, nodes.turn + 1), key=abs):
            for i, j in moves:
                before = ((heading + turn) % nodes.grid.headings, row + i, column + j)
                in_place = turn == 0 or (i, j) == (0, 0)
                if nodes.contains(state, before) and (in_place or nodes.may_turn(before, node)):
                    return before
        raise AssertionError(f"node {node} has no predecessor")


def _first_node(state: Words) -> Node:
    """Return the first node that a state contains; the state must not be empty."""
    word, row, column = (int(i[0]) for i in np.nonzero(state))
    bits = int(state[word, row, column])
    return 64 * word + (bits & -bits).bit_length() - 1, row, column
