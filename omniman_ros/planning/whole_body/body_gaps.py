"""Gaps of the whole body: to what stands, to what moves, and between its own parts."""

import itertools
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.body_geometry import LINKS_BEFORE_WRIST, UNCHECKED_PAIRS
from omniman_ros.collision.body_spheres import LOAD, BodySpheres, PlacedSpheres
from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.signed_gaps import (
    point_gap_values,
    point_gaps,
    rectangle_gap_derivative,
    rectangle_gaps,
)
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.motion.whole_body.model import HALF_TURN
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.redundancy import Configurations

FAR = 10.0  #: Gap of a row that constrains nothing [m]
#: Gap beyond which that to the disc around an obstacle stands for the true one [m]
NEAR = 0.3
#: Number of standing obstacles at each configuration whose gaps are computed at first
FIRST_TRIED = 12
SAME_HEIGHT = 1e-6  #: Change of a height that is round-off [m]
OWN, STANDING, MOVING = range(3)
"""Kinds of gaps: between parts of the robot, to what stands, to what moves."""
PLATFORM = "platform"  #: Name of the platform among the parts


@dataclass(frozen=True)
class GapRows(Validated):
    """The nearest gaps at each of k configurations, with their derivatives."""

    #: Gaps (k, n), less the margin around what moves, which grows [m]
    gap: Annotated[Array, Shape("k", "n")]
    #: Derivatives (k, n, d) by the redundancy coordinates
    slope: Annotated[Array, Shape("k", "n", "d")]
    #: What each (k, n) is a gap to: OWN, STANDING or MOVING
    kind: Annotated[Indices, Shape("k", "n")]

    def filled(self, count: int) -> "GapRows":
        """Return n = `count` gaps of each configuration: far ones fill up."""
        k, n = self.gap.shape
        more, d = count - n, self.slope.shape[2]
        return GapRows.unchecked(
            gap=np.hstack([self.gap, np.full((k, more), FAR)]),
            slope=np.concatenate([self.slope, np.zeros((k, more, d))], axis=1),
            kind=np.hstack([self.kind, np.full((k, more), STANDING)]),
        )


@dataclass(frozen=True)
class _PartGaps:
    """Gaps of each part of the robot to n obstacles at each of k poses."""

    numbers: Indices  #: Numbers (k, n) of the obstacles, the moving ones last
    gap: Array  #: Gaps (k, parts * n) [m], part by part
    nearest: Indices  #: Nearest spheres (k, parts of the arm, n)


