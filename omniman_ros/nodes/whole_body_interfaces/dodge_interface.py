"""Motions of the whole body that dodge: planned cycle by cycle, while the tool is led."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.nodes.trajectory_interfaces.body_interface import BodyInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import StreamContext
from omniman_ros.nodes.trajectory_interfaces.tool_interface import in_background
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolStream
from omniman_ros.nodes.whole_body_interfaces.parameters import WholeBodyPlannerParameters
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.way import NoWayError

if TYPE_CHECKING:
    from omniman_ros.planning.whole_body.dodging_motion import DodgingMotion
    from omniman_ros.planning.whole_body.task import BodySetup, BodyTask

PROGRESS = 0.001  #: Movement on the path that counts as progress [m]
#: Time without progress after which the robot counts as waiting, and another way is searched for;
#: least time between two searches [s].
BLOCKED = 1.0


class DodgeInterface(BodyInterface):
    """Plans tasks of the whole body, and drives one at a time; see `ToolDriver`."""

    _context: StreamContext[WholeBodyPlannerParameters]
    core: "DodgingMotion"  #: Motion that is driven

    def __init__(
        self,
        context: StreamContext[WholeBodyPlannerParameters],
        core: "DodgingMotion",
        surroundings: SurroundingsInterface,
    ) -> None:
        super().__init__(context, core, "tool path")
        self._surroundings = surroundings
        self._model = WholeBodyModel(context.options.mount)
        self._found: Obstruction | None = None  # of the last cycle
        self._nearest: Obstruction | None = None  # on the way of the last cycle
        self.cycle_time = math.nan
        self._no_way: NoWayError | None = None  # of the last search, until there is progress
        self._search: Future[None] | None = None
        self._place = self._moved_at = self._cycled_at = 0.0
        self._searched_at = -math.inf

    def configure(self, new: WholeBodyPlannerParameters) -> None:
        """Set new parameters, which apply from the next path on."""
        self.core.limits = WholeBodyLimits.of_whole_body(new.core, new.arm)
        if self._tool is not None:
            self._tool.correction.options = new.tool_path

    def planner(self, poses: Array, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task: it searches for the platform's way."""
        # Imported here, so that the parameters of the node can be read without casadi.
        from omniman_ros.planning.whole_body.task import WholeBodyTask

        setup, now = self._setup(), self._context.time_base.now()
        around = self._surroundings.hindrances()
        return lambda: WholeBodyTask(setup, poses, start, now, around)

    def hold_planner(self, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task that holds the tool where it is, from positions (9,)."""
        from omniman_ros.planning.whole_body.task import ToolHold

        setup, now = self._setup(), self._context.time_base.now()
        return lambda: ToolHold(setup, start, now)

    def _setup(self) -> "BodySetup":
        from omniman_ros.planning.whole_body.task import BodySetup

        p = self._context.options
        load = p.load if p.load.is_carried else None
        return BodySetup(p.description, self.core.limits, p.tool, load, p.led_tool, p.dodge)

    def drive(self, task: "BodyTask") -> None:
        """Start a task from the robot's present position."""
        p, now = self._context.options, self._node.now()
        self.log.accept(replaces_pending=False)
        self.log.start(replaces_driven=False)
        self.core.follow(task)
        self._tool = ToolStream(self._model, self.core, p.tool_path, p.arm.each("velocity"))
        self.output.begin(from_rest=True)
        self._search = self._found = self._nearest = self._no_way = None
        self._place, self._moved_at, self._cycled_at = 0.0, now, now
        length = task.redundancy.path.length()
        self._announce(f"{length:.2f} m of the tool" if task.has_end else "the tool is held")

    def platform_reference(self, motion_time: float) -> Array:
        """Return the planned pose of the platform; see the base class."""
        return self.core.platform(motion_time)

    @property
    def max_pace(self) -> float:
        """Highest pace, 0 to 1; the robot stands while it does not know what is around it."""
        return 0.0 if not self.idle and self._surroundings.silence_reason() else super().max_pace

    @property
    def obstruction(self) -> Obstruction | None:
        """What is in the way, as the last cycle found it, or else the last search.

        Of a robot that waits with a clear plan, it is what leaves the least room.
        """
        if self._found is not None:
            return self._found
        if self._no_way is not None:
            return self._no_way.obstruction
        return self._nearest if self.waiting_time() >= BLOCKED else None

    def waiting_time(self) -> float:
        """Return how long there has been no progress [s]."""
        is_led = self.core.state is PathState.FOLLOWING
        return self._node.now() - self._moved_at if is_led else 0.0

    def waiting_reason(self) -> str:
        """Return why the robot waits on its path, or an empty string."""
        if self.waiting_time() < BLOCKED:
            return ""
        if silence := self._surroundings.silence_reason():
            return silence
        return str(self._no_way or self.obstruction or "the robot is slowed down")

    def plan(self) -> None:
        """Choose the motion for the next cycle, and give up if there is no way on."""
        begin, time_base = self._node.now(), self._context.time_base
        now, pace = time_base.now(), time_base.pace
        elapsed, self._cycled_at = begin - self._cycled_at, begin
        around = self._surroundings.hindrances()
        outcome = self.core.cycle(now, pace.rate(begin), around)
        if outcome is None:  # paused, braking or at its end: no progress is expected
            self._moved_at += elapsed
            self._found = self._nearest = None
            return
        self.cycle_time = self._node.now() - begin
        self._found, self._nearest = outcome.obstruction, outcome.verdict.nearest
        if not self.core.task.has_end:
            self._moved_at = begin
            return
        place = self.core.place(now)
        if place > self._place + PROGRESS:
            self._place, self._moved_at, self._no_way = place, begin, None
        elif pace.target == 0.0 and not self._surroundings.silence_reason():
            self._moved_at += elapsed  # who slows the robot down wants it to wait
        self._search_if_blocked(begin, now)
        if begin - self._moved_at > self._context.options.patience:
            self.give_up(f"it waited in vain: {self.waiting_reason()}", brake=True)

    def _search_if_blocked(self, now: float, motion_time: float) -> None:
        """Search for another way, in the background, as something stands in the way of this one.

        Also while there is no progress, whatever the cause.
        """
        if self._search is not None:
            if not self._search.done():
                return
            search, self._search = self._search, None
            try:
                search.result()
                self._no_way = None
            except NoWayError as error:
                self._no_way = error
            except Exception as error:  # raised in the thread; it must not end the node
                self._node.get_logger().error(f"search failed: {type(error).__name__}: {error}")
        stands = self._found is not None and self._found.cause is Cause.STANDING
        is_blocked = stands or self.waiting_time() >= BLOCKED
        if is_blocked and now - self._searched_at >= BLOCKED:
            self._searched_at = now
            task, around = self.core.task, self._surroundings.hindrances()
            self._search = in_background(lambda: task.search(motion_time, around))

    def blocking_reason(self) -> str:
        """Return why no path can start yet, or an empty string."""
        return self._surroundings.silence_reason() or super().blocking_reason()
