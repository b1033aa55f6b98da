"""Problem of a route search: start, goal, obstacles and the gaps to keep."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.separation import Workspace, outside_by
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap

#: Ratio of the smallest gap at the nodes to the margin [-], allowed in narrow passages
NODE_GAP_FACTOR = 0.75
PATH_GAP_FACTOR = 0.5  #: Ratio of the smallest gap between the nodes to the margin [-]
LEAST_ROOM = 1e-3  #: Gap below which the robot counts as touching, without any margin [m]
#: Gaps in addition to the margin below which a route costs more, in two steps [m]
COSTLY_GAPS = (0.05, 0.15)
#: Cost of time by the number of gaps, of margin and margin + COSTLY_GAPS, that a node violates
FACTORS = np.array([1.0, 1.25, 1.75, 3.0], dtype=np.float32)
TURNING = 0.1  #: Cost of a rotation in addition to its time, over that time [-]
MAX_OUTSIDE = 0.2  #: Largest distance by which a start may be outside of the workspace [m]


@dataclass(frozen=True)
class Rooms:
    """Gaps of a route search [m]."""

    margin: float  #: Gap that is kept where there is room
    floor: float  #: Gap that is kept everywhere on the path
    #: Gaps at the nodes: the smallest one, the margin, and the two costly ones
    levels: tuple[float, float, float, float]

    @staticmethod
    def of(margin: float) -> "Rooms":
        """Return the gaps for a margin [m]."""
        least = max(NODE_GAP_FACTOR * margin, LEAST_ROOM)
        levels = least, max(margin, least), margin + COSTLY_GAPS[0], margin + COSTLY_GAPS[1]
        return Rooms(margin, max(PATH_GAP_FACTOR * margin, 0.5 * LEAST_ROOM), levels)

    def factors(self, gap: Array) -> Array:
        """Return the cost of time (N,) at gaps (N,) [m]: FACTORS, interpolated."""
        low = np.array(self.levels) + 1e-9 * np.arange(4)  # without a margin two are equal
        return np.interp(gap, low, FACTORS[::-1].astype(np.float64))


@dataclass(frozen=True)
class RouteProblem(Validated):
    """Problem of a route from a pose to a pose around all static obstacles.

    Raises:
        InputError: A value is not finite or out of its range.
    """

    start: Annotated[Array, Shape(3)]  #: (3,) start in odom [m, m, rad]
    goal: Annotated[Array, Shape(3)]  #: (3,) goal in odom [m, m, rad], its heading on any branch
    footprint: Footprint  #: Outline of the robot
    margin: float  #: Gap that is kept around the robot where there is room [m]
    speeds: tuple[float, float]  #: Largest linear [m/s] and angular speed [rad/s]
    obstacles: Ellipses  #: All static obstacles but those of the map
    grid: GridMap | None  #: Map, or None
    #: (x_min, y_min, x_max, y_max) in odom that the robot must not leave [m]; it is widened if the
    #: start is outside of it by up to MAX_OUTSIDE.
    workspace: Workspace
    rooms: Rooms = field(init=False)  #: Gaps that follow from the margin
    #: Obstacles, and discs that cover the map's occupied cells
    around: Ellipses = field(init=False)
    #: Gaps to all of these, up to the largest relevant one
    clearance: Clearance = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, pose in (("start", self.start), ("goal", self.goal)):
            plausible.demand(pose[:2], plausible.LENGTH, f"route: {name}")
            plausible.demand(pose[2:], plausible.ANGLE, f"route: heading of the {name}")
        half = self.footprint.whole.half
        if not (half.min() >= 0.01 and half.max() <= 10.0):
            raise InputError(f"route: half extents {half.tolist()} m must be from 0.01 to 10")
        if not 0.0 <= self.margin <= 2.0:
            raise InputError(f"route: margin {self.margin} m must be from 0 to 2")
        if not all(0.0 < speed < math.inf for speed in self.speeds):
            raise InputError(f"route: speeds {self.speeds} m/s, rad/s must be above 0")
        plausible.demand(self.obstacles.centers, plausible.LENGTH, "route: obstacles")
        rooms, workspace = Rooms.of(self.margin), self._widened()
        cells = Ellipses.none() if self.grid is None else self.grid.ellipses()
        around = self.obstacles.joined(cells)
        clearance = Clearance(self.footprint, around, workspace, rooms.levels[-1] + LEAST_ROOM)
        for name, value in (
            ("workspace", workspace),
            ("rooms", rooms),
            ("around", around),
            ("clearance", clearance),
        ):
            object.__setattr__(self, name, value)

    @property
    def ends(self) -> Array:
        """Start and goal (2, 3) [m, m, rad]."""
        return np.stack([self.start, self.goal])

    @property
    def cells(self) -> Array:
        """Centres (M, 2) of the discs that cover the map's occupied cells [m]."""
        return self.around.centers[len(self.obstacles) :]

    @property
    def radius(self) -> float:
        """Radius of the disc around base_link that just covers the robot [m]."""
        return self.footprint.radius

    def room(self) -> Array:
        """Return the gaps (2,) at start and goal [m]; negative inside an occupied area."""
        result = self.clearance.gaps(self.ends)
        if self.grid is not None:
            result[self.grid.occupied_at(self.ends[:, :2])] = -1.0
        return result

    def turning(self, angles: Array) -> Array:
        """Return the cost (N,) [s] of rotations by angles (N,) [rad] in addition to their time."""
        result: Array = TURNING * np.abs(angles) / self.speeds[1]
        return result

    def _widened(self) -> Workspace:
        """Return the workspace, widened if the start is slightly outside."""
        excess = float(outside_by(self.start[None], self.footprint.whole, self.workspace)[0])
        extra = excess + LEAST_ROOM if 0.0 < excess <= MAX_OUTSIDE else 0.0
        x_min, y_min, x_max, y_max = self.workspace
        return x_min - extra, y_min - extra, x_max + extra, y_max + extra
