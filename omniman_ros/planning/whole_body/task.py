"""Tasks of the whole body past what is around it: the tool along a path, or held."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import AXES
from omniman_ros.motion.whole_body.held_tool import HeldTool
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.redundancy_resolver import RedundancyResolver
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.controller import CycleOutcome, WholeBodyController
from omniman_ros.planning.whole_body.free_orientation import FreeOrientation
from omniman_ros.planning.whole_body.linearisation import Linearisation, PathLimits
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.plan_check import PlanCheck
from omniman_ros.planning.whole_body.platform_path import PlatformPath
from omniman_ros.planning.whole_body.platform_path_search import PlatformPathSearch
from omniman_ros.planning.whole_body.redundancy import (
    COORDINATES,
    BodyRedundancy,
    SingularityMargins,
    ToolRedundancy,
)

REST = 1e-3  #: Rate of the coordinates below which a robot that waits rests [m/s, rad/s]


class BodyTask:
    """Platform and arm along a path of the body, such as one of the tool.

    Axes (9,) are at rest at the start; the way of the platform leads the plans.

    Args:
        free: Coordinates of the tool's free orientation at the start; None: zero.

    Attributes:
        leads_tool: Whether the tool is on the path, so that the arm follows in closed form.
        has_end: Whether the task ends by itself, so that progress is expected.
        check: What each plan must pass.
        detour: Task that begins where the robot waits and may take the place of this one.

    Raises:
        InputError: The tool is led, and the arm starts near a singularity.
        SolverError: casadi has no HPIPM.
    """

    leads_tool, has_end = True, True
    detour: "BodyTask | None" = None

    def __init__(
        self,
        setup: BodySetup,
        redundancy: BodyRedundancy,
        way: PlatformPath,
        start: Array,
        time: float,
        along: PathLimits | None = None,
        free: Array | None = None,
    ) -> None:
        limits, options, o = setup.limits, setup.path, setup.dodge
        margins = None
        if self.leads_tool:
            margins = SingularityMargins(redundancy.model, limits, options, start[3:])
        speed, acceleration = options.linear_velocity, options.linear_acceleration
        turning = options.angular_velocity, options.angular_acceleration
        along = along or PathLimits(speed, acceleration, options.reserve, turning)
        gaps = BodyGaps(setup.description, setup.tool, setup.load, o.spacing, o.time_gap)
        balance = BodyBalance(setup.description)
        self.redundancy, self.way = redundancy, way
        self.check = PlanCheck(redundancy, gaps, balance, margins, limits, o)
        improve = Linearisation(redundancy, gaps, balance, margins, limits, along, o)
        self.controller = WholeBodyController(redundancy, gaps, limits, improve, self.check, o)
        #: Redundancy coordinates (d,) at the start
        self.begin: Array = np.zeros(len(redundancy.bound))
        self.begin[:3] = start[:3]
        if free is not None:
            self.begin[COORDINATES:] = free
        self.controller.begin(time, self.begin)

    def search(self, time: float, around: ObstacleSnapshot) -> None:
        """Find the way anew from where the robot is at a time [s], as something new stands.

        Raises:
            NoPathError: There is none; the way before stays.
        """

    @property
    def description(self) -> str:
        """What is done, in words."""
        return f"{self.redundancy.path.length():.2f} m of the tool"

    def cycle(
        self, now: float, around: ObstacleSnapshot, ready: float | None = None
    ) -> CycleOutcome:
        """Choose the motion from a time [s] on; see :meth:`WholeBodyController.cycle`."""
        return self.controller.cycle(now, self.way, around, ready)

    def axes(self, times: Array) -> Array:
        """Return all axes (k, 9) at times (k,) [s] of the motion that is followed."""
        return self.redundancy.axes(self.controller.motion.at(times)[0])

    def rests(self, time: float) -> bool:
        """Return whether the robot is at rest at a time [s], but for its giving way slowly."""
        return bool(np.abs(self.controller.motion.sample(time)[1]).max() < REST)

    def is_completed(self, time: float) -> bool:
        """Return whether the task is done, with the body at rest at its end, at a time [s]."""
        return self.has_end and self.controller.is_completed(time)


class WholeBodyTask(BodyTask):
    """Leads the tool along one path, from rest to rest.

    Args:
        poses: Poses (k, 4, 4) of `tool0` in odom; the tool moves straight to the first.
        goal: Pose (4, 4) around whose axis the cone of a free orientation is, as far as it allows;
            None: each pose has its own.

    Raises:
        InputError: The input is invalid, the path is too far away, the arm starts near a
            singularity, or there is no way for the platform (:class:`NoPathError`).
        SolverError: casadi has no HPIPM.
    """

    def __init__(
        self,
        setup: BodySetup,
        poses: Array,
        start: Array,
        time: float,
        around: ObstacleSnapshot,
        goal: Array | None = None,
    ) -> None:
        self._search, free = path_search(setup, poses, start, goal)
        way = self._search.find(np.concatenate([start[:3], [0.0], free]), around)
        super().__init__(setup, self._search.redundancy, way, start, time, free=free)

    def search(self, time: float, around: ObstacleSnapshot) -> None:
        """Find the way anew; see the base class."""
        at, _ = self.controller.motion.sample(time)
        self.way = self._search.find(at, around)


def path_search(
    setup: BodySetup, poses: Array, start: Array, goal: Array | None = None
) -> tuple[PlatformPathSearch, Array]:
    """Return the search for ways of the platform while the tool is led along poses (k, 4, 4).

    The coordinates of the tool's free orientation at the start, if any, come second. The cone is
    around the axis of a goal (4, 4), if there is one; see :class:`WholeBodyTask`.

    Raises:
        InputError: The input is invalid, the path is too far away, or the arm starts (9,) near a
            singularity.
    """
    model = WholeBodyModel(setup.description.mount)
    limits, options, o = setup.limits, setup.path, setup.dodge
    ToolPlanner(model, limits, options).require_valid(poses, start)
    tool, free, begin = model.forward(start), _freedom(setup), np.zeros(0)
    led = np.concatenate([tool[None], poses])
    if free is not None:
        led, begin = free.path_of(tool, poses, goal)
    path = ToolCurve(led, options)
    resolver = RedundancyResolver(model, limits, options)
    resolver.signs(start[3:])  # raises on a singularity, where there is no branch
    redundancy = ToolRedundancy(model, path, start[3:], free)
    coarse = BodyGaps(setup.description, setup.tool, setup.load, o.way.spacing)
    search = PlatformPathSearch(
        redundancy, path, coarse, resolver, limits, options.singularity, o.way
    )
    return search, begin


def _freedom(setup: BodySetup) -> FreeOrientation | None:
    return FreeOrientation(setup.freedom) if setup.freedom.is_free else None


class ToolHold(BodyTask):
    """Holds the tool where it is, while platform and arm give way and come back; without end.

    The platform comes back to the start (9,).

    Raises:
        InputError: The positions are not finite, or the arm starts near a singularity.
        SolverError: casadi has no HPIPM.
    """

    has_end = False
    description = "the tool is held"

    def __init__(self, setup: BodySetup, start: Array, time: float) -> None:
        if start.shape != (AXES,) or not np.isfinite(start).all():
            raise InputError(f"the start must be {AXES} finite positions")
        model = WholeBodyModel(setup.description.mount)
        held = HeldTool(model.forward(start))
        redundancy = ToolRedundancy(model, held, start[3:], _freedom(setup))
        rest = np.append(start[:3], np.zeros(len(redundancy.bound) - COORDINATES))
        way = PlatformPath(0.0, 1.0, np.tile(rest, (2, 1)))
        super().__init__(setup, redundancy, way, start, time)