class BodyGaps:
    """Gaps of platform, arm, tool and load.

    The platform is one rectangle or several from the floor to the deck's top, the rest are spheres
    with a largest spacing, all of which contain the parts: no gap is overestimated.

    Args:
        spacing: Largest distance between spheres [m].
        time_gap: Time in which what moves covers the gap that rows keep to it besides [s].

    Attributes:
        names: Names of the parts, the platform first.
        rectangles: Parts of the platform's outline.
        heights: Lower and upper side of the platform [m].
        radius: Distance of the platform's farthest point from the z axis of base_link [m].
    """

    def __init__(
        self,
        description: DescriptionParameters,
        tool: ToolShape,
        load: LoadShape | None,
        spacing: float,
        time_gap: float = 0.0,
    ) -> None:
        self._time_gap = time_gap
        robot, mount = description.robot, description.mount
        self.spheres = BodySpheres(mount, tool, load, spacing)
        self.names: tuple[str, ...] = (PLATFORM, *self.spheres.names)
        self.rectangles = Rectangles.around(robot.body).each()
        self.radius = max(float(each.radius) for each in self.rectangles)
        self.heights = 0.0, platform_top(robot, mount.z)
        self._deck = UprightObstacles.join(
            [
                UprightObstacles.box(
                    (*each.centre.tolist(), float(each.yaw)),
                    2.0 * float(each.half[0]),
                    2.0 * float(each.half[1]),
                    self.heights,
                )
                for each in self.rectangles
            ]
        )
        part = self.spheres.part
        ends = np.flatnonzero(np.diff(part, append=part[-1] + 1)) + 1
        self._of_part = list(itertools.pairwise((0, *ends.tolist())))
        self._base: Array = mount.pose @ HALF_TURN
        # Spheres on the axes of the first two joints keep their height above the deck.
        configurations = np.linspace(-1.0, 1.0, 3)[:, None] * np.ones(JOINTS)
        heights = self.spheres.place(configurations).centre[..., 2]
        is_moved = np.ptp(heights, axis=0) > SAME_HEIGHT
        self._above: Indices = np.flatnonzero(is_moved)
        names = self.spheres.names
        load_part = names.index(LOAD) if LOAD in names else len(names)
        pairs = [
            (i, j)
            for i, a in enumerate(part.tolist())
            for j, b in enumerate(part.tolist())
            if b - a > 1
            and (a, b) not in UNCHECKED_PAIRS
            and not (b == load_part and a >= LINKS_BEFORE_WRIST)
        ]
        self._first: Indices = np.array([i for i, _ in pairs])
        self._second: Indices = np.array([j for _, j in pairs])

    # ---- values only, for checks and the search ---------------------------------------------

    def part_name(self, index: int) -> str:
        """Return the name of a part of the robot by its place in `to_obstacles`."""
        return PLATFORM if index == 0 else self.spheres.names[self.spheres.part[index - 1]]

    def nearest_own(self, placed: PlacedSpheres, k: int) -> tuple[str, str]:
        """Return the names of the two parts of the robot that are nearest to each other."""
        to_deck, between = (gaps[k] for gaps in self._own_gaps(placed))
        if to_deck.min() <= between.min():
            return self.part_name(1 + int(self._above[to_deck.argmin()])), PLATFORM
        pair = int(between.argmin())
        return self.part_name(1 + int(self._second[pair])), self.part_name(
            1 + int(self._first[pair])
        )

    def own(self, placed: PlacedSpheres) -> Array:
        """Return the least gap (k,) between two parts of the robot for spheres (k, S) [m]."""
        to_deck, between = self._own_gaps(placed)
        result: Array = np.minimum(to_deck.min(axis=1), between.min(axis=1))
        return result

    def _own_gaps(self, placed: PlacedSpheres) -> tuple[Array, Array]:
        """Return the gaps (k, A) of spheres to the deck, and (k, P) between two of them [m]."""
        centre, radius = placed.centre, self.spheres.radius
        above = np.moveaxis(centre[:, self._above], -1, 0)
        deck = point_gap_values(self._deck, above)
        to_deck = deck.min(axis=-1) - radius[self._above]
        by_axis = np.ascontiguousarray(centre.T)  # (3, S, k): short axes are slow to sum over
        apart = by_axis[:, self._first] - by_axis[:, self._second]
        apart *= apart
        between = np.sqrt(apart[0] + apart[1] + apart[2])
        between -= (radius[self._first] + radius[self._second])[:, None]
        return to_deck, between.T

    def to_obstacles(
        self,
        poses: Array,
        centre: Array,
        around: ObstacleSnapshot,
        ages: Array,
        reach: float,
    ) -> tuple[Array, Indices]:
        """Return the gaps (k, M) to obstacles [m], and the numbers (k, M) of the nearest parts.

        The centres (k, S, 3) of the spheres are in base_link at poses (k, 3) and ages (k,) [s]. A
        gap that is above a reach [m] may be a lower bound above it, with part 0; also one to what
        moves, less its growth.
        """
        points, moving = np.moveaxis(in_odom(poses, centre), -1, 0), around.moving
        bounds = self._bounds(poses, points, around.standing, reach)
        places = moving.obstacles.centre[:, None] + ages[:, None] * moving.velocity[:, None]
        of_moving = self._disc_bounds(poses, points, places, _extent(moving.obstacles))
        growth = around.growth * (ages - ages.min())[:, None]
        is_near = np.hstack([~(bounds > reach), ~(of_moving - growth > reach)])
        gaps, parts = np.hstack([bounds, of_moving]), np.zeros(is_near.shape, dtype=np.intp)
        at, number = np.nonzero(is_near)
        if len(at):
            near = around.placed(ages[at], number[:, None])
            platform = self.platform(poses[at], near)[:, 0]
            spheres = point_gap_values(_for_spheres(near), points[:, at])[..., 0]
            spheres -= self.spheres.radius
            nearest = spheres.argmin(axis=1)
            arm = np.take_along_axis(spheres, nearest[:, None], axis=1)[:, 0]
            gaps[at, number] = np.fmin(arm, platform)
            parts[at, number] = np.where(arm < platform, 1 + nearest, 0)
        return gaps, parts

    def platform(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the gaps (k, M) of the platform at poses (k, 3) to obstacles [m]."""
        found = [
            rectangle_gaps(obstacles, each.poses(poses), each.half, self.heights)
            for each in self.rectangles
        ]
        result: Array = np.min(found, axis=0)
        return result

    def _bounds(
        self, poses: Array, points: Array, obstacles: UprightObstacles, reach: float
    ) -> Array:
        """Return lower bounds (k, M) of the gaps at poses (k, 3), with spheres at (3, k, S).

        Obstacles count as discs without heights. Those that are beyond a reach [m] of all that
        the body passes have one bound. NaN, out of the arm's reach, is left out.
        """
        if not len(obstacles):
            return np.zeros((len(poses), 0))
        extent = _extent(obstacles)
        size, sides = self.spheres.radius.max(), (np.fmin, np.fmax)
        low, high = (
            side(
                side.reduce(points[:2], axis=(1, 2)) + sign * size,
                side.reduce(poses[:, :2], axis=0) + sign * self.radius,
            )[:, None]
            for side, sign in zip(sides, (-1.0, 1.0), strict=True)
        )
        beyond = np.maximum(np.maximum(low - obstacles.centre, obstacles.centre - high), 0.0)
        apart = np.hypot(*beyond) - extent
        result = np.tile(apart, (len(poses), 1))
        near = np.flatnonzero(~(apart > reach))
        if not len(near):
            return result
        centre = obstacles.centre[:, near]
        result[:, near] = self._disc_bounds(poses, points, centre, extent[near])
        return result

    def _disc_bounds(self, poses: Array, points: Array, centre: Array, extent: Array) -> Array:
        """Return what `_bounds` does to discs with centres (2, M) or (2, k, M) and radii (M,)."""
        origin = poses[0, :2]
        level = np.moveaxis(points[:2], 0, -1) - origin
        apart = np.moveaxis(centre, 0, -2) - origin[:, None]  # (..., 2, M)
        square = (level * level).sum(axis=-1)[..., None] - 2.0 * (level @ apart)
        least = np.fmin.reduce(square, axis=1) + (apart * apart).sum(axis=-2)
        arm = np.sqrt(np.maximum(least, 0.0)) - self.spheres.radius.max()
        platform = np.min([_depth(each, poses, centre) for each in self.rectangles], axis=0)
        result: Array = np.fmin(platform, arm) - extent
        return result

    # ---- with derivatives, for the program --------------------------------------------------

    def rows(
        self, at: Configurations, around: ObstacleSnapshot, ages: Array, reach: float, count: int
    ) -> GapRows:
        """Return the n = `count` nearest gaps at configurations (k,), with derivatives.

        Obstacles are left out beyond a reach [m]; they are placed at ages (k,) [s]. Each part of
        the robot has one gap to each of them, that of its nearest sphere. If there are fewer gaps
        than rows, these have one order at all configurations, and far ones fill up.
        """
        placed = self.spheres.carried(self._base @ at.frames)
        moved = self.spheres.joint_derivative(placed)
        own = self._own_rows(at, placed, moved)
        centre = in_odom(at.platform, placed.centre)
        found = self._found(at.platform, centre, around, ages, reach, own.gap, count)
        gaps = np.hstack([own.gap, found.gap])
        kept = np.tile(np.arange(gaps.shape[1]), (len(ages), 1))
        if gaps.shape[1] > count:
            kept = np.argpartition(gaps, count - 1, axis=1)[:, :count]
        gap = np.take_along_axis(gaps, kept, axis=1)
        is_near, last = gap <= reach, own.gap.shape[1] - 1
        slope = np.take_along_axis(own.slope, np.minimum(kept, last)[..., None], axis=1)
        kind = np.full(kept.shape, OWN)
        row, slot = np.nonzero((kept > last) & is_near)
        if len(row):
            column = kept[row, slot] - last - 1
            slope[row, slot] = self._slopes(at, centre, moved, around, ages, found, row, column)
            number = found.numbers[row, column % found.numbers.shape[1]]
            kind[row, slot] = np.where(number < len(around.standing), STANDING, MOVING)
        return GapRows.unchecked(
            gap=np.where(is_near, gap, FAR),
            slope=np.where(is_near[..., None], slope, 0.0),
            kind=np.where(is_near, kind, STANDING),
        ).filled(count)

    def _found(
        self,
        poses: Array,
        centre: Array,
        around: ObstacleSnapshot,
        ages: Array,
        reach: float,
        own: Array,
        count: int,
    ) -> _PartGaps:
        """Return gaps at poses (k, 3), among them all of the `count` smallest within a reach [m].

        The nearest obstacles by the bounds are looked at first, then more of them, until no other
        one can have a smaller gap. Own gaps (k, o) count among the smallest.
        """
        points, still = np.moveaxis(centre, -1, 0), len(around.standing)
        bounds = self._bounds(poses, points, around.standing, reach)
        near = np.flatnonzero(~(bounds > reach).all(axis=0))
        bounds = bounds[:, near]
        moving = np.tile(still + np.arange(len(around.moving)), (len(ages), 1))
        blocks = len(self.rectangles) + len(self._of_part)
        is_few = own.shape[1] + blocks * (len(near) + moving.shape[1]) <= count
        enough = max(FIRST_TRIED, count // blocks + 1)  # as many gaps as rows, at least
        tried = len(near) if is_few else min(enough, len(near))
        order = np.argsort(bounds, axis=1)
        while True:
            numbers = np.hstack([near[np.sort(order[:, :tried], axis=1)], moving])
            found = self._gaps_of_parts(poses, points, around, ages, numbers)
            if tried == len(near):
                return found
            gaps = np.hstack([own, found.gap])
            largest = np.partition(gaps, count - 1, axis=1)[:, count - 1]
            following = np.take_along_axis(bounds, order[:, tried, None], axis=1)[:, 0]
            if (following >= np.minimum(largest, reach)).all():
                return found
            tried = min(2 * tried, len(near))

    def _gaps_of_parts(
        self,
        poses: Array,
        points: Array,
        around: ObstacleSnapshot,
        ages: Array,
        numbers: Indices,
    ) -> _PartGaps:
        """Return the gaps of each part to the obstacles with numbers (k, n) at poses (k, 3)."""
        obstacles = around.placed(ages, numbers)
        platform = [
            rectangle_gaps(obstacles, each.poses(poses), each.half, self.heights)
            for each in self.rectangles
        ]
        distance = point_gap_values(_for_spheres(obstacles), points)
        distance -= self.spheres.radius[:, None]
        nearest = np.stack(
            [first + distance[:, first:end].argmin(axis=1) for first, end in self._of_part],
            axis=1,
        )
        arm = np.take_along_axis(distance, nearest, axis=1)
        gap = np.concatenate([np.stack(platform, axis=1), arm], axis=1)  # (k, parts, n)
        moving = slice(numbers.shape[1] - len(around.moving), None)
        gap[..., moving] -= (around.growth * np.maximum(ages, 0.0)[:, None])[:, None]
        gap[..., moving] -= self._time_gap * around.pace * np.hypot(*around.moving.velocity)
        return _PartGaps(numbers, gap.reshape(len(poses), -1), nearest)

    def _slopes(
        self,
        at: Configurations,
        centre: Array,
        moved: Array,
        around: ObstacleSnapshot,
        ages: Array,
        found: _PartGaps,
        row: Indices,
        column: Indices,
    ) -> Array:
        """Return the derivatives (p, d) of gaps (p,) by their rows and columns in `found`."""
        block, column = np.divmod(column, found.numbers.shape[1])
        obstacles = around.placed(ages[row], found.numbers[row, column, None])  # (p, 1)
        poses, parts = at.platform[row], len(self.rectangles)
        sphere = found.nearest[row, np.maximum(block - parts, 0), column]
        places = centre[row, sphere]
        _, normal = point_gaps(obstacles, places.T)
        slope = _by_coordinates(at.rates[row], normal[..., 0].T, places, moved[row, sphere], poses)
        for k, each in enumerate(self.rectangles):
            mine = block == k
            near, at_rows = found.numbers[row[mine], column[mine], None], poses[mine]
            _, by_centre = rectangle_gap_derivative(
                around.placed(ages[row[mine]], near), each.poses(at_rows), each.half, self.heights
            )
            slope[mine] = 0.0
            slope[mine, :3] = _at_base(by_centre[:, 0], at_rows, each)
        return slope

    def _own_rows(self, at: Configurations, placed: PlacedSpheres, moved: Array) -> GapRows:
        """Return the nearest gaps of the robot's parts: to the deck, and between spheres."""
        to_deck, between = self._own_gaps(placed)
        centre, k = placed.centre, len(to_deck)
        rows = np.arange(k)[:, None]
        closest = np.argpartition(to_deck, 1, axis=1)[:, :2]
        sphere = self._above[closest]
        deck, normal = point_gaps(self._deck, np.moveaxis(centre[rows, sphere], -1, 0))
        normal = np.take_along_axis(normal, deck.argmin(axis=-1)[None, ..., None], axis=-1)
        from_deck = np.moveaxis(normal[..., 0], 0, -1)
        pair = np.argpartition(between, 1, axis=1)[:, :2]
        first, second = self._first[pair], self._second[pair]
        apart = centre[rows, second] - centre[rows, first]
        apart /= np.maximum(np.linalg.norm(apart, axis=-1), 1e-9)[..., None]
        change = moved[rows, second] - moved[rows, first]
        by_joints = np.einsum(
            "kni,knij->knj",
            np.concatenate([from_deck, apart], axis=1),
            np.concatenate([moved[rows, sphere], change], axis=1),
        )
        return GapRows.unchecked(
            gap=np.hstack([to_deck[rows, closest], between[rows, pair]]),
            slope=by_joints @ at.rates,
            kind=np.full((k, 4), OWN),
        )


def _for_spheres(obstacles: UprightObstacles) -> UprightObstacles:
    """Return obstacles with arrays (..., k, M) for spheres, which have an axis before M."""
    return UprightObstacles.unchecked(
        **{name: value[..., None, :] for name, value in vars(obstacles).items()}
    )


def in_odom(poses: Array, points: Array) -> Array:
    """Return points (k, S, 3) of base_link at poses (k, 3) in odom."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack(
        (poses[:, 0, None] + c * x - s * y, poses[:, 1, None] + s * x + c * y, z), axis=-1
    )


def _extent(obstacles: UprightObstacles) -> Array:
    """Return the radii (M,) of discs that contain obstacles [m]."""
    result: Array = np.hypot(*obstacles.half) + obstacles.rounding
    return result


def _depth(rectangle: Rectangles, poses: Array, points: Array) -> Array:
    """Return signed distances (k, M) of points (2, M) or (2, k, M) from a rectangle at k poses."""
    at = rectangle.poses(poses)
    c, s = np.cos(at[:, 2, None]), np.sin(at[:, 2, None])
    x, y = points[0] - at[:, 0, None], points[1] - at[:, 1, None]
    ahead = np.abs(c * x + s * y) - rectangle.half[0]
    beside = np.abs(c * y - s * x) - rectangle.half[1]
    outside = np.hypot(np.maximum(ahead, 0.0), np.maximum(beside, 0.0))
    result: Array = outside + np.minimum(np.maximum(ahead, beside), 0.0)
    return result


def _at_base(slopes: Array, poses: Array, rectangle: Rectangles) -> Array:
    """Return derivatives (p, 3) by the platform's pose from those (p, 3) by a rectangle."""
    offset = rectangle.poses(poses)[:, :2] - poses[:, :2]
    turn = slopes[:, 2] + slopes[:, 1] * offset[:, 0] - slopes[:, 0] * offset[:, 1]
    return np.column_stack([slopes[:, :2], turn])


def _by_coordinates(
    rates: Array, normal: Array, centre: Array, moved: Array, poses: Array
) -> Array:
    """Return derivatives (p, d) of gaps by the coordinates.

    Normals (p, 3) are the derivatives by the centres, in odom; centres (p, 3) and poses (p, 3) are
    in the frame of the obstacles; `moved` (p, 3, 6) is by the joints, in base_link, whose
    derivatives by the coordinates are `rates` (p, 6, d).
    """
    lever_arm = centre[:, :2] - poses[:, :2]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    nx, ny, nz = normal.T
    in_base = np.column_stack((c * nx + s * ny, c * ny - s * nx, nz))
    by_joints = np.einsum("pi,pij->pj", in_base, moved)
    result: Array = np.einsum("pj,pjc->pc", by_joints, rates)
    result[:, 0] += nx
    result[:, 1] += ny
    result[:, 2] += ny * lever_arm[:, 0] - nx * lever_arm[:, 1]
    return result
