"""Goals of the tool: the straight way there, or one around what stands.

Around, the robot is carried as a whole: its platform drives a route over (x, y, heading) while the
arm keeps the posture of the start. The route leads to a pose of the platform from which the arm
reaches the goal, and the tool goes straight there from the end of the route. Either way is a path
of the tool, on which the search of :class:`WholeBodyTask` is free to choose the motion.
"""

import math
from collections.abc import Iterator

import numpy as np

from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.se2 import wrap
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.tool_curve import ROTATION_LENGTH
from omniman_ros.planning.whole_body.carried_route import CarriedRoutes
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER
from omniman_ros.planning.whole_body.task import WholeBodyTask, path_search

ENDS = 400  #: Number of poses of the platform at the goal that are looked at, about
TRIES = 3  #: Number of ends of a route that are tried
APART = (
    0.5  #: Least distance between two of them [m]; a rotation by 1 rad counts as ROTATION_LENGTH
)
BEFORE = (0.0, 0.3, 0.6)  #: Distances of a route's end from the platform's pose at the goal [m]
DETOUR_PERIOD = 5.0  #: Least time between two searches for a detour [s]
RETREAT = 0.5  #: Length of the path on which the tool goes back before a detour [m]
RETREAT_STEPS = 11  #: Number of poses on it


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
    corners = np.stack([start[:3], ends[0]])
    routes = CarriedRoutes(setup, start[None, 3:], corners, ROTATION_LENGTH, standing)
    left = ends[routes.have_room(ends)]
    left = left[routes.may_reach(start, left)]
    for _ in range(TRIES):
        if not len(left):
            return
        end = left[0]
        route = routes.between(start[:3], end)
        if route is not None:
            yield route
        turn = ROTATION_LENGTH * np.abs([wrap(angle) for angle in (left - end)[:, 2].tolist()])
        left = left[np.hypot(*(left - end)[:, :2].T) + turn > APART]
