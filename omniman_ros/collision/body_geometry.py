"""Shape of platform, arm, tool and load, and distances between them and from obstacles."""

from itertools import groupby

import numpy as np

from omniman_ros.collision.arm_segments import ArmSegments, Segments
from omniman_ros.collision.convex_pieces import convex_pieces
from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.load_box import LoadBox
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.prism import ConvexPrism
from omniman_ros.collision.segments import segment_distances
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Body
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.description.urdf import carries_arm
from omniman_ros.motion.whole_body.model import planar_transform

PLATFORM = "platform"  #: Name of the platform among the parts
LOAD = "load"  #: Name of the load among the parts
#: Number of the arm's first links that keep their distance from the platform: base, shoulder
RIGID_LINKS = 2
#: Number of the arm's first links that are not near the load at all joint angles
LINKS_BEFORE_WRIST = 5
#: Pairs of links, by number from the arm's base, that are not neighbours although their distance
#: hardly depends on the joints: base and upper arm, forearm and wrist_2, wrist_1 and wrist_3 or
#: the tool, wrist_2 and the tool.
UNCHECKED_PAIRS = frozenset({(0, 2), (3, 5), (4, 6), (4, 7), (5, 7)})


class BodyGeometry:
    """Distances of the surfaces of the robot's parts from one another and from obstacles.

    The platform is a box with the length and the width of the body, or a prism with the body's
    outline, from the floor to the upper side of the deck. Links of the arm and the tool are
    capsules. The load is a box. Where two parts overlap, their distance is minus the depth, if
    that is less than the radius of a capsule; deeper, it is minus the radius. Between platform and
    load, and from obstacles, it is zero then.

    Attributes:
        pairs: Names of the two parts of each pair that may collide.
        lever_arms: (P, 6) largest travel of one part of each pair relative to the other, per angle
            of each joint [m/rad].
        part_radii: (N,) bounds of the horizontal distance of each part's points from the z axis of
            base_link, at all joint angles [m].
        part_levers: (N, 6) largest travel of each part relative to the platform, per angle of each
            joint [m/rad].
    """

    def __init__(
        self,
        description: DescriptionParameters,
        tool: ToolShape | None = None,
        load: LoadShape | None = None,
    ) -> None:
        robot, mount = description.robot, description.mount
        has_arm = carries_arm(robot)
        heights = 0.0, platform_top(robot, mount.z if has_arm else None)
        self._platform = platform_body(robot.body, heights)
        self.parts: tuple[str, ...] = (PLATFORM,)
        self.pairs: tuple[tuple[str, str], ...] = ()
        self.lever_arms: Array = np.zeros((0, JOINTS))
        self.part_radii: Array = np.array([self._platform.radius])
        self.part_levers: Array = np.zeros((1, JOINTS))
        self._arm: ArmSegments | None = None
        self._load: LoadBox | None = None
        if has_arm:
            self._arm = ArmSegments(mount, tool or ToolShape())
            self._load = LoadBox(load) if load is not None and load.is_carried else None
            self._find_pairs(self._arm)
            self._bound_parts(self._arm, float(np.hypot(mount.x, mount.y)))

    def _find_pairs(self, arm: ArmSegments) -> None:
        """Find which parts may collide with which."""
        names, link = arm.names, arm.link
        candidates = sorted(
            (a, b, i, j)
            for i, a in enumerate(link.tolist())
            for j, b in enumerate(link.tolist())
            if b - a > 1 and (a, b) not in UNCHECKED_PAIRS
        )
        self._first: Indices = np.array([i for _, _, i, _ in candidates])
        self._second: Indices = np.array([j for _, _, _, j in candidates])
        self._pair_begins = _begins([pair[:2] for pair in candidates])
        self._link_begins = _begins(link.tolist())
        self.parts = (PLATFORM, *names)
        ends = list(dict.fromkeys(pair[:2] for pair in candidates))
        self.pairs = tuple((names[a], names[b]) for a, b in ends)
        self.pairs += tuple((PLATFORM, name) for name in names[RIGID_LINKS:])
        ends += [(0, link) for link in range(RIGID_LINKS, len(names))]
        lever_arms = [arm.lever_arms(a, min(b, JOINTS), arm.extent(b)) for a, b in ends]
        if self._load is not None:
            self.parts += (LOAD,)
            others = (PLATFORM, *names[:LINKS_BEFORE_WRIST])
            self.pairs += tuple((name, LOAD) for name in others)
            firsts = (0, *range(LINKS_BEFORE_WRIST))
            lever_arms += [arm.lever_arms(first, JOINTS, self._load.extent) for first in firsts]
        self.lever_arms = np.array(lever_arms)

    def _bound_parts(self, arm: ArmSegments, offset: float) -> None:
        """Bound where the parts can be; the arm stands `offset` [m] from the z axis."""
        links = range(len(arm.names))
        lever_arms = [arm.lever_arms(0, min(link, JOINTS), arm.extent(link)) for link in links]
        if self._load is not None:
            lever_arms.append(arm.lever_arms(0, JOINTS, self._load.extent))
        self.part_levers = np.vstack((self.part_levers, lever_arms))
        # Each link but the first turns about the upright axis of the first joint.
        reach = np.maximum(np.array(lever_arms)[:, 0], arm.extent(0))
        self.part_radii = np.append(self.part_radii, offset + reach)

    def self_distances(self, q: Array, reach: float = np.inf) -> Array:
        """Return the distances (..., P) [m] of all pairs at joint angles (..., 6) [rad].

        Those above `reach` [m] may be too small, but are not below it.

        Raises:
            InputError: An angle is not finite.
        """
        _require_finite("joint angles", q)
        arm = self._arm
        if arm is None:
            return np.zeros((*q.shape[:-1], 0))
        frames = arm.frames(q)
        axes = arm.capsules(frames)
        first, second = axes.select(self._first), axes.select(self._second)
        between = segment_distances(first.start, first.end, second.start, second.end)
        between -= arm.radius[self._first] + arm.radius[self._second]
        moving = axes.select(np.arange(self._link_begins[RIGID_LINKS], len(arm.link)))
        radius = arm.radius[self._link_begins[RIGID_LINKS] :]
        far = reach + arm.radius.max()
        to_deck = self._platform.distances_from_segments(moving.start, moving.end, far) - radius
        begins = self._link_begins[RIGID_LINKS:] - self._link_begins[RIGID_LINKS]
        found = [
            np.minimum.reduceat(between, self._pair_begins, axis=-1),
            np.minimum.reduceat(to_deck, begins, axis=-1),
        ]
        if self._load is not None:
            flange = frames[..., -1, :, :]
            count = self._link_begins[LINKS_BEFORE_WRIST]
            near = axes.select(np.arange(count))
            to_links = self._load.distances(flange, near, far) - arm.radius[:count]
            begins = self._link_begins[:LINKS_BEFORE_WRIST]
            found += [
                self._platform.distances_from_load(self._load, flange, reach)[..., None],
                np.minimum.reduceat(to_links, begins, axis=-1),
            ]
        return np.concatenate(found, axis=-1)

    def distances(
        self, poses: Array, q: Array, obstacles: UprightObstacles, reach: float = np.inf
    ) -> Array:
        """Return the distances (..., N, M) [m] of the N parts from M obstacles.

        Poses (..., 3) are those of base_link in the frame of the obstacles [m, m, rad]; joint
        angles (..., 6) [rad] are not used without an arm. Distances above `reach` [m] may be too
        small, but are not below it.

        Raises:
            InputError: A pose or an angle is not finite.
        """
        _require_finite("poses", poses)
        found = [self._platform.distances_from_obstacles(poses, obstacles)[..., None, :]]
        arm = self._arm
        if arm is not None:
            _require_finite("joint angles", q)
            frames = planar_transform(poses)[..., None, :, :] @ arm.frames(q)
            axes = arm.capsules(frames)
            found.append(self._arm_distances(arm, axes, obstacles, reach))
            if self._load is not None:
                load = self._load.distances_from_obstacles(frames[..., -1, :, :], obstacles, reach)
                found.append(load[..., None, :])
        return np.concatenate(found, axis=-2)

    def _arm_distances(
        self, arm: ArmSegments, axes: Segments, obstacles: UprightObstacles, reach: float
    ) -> Array:
        """Return the distances (..., L, M) of the arm's links from obstacles [m].

        Only obstacles that are near the whole arm are looked at closely.
        """
        far = reach + arm.radius.max()
        batch, segments = axes.start.shape[1:-1], axes.start.shape[-1]
        start, end = (points.reshape(3, -1, segments) for points in (axes.start, axes.end))
        centre, radius = Segments(start, end).sphere()
        bound = obstacles.point_distances(centre[..., None]) - radius[:, None] - arm.radius.max()
        result = np.repeat(bound[:, None], len(arm.names), axis=1)
        configuration, obstacle = np.nonzero(bound <= reach)
        start, end = (np.swapaxes(points[:, configuration], 1, 2) for points in (start, end))
        each = obstacles.select(obstacle).distances(start, end, far) - arm.radius[:, None]
        least = np.minimum.reduceat(each, self._link_begins, axis=0)
        result[configuration, :, obstacle] = least.T
        return result.reshape(*batch, len(arm.names), len(obstacles))


