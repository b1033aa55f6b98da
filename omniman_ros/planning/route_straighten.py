"""What was found on a lattice: checked with exact gaps, and straightened."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.route import Route, along, durations, refined
from omniman_ros.planning.route_lattice import Lattice
from omniman_ros.planning.route_marks import Marks
from omniman_ros.planning.route_problem import RouteProblem

Array = NDArray[np.float64]
Index = NDArray[np.intp]

WORSE = 0.003
"""A straight line may be dearer by this share than the path that it replaces."""
PART = 50
"""So many poses of a path are checked at once."""
FIRST_LOOKS = 16
"""So many poses of a line are looked at before all of them."""
PASSES = 2
"""A path is straightened so often, forwards and backwards in turn."""


@dataclass(frozen=True)
class Checked:
    """A path (N, 3) of the lattice with its exact gaps.

    Attributes:
        path: (N, 3) [m, m, rad].
        fine: (K,) fractional indices of the poses that were looked at, whole ones among them.
        gap: (K,) there [m].
    """

    path: Array
    fine: Array
    gap: Array


@dataclass(frozen=True)
class Priced:
    """A path of the lattice with what it costs.

    Attributes:
        path: (N, 3) [m, m, rad].
        cost: (N,) up to each pose [s].
        room: (N - 1,) least gap of each piece [m].
    """

    path: Array
    cost: Array
    room: Array

    def backwards(self) -> "Priced":
        """From its end to its begin."""
        return Priced(self.path[::-1], self.cost[-1] - self.cost[::-1], self.room[::-1])


class Straightener:
    """Checks and straightens paths.

    Args:
        problem: What is asked.
        lattice: That the paths are of.
        marks: Of the lattice, filled.
    """

    def __init__(self, problem: RouteProblem, lattice: Lattice, marks: Marks) -> None:
        self._problem, self._lattice, self._marks = problem, lattice, marks

    def check(self, path: Array) -> Generator[int, None, Checked]:
        """Look at a path (N, 3) closely."""
        fine = refined(path, self._problem.half)
        poses = along(path, fine)
        gap = np.empty(len(poses))
        for k in range(0, len(poses), PART):
            part = slice(k, k + PART)
            gap[part] = self._gaps(poses[part])
            yield 200
        return Checked(path, fine, gap)

    def tight(self, checked: Checked) -> Index:
        """Which poses must not be used, the ends apart: it is too tight before or after them."""
        path, fine, gap = checked.path, checked.fine, checked.gap
        tight = fine[gap < self._marks.floor(along(path, fine))]
        # Of the two poses around a place, the one that is closer itself.
        at = gap[np.searchsorted(fine, np.arange(len(path)))]
        before = np.clip(np.floor(tight).astype(np.intp), 1, len(path) - 2)
        after = np.clip(np.ceil(tight).astype(np.intp), 1, len(path) - 2)
        return np.unique(np.where(at[before] < at[after], before, after))

    def straightened(self, checked: Checked) -> Generator[int, None, Route]:
        """The route: poses joined by straight lines wherever that is no dearer, nor closer."""
        priced = self._priced(checked)
        for _ in range(PASSES):
            priced = yield from self._shortened(priced)
            priced = priced.backwards()
        start, goal = self._problem.ends
        poses = self._lattice.frame.odom(priced.path)
        heading = start[2] - poses[0, 2]
        poses[0] = start
        poses[1:, 2] += heading
        poses[-1, :2] = goal[:2]
        return Route(poses, self._problem.speeds)

    def _gaps(self, poses: Array) -> Array:
        """Gaps (N,) at poses of the lattice; infinity where the nodes tell that there is room."""
        near = self._marks.words[3, self._lattice.nearest(poses)] != 0
        result = np.full(len(poses), np.inf)
        if near.any():
            odom = self._lattice.frame.odom(poses[near])
            result[near] = self._problem.clearance.gaps(odom)
        return result

    def _priced(self, checked: Checked) -> Priced:
        problem, path, gap = self._problem, checked.path, checked.gap
        step = np.diff(along(path, checked.fine), axis=0)
        factor = problem.rooms.factors(gap)
        each = durations(step, problem.speeds) * 0.5 * (factor[1:] + factor[:-1])
        each += problem.turning(step[:, 2])
        whole = np.searchsorted(checked.fine, np.arange(len(path)))
        cost = np.concatenate([[0.0], np.cumsum(each)])[whole]
        room = np.minimum(np.minimum.reduceat(gap, whole[:-1]), gap[whole[1:]])
        return Priced(path, cost, room)

    def _line(self, line: Array, least: float) -> tuple[float, float]:
        """Cost [s] of a line (2, 3), and its least gap [m]; infinity if that is below `least`."""
        problem = self._problem
        index = refined(line, problem.half)
        poses = along(line, index)
        stride = max(len(index) // FIRST_LOOKS, 1)
        some = self._gaps(poses[stride // 2 :: stride])
        if some.min() < least:
            return math.inf, float(some.min())
        gap = self._gaps(poses)
        if gap.min() < least:
            return math.inf, float(gap.min())
        factor = problem.rooms.factors(gap)
        step = np.diff(line, axis=0)
        mean = 0.5 * float((factor[1:] + factor[:-1]).mean())
        cost = durations(step, problem.speeds) * mean + problem.turning(step[:, 2])
        return float(cost[0]), float(gap.min())

    def _shortened(self, path: Priced) -> Generator[int, None, Priced]:
        """One pass: from each pose that is kept on as far as a line does."""
        margin, last = self._problem.margin, len(path.path) - 1
        kept, costs, rooms = [0], [0.0], []
        i, step = 0, last
        while i < last:
            step = min(step, last - i)
            while True:
                j = i + step
                before = path.cost[j] - path.cost[i]
                if step == 1:
                    lasts, gap = before, path.room[i]
                    break
                least = min(margin, float(path.room[i:j].min())) - 1e-9
                lasts, gap = self._line(path.path[[i, j]], least)
                yield 350
                if lasts <= (1.0 + WORSE) * before:
                    break
                step = (step + 1) // 2
            kept.append(j)
            costs.append(costs[-1] + float(lasts))
            rooms.append(float(gap))
            i, step = j, 2 * step
        return Priced(path.path[kept], np.array(costs), np.array(rooms))
