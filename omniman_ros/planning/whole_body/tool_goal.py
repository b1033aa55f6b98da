"""Goals of the tool: the straight way there, or one around what stands.

Around, the robot is carried as a whole: its platform drives a route over (x, y, heading) while the
arm keeps the posture of the start. The route leads to a pose of the platform from which the arm
reaches the goal, and the tool goes straight there from the end of the route. Either way is a path
of the tool, on which the search of :class:`WholeBodyTask` is free to choose the motion.
"""

import math
from collections.abc import Iterator

import numpy as np

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.se2 import wrap
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.tool_curve import ROTATION_LENGTH
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.route.disc_reach import reached_by_disc
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.search import RouteSearch
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER
from omniman_ros.planning.whole_body.task import WholeBodyTask, path_search
from omniman_ros.surroundings.ellipses import Ellipses

#: Gap of the route relative to that of a way of the platform: a route halves it between its nodes
GAP_FACTOR = 2.0
ROOM = 4.0  #: Distance around start and goal that a route may use [m]
RESOLUTION = 0.1  #: Edge of the route's lattice [m]
HEADINGS = 16  #: Number of headings of the route's lattice
WORK = 400_000  #: Largest effort of one search for a route [expansions]
ENDS = 400  #: Number of poses of the platform at the goal that are looked at, about
TRIES = 3  #: Number of ends of a route that are tried
APART = (
    0.5  #: Least distance between two of them [m]; a rotation by 1 rad counts as ROTATION_LENGTH
)
BEFORE = (0.0, 0.3, 0.6)  #: Distances of a route's end from the platform's pose at the goal [m]
DETOUR_PERIOD = 5.0  #: Least time between two searches for a detour [s]
RETREAT = 0.5  #: Length of the path on which the tool goes back before a detour [m]
RETREAT_STEPS = 11  #: Number of poses on it
PIECE = 0.1  #: Length of a long obstacle for which one disc stands, at least [m]


class ToolGoalTask(WholeBodyTask):
    """Leads the tool along a path to a goal, and looks for another path where that one is blocked.

    See the base class for the arguments; the goal is the last of the poses, which are of the tool
    as it is. So its tilts in a cone do not add up from one path to the next.
    """

    def __init__(
        self, setup: BodySetup, poses: Array, start: Array, time: float, around: ObstacleSnapshot
    ) -> None:
        super().__init__(setup, poses, start, time, around, poses[-1])
        self._setup, self._goal, self._tried_at = setup, poses[-1], -math.inf

    def search(self, time: float, around: ObstacleSnapshot) -> None:
        """Find the way of the platform anew, or a `detour` of the tool if there is none.

        A detour begins at rest, and is looked for every `DETOUR_PERIOD` at most.
        """
        try:
            super().search(time, around)
        except NoPathError as error:
            if not self.rests(time) or time - self._tried_at < DETOUR_PERIOD:
                raise
            self._tried_at = time
            now = self.controller.motion.sample(time)[0]
            place = float(now[PATH_PARAMETER])
            places = np.linspace(place, max(place - RETREAT, 0.0), RETREAT_STEPS)
            back = np.insert(self.way.at(places)[0], PATH_PARAMETER, places, axis=1)
            start, *before = self.redundancy.axes(np.vstack([now, back]))
            try:
                self.detour = tool_goal_task(
                    self._setup, self._goal, start, time, around, np.array(before)
                )
            except InputError:
                raise error from None


def tool_goal_task(
    setup: BodySetup,
    goal: Array,
    start: Array,
    time: float,
    around: ObstacleSnapshot,
    back: Array | None = None,
) -> ToolGoalTask:
    """Return the task that leads the tool to a pose (4, 4) in odom, from axes (9,) at rest.

    Args:
        back: Axes (k, 9) through which the robot can leave its start; a way around what stands
            begins at the last. None: it begins at the start.

    Raises:
        InputError: The input is invalid, the arm starts near a singularity, or the goal is out of
            reach or there is no way to it, not even around (:class:`NoPathError`).
        SolverError: casadi has no HPIPM.
    """
    axes = start[None] if back is None else back
    model = WholeBodyModel(setup.description.mount)
    tool = model.forward(np.vstack([start, axes]))
    straight = np.stack([tool[0], goal])
    ends = path_search(setup, straight, start, goal)[0].ends(start[:3], around)
    try:
        return ToolGoalTask(setup, straight, start, time, around)
    except NoPathError as error:
        found = error.obstruction
    on_platform = np.linalg.inv(planar_transform(axes[-1, :3])) @ tool[-1]
    ends = ends[:: max(1, len(ends) // ENDS)]
    away = ends[:, :2] - goal[:2, 3]
    away /= np.maximum(np.hypot(*away.T), 1e-9)[:, None]
    # What stands under the goal leaves no room for the posture of the start: it stays before.
    before = [np.column_stack([ends[:, :2] + d * away, ends[:, 2]]) for d in BEFORE]
    for poses in _routes(setup, np.concatenate(before), axes[-1], around.standing):
        way = np.concatenate([tool, planar_transform(poses) @ on_platform, goal[None]])
        try:
            return ToolGoalTask(setup, way, start, time, around)
        except NoPathError:
            continue
    raise NoPathError(f"{found}, and there is no way around", found)


def _routes(
    setup: BodySetup, ends: Array, start: Array, standing: UprightObstacles
) -> Iterator[Array]:
    """Yield routes of the robot in its posture at the start (9,) to some of the ends (n, 3).

    A route is poses (k, 3) of the platform, close to one another.
    """
    margin = GAP_FACTOR * setup.dodge.way.margin
    outline = BodyOutline(setup.description, setup.tool, setup.load)
    footprint = outline.footprint(start[None, 3:], setup.dodge.way.margin)
    discs = covering_discs(standing)
    corners = np.stack([start[:2], ends[0, :2]])
    (x_min, y_min), (x_max, y_max) = corners.min(axis=0) - ROOM, corners.max(axis=0) + ROOM
    workspace = x_min, y_min, x_max, y_max
    top = platform_top(setup.description.robot, setup.description.mount.z)
    beside = discs.select((discs.lower < top) & (discs.upper > 0.0))
    inner = _inscribed_radius(footprint.platform)
    left = ends[Clearance(footprint, discs, workspace, margin + PIECE).gaps(ends) > margin]
    left = left[reached_by_disc(start[:2], left[:, :2], inner, beside, workspace)]
    for _ in range(TRIES):
        if not len(left):
            return
        end = left[0]
        problem = RouteProblem(
            start[:3], end, footprint, margin, (1.0, 1.0 / ROTATION_LENGTH), discs, None, workspace
        )
        search = RouteSearch(problem, RESOLUTION, HEADINGS)
        search.advance(WORK)
        if search.route is not None:
            yield search.route.samples(footprint.radius)[1]
        turn = ROTATION_LENGTH * np.abs([wrap(angle) for angle in (left - end)[:, 2].tolist()])
        left = left[np.hypot(*(left - end)[:, :2].T) + turn > APART]


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
