"""Node `whole_body_planner`: the tool on its path while platform and arm avoid obstacles."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64

from omniman_ros.core.arrays import Array
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.extras import PLANNING
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvents, MotionInput
from omniman_ros.nodes.motion_time_base import MotionServices, MotionTimeBase, ScalingInterface
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.path_interpolator.motions import HealthInput, LimitInterface, StreamContext
from omniman_ros.nodes.path_interpolator.tool import (
    BodyInterface,
    ToolInterface,
    ToolStream,
    in_background,
)
from omniman_ros.nodes.path_interpolator.trajectories import MotionSupervisor
from omniman_ros.nodes.robot_streams import ArmFeed, OdomFeed, arm_previews, platform_previews
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction, status_values
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
    from omniman_ros.planning.whole_body.task import BodyTask

PROGRESS = 0.001  #: Movement on the path that counts as progress [m]
#: Time without progress after which the robot counts as waiting, and another way is searched for;
#: least time between two searches [s].
BLOCKED = 1.0
SOURCE = "body"  #: Value of `active_source` while the node drives the platform


class AvoidanceInterface(BodyInterface):
    """Plans tasks of the whole body, and drives one at a time; see `ToolDriver`."""

    _context: StreamContext[WholeBodyPlannerParameters]
    core: "AvoidanceMotion"  #: Motion that is driven

    def __init__(
        self,
        context: StreamContext[WholeBodyPlannerParameters],
        core: "AvoidanceMotion",
        surroundings: SurroundingsInterface,
    ) -> None:
        super().__init__(context, core, MotionInput.TOOL_PATH)
        self._surroundings = surroundings
        self._model = WholeBodyModel(context.options.mount)
        self._found: Obstruction | None = None  # of the last cycle
        self._nearest: Obstruction | None = None  # on the way of the last cycle
        self.cycle_time = math.nan
        self._no_path: NoPathError | None = None  # of the last search, until there is progress
        self._search: Future[None] | None = None
        self._path_parameter = self._moved_at = self._cycled_at = 0.0
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
        around = self._surroundings.obstacle_snapshot()
        return lambda: WholeBodyTask(setup, poses, start, now, around)

    def hold_planner(self, start: Array) -> "Callable[[], BodyTask]":
        """Return what makes a task that holds the tool where it is, from positions (9,)."""
        from omniman_ros.planning.whole_body.task import ToolHold

        setup, now = self._setup(), self._context.time_base.now()
        return lambda: ToolHold(setup, start, now)

    def _setup(self) -> BodySetup:
        p = self._context.options
        load = p.load if p.load.is_carried else None
        return BodySetup(p.description, self.core.limits, p.tool, load, p.led_tool, p.dodge)

    def drive(self, motion: LoggedMotion, task: "BodyTask") -> None:
        """Start a task from the robot's present position."""
        p, now = self._context.options, self._node.now()
        self.core.follow(task)
        self._tool = ToolStream(self._model, self.core, p.tool_path, p.arm.each("velocity"))
        self.output.begin(from_rest=True)
        self._search = self._found = self._nearest = self._no_path = None
        self._path_parameter, self._moved_at, self._cycled_at = 0.0, now, now
        length = task.redundancy.path.length()
        what = f"{length:.2f} m of the tool" if task.has_end else "the tool is held"
        self._announce(motion, what)

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
        if self._no_path is not None:
            return self._no_path.obstruction
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
        return str(self._no_path or self.obstruction or "the robot is slowed down")

    def plan(self) -> None:
        """Choose the motion for the next cycle, and give up if there is no way on."""
        begin, time_base = self._node.now(), self._context.time_base
        now, pace = time_base.now(), time_base.pace
        elapsed, self._cycled_at = begin - self._cycled_at, begin
        around = self._surroundings.obstacle_snapshot()
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
        path_parameter = self.core.path_parameter(now)
        if path_parameter > self._path_parameter + PROGRESS:
            self._path_parameter, self._moved_at, self._no_path = path_parameter, begin, None
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
                self._no_path = None
            except NoPathError as error:
                self._no_path = error
            except Exception as error:  # raised in the thread; it must not end the node
                self._node.get_logger().error(f"search failed: {type(error).__name__}: {error}")
        stands = self._found is not None and self._found.cause is Cause.STANDING
        is_blocked = stands or self.waiting_time() >= BLOCKED
        if is_blocked and now - self._searched_at >= BLOCKED:
            self._searched_at = now
            task, around = self.core.task, self._surroundings.obstacle_snapshot()
            self._search = in_background(lambda: task.search(motion_time, around))

    def blocking_reason(self) -> str:
        """Return why no path can start yet, or an empty string."""
        return self._surroundings.silence_reason() or super().blocking_reason()


