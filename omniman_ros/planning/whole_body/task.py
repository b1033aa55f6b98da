"""A task of the whole body: the tool along a path, past what is around the robot."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.arrays import Array
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.posture import PostureResolver
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.controller import CycleOutcome, WholeBodyController
from omniman_ros.planning.whole_body.linearisation import Linearisation
from omniman_ros.planning.whole_body.parameters import DodgeOptions
from omniman_ros.planning.whole_body.plan_check import PlanCheck
from omniman_ros.planning.whole_body.redundancy import ToolRedundancy
from omniman_ros.planning.whole_body.surroundings import Hindrances
from omniman_ros.planning.whole_body.way import Way
from omniman_ros.planning.whole_body.way_search import WaySearch


@dataclass(frozen=True)
class BodySetup:
    """What a task needs to know of the robot.

    Attributes:
        description: Shapes of platform and arm, and where the arm is mounted.
        limits: Limits of the nine axes and of the wheels.
        tool: Shape of the tool.
        load: Shape of the load, if any.
        path: Options of tool paths.
        dodge: Options of the way around obstacles.
    """

    description: DescriptionParameters
    limits: WholeBodyLimits
    tool: ToolShape
    load: LoadShape | None
    path: ToolPathOptions
    dodge: DodgeOptions


class WholeBodyTask:
    """Leads the tool along one path, from rest to rest.

    Args:
        setup: The robot, and all options.
        poses: Poses (k, 4, 4) of `tool0` in odom; the tool moves straight to the first.
        start: (9,) positions of all axes at rest.
        time: Time at which the task begins [s].
        around: What is around the robot.

    Attributes:
        redundancy: Kinematics on the path of the tool.
        way: Way of the platform that leads the plans.
        controller: Control of the motion.

    Raises:
        InputError: The input is invalid, the path is too far away, the arm starts near a
            singularity, or there is no way for the platform (:class:`NoWayError`).
        SolverError: casadi has no HPIPM.
    """

    def __init__(
        self, setup: BodySetup, poses: Array, start: Array, time: float, around: Hindrances
    ) -> None:
        model = WholeBodyModel(setup.description.mount)
        limits, options, o = setup.limits, setup.path, setup.dodge
        ToolPlanner(model, limits, options).require_valid(poses, start)
        path = ToolCurve(np.concatenate([model.forward(start)[None], poses]), options)
        resolver = PostureResolver(model, limits, options)
        resolver.signs(start[3:])  # raises on a singularity, where there is no branch
        self.redundancy = ToolRedundancy(model, path, start[3:])
        shapes = setup.description, setup.tool, setup.load
        least, gaps = options.singularity, BodyGaps(*shapes, o.spacing)
        coarse = BodyGaps(*shapes, o.way.spacing)
        self._search = WaySearch(self.redundancy, coarse, resolver, limits, least, o.way)
        at = np.append(start[:3], 0.0)
        self.way: Way = self._search.find(at, around.standing)
        tool = (options.linear_velocity, options.linear_acceleration, least, options.reserve)
        self.controller = WholeBodyController(
            self.redundancy,
            gaps,
            limits,
            Linearisation(self.redundancy, gaps, resolver, limits, tool, o),
            PlanCheck(self.redundancy, gaps, resolver, limits, least, o),
            o,
        )
        self.controller.begin(time, at)

    def search(self, time: float, around: Hindrances) -> None:
        """Find the way anew from where the robot is at a time [s], as something new stands.

        Raises:
            NoWayError: There is none; the way before stays.
        """
        at, _ = self.controller.motion.sample(time)
        self.way = self._search.find(at, around.standing)

    def cycle(self, now: float, around: Hindrances) -> CycleOutcome:
        """Choose the motion from a time [s] on; see :meth:`WholeBodyController.cycle`."""
        return self.controller.cycle(now, self.way, around)

    def axes(self, times: Array) -> Array:
        """Return all axes (k, 9) at times (k,) [s] of the motion that is followed."""
        return self.redundancy.axes(self.controller.motion.at(times)[0])

    def is_completed(self, time: float) -> bool:
        """Return whether the robot is at rest at the end of the path at a time [s]."""
        return self.controller.is_completed(time)
