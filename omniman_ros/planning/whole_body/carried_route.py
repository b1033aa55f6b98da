"""Routes of the platform over (x, y, heading) while the robot is carried as a whole."""

import math

import numpy as np

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.upright_obstacles import Mask, UprightObstacles
from omniman_ros.core.arrays import Array
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.route.disc_reach import reached_by_disc
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.search import RouteSearch
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.surroundings.ellipses import Ellipses

#: Gap of the route relative to that of a way of the platform: a route halves it between its nodes
GAP_FACTOR = 2.0
ROOM = 4.0  #: Distance around start and goal that a route may use [m]
RESOLUTION = 0.1  #: Edge of the route's lattice [m]
HEADINGS = 16  #: Number of headings of the route's lattice
WORK = 400_000  #: Largest effort of one search for a route [expansions]
PIECE = 0.1  #: Length of a long obstacle for which one disc stands, at least [m]


class CarriedRoutes:
    """Routes past what stands on which the arm has room for each of some postures.

    Args:
        postures: Joint angles (k, 6) [rad].
        corners: Poses (n, 3) of the platform around which there is a workspace [m, m, rad].
        rotation_length: Distance as which a rotation by 1 rad counts [m].
    """

    def __init__(
        self,
        setup: BodySetup,
        postures: Array,
        corners: Array,
        rotation_length: float,
        standing: UprightObstacles,
    ) -> None:
        robot, gap = setup.description, setup.dodge.way.margin
        self._margin, self._speeds = GAP_FACTOR * gap, (1.0, 1.0 / rotation_length)
        self._footprint = BodyOutline(robot, setup.tool, setup.load).footprint(postures, gap)
        self._discs = discs = covering_discs(standing)
        (x_min, y_min), (x_max, y_max) = (
            corners[:, :2].min(axis=0) - ROOM,
            corners[:, :2].max(axis=0) + ROOM,
        )
        self._workspace = x_min, y_min, x_max, y_max
        top = platform_top(robot.robot, robot.mount.z)
        self._beside = discs.select((discs.lower < top) & (discs.upper > 0.0))

    def have_room(self, poses: Array) -> Mask:
        """Return which poses (n, 3) have the gap that routes keep."""
        reach = self._margin + PIECE
        gaps = Clearance(self._footprint, self._discs, self._workspace, reach).gaps(poses)
        result: Mask = gaps > self._margin
        return result

    def may_reach(self, start: Array, ends: Array) -> Mask:
        """Return which ends (n, 3) a disc within the platform reaches from a start (3,)."""
        inner = _inscribed_radius(self._footprint.platform)
        return reached_by_disc(start[:2], ends[:, :2], inner, self._beside, self._workspace)

    def between(self, start: Array, end: Array) -> Array | None:
        """Return a route as poses (k, 3) close to one another, or None if none is found."""
        problem = RouteProblem(
            start,
            end,
            self._footprint,
            self._margin,
            self._speeds,
            self._discs,
            None,
            self._workspace,
        )
        search = RouteSearch(problem, RESOLUTION, HEADINGS)
        search.advance(WORK)
        return None if search.route is None else search.route.samples(self._footprint.radius)[1]


def _inscribed_radius(platform: Rectangles) -> float:
    """Return the radius of a disc around base_link within one of a platform's rectangles [m]."""
    own = np.abs(np.stack(platform.own_centre, axis=-1))
    return max(float((platform.half - own).min(axis=-1).max()), 0.0)


def covering_discs(obstacles: UprightObstacles) -> Ellipses:
    """Return discs that cover obstacles at their heights: several for a long one."""
    long, short = obstacles.half.max(axis=0), obstacles.half.min(axis=0)
    yaw = obstacles.yaw + 0.5 * math.pi * (obstacles.half[1] > obstacles.half[0])
    count = np.maximum(np.ceil(long / np.maximum(short, PIECE)), 1.0).astype(np.intp)
    owner = np.repeat(np.arange(len(count)), count)
    index = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    piece = (long / count)[owner]
    along = (2.0 * index + 1.0) * piece - long[owner]
    centre = obstacles.centre[:, owner] + along * np.stack([np.cos(yaw), np.sin(yaw)])[:, owner]
    radius = np.hypot(piece, short[owner]) + obstacles.rounding[owner]
    flat = np.zeros(len(owner))
    return Ellipses(
        0.0,
        centre.T,
        np.zeros((len(owner), 2)),
        np.column_stack([radius, radius]),
        flat,
        flat,
        obstacles.lower[owner],
        obstacles.upper[owner],
    )