class BodyCoordinator:
    """Runs the paths of the tool."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[WholeBodyPlannerParameters],
        period: float,
    ) -> None:
        # Imported here, so that the parameters of the node can be read without casadi.
        from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion

        p, odom_frame = settings.value, settings.value.frames.odom.odom_frame
        self._node, self.is_ending = node, False
        self._progress = node.create_publisher(Float64, "path_progress", 10)
        self.scaling = ScalingInterface(node, self._on_slowed)
        motion = AvoidanceMotion(WholeBodyLimits.of_whole_body(p.core, p.arm))
        self.context: StreamContext[WholeBodyPlannerParameters] = StreamContext(
            node=node,
            events=MotionEvents(node),
            read_options=lambda: settings.value,
            frames=FrameTransforms(node, lambda: settings.value.frames),
            stream_monitor=StreamMonitor(p.restart, SOURCE),
            odom=OdomFeed(node, "odom", odom_frame, lambda *it: self.whole_body.update_pose(*it)),
            arm_feed=ArmFeed(
                node,
                p.arm.joints,
                lambda: not self.whole_body.idle,
                lambda: self._supervisor.check_arm(),
            ),
            time_base=MotionTimeBase(
                (motion,), node.now, self.scaling, lambda: settings.value.scaling_timeout
            ),
            platform_previews=platform_previews(
                node, f"{SOURCE}/reference", odom_frame, p.horizon
            ),
            arm_previews=arm_previews(node, p.arm.joints, p.horizon),
            publish_all=lambda horizon: self.whole_body.publish(horizon),
            on_started=self._on_started,
            conflict=lambda _: "",
            is_ending=lambda: self.is_ending,
        )
        self.limits = LimitInterface(
            node, lambda: settings.value, ((motion, slice(None)),), self._on_slowed
        )
        self.surroundings = SurroundingsInterface(node, self.context.frames, p.surroundings)
        self.whole_body = AvoidanceInterface(self.context, motion, self.surroundings)
        self.tool: ToolInterface[BodyTask] = ToolInterface(
            self.context,
            self.whole_body,
            self.whole_body,
            self.surroundings.dismiss_silent_source,
        )
        HealthInput(self.context, self._scale_limits)
        self._supervisor = MotionSupervisor(self.context, self.scaling, period, self.whole_body)
        StreamMonitorInterface(node, self.context.stream_monitor, self._supervisor.check_control)
        self._scaled_at, self._ticked_at = float("-inf"), node.now()

    def configure(self, new: WholeBodyPlannerParameters) -> None:
        """Set new parameters, which apply from the next path on."""
        self.whole_body.configure(new)
        self.surroundings.configure(new.surroundings)
        self.limits.configure(new)
        self.context.stream_monitor.silence = new.restart

    def _on_slowed(self) -> None:
        """Slow down at once; further changes within a tick of the stream wait for the next."""
        if self._node.now() - self._scaled_at >= TICK:
            self._scaled_at = self._node.now()
            self.send()

    def _scale_limits(self, scale: float) -> None:
        self.whole_body.limit_scale = scale
        self._on_slowed()

    def _on_started(self) -> None:
        self.context.time_base.release()
        self.send()

    def hold(self) -> None:
        """Hold the tool where it is, or raise RefusedError if no motion may begin."""
        if self.is_ending:
            raise RefusedError("the node is shutting down")
        if why := self.tool.take(self.whole_body.hold_planner, "a hold of the tool"):
            raise RefusedError(why)

    def cancel(self) -> None:
        """Discard what waits or brake what moves; raise RefusedError if there is nothing."""
        is_discarded = self.tool.discard()
        if not self.context.time_base.idle or not is_discarded:
            self.context.time_base.cancel()

    def begin_shutdown(self) -> None:
        """Bring the robot to rest on its path, and accept nothing new."""
        self.is_ending = True
        self.context.frames.end_waiting()
        self.tool.discard()
        if not self.context.time_base.idle:
            self.context.time_base.cancel()
            self.send()

    def tick(self) -> None:
        """Supervise the motion, start a path that waits, plan, and publish previews."""
        since_tick, self._ticked_at = self._node.now() - self._ticked_at, self._node.now()
        self._supervisor.check_time(since_tick)
        if since_tick < -TIME_JUMP:
            self.tool.restart_timeout()
        self._supervisor.check_control()
        if self.context.odom.pose is not None:
            self.surroundings.update_map(self.context.odom.pose)
        if refusal := self.tool.start():
            self._node.warn("tool path refused", f"tool path not used: {refusal}")
        if self.context.time_base.idle:
            return
        self.whole_body.plan()
        self.send()

    def send(self) -> None:
        """Publish progress, the demand, and previews at the pace that is allowed now."""
        time_base = self.context.time_base
        if time_base.idle:
            return
        self._progress.publish(Float64(data=time_base.progress()))
        motion_time = time_base.now()
        self.limits.publish_demand(motion_time)
        pace = min(self.whole_body.max_pace, self.limits.max_pace(motion_time))
        self._supervisor.limit_pace(pace)
        self.whole_body.tick()


class WholeBodyPlannerNode(OmnimanNode):
    """Serves paths and holds of the tool among obstacles as a ROS node."""

    lookahead = 0.04  # about the time that a plan takes

    def __init__(self, **options: object) -> None:
        # Imported here, so that the parameters of this module can be read without casadi.
        from omniman_ros.planning.whole_body.controller import PERIOD

        super().__init__("whole_body_planner", **options)
        self.settings = ParameterSet(self, WholeBodyPlannerParameters)
        self.motions = BodyCoordinator(self, self.settings, PERIOD)
        self.settings.on_change(self.motions.configure)
        time_base = self.motions.context.time_base
        services = MotionServices(self, time_base, self.motions.cancel, self.motions.send)
        services.add("hold", self.motions.hold, lambda: self.motions.tool.log.text)
        self._status_publisher = self.create_publisher(DiagnosticStatus, "body/status", 10)
        self.every(PERIOD, self._tick)

    def _tick(self) -> None:
        self.motions.tick()
        if self._status_publisher.get_subscription_count():
            self._status_publisher.publish(self.status_message(*self.status()))

    def begin_shutdown(self, reason: str) -> None:
        """Bring the robot to rest on its path, and accept nothing new."""
        self.motions.begin_shutdown()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way."""
        return self.motions.context.time_base.idle

    @property
    def stop_timeout(self) -> float:
        """How long the robot may take to come to rest from now on [s], with a margin of 1 s."""
        return 1.0 + self.motions.context.time_base.remaining()

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for `body/status` and the diagnostics."""
        motions, time_base = self.motions, self.motions.context.time_base
        body, tool = motions.whole_body, motions.tool
        waits = body.waiting_reason()
        values: list[tuple[str, object]] = [
            ("body", body.core.state.value),
            ("body_progress", round(body.core.progress(time_base.now()), 4)),
            ("waits", waits),
            *status_values(None if body.idle else body.obstruction),
            ("cycle_ms", round(1e3 * body.cycle_time, 2)),
            ("obstacles", len(motions.surroundings)),
            ("speed_scaling", round(motions.scaling.value, 4)),
            ("body_event", body.log.event.value),
            ("body_last", body.log.text),
            ("tool_path_event", tool.log.event.value),
            ("tool_path_last", tool.log.text),
        ]
        if waits:
            return DiagnosticStatus.WARN, f"waits: {waits}", values
        latest = max((body.log, tool.log), key=lambda log: log.order)
        if latest.is_trouble and body.idle:
            return DiagnosticStatus.WARN, latest.text, values
        return DiagnosticStatus.OK, time_base.state.value, values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros whole_body_planner`."""
    return run(WholeBodyPlannerNode, args, PLANNING)
