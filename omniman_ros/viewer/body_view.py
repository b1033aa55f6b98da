"""The shapes of the robot by which distances are computed, and what is nearest to them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.collision.arm_segments import ArmSegments
from omniman_ros.collision.body_geometry import PLATFORM, BodyGeometry
from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.obstacle_shapes import FARTHEST, ellipse_surroundings
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.urdf import carries_arm
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.whole_body.model import planar_transform
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.viewer.placed_obstacles import ObstacleArrays

JOINT_TOLERANCE = 0.01  #: Rotation of a joint from which the footprint is computed anew [rad]
DISPLAY_DISTANCE = 3.0  #: Distance up to which something counts as near [m]
NEAREST_POINTS = 60  #: Number of nearest scanner points whose distances are computed
PLATFORM_HEIGHT = 0.3  #: Height at which a line from the platform is drawn [m]
GHOST_SPACING = 0.2  #: Least distance between the same points of two ghosts of a plan [m]
STATIONS = np.linspace(0.0, 1.0, 11)  #: Ratios along an axis or edge where a line may begin


@dataclass(frozen=True)
class Nearest:
    """What is nearest to the robot."""

    part: str  #: Name of the robot's part
    distance: float  #: Its distance [m]
    line: Array  #: (2, 3) line between the two in `odom`, to draw [m]


@dataclass(frozen=True)
class BodyView:
    """The robot's shapes.

    Attributes:
        start, end: (S, 3) ends of the axes of the arm's capsules in `odom` [m].
    """

    start: Array
    end: Array
    radius: Array  #: (S,) their radii [m]
    footprint: Array  #: (P, 4, 2) corners of the rectangles that bound the robot from above [m]
    nearest: Nearest | None  #: What is nearest; None if nothing is near


@dataclass(frozen=True)
class PlanView:
    """The motion of the whole body that is planned."""

    ghosts: Array  #: (s, 2, 3) lines in `odom`: platform and arm in the end and on the way [m]
    nearest: Nearest | None  #: What it avoids: what is nearest on the way; None if nothing is near


class BodyShapes:
    """Computes the view of a robot's shapes."""

    def __init__(
        self, description: DescriptionParameters, tool: ToolShape, load: LoadShape
    ) -> None:
        half = 0.5 * np.array([description.robot.body.length, description.robot.body.width])
        self._box: Array = half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        self._geometry = BodyGeometry(description, tool, load)
        self._outline = BodyOutline(description, tool, load)
        has_arm = carries_arm(description.robot)
        self._arm = ArmSegments(description.mount, tool) if has_arm else None
        self._posture: Array | None = None
        self._corners: Array = np.zeros((0, 4, 2))

    def view(self, pose: Array, joints: Array, obstacles: UprightObstacles) -> BodyView:
        """Return the shapes at a pose, and what is nearest to them.

        Args:
            pose: Pose (3,) of base_link in `odom` [m, m, rad].
            joints: Joint angles (6,) [rad]; not used without an arm.

        Raises:
            InputError: A number is not finite.
        """
        start, end, radius = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        if self._arm is not None:
            axes = self._arm.capsules(self._links(pose, joints))
            start, end, radius = axes.start.T, axes.end.T, self._arm.radius
        footprint = _in_odom(self._footprint(joints), pose)
        nearest = self._nearest(pose, joints, obstacles, start, end)
        return BodyView(start, end, radius, footprint, nearest)

    def plan_view(self, plan: Array, obstacles: Sequence[UprightObstacles]) -> PlanView:
        """Return the view of a plan, axes (k, 9), with what is around at each of its instants."""
        ghosts, near = [], []
        for axes, around in zip(plan, obstacles, strict=True):
            pose, joints = axes[PLATFORM_COLUMNS], axes[JOINT_COLUMNS]
            corners = np.insert(_in_odom(self._box, pose), 2, PLATFORM_HEIGHT, axis=1)
            links = self._links(pose, joints)[:, :3, 3]
            edges = [*zip(corners, np.roll(corners, -1, axis=0), strict=True)]
            ghosts.append(np.array([*edges, *itertools.pairwise(links)]))
            near.append(self.view(pose, joints, around).nearest)
        known = [each for each in near if each is not None]
        nearest = min(known, key=lambda each: each.distance, default=None)
        return PlanView(np.concatenate(_apart(ghosts)), nearest)

    def _links(self, pose: Array, joints: Array) -> Array:
        """Return the poses (7, 4, 4) of the arm's links in `odom`."""
        assert self._arm is not None
        result: Array = planar_transform(pose) @ self._arm.frames(joints)
        return result

    def _footprint(self, joints: Array) -> Array:
        """Return the corners (P, 4, 2) in base_link of the rectangles at all heights [m]."""
        last = self._posture
        if last is None or np.abs(joints - last).max() > JOINT_TOLERANCE:
            self._posture = joints
            whole = self._outline.footprint(joints[None], 0.0).whole
            self._corners = whole.corners.reshape(-1, 4, 2)
        return self._corners

    def _nearest(
        self, pose: Array, joints: Array, obstacles: UprightObstacles, start: Array, end: Array
    ) -> Nearest | None:
        if not len(obstacles):
            return None
        distances = self._geometry.distances(pose, joints, obstacles, DISPLAY_DISTANCE)
        part, obstacle = np.unravel_index(int(distances.argmin()), distances.shape)
        distance = float(distances[part, obstacle])
        if distance >= DISPLAY_DISTANCE:
            return None
        name = self._geometry.parts[part]
        thing = obstacles.select(np.array([obstacle]))
        if self._arm is not None and name in self._arm.names:
            chosen = self._arm.link == self._arm.names.index(name)
            begin, way = start[chosen, None], (end - start)[chosen, None]
            points = (begin + STATIONS[:, None] * way).reshape(-1, 3)
        else:
            corners = _in_odom(self._corners[0 if name == PLATFORM else -1], pose)
            edges = np.roll(corners, -1, axis=0) - corners
            flat = (corners[:, None] + STATIONS[:, None] * edges[:, None]).reshape(-1, 2)
            height = np.clip(PLATFORM_HEIGHT, thing.lower, thing.upper)
            points = np.column_stack((flat, np.broadcast_to(height, len(flat))))
        nearest = points[thing.point_distances(points.T[..., None])[:, 0].argmin()]
        place = thing.nearest_points(nearest[:, None])[:, 0]
        return Nearest(name, distance, np.stack((nearest, place)))


