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

    def nearest(self, count: int) -> "GapRows":
        """Return the n = `count` smallest gaps of each configuration; far ones fill up."""
        k, n = self.gap.shape
        if n < count:
            more, d = count - n, self.slope.shape[2]
            return GapRows.unchecked(
                gap=np.hstack([self.gap, np.full((k, more), FAR)]),
                slope=np.concatenate([self.slope, np.zeros((k, more, d))], axis=1),
                kind=np.hstack([self.kind, np.full((k, more), STANDING)]),
            )
        index = np.argpartition(self.gap, count - 1, axis=1)[:, :count]
        return GapRows.unchecked(
            gap=np.take_along_axis(self.gap, index, axis=1),
            slope=np.take_along_axis(self.slope, index[..., None], axis=1),
            kind=np.take_along_axis(self.kind, index, axis=1),
        )


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

    def platform(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the gaps (k, M) of the platform at poses (k, 3) to obstacles [m]."""
        found = [
            rectangle_gaps(obstacles, each.poses(poses), each.half, self.heights)
            for each in self.rectangles
        ]
        result: Array = np.min(found, axis=0)
        return result

    def to_obstacles(
        self, poses: Array, centre: Array, obstacles: UprightObstacles, standing: int
    ) -> Array:
        """Return the gaps (k, 1 + S, M) of platform and spheres to obstacles [m].

        The centres (k, S, 3) of the spheres are in base_link. The centres (2, k, M) of the
        obstacles may differ from pose to pose (k, 3). Of the first ones, which stand, those that
        are never within `NEAR` count with one lower bound that is above it.
        """
        points = np.moveaxis(in_odom(poses, centre), -1, 0)
        bounds = self._bounds(poses, points, obstacles.select(np.arange(standing)))
        is_near = np.ones(len(obstacles), dtype=bool)
        is_near[:standing] = ~(bounds > NEAR)
        near = np.flatnonzero(is_near)
        chosen = obstacles.select(near)
        result = np.empty((len(poses), 1 + len(self.spheres.radius), len(obstacles)))
        result[..., :standing] = bounds
        result[:, 0, near] = self.platform(poses, chosen)
        gaps = point_gap_values(_for_spheres(chosen), points)
        result[:, 1:, near] = gaps - self.spheres.radius[:, None]
        return result

    def _bounds(self, poses: Array, points: Array, obstacles: UprightObstacles) -> Array:
        """Return lower bounds (M,) of the gaps at all poses (k, 3), with spheres at (3, k, S).

        Obstacles count as discs. Poses out of the arm's reach, with NaN, are left out.
        """
        origin = poses[0, :2]
        level = np.moveaxis(points[:2], 0, -1) - origin
        centre = np.moveaxis(obstacles.centre, 0, -2) - origin[:, None]  # (..., 2, M)
        square = (level * level).sum(axis=-1)[..., None] - 2.0 * (level @ centre)
        least = np.fmin.reduce(square, axis=1) + (centre * centre).sum(axis=-2)
        arm = np.sqrt(np.maximum(np.fmin.reduce(least, axis=0), 0.0)) - self.spheres.radius.max()
        base = (centre - (poses[:, :2] - origin)[:, :, None]) ** 2
        platform = np.sqrt(np.fmin.reduce(base.sum(axis=-2), axis=0)) - self.radius
        extent = np.hypot(*obstacles.half) + obstacles.rounding
        result: Array = np.minimum(arm, platform) - extent
        return result

    # ---- with derivatives, for the program --------------------------------------------------

    def rows(
        self, at: Configurations, around: ObstacleSnapshot, ages: Array, reach: float, count: int
    ) -> GapRows:
        """Return the n = `count` nearest gaps at configurations (k,), with derivatives.

        Obstacles are left out beyond a reach [m]; they are placed at ages (k,) [s].
        """
        placed = self.spheres.carried(self._base @ at.frames)
        moved = self.spheres.joint_derivative(placed)
        own = self._own_rows(at, placed, moved)
        points = np.moveaxis(in_odom(at.platform, placed.centre), -1, 0)
        is_near = ~(self._bounds(at.platform, points, around.standing) > reach)
        around = around.selected(np.flatnonzero(is_near), np.arange(len(around.moving)))
        obstacles = self._obstacle_rows(at, placed, moved, around, ages)
        joined = GapRows.unchecked(
            gap=np.hstack([own.gap, obstacles.gap]),
            slope=np.concatenate([own.slope, obstacles.slope], axis=1),
            kind=np.hstack([own.kind, obstacles.kind]),
        ).nearest(count)
        is_far = joined.gap > reach
        return GapRows.unchecked(
            gap=np.where(is_far, FAR, joined.gap),
            slope=np.where(is_far[..., None], 0.0, joined.slope),
            kind=joined.kind,
        )

    def _obstacle_rows(
        self,
        at: Configurations,
        placed: PlacedSpheres,
        moved: Array,
        around: ObstacleSnapshot,
        ages: Array,
    ) -> GapRows:
        """Return the gap of each part to each solid, that of its nearest sphere."""
        obstacles, poses, k = around.placed(ages), at.platform, len(at.q)
        gaps, slopes = [], []
        for each in self.rectangles:
            gap, by_centre = rectangle_gap_derivative(
                obstacles, each.poses(poses), each.half, self.heights
            )
            gaps.append(gap)
            slopes.append(_at_base(by_centre, poses, each, at.z.shape[1]))
        centre = in_odom(poses, placed.centre)
        distance, normal = point_gaps(_for_spheres(obstacles), np.moveaxis(centre, -1, 0))
        distance -= self.spheres.radius[:, None]
        nearest = np.hstack(
            [first + distance[:, first:end].argmin(axis=1) for first, end in self._of_part]
        )  # (k, parts * m)
        rows, obstacle = (
            np.arange(k)[:, None],
            np.tile(np.arange(len(obstacles)), len(self._of_part)),
        )
        n = np.moveaxis(normal[:, rows, nearest, obstacle], 0, -1)
        gaps.append(distance[rows, nearest, obstacle])
        slopes.append(_by_coordinates(at, n, centre[rows, nearest], moved[rows, nearest], poses))
        gap = np.hstack(gaps)
        repeats = gap.shape[1] // max(len(obstacles), 1)
        still = len(around.standing)
        kind, growth = np.full(len(obstacles), STANDING), np.zeros(len(obstacles))
        kind[still:], growth[still:] = MOVING, around.growth
        gap -= np.tile(growth, repeats) * np.maximum(ages, 0.0)[:, None]
        gap -= np.tile(self._time_gap * around.pace * np.hypot(*around.velocities), repeats)
        kinds = np.broadcast_to(np.tile(kind, repeats), gap.shape)
        return GapRows.unchecked(gap=gap, slope=np.concatenate(slopes, axis=1), kind=kinds)

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
    """Return obstacles with centres (2, ..., M) for spheres, which have an axis before M."""
    return obstacles.placed(obstacles.centre[..., None, :])


def in_odom(poses: Array, points: Array) -> Array:
    """Return points (k, S, 3) of base_link at poses (k, 3) in odom."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack(
        (poses[:, 0, None] + c * x - s * y, poses[:, 1, None] + s * x + c * y, z), axis=-1
    )


