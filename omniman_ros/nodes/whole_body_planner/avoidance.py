"""Platform and arm on their paths while they avoid obstacles: tasks, and why they wait."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_reference_message
from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.nodes.motion_log import LoggedMotion, MotionInput
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.path_interpolator.tool import BodyInterface, in_background
from omniman_ros.nodes.whole_body_planner.named_surroundings import NamedSurroundings
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.progress_watch import BLOCKED, ProgressWatch

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
    from omniman_ros.planning.whole_body.task import BodyTask

DELAY_DECAY = 0.9  #: Factor by which the delay of plans that is expected falls from cycle to cycle
LONGEST_SENT = 2.0  #: Longest time for which a motion is sent ahead [s]
#: Time between two points of a plan that is shown, and from now to the last one at most [s]
PLAN_STEP, LONGEST_SHOWN = 0.5, 5.0
SENT_STEP = 0.2  #: Step of that time: a message with another number of points is made anew [s]


class AvoidanceInterface(BodyInterface["BodyTask"]):
    """Plans tasks of the whole body, and drives one at a time."""

    _motions: MotionCoordinator[WholeBodyPlannerParameters]
    core: "AvoidanceMotion"  #: Motion that is driven
    spacing = 2  # its motions are sent to their rest: twice as long as others

    def __init__(
        self,
        motions: MotionCoordinator[WholeBodyPlannerParameters],
        core: "AvoidanceMotion",
        surroundings: NamedSurroundings,
    ) -> None:
        super().__init__(motions, core, MotionInput.TOOL_PATH)
        self._surroundings = surroundings
        self._found: Obstruction | None = None  # of the last cycle
        self._nearest: Obstruction | None = None  # on the way of the last cycle
        self.cycle_time = math.nan
        self._delay = 0.0  # until a plan is used, by the last cycles [s]
        self._sent_for = 0.0  # until the robot rests [s]
        self._search: Future[None] | None = None
        self._watch = ProgressWatch(0.0)

    def configure(self, new: WholeBodyPlannerParameters) -> None:
        """Set new parameters, which apply from the next path on."""
        self.core.limits = WholeBodyLimits.of_whole_body(new.core, new.arm)
        self.configure_tool(new)

    def planner(self, poses: Array, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task: it searches for the platform's way."""
        # Imported here, so that the parameters of the node can be read without casadi.
        from omniman_ros.planning.whole_body.task import WholeBodyTask

        setup, now = self._setup(), self._motions.time_base.now()
        around = self._surroundings.snapshot()
        return lambda: WholeBodyTask(setup, poses, start, now, around)

    def goal_planner(self, poses: Array, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task to the last of poses (k, 4, 4) in odom, from axes (9,)."""
        from omniman_ros.planning.whole_body.tool_goal import tool_goal_task

        setup, now = self._setup(), self._motions.time_base.now()
        around = self._surroundings.snapshot()
        return lambda: tool_goal_task(setup, poses[-1], start, now, around)

    def joint_planner(self, goal: Array, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task that moves all axes from a start to a goal, (9,) each."""
        from omniman_ros.planning.whole_body.joint_goal import JointGoalTask

        setup, now = self._setup(), self._motions.time_base.now()
        around = self._surroundings.snapshot()
        return lambda: JointGoalTask(setup, goal, start, now, around)

    def hold_planner(self, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task that holds the tool where it is, from positions (9,)."""
        from omniman_ros.planning.whole_body.task import ToolHold

        setup, now = self._setup(), self._motions.time_base.now()
        return lambda: ToolHold(setup, start, now)

    def expect_path(self) -> None:
        """Prepare for a path of the tool; see the base class."""
        self._surroundings.obstacles.dismiss_silent_source()

    def _setup(self) -> BodySetup:
        p = self._motions.options
        load = p.load if p.load.is_carried else None
        return BodySetup(
            p.description, self.core.limits, p.tool, load, p.led_tool, p.dodge, p.orientation
        )

    def drive(self, motion: LoggedMotion, task: "BodyTask") -> None:
        """Start a task from the robot's present position."""
        now = self._node.now()
        self.core.follow(task)
        self._lead(self.core if task.leads_tool else None)
        self.output.begin(from_rest=True)
        self._search = self._found = self._nearest = None
        self._watch = ProgressWatch(now)
        self._announce(motion, task.description)

    def platform_reference(self, motion_time: float) -> Array:
        """Return the planned pose of the platform; see the base class."""
        return self.core.platform(motion_time)

    @property
    def max_pace(self) -> float:
        """Highest pace, 0 to 1; the robot stands while it does not know what is around it."""
        return 0.0 if not self.idle and self._surroundings.blind_reason() else super().max_pace

    def _planned(self, times: Array) -> tuple[Array, Array, Array]:
        return self.core.planned(times)

    def publish(self, horizon: float, *, platform: bool = True) -> None:
        """Publish previews of both parts, or of the arm alone, until the robot rests on its path.

        Who receives them follows the last ones to their end if this node falls silent.
        """
        super().publish(max(horizon, self._sent_for), platform=platform)

    def plan_message(self) -> JointTrajectory:
        """Return the plan that is followed, from now on, as a trajectory of all axes."""
        p, now = self._motions.options, self._motions.time_base.now()
        left = min(max(self.core.task.controller.motion.end - now, 0.0), LONGEST_SHOWN)
        times = PLAN_STEP * np.arange(math.ceil(left / PLAN_STEP) + 1, dtype=float)
        names = (*PLATFORM_AXES, *p.arm.joints)
        message = joint_reference_message(names, len(times), PLAN_STEP)
        message.header.frame_id, message.header.stamp = (
            p.frames.odom.odom_frame,
            self._node.stamp(),
        )
        for point, axes in zip(message.points, self.core.task.axes(now + times), strict=True):
            point.positions = axes.tolist()
        return message

    def remaining_length(self) -> float:
        """Return the length of the rest of the path [m]."""
        done = self.core.progress(self._motions.time_base.now())
        return (1.0 - done) * self.core.task.redundancy.path.length()

    @property
    def obstruction(self) -> Obstruction | None:
        """What is in the way, as the last cycle found it, or else the last search.

        Of a robot that waits with a clear plan, it is what leaves the least room.
        """
        if self._found is not None:
            return self._found
        if self._watch.no_path is not None:
            return self._watch.no_path.obstruction
        return self._nearest if self.waiting_time() >= BLOCKED else None

    def waiting_time(self) -> float:
        """Return how long there has been no progress [s]."""
        is_led = self.core.state is PathState.FOLLOWING
        return self._watch.waiting_time(self._node.now()) if is_led else 0.0

    def waiting_reason(self) -> str:
        """Return why the robot waits on its path, or an empty string."""
        if self.waiting_time() < BLOCKED:
            return ""
        if silence := self._surroundings.blind_reason():
            return silence
        return str(self._watch.no_path or self.obstruction or "the robot is slowed down")

    def plan(self) -> None:
        """Choose the motion for the next cycle, and give up if there is no way on."""
        begin, time_base = self._node.now(), self._motions.time_base
        now, pace = time_base.now(), time_base.pace
        around = self._surroundings.snapshot()
        ahead = self._motions.options.horizon
        outcome = self.core.cycle(now, pace.rate(begin), around, self._delay, ahead)
        if outcome is None:  # paused, braking or at its end: no progress is expected
            self._watch.excuse(begin)
            self._found = self._nearest = None
            return
        self.cycle_time = self._node.now() - begin
        self._delay = max(self.cycle_time, DELAY_DECAY * self._delay)
        rest = min(self.core.time_to_rest(now, pace.rate(begin)), LONGEST_SENT)
        self._sent_for = SENT_STEP * math.ceil(rest / SENT_STEP)
        self._found, self._nearest = outcome.obstruction, outcome.verdict.nearest
        if not self.core.task.has_end:
            self._watch.excuse(begin)
            return
        is_held = pace.target == 0.0
        is_excused = is_held and not self._surroundings.blind_reason()
        place = self.core.path_parameter(now)
        self._watch.note(begin, place, is_held=is_held, is_excused=is_excused)
        self._search_if_blocked(begin, now)
        if self.waiting_time() > self._motions.options.patience:
            self.give_up(f"it waited in vain: {self.waiting_reason()}", brake=True)

    def _search_if_blocked(self, now: float, motion_time: float) -> None:
        """Search for another way in the background once that is due; take what was found."""
        if self._search is not None:
            if not self._search.done():
                return
            search, self._search = self._search, None
            try:
                search.result()
                self._watch.no_path = None
                if self.core.take_detour(motion_time):
                    self._watch = ProgressWatch(now)
            except NoPathError as error:
                self._watch.no_path = error
            except Exception as error:  # raised in the thread; it must not end the node
                self._node.get_logger().error(f"search failed: {type(error).__name__}: {error}")
        is_obstructed = self._found is not None and self._found.cause is Cause.STANDING
        if self._watch.is_search_due(now, is_obstructed=is_obstructed):
            task, around = self.core.task, self._surroundings.snapshot()
            self._search = in_background(lambda: task.search(motion_time, around))

    def blocking_reason(self) -> str:
        """Return why no path can start yet, or an empty string."""
        return self._surroundings.blind_reason() or super().blocking_reason()
