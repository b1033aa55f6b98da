"""Where somebody may be whom no scanner sees, and how soon somebody could be where.

The set of places that people may have reached without being seen grows at the speed of people and
loses what is seen: set-based prediction of hidden road users (P. F. Orzechowski, A. Meyer and
M. Lauer, "Tackling Occlusions & Limited Sensor Range with Set-based Safety Verification", ITSC
2018), here on a grid of the centres of people.
"""

import math

import numpy as np

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.perception.parameters import UnseenParameters
from omniman_ros.perception.rolling_grid import centered_corner, grown, shifted
from omniman_ros.perception.scan import Mask, View

RESOLUTION = 0.1  #: Edge of a cell [m]
HORIZON = 3.0  #: Time up to which arrivals are looked at [s]


class UnseenSpace:
    """Places where somebody may stand who is not seen: a square grid in odom.

    A place counts as that of somebody's centre. It is ruled out if something within the radius of
    a person was just seen free, or was met by a beam, so that who stands there would be seen; or
    if something stands there, or the robot does. What lies outside of the grid is not seen.

    Args:
        size: Edge of the grid [m].

    Attributes:
        corner: (2,) column and row of the first cell in odom, counted from the origin of odom.
        hidden: (n, n) whether somebody may be there, rows along y.
    """

    def __init__(self, parameters: UnseenParameters, size: float) -> None:
        self.parameters = parameters
        count = math.ceil(size / RESOLUTION)
        self.hidden: Mask = np.ones((count, count), dtype=bool)
        self.corner = np.zeros(2, dtype=np.intp)
        self._passable: Mask = self.hidden.copy()
        self.clear()

    def clear(self) -> None:
        """Forget what was seen."""
        self.hidden[:] = self._passable[:] = True
        self.corner[:] = -(len(self.hidden) // 2)
        self._time = -math.inf
        self._way, self._steps = 0.0, 0

    @property
    def origin(self) -> Array:
        """Corner (2,) of the first cell in odom [m]."""
        origin: Array = RESOLUTION * self.corner.astype(np.float64)
        return origin

    def update(
        self,
        time: float,
        view: View,
        reach: float,
        met: Array,
        standing: Array,
        own: tuple[PlanarPose, Rectangles],
    ) -> None:
        """Enter what was seen up to a reach [m] at a time [s].

        In odom, beams have met the points `met` (M, 2), nobody goes through those of what stands
        (K, 2), and the robot has a pose and is within rectangles.

        Args:
            own: Pose of the robot in odom [m, m, rad], and rectangles that contain it.
        """
        pose, parts = own
        self._follow(np.array(pose[:2]))
        count, body = len(self.hidden), round(self.parameters.person.radius / RESOLUTION)
        self._passable = ~grown(self._cells(standing), body)
        if math.isfinite(self._time):
            self._way += self.parameters.speed * min(max(time - self._time, 0.0), HORIZON)
        self._time = time
        steps = math.floor(self._way / RESOLUTION)
        self._way -= steps * RESOLUTION
        hidden = grown(self.hidden, steps, self._steps)
        self._steps += steps
        hidden[[0, -1]] = hidden[:, [0, -1]] = True
        known = self._cells(met) | self._covered(pose, parts)
        rows, columns, free = view.passed(self.origin, RESOLUTION, count, reach)
        known[rows, columns] |= free
        self.hidden = hidden & self._passable & ~grown(known, body)

    def arrivals(self) -> Array:
        """Return the time (n, n) in which somebody could be in each cell [s].

        Somebody walks around what stands. It is infinity beyond `HORIZON`, and NaN where nobody
        can be.
        """
        speed = self.parameters.speed
        reached = self.hidden
        times = np.where(self._passable, np.inf, np.nan)
        times[reached] = 0.0
        for step in range(math.floor(HORIZON * speed / RESOLUTION)):
            further = grown(reached, 1, step) & self._passable
            times[further & ~reached] = (step + 1) * RESOLUTION / speed
            reached = further
        return times

    def _follow(self, center: Array) -> None:
        """Move the grid if the robot has left its middle."""
        count = len(self.hidden)
        corner = centered_corner(center, RESOLUTION, count)
        shift = corner - self.corner
        if np.abs(shift).max() > count // 16:
            self.hidden, self.corner = shifted(self.hidden, shift, True), corner

    def _cells(self, points: Array) -> Mask:
        """Return the cells (n, n) in which points (M, 2) in odom lie."""
        count = len(self.hidden)
        index = np.floor(points / RESOLUTION).astype(np.intp) - self.corner
        index = index[np.all((index >= 0) & (index < count), axis=1)]
        cells: Mask = np.zeros((count, count), dtype=bool)
        cells[index[:, 1], index[:, 0]] = True
        return cells

    def _covered(self, pose: PlanarPose, parts: Rectangles) -> Mask:
        """Return the cells (n, n) whose middles the robot covers."""
        count = len(self.hidden)
        steps = RESOLUTION * (np.arange(count) + 0.5)
        x, y = steps + self.origin[0] - pose[0], steps + self.origin[1] - pose[1]
        near = float(parts.radius.max())
        columns, rows = np.abs(x) <= near, np.abs(y) <= near
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = (axis.ravel() for axis in np.meshgrid(x[columns], y[rows]))
        local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
        cells: Mask = np.zeros((count, count), dtype=bool)
        cells[np.ix_(rows, columns)] = (parts.distances(local) <= 0.0).reshape(
            rows.sum(), columns.sum()
        )
        return cells