def _begins(labels: list[object]) -> Indices:
    """Return the index of the first of each run of equal labels."""
    lengths = [len(list(run)) for _, run in groupby(labels)]
    return np.cumsum([0, *lengths[:-1]])


def _require_finite(name: str, values: Array) -> None:
    """Require that values are finite; an unknown distance must not count as a large one."""
    if not np.isfinite(values).all():
        raise InputError(f"{name} must be finite")


class PlatformBox:
    """A platform that is its bounding box [m].

    The radius is the distance of its farthest point from the z axis of base_link.
    """

    def __init__(self, length: float, width: float, heights: tuple[float, float]) -> None:
        self._half: Array = np.array((0.5 * length, 0.5 * width))
        self._heights = heights
        self._box = UprightObstacles.box((0.0, 0.0, 0.0), length, width, heights)
        self.radius = float(np.hypot(*self._half))

    def distances_from_segments(self, start: Array, end: Array, reach: float) -> Array:
        """Return the distances (...) from segments (3, ...) in base_link; zero where they meet.

        Above `reach` [m] a lower bound is enough.
        """
        return self._box.distances(start[..., None], end[..., None], reach)[..., 0]

    def distances_from_load(self, load: LoadBox, flange: Array, reach: float) -> Array:
        """Return the distances (...) from a load at poses (..., 4, 4) of the flange [m]."""
        return load.distances_from_obstacles(flange, self._box, reach)[..., 0]

    def distances_from_obstacles(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the distances (..., M) from obstacles at poses (..., 3) in their frame [m].

        Args:
            poses: Poses (..., 3) of base_link in the frame of the obstacles [m, m, rad].
        """
        return obstacles.box_distances(poses, self._half, self._heights)


class PlatformPrism:
    """A platform whose outline is a simple polygon, convex or not.

    Seen from above, polygon and rectangle are apart by the least distance of a side of the polygon
    from the rectangle, unless the rectangle lies within the polygon. In space, the polygon is the
    union of convex pieces: their least distance counts. Methods and radius are those of
    `PlatformBox`.

    Args:
        corners: Corners (K, 2) of the outline in base_link, counter-clockwise [m].
    """

    def __init__(self, corners: Array, heights: tuple[float, float]) -> None:
        self._heights = heights
        self._pieces = [ConvexPrism(piece, heights) for piece in convex_pieces(corners)]
        following = np.roll(corners, -1, axis=0)
        self._sides = list(zip(corners.tolist(), following.tolist(), strict=True))
        self.radius = float(np.hypot(*corners.T).max())

    def distances_from_segments(self, start: Array, end: Array, reach: float) -> Array:
        """Return the distances (...) from segments (3, ...) in base_link; zero where they meet."""
        result: Array = np.full(start.shape[1:], np.inf)
        for piece in self._pieces:
            # Only a piece that may be nearer than those before matters.
            found = piece.distances(start, end, np.minimum(result, reach))
            np.minimum(result, found, out=result)
        return result

    def distances_from_load(self, load: LoadBox, flange: Array, reach: float) -> Array:
        """Return the distances (...) from a load, with the flange at poses (..., 4, 4) [m]."""
        each = [load.distances_from_prism(flange, piece, reach) for piece in self._pieces]
        result: Array = np.min(each, axis=0)
        return result

    def distances_from_obstacles(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the distances (..., M) from M obstacles; zero where they meet [m]."""
        apart = self._distances_from_rectangles(poses, obstacles)
        horizontal = np.maximum(apart - obstacles.rounding, 0.0)
        bottom, top = self._heights
        vertical = np.maximum(np.maximum(obstacles.lower - top, bottom - obstacles.upper), 0.0)
        result: Array = np.hypot(horizontal, vertical)
        return result

    def _distances_from_rectangles(self, poses: Array, obstacles: UprightObstacles) -> Array:
        """Return the horizontal distances (..., M) from obstacles without their rounding [m]."""
        c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
        dx, dy = (obstacles.centre[i] - poses[..., i, None] for i in (0, 1))
        # Centres and directions of the rectangles in base_link.
        x, y = c * dx + s * dy, c * dy - s * dx
        yaw = obstacles.yaw - poses[..., 2, None]
        c, s = np.cos(yaw), np.sin(yaw)
        length, width = obstacles.half
        corners = [
            (x + i * length * c - j * width * s, y + i * length * s + j * width * c)
            for i in (-1.0, 1.0)
            for j in (-1.0, 1.0)
        ]
        squared = np.full(x.shape, np.inf)
        meet, within = np.zeros(x.shape, dtype=bool), np.zeros(x.shape, dtype=bool)
        for (ax, ay), (bx, by) in self._sides:
            # The side's first corner and its direction in the frames of the rectangles.
            u, v = c * (ax - x) + s * (ay - y), c * (ay - y) - s * (ax - x)
            eu, ev = c * (bx - ax) + s * (by - ay), c * (by - ay) - s * (bx - ax)
            beyond_u = np.maximum(np.abs(u) - length, 0.0)
            beyond_v = np.maximum(np.abs(v) - width, 0.0)
            np.minimum(squared, beyond_u * beyond_u + beyond_v * beyond_v, out=squared)
            # No axis of the rectangle and not the side's normal separate the two.
            mu, mv = u + 0.5 * eu, v + 0.5 * ev
            meet |= (
                (np.abs(mu) <= length + 0.5 * np.abs(eu))
                & (np.abs(mv) <= width + 0.5 * np.abs(ev))
                & (np.abs(mu * ev - mv * eu) <= length * np.abs(ev) + width * np.abs(eu))
            )
            ex, ey = bx - ax, by - ay
            for px, py in corners:
                fraction = np.clip(
                    ((px - ax) * ex + (py - ay) * ey) / (ex * ex + ey * ey), 0.0, 1.0
                )
                gx, gy = px - ax - fraction * ex, py - ay - fraction * ey
                np.minimum(squared, gx * gx + gy * gy, out=squared)
            if ay != by:
                crosses = (ay > y) != (by > y)
                within ^= crosses & (x < ax + (y - ay) * (ex / ey))
        return np.where(meet | within, 0.0, np.sqrt(squared))


def platform_body(body: Body, heights: tuple[float, float]) -> PlatformBox | PlatformPrism:
    """Return the platform between two heights [m]."""
    if body.outline is None:
        return PlatformBox(body.length, body.width, heights)
    return PlatformPrism(body.outline, heights)
