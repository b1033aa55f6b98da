"""Search of a route over (x, y, heading) around static obstacles, in slices of time.

The search is on a lattice of nodes and headings (`lattice`). First the occupied states are marked
(`occupancy`). Then the 2-D cost to the goal is computed over the nodes at which any heading is
free; it guides the search over (x, y, heading) (`find`, `tree`), whose result does not depend on
the slices. The path is checked and straightened with exact gaps (`straighten`).
"""

from collections.abc import Generator, Iterator

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.planning.route.find import LatticeSearch
from omniman_ros.planning.route.lattice import Lattice, LatticeFrame, Region, Work
from omniman_ros.planning.route.occupancy import HeadingOccupancy
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.route import Route, straight
from omniman_ros.planning.route.straighten import Straightener

FINEST = 120  #: Largest number of headings per revolution: half of them fit into a word
#: Largest number of headings of a robot that half a revolution changes: all fit into a word
FINEST_WHOLE = 64
#: Gap below which a start or goal may be in a slot, and lattices along it are tried [m]
SLOT = 0.1
PAD = 2.0  #: Distance around start and goal that is searched first [m]; then twice that, and so on
MAX_NODES = 4_000_000  #: Largest number of nodes of a lattice
#: Number of searches in a region, each without the nodes that were too tight before
MAX_SEARCHES = 40
PART = 50  #: Number of poses of the straight line that are checked at once


class RouteSearch:
    """Search from a pose to a pose, a slice at a time.

    Obstacles count as being at rest at their centres. A start or a goal that is closer to one than
    the margin is left or reached with the smaller gap there. A start slightly outside of the
    workspace widens it accordingly.

    Args:
        resolution: Edge of the lattice [m], or less, to fit the map's cells.
        headings: Number of headings per revolution, even, up to FINEST; there are at most
            FINEST_WHOLE where half a revolution changes the outline of the robot. If no route is
            found, both are refined by a factor of two once, as far as possible.

    Attributes:
        reason: Reason why no route was found, or an empty string.
        worked: Work that was done [expansions].

    Raises:
        InputError: A value is out of its range.
    """

    def __init__(
        self, problem: RouteProblem, resolution: float = 0.05, headings: int = FINEST
    ) -> None:
        if not 0.01 <= resolution <= 1.0:
            raise InputError(f"route: resolution {resolution} m must be from 0.01 to 1")
        if headings % 2 or not 8 <= headings <= FINEST:
            raise InputError(
                f"route: number of headings {headings} must be even and from 8 to {FINEST}"
            )
        self.problem = problem
        self._most = FINEST if problem.footprint.is_symmetric else FINEST_WHOLE
        self._resolution, self._headings = resolution, min(headings, self._most)
        self.route: Route | None = None
        self.finished = False
        self.reason = ""
        self.worked = 0
        self._left = 0
        self._work = self._run()

    @property
    def failed(self) -> bool:
        """Whether the search is finished without a route."""
        return self.finished and self.route is None

    def advance(self, nodes: int) -> bool:
        """Do the work of about `nodes` expansions, 1.5 us each; return whether it is finished.

        If one slice does too much, the next one does less.
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
        """Search the straight line, then lattices in several frames."""
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
        """Use the straight line as the route if all gaps on it are wide."""
        problem = self.problem
        line = straight(problem.start, problem.goal, problem.speeds)
        _, poses = line.samples(problem.radius)
        for k in range(0, len(poses), PART):
            gaps = problem.clearance.gaps(poses[k : k + PART])
            yield 400
            if not (gaps >= problem.rooms.levels[-1]).all():
                return
        self.route = line

    def _frames(self, room: Array) -> Iterator[tuple[LatticeFrame, int]]:
        """Yield frames to try: the usual one, those along an end in a slot, a finer one."""
        problem, edge, headings = self.problem, self._resolution, self._headings
        yield LatticeFrame.of(problem.start, problem.grid, edge), headings
        for pose, gap in zip(problem.ends, room, strict=True):
            if gap < SLOT:
                yield LatticeFrame(pose[:2], float(pose[2]), edge), headings
        yield (
            LatticeFrame.of(problem.start, problem.grid, 0.5 * edge),
            min(2 * headings, self._most),
        )

    def _on_lattice(self, frame: LatticeFrame, headings: int, room: Array) -> Work:
        """Search ever larger regions until one contains everything or its edge is not reached."""
        ends, everything = frame.own(self.problem.ends), frame.extent(self.problem)
        pad = PAD
        while True:
            region = Region.around(ends, pad, everything, frame.edge)
            if region.size > MAX_NODES:
                self.reason = f"the region to search has {region.size} nodes, too many"
                return
            lattice = Lattice(
                frame, region, headings, self.problem.ends, self.problem.footprint.is_symmetric
            )
            at_edge = yield from self._in_region(lattice, room)
            if self.route is not None or region.whole or not at_edge:
                return
            pad *= 2.0

    def _in_region(self, lattice: Lattice, room: Array) -> Generator[int, None, bool]:
        """Search one region; return whether a larger one may help if nothing was found."""
        marks = HeadingOccupancy(self.problem, lattice, room)
        yield from marks.fill()
        finder = LatticeSearch(self.problem, lattice, marks)
        yield from finder.prepare()
        straightener = Straightener(self.problem, lattice, marks)
        for _ in range(MAX_SEARCHES):
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
        self.reason = "each path that was found is too tight between the nodes"
        return finder.at_edge
