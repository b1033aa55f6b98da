"""What a search for a route is asked: from where to where, around what, and how close."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.route import Clearance
from omniman_ros.planning.separation import Workspace, outside_by

Array = NDArray[np.float64]

LEAST_SHARE = 0.75
"""Of the margin is kept at the nodes at least: routes may be so tight where they must ..."""
FLOOR_SHARE = 0.5
"""... and on the way between the nodes so much of it."""
LEAST_ROOM = 1e-3
"""Gap below which the box counts as touching, without any margin [m]."""
DEAR = (0.05, 0.15)
"""Gaps beyond the margin below which a route is dearer [m]."""
FACTORS = np.array([1.0, 1.25, 1.75, 3.0], dtype=np.float32)
"""What time costs, by how many of the gaps margin, margin + DEAR a node falls short of."""
TURNING = 0.1
"""What a turn costs beside the time, as a share of the time that it takes."""
ASTRAY = 0.2
"""A start may be so much outside of the workspace [m]."""


@dataclass(frozen=True)
class Rooms:
    """Gaps that count [m].

    Attributes:
        margin: What is kept where there is room.
        floor: What is kept everywhere on the way.
        levels: At the nodes: what is kept, the margin, and what is dear below.
    """

    margin: float
    floor: float
    levels: tuple[float, float, float, float]

    @staticmethod
    def of(margin: float) -> "Rooms":
        """Those of a margin [m]."""
        least = max(LEAST_SHARE * margin, LEAST_ROOM)
        levels = least, max(margin, least), margin + DEAR[0], margin + DEAR[1]
        return Rooms(margin, max(FLOOR_SHARE * margin, 0.5 * LEAST_ROOM), levels)

    def factors(self, gap: Array) -> Array:
        """What time costs (N,) at gaps (N,) [m]: as FACTORS at nodes, without steps."""
        low = np.array(self.levels) + 1e-9 * np.arange(4)  # without a margin two are equal
        return np.interp(gap, low, FACTORS[::-1].astype(np.float64))


@dataclass(frozen=True)
class RouteProblem:
    """From a pose to a pose around everything that stands.

    Attributes:
        start: (3,) in odom [m, m, rad].
        goal: (3,) in odom [m, m, rad], its heading on any branch.
        half: (2,) half length and half width of the box [m].
        margin: Gap that is kept around the box where there is room [m].
        speeds: Largest v and w [m/s, rad/s].
        obstacles: All that stand but the map.
        grid: A map, if there is one.
        workspace: (x_min, y_min, x_max, y_max) in odom where the box must stay [m]; widened, where
            the start is outside of what was given by less than ASTRAY.
        rooms: The gaps that count, for the margin.
        around: The obstacles, and discs that cover the map's occupied cells.
        clearance: Gaps to all of it, as far as they count.

    Raises:
        InputError: A value is not finite or out of its range.
    """

    start: Array
    goal: Array
    half: Array
    margin: float
    speeds: tuple[float, float]
    obstacles: Ellipses
    grid: GridMap | None
    workspace: Workspace
    rooms: Rooms = field(init=False)
    around: Ellipses = field(init=False)
    clearance: Clearance = field(init=False)

    def __post_init__(self) -> None:
        for name, pose in (("start", self.start), ("goal", self.goal)):
            if pose.shape != (3,):
                raise InputError(f"route: {name} of shape {pose.shape}, expected (3,)")
            plausible.demand(pose[:2], plausible.LENGTH, f"route: {name}")
            plausible.demand(pose[2:], plausible.ANGLE, f"route: heading of the {name}")
        half = self.half
        if half.shape != (2,) or not (half.min() >= 0.01 and half.max() <= 10.0):
            raise InputError(f"route: half extents {half.tolist()} m, expected two of 0.01 to 10")
        if not 0.0 <= self.margin <= 2.0:
            raise InputError(f"route: margin {self.margin} m, expected 0 to 2")
        if not all(0.0 < speed < math.inf for speed in self.speeds):
            raise InputError(f"route: speeds {self.speeds} m/s, rad/s, expected above 0")
        plausible.demand(self.obstacles.centers, plausible.LENGTH, "route: obstacles")
        rooms, workspace = Rooms.of(self.margin), self._widened()
        cells = Ellipses.none() if self.grid is None else self.grid.ellipses()
        around = self.obstacles.joined(cells)
        clearance = Clearance(half, around, workspace, rooms.levels[-1] + LEAST_ROOM)
        for name, value in (
            ("workspace", workspace), ("rooms", rooms), ("around", around),
            ("clearance", clearance),
        ):  # fmt: skip
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
        """Of the disc that just covers the box [m]."""
        return math.hypot(*self.half)

    def room(self) -> Array:
        """Gaps (2,) at the start and the goal [m], below zero in the midst of occupied cells."""
        result = self.clearance.gaps(self.ends)
        if self.grid is not None:
            result[self.grid.occupied_at(self.ends[:, :2])] = -1.0
        return result

    def turning(self, angles: Array) -> Array:
        """What turns by angles (N,) [rad] cost beside their time (N,) [s]."""
        result: Array = TURNING * np.abs(angles) / self.speeds[1]
        return result

    def _widened(self) -> Workspace:
        over = float(outside_by(self.start[None], self.half, self.workspace)[0])
        by = over + LEAST_ROOM if 0.0 < over <= ASTRAY else 0.0
        x_min, y_min, x_max, y_max = self.workspace
        return x_min - by, y_min - by, x_max + by, y_max + by