def _at_base(slopes: Array, poses: Array, rectangle: Rectangles, coordinates: int) -> Array:
    """Return derivatives (k, M, d) by the coordinates from those (k, M, 3) by a rectangle."""
    offset = rectangle.poses(poses)[:, :2] - poses[:, :2]
    result = np.zeros((*slopes.shape[:2], coordinates))
    result[..., :3] = slopes
    result[..., 2] += slopes[..., 1] * offset[:, None, 0] - slopes[..., 0] * offset[:, None, 1]
    return result


def _by_coordinates(
    at: Configurations, normal: Array, centre: Array, moved: Array, poses: Array
) -> Array:
    """Return derivatives (k, M, d) of gaps by the coordinates.

    Normals (k, M, 3) are the derivatives by the centres, in odom; centres (k, M, 3) and poses (k,
    3) are in the frame of the obstacles; `moved` (k, M, 3, 6) is by the joints, in base_link.
    """
    lever_arm = centre[..., :2] - poses[:, None, :2]
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    nx, ny, nz = np.moveaxis(normal, -1, 0)
    in_base = np.stack((c * nx + s * ny, c * ny - s * nx, nz), axis=-1)
    result: Array = np.einsum("kmi,kmij->kmj", in_base, moved) @ at.rates
    result[..., 0] += nx
    result[..., 1] += ny
    result[..., 2] += ny * lever_arm[..., 0] - nx * lever_arm[..., 1]
    return result
