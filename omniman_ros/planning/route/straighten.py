"""Check of a path of the lattice with exact gaps, and its straightening."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.planning.route.lattice import Lattice
from omniman_ros.planning.route.occupancy import HeadingOccupancy
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.route import Route, along, durations, refined

Index = NDArray[np.intp]  #: Array of indices of poses

#: Relative amount by which a straight line may cost more than the path that it replaces [-]
MAX_COST_INCREASE = 0.003
PART = 50  #: Number of poses of a path that are checked at once
FIRST_LOOKS = 16  #: Number of poses of a line that are checked before all of them
PASSES = 2  #: Number of times that a path is straightened, forwards and backwards in turn


@dataclass(frozen=True)
class Checked:
    """A path (N, 3) of the lattice with its exact gaps."""

    path: Array  #: (N, 3) poses [m, m, rad]
    fine: Array  #: (K,) fractional indices of the poses that were checked, whole ones among them
    gap: Array  #: (K,) gaps there [m]


@dataclass(frozen=True)
class Priced:
    """A path of the lattice with its costs."""

    path: Array  #: (N, 3) poses [m, m, rad]
    cost: Array  #: (N,) costs up to each pose [s]
    room: Array  #: (N - 1,) smallest gap of each piece [m]

    def backwards(self) -> "Priced":
        """Return the path from its end to its start."""
        return Priced(self.path[::-1], self.cost[-1] - self.cost[::-1], self.room[::-1])


class Straightener:
    """Checks and straightens paths."""

    def __init__(self, problem: RouteProblem, lattice: Lattice, marks: HeadingOccupancy) -> None:
        self._problem, self._lattice, self._marks = problem, lattice, marks

    def check(self, path: Array) -> Generator[int, None, Checked]:
        """Compute the exact gaps of a path (N, 3)."""
        fine = refined(path, self._problem.radius)
        poses = along(path, fine)
        gap = np.empty(len(poses))
        for k in range(0, len(poses), PART):
            part = slice(k, k + PART)
            gap[part] = self._gaps(poses[part])
            yield 200
        return Checked(path, fine, gap)

    def tight(self, checked: Checked) -> Index:
        """Return the poses, the ends excepted, before or after which the path is too tight."""
        path, fine, gap = checked.path, checked.fine, checked.gap
        tight = fine[gap < self._marks.floor(along(path, fine))]
        # Of the two poses around a tight position, the one with the smaller gap is returned.
        at = gap[np.searchsorted(fine, np.arange(len(path)))]
        before = np.clip(np.floor(tight).astype(np.intp), 1, len(path) - 2)
        after = np.clip(np.ceil(tight).astype(np.intp), 1, len(path) - 2)
        return np.unique(np.where(at[before] < at[after], before, after))

    def straightened(self, checked: Checked) -> Generator[int, None, Route]:
        """Return the route, with straight lines wherever neither cost nor gap gets worse."""
        priced = self._priced(checked)
        for _ in range(PASSES):
            priced = yield from self._shortened(priced)
            priced = priced.backwards()
        start, goal = self._problem.ends
        poses = self._lattice.frame.odom(priced.path)
        rotation = start[2] - poses[0, 2]  # to the branch of the start
        poses[0] = start
        poses[1:, 2] += rotation
        poses[-1, :2] = goal[:2]
        return Route(poses, self._problem.speeds)

    def _gaps(self, poses: Array) -> Array:
        """Return gaps (N,) at poses of the lattice; infinity if the occupancy shows a wide gap."""
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
        """Return cost [s] and least gap [m] of a line (2, 3); cost infinity if below `least`."""
        problem = self._problem
        index = refined(line, problem.radius)
        poses = along(line, index)
        stride = max(len(index) // FIRST_LOOKS, 1)
        coarse = self._gaps(poses[stride // 2 :: stride])
        if coarse.min() < least:
            return math.inf, float(coarse.min())
        gap = self._gaps(poses)
        if gap.min() < least:
            return math.inf, float(gap.min())
        factor = problem.rooms.factors(gap)
        step = np.diff(line, axis=0)
        mean = 0.5 * float((factor[1:] + factor[:-1]).mean())
        cost = durations(step, problem.speeds) * mean + problem.turning(step[:, 2])
        return float(cost[0]), float(gap.min())

    def _shortened(self, path: Priced) -> Generator[int, None, Priced]:
        """Do one pass: from each kept pose on, use the longest acceptable line."""
        margin, last = self._problem.margin, len(path.path) - 1
        kept, costs, rooms = [0], [0.0], []
        i, step = 0, last
        while i < last:
            step = min(step, last - i)
            while True:
                j = i + step
                before = path.cost[j] - path.cost[i]
                if step == 1:
                    cost, gap = before, path.room[i]
                    break
                least = min(margin, float(path.room[i:j].min())) - 1e-9
                cost, gap = self._line(path.path[[i, j]], least)
                yield 350
                if cost <= (1.0 + MAX_COST_INCREASE) * before:
                    break
                step = (step + 1) // 2
            kept.append(j)
            costs.append(costs[-1] + float(cost))
            rooms.append(float(gap))
            i, step = j, 2 * step
        return Priced(path.path[kept], np.array(costs), np.array(rooms))
