"""Search of a route over (x, y, heading) around everything that stands, in slices of time.

The floor is a lattice of nodes and headings (`route_lattice`). Where the box is free on it is
marked first (`route_marks`). Over the nodes at which any heading is free the cost to the goal is
found next, in 2-D (`route_flood`); it guides the search over (x, y, heading) (`route_find`,
`route_tree`), which finds the same whatever the slices. What it finds is checked and straightened
with exact gaps (`route_straighten`).
"""

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route import Route, straight
from omniman_ros.planning.route_find import Finder
from omniman_ros.planning.route_lattice import Frame, Lattice, Region, Work
from omniman_ros.planning.route_marks import Marks
from omniman_ros.planning.route_problem import RouteProblem
from omniman_ros.planning.route_straighten import Straightener
from omniman_ros.planning.separation import Workspace

Array = NDArray[np.float64]

UNLIMITED: Workspace = (-1e3, -1e3, 1e3, 1e3)

FINEST = 120
"""Headings a turn at most: half of them fit a word."""
SLOT = 0.1
"""A start or goal with less room may stand in a slot [m]: lattices along it are tried."""
PAD = 2.0
"""Room around start and goal that is searched first [m]; then twice that, and so on."""
MOST_NODES = 4_000_000
"""A lattice has at most so many nodes."""
RETRIES = 40
"""So often a route that is too tight between two nodes is sought anew without those."""
PART = 50
"""So many poses of the straight line are checked at once."""


class RouteSearch:
    """Search from a pose to a pose, a slice at a time.

    Obstacles stand where they are at their time. A start or a goal that is closer to one than the
    margin is left and reached with what room there is. A start that is a little outside of the
    workspace widens it by that.

    Args:
        start: (3,) in odom [m, m, rad].
        goal: (3,) in odom [m, m, rad], its heading on any branch.
        half: (2,) half length and half width of the box [m].
        margin: Gap kept around the box where there is room; never less than half of it, but near
            a start or goal that has less [m].
        speeds: Largest v and w [m/s, rad/s].
        obstacles: All that stand.
        grid: A map, if there is one; the lattice is along its axes.
        workspace: (x_min, y_min, x_max, y_max) in odom where the box must stay [m].
        resolution: Edge of the lattice [m], or less, to fit the map's cells.
        headings: Headings a turn, even, up to FINEST. Where no way is found, both are made finer
            by two once, headings up to FINEST.

    Attributes:
        problem: What is asked.
        route: What was found, or None.
        finished: Whether there is nothing more to do.
        reason: Why nothing was found, or empty.
        worked: What was done, in expansions.

    Raises:
        InputError: A value is not finite or out of its range.
    """

    def __init__(
        self,
        start: Array,
        goal: Array,
        half: Array,
        margin: float,
        speeds: tuple[float, float],
        obstacles: Ellipses | None = None,
        grid: GridMap | None = None,
        workspace: Workspace = UNLIMITED,
        resolution: float = 0.05,
        headings: int = FINEST,
    ) -> None:
        if not 0.01 <= resolution <= 1.0:
            raise InputError(f"route: resolution {resolution} m, expected 0.01 to 1")
        if headings % 2 or not 8 <= headings <= FINEST:
            raise InputError(
                f"route: {headings} headings, expected an even number of 8 to {FINEST}"
            )
        known = Ellipses.none() if obstacles is None else obstacles
        self.problem = RouteProblem(start, goal, half, margin, speeds, known, grid, workspace)
        self._resolution, self._headings = resolution, headings
        self.route: Route | None = None
        self.finished = False
        self.reason = ""
        self.worked = 0
        self._left = 0
        self._work = self._run()

    @property
    def failed(self) -> bool:
        """Whether there is no route."""
        return self.finished and self.route is None

    def advance(self, nodes: int) -> bool:
        """Do as much work as about so many expansions, 1.5 us each; whether it is finished.

        What one slice does too much the next does less.
        """
        self._left += nodes
        while self._left > 0 and not self.finished:
            try:
                done = next(self._work)
            except StopIteration:
                self.finished, self._left = True, 0
                break
            self._left -= done
            self.worked += done
        return self.finished

    def _run(self) -> Work:
        room = self.problem.room()
        yield 100
        for name, gap in zip(("start", "goal"), room, strict=True):
            if not gap > 0.0:
                self.reason = f"the {name} touches an obstacle or the workspace's edge"
                return
        yield from self._straight_on()
        if self.route is not None:
            return
        for frame, headings in self._frames(room):
            yield from self._on_lattice(frame, headings, room)
            if self.route is not None:
                return

    def _straight_on(self) -> Work:
        """The route is the straight line if there is plenty of room on it."""
        problem = self.problem
        line = straight(problem.start, problem.goal, problem.speeds)
        _, poses = line.samples(problem.half)
        for k in range(0, len(poses), PART):
            gaps = problem.clearance.gaps(poses[k : k + PART])
            yield 400
            if not (gaps >= problem.rooms.levels[-1]).all():
                return
        self.route = line

    def _frames(self, room: Array) -> Iterator[tuple[Frame, int]]:
        """Lattices to try: the usual one, those along a start or goal in a slot, a finer one."""
        problem, edge, headings = self.problem, self._resolution, self._headings
        yield Frame.of(problem.start, problem.grid, edge), headings
        for pose, gap in zip(problem.ends, room, strict=True):
            if gap < SLOT:
                yield Frame(pose[:2], float(pose[2]), edge), headings
        yield Frame.of(problem.start, problem.grid, 0.5 * edge), min(2 * headings, FINEST)

    def _on_lattice(self, frame: Frame, headings: int, room: Array) -> Work:
        """Search ever larger regions, until one holds everything or its edge is not reached."""
        ends, everything = frame.own(self.problem.ends), frame.extent(self.problem)
        pad = PAD
        while True:
            region = Region.around(ends, pad, everything, frame.edge)
            if region.size > MOST_NODES:
                self.reason = f"the region to search has {region.size} nodes, too many"
                return
            lattice = Lattice(frame, region, headings, self.problem.ends)
            at_edge = yield from self._in_region(lattice, room)
            if self.route is not None or region.whole or not at_edge:
                return
            pad *= 2.0

    def _in_region(self, lattice: Lattice, room: Array) -> Generator[int, None, bool]:
        """Search one region; whether a larger one may help where nothing was found."""
        marks = Marks(self.problem, lattice, room)
        yield from marks.fill()
        finder = Finder(self.problem, lattice, marks)
        yield from finder.prepare()
        straightener = Straightener(self.problem, lattice, marks)
        for _ in range(RETRIES):
            found = yield from finder.find()
            if found is None:
                self.reason = finder.reason
                return finder.at_edge
            checked = yield from straightener.check(found.poses)
            tight = straightener.tight(checked)
            if not len(tight):
                self.route = yield from straightener.straightened(checked)
                self.reason = ""
                return finder.at_edge
            marks.forbid(found.nodes[tight - 1], found.headings[tight - 1])
        self.reason = "what was found is too tight between the nodes"
        return finder.at_edge