def _apart(ghosts: Sequence[Array]) -> list[Array]:
    """Return the last of the ghosts (s, 2, 3), and those apart from the first and from later ones.

    The first is where the robot is.
    """
    kept = [ghosts[-1]]
    for ghost in ghosts[-2:0:-1]:
        others = np.stack((ghosts[0], kept[-1]))
        if (np.linalg.norm(ghost - others, axis=-1).max(axis=(1, 2)) >= GHOST_SPACING).all():
            kept.append(ghost)
    return kept


def obstacles_around(
    pose: Array, others: Ellipses, placed: ObstacleArrays, scan: Array, ahead: float = 0.0
) -> UprightObstacles:
    """Return what is around the robot: obstacles, and the nearest points of scanners.

    Like the cells of a map, the points count at all heights.

    Args:
        pose: Pose (3,) of base_link in `odom` [m, m, rad].
        scan: Points (k, 3) in `odom` [m].
        ahead: Time for which the obstacles go on before at their velocities [s].
    """
    away = np.hypot(*(scan[:, :2] - pose[:2]).T)
    points = scan[np.argsort(away)[:NEAREST_POINTS], :2]
    m, k = len(placed.numbers), len(points)
    own = Ellipses(
        0.0, placed.centers, placed.velocities, placed.semi_axes, placed.angles, np.zeros(m)
    )
    moved = (replace(e, centers=e.centers + ahead * e.velocities) for e in (others, own))
    flat = np.zeros(k)
    beams = UprightObstacles(
        points.T, flat, np.zeros((2, k)), flat, flat - FARTHEST, flat + FARTHEST
    )
    known = (ellipse_surroundings(each).obstacles for each in moved)
    return UprightObstacles.join([*known, beams])


def _in_odom(points: Array, pose: Array) -> Array:
    """Return points (..., 2) of base_link at a pose (3,) in `odom` [m]."""
    result: Array = points @ se2.rotation(float(pose[2]))[:2, :2] + pose[:2]
    return result
