"""Shape of platform, arm, tool and load, and distances between them and from solids."""

from itertools import groupby

import numpy as np

from omniman_ros.collision.arm_segments import ArmSegments, Segments
from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.load_box import LoadBox
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.platform_body import platform_body
from omniman_ros.collision.segments import segment_distances
from omniman_ros.collision.solids import UprightSolids
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
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
ALWAYS_NEAR = frozenset({(0, 2), (3, 5), (4, 6), (4, 7), (5, 7)})


class BodyGeometry:
    """Distances of the surfaces of the robot's parts from one another and from solids.

    The platform is a box with the length and the width of the body, or a prism with the body's
    outline, from the floor to the upper side of the deck. Links of the arm and the tool are
    capsules. The load is a box. Where two parts overlap, their distance is minus the depth, if
    that is less than the radius of a capsule; deeper, it is minus the radius. Between platform and
    load, and from solids, it is zero then.

    Args:
        description: Shapes of platform and arm, and where the arm is mounted.

    Attributes:
        parts: Names of the parts.
        pairs: Names of the two parts of each pair that may collide.
        levers: (P, 6) largest travel of one part of each pair relative to the other, per angle of
            each joint [m/rad].
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
        self.levers: Array = np.zeros((0, JOINTS))
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
            if b - a > 1 and (a, b) not in ALWAYS_NEAR
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
        levers = [arm.levers(a, min(b, JOINTS), arm.extent(b)) for a, b in ends]
        if self._load is not None:
            self.parts += (LOAD,)
            others = (PLATFORM, *names[:LINKS_BEFORE_WRIST])
            self.pairs += tuple((name, LOAD) for name in others)
            firsts = (0, *range(LINKS_BEFORE_WRIST))
            levers += [arm.levers(first, JOINTS, self._load.extent) for first in firsts]
        self.levers = np.array(levers)

    def _bound_parts(self, arm: ArmSegments, offset: float) -> None:
        """Bound where the parts can be; the arm stands `offset` [m] from the z axis."""
        links = range(len(arm.names))
        levers = [arm.levers(0, min(link, JOINTS), arm.extent(link)) for link in links]
        if self._load is not None:
            levers.append(arm.levers(0, JOINTS, self._load.extent))
        self.part_levers = np.vstack((self.part_levers, levers))
        # Each link but the first turns about the upright axis of the first joint.
        reach = np.maximum(np.array(levers)[:, 0], arm.extent(0))
        self.part_radii = np.append(self.part_radii, offset + reach)

    def self_distances(self, q: Array, reach: float = np.inf) -> Array:
        """Return the distances between the parts of the robot.

        Args:
            q: Joint angles (..., 6) [rad].
            reach: Distance above which a lower bound is enough [m].

        Returns:
            Distances (..., P) [m] of all pairs. Those above `reach` may be too small, but are not
            below it.

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
        self, poses: Array, q: Array, solids: UprightSolids, reach: float = np.inf
    ) -> Array:
        """Return the distances of the robot's parts from solids.

        Args:
            poses: Poses (..., 3) of base_link in the frame of the solids [m, m, rad].
            q: Joint angles (..., 6) [rad]; not used without an arm.
            solids: M solids.
            reach: Distance above which a lower bound is enough [m].

        Returns:
            Distances (..., N, M) [m] of the N parts. Those above `reach` may be too small, but are
            not below it.

        Raises:
            InputError: A pose or an angle is not finite.
        """
        _require_finite("poses", poses)
        found = [self._platform.distances_from_solids(poses, solids)[..., None, :]]
        arm = self._arm
        if arm is not None:
            _require_finite("joint angles", q)
            frames = planar_transform(poses)[..., None, :, :] @ arm.frames(q)
            axes = arm.capsules(frames)
            found.append(self._arm_distances(arm, axes, solids, reach))
            if self._load is not None:
                load = self._load.distances_from_solids(frames[..., -1, :, :], solids, reach)
                found.append(load[..., None, :])
        return np.concatenate(found, axis=-2)

    def _arm_distances(
        self, arm: ArmSegments, axes: Segments, solids: UprightSolids, reach: float
    ) -> Array:
        """Return the distances (..., L, M) of the arm's links from solids [m].

        Only solids that are near the whole arm are looked at closely.
        """
        far = reach + arm.radius.max()
        batch, segments = axes.start.shape[1:-1], axes.start.shape[-1]
        start, end = (points.reshape(3, -1, segments) for points in (axes.start, axes.end))
        centre, radius = Segments(start, end).sphere()
        bound = solids.point_distances(centre[..., None]) - radius[:, None] - arm.radius.max()
        result = np.repeat(bound[:, None], len(arm.names), axis=1)
        configuration, solid = np.nonzero(bound <= reach)
        start, end = (np.swapaxes(points[:, configuration], 1, 2) for points in (start, end))
        each = solids.select(solid).distances(start, end, far) - arm.radius[:, None]
        least = np.minimum.reduceat(each, self._link_begins, axis=0)
        result[configuration, :, solid] = least.T
        return result.reshape(*batch, len(arm.names), len(solids))


def _begins(labels: list[object]) -> Indices:
    """Return the index of the first of each run of equal labels."""
    lengths = [len(list(run)) for _, run in groupby(labels)]
    return np.cumsum([0, *lengths[:-1]])


def _require_finite(name: str, values: Array) -> None:
    """Require that values are finite; an unknown distance must not count as a large one."""
    if not np.isfinite(values).all():
        raise InputError(f"{name} must be finite")
