"""Paths of the tool: accepted, planned in the background, driven by platform and arm."""

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.pace import Pace
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.motion.whole_body.correction import (
    PlatformCorrection,
    corrected_arm_motion,
    joint_speed_pace,
)
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionInput,
    MotionLog,
    PendingMotion,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.path_interpolator.motions import (
    BodyContext,
    DrivenMotion,
    MotionInterface,
    WholeBodyOutput,
)
from omniman_ros.nodes.serialized import deserialized, serialized_stamp

POSE_BYTES = 160  #: Upper bound of the size of a pose in a serialized path [bytes]
SPARE_POSES = 100  #: Number of poses whose bytes are allowed for the rest of the message


class PathInput:
    """Passes each received path on, once the transform of its frame is known."""

    def __init__(
        self,
        context: BodyContext,
        topic: str,
        log: MotionLog,
        max_poses: Callable[[], int],
        refusal: Callable[[], str],
        accept: Callable[[LoggedMotion, Path], str],
    ) -> None:
        self._log, self._max_poses, self._refusal = log, max_poses, refusal

        def take(received: tuple[LoggedMotion, Path]) -> str:
            return accept(*received)

        self._take = context.frames.deferred(topic, lambda received: [received[1].header], take)
        # The message stays serialized, so that a path of a million poses is refused unread.
        on_data = context.node.guarded(topic, self._on_data)
        context.node.create_subscription(Path, topic, on_data, 10, raw=True)

    def _on_data(self, data: bytes) -> str | None:
        motion = self._log.receive(serialized_stamp(data))
        max_poses = self._max_poses()
        try:
            if len(data) > POSE_BYTES * (max_poses + SPARE_POSES):
                raise InputError(
                    f"{len(data) / 1e6:.0f} MB, at most {max_poses} poses are accepted"
                )
            if why := self._refusal():  # before unpacking, which would hold up the motion
                raise InputError(why)
            message = deserialized(data, Path)
        except InputError as error:
            raise self._log.refuse(motion, str(error)) from error
        return self._take((motion, message))


#: Number of steps between a pace of 0 and 1; fewer changes of the pace disturb the motion less
PACE_STEPS = 20


class LedTool(Protocol):
    """The tool of a planned motion."""

    @property
    def branch(self) -> int:
        """Branch of the arm's inverse kinematics."""

    def tool(self, times: Array) -> Array:
        """Return poses (m, 4, 4) of `tool0` in odom at times (m,) of the motion [s]."""


class PlannedAxes(Protocol):
    """The axes of a planned motion, in motion time."""

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) at increasing motion times (k,) [s]."""

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the tool's motion at increasing motion times (k,) [s]."""


@dataclass(frozen=True)
class CorrectedStretch:
    """A stretch of a tool path, corrected for the platform's error."""

    window: Window  #: All axes (k, 9) at the times of the stretch
    tool: Array  #: (4, 4) planned pose of `tool0` in odom at the first time


class ToolStream:
    """A planned tool path whose joint angles are corrected for the platform's error.

    Args:
        velocity: (6,) limits of the joint speeds [rad/s].
    """

    def __init__(
        self,
        model: WholeBodyModel,
        plan: LedTool,
        options: ToolPathOptions,
        velocity: tuple[float, ...],
    ) -> None:
        self._model, self.plan, self._velocity = model, plan, np.array(velocity)
        self.correction = PlatformCorrection(options)
        self._joint_pace: float = 1.0
        self._arm_offset: Array = np.zeros(len(velocity))

    @property
    def max_pace(self) -> float:
        """Highest pace at which the path may be driven, 0 to 1."""
        steps = np.floor(PACE_STEPS * min(self.correction.max_pace(), self._joint_pace))
        return max(float(steps), 1.0) / PACE_STEPS  # a pace of 0 would remain 0

    def corrected(self, times: Array, pace: Pace, core: PlannedAxes) -> CorrectedStretch:
        """Correct the plan at times (k,) a tick apart [s]; raise InputError if out of reach."""
        # The times are padded by one tick on either side, for central differences.
        padded = np.concatenate([times[:1] - TICK, times, times[-1:] + TICK])
        paced = pace.sample(padded)
        plan_times = core.plan_times(paced.motion)
        planned = paced_window(pace, core.sample, padded)
        window = self.window(planned, plan_times, float(paced.rate[0]))
        offset = window.positions[0, JOINT_COLUMNS] - planned.positions[1, JOINT_COLUMNS]
        self._arm_offset = offset
        return CorrectedStretch(window, self.plan.tool(plan_times[1:2])[0])

    def offset(self, planned: Window) -> Window:
        """Return a planned motion (k, 9) whose arm keeps the correction of the last stretch."""
        positions = planned.positions.copy()
        positions[:, JOINT_COLUMNS] += self._arm_offset
        return replace(planned, positions=positions)

    def correct(self, time: float, pose: Array, reference: Array) -> str:
        """Correct the arm for a measured and a planned pose (3,); return any excessive error.

        Args:
            pose: (3,) measured pose of the platform in odom [m, m, rad].
        """
        self.correction.update(time, pose, reference)
        if self.correction.error_ratio <= 1.0:
            return ""
        x, y, theta = self.correction.error
        return f"{math.hypot(x, y):.3f} m and {theta:.3f} rad"

    def window(self, planned: Window, plan_times: Array, rate: float) -> Window:
        """Replace the arm's part of a planned motion by the corrected one.

        Args:
            planned: All axes (k + 2, 9), from a tick before the result to a tick after it.
            plan_times: (k + 2,) times of the plan [s].
            rate: Present pace, 0 to 1.

        Returns:
            The corrected motion (k, 9).
        """
        platform = self.correction.platform_at(
            planned.positions[:, PLATFORM_COLUMNS], planned.times
        )
        tool, near = self.plan.tool(plan_times), planned.positions[:, JOINT_COLUMNS]
        arm = corrected_arm_motion(self._model, platform, tool, self.plan.branch, near, TICK)
        self._joint_pace = joint_speed_pace(arm[1], self._velocity, rate)
        whole = (planned.positions, planned.velocities, planned.accelerations)
        parts = zip(whole, arm, strict=True)
        joined = (np.hstack([rows[1:-1, PLATFORM_COLUMNS], joints]) for rows, joints in parts)
        return Window(planned.times[1:-1], *joined)


class ToolPosePublisher:
    """Publisher of poses of the tool in odom."""

    def __init__(self, node: OmnimanNode, topic: str, frame: str) -> None:
        self._node = node
        self._message = PoseStamped()
        self._message.header.frame_id = frame
        self._publisher = node.create_publisher(PoseStamped, topic, 10)

    def send(self, time: float, pose: Array) -> None:
        """Publish a pose (4, 4) at a time of the node's clock [s]."""
        arm_conversions.fill_pose(self._message.pose, pose)
        self._message.header.stamp = self._node.stamp(time)
        self._publisher.publish(self._message)


#: Shortest period of corrected previews of the arm between those of both parts [s]
MIN_CORRECTION_PERIOD = 0.018


class BodyInterface(MotionInterface):
    """Drives motions of the whole body; where the tool is led, the arm corrects the platform."""

    def __init__(self, context: BodyContext, core: DrivenMotion, kind: MotionInput) -> None:
        super().__init__(context, core, WholeBodyOutput(context), kind)
        self.limit_scale = 1.0
        self._tool: ToolStream | None = None
        self._corrected_at = float("-inf")
        self._tool_reference = ToolPosePublisher(
            self._node, "tool_reference", context.options.frames.odom.odom_frame
        )

    @property
    def max_pace(self) -> float:
        """Highest pace at which the motion may be driven, 0 to 1."""
        if self.idle:
            return 1.0
        return min(self.limit_scale, 1.0 if self._tool is None else self._tool.max_pace)

    def blocking_reason(self) -> str:
        """Return why no motion can start yet, or an empty string."""
        options, context = self._context.options, self._context
        why = context.arm_feed.blocking_reason(options.joint_trajectory, idle=self.idle)
        if why or not self.idle:
            return why
        why = context.odom.blocking_reason(options.odom_timeout)
        return why or context.control_wait_reason()

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (9,), with odom's heading as it is."""
        odom, arm = self._context.odom, self._context.arm_feed.state()
        if odom.pose is None or arm is None:
            return None
        return np.concatenate([odom.pose, arm[0]]), np.concatenate([odom.velocity, arm[1]])

    def rest_position(self) -> Array:
        """Return the positions (9,) at which platform and arm are at rest [m, m, rad, ...]."""
        tolerance = self._context.options.joint_trajectory.start_tolerance
        arm = self._context.arm_feed.start_position(tolerance)
        assert self._context.odom.pose is not None and arm is not None
        return np.concatenate([self._context.odom.pose, arm])

    def update_pose(self, pose: Array, at: float) -> None:
        """Correct the arm for the platform's pose (3,) in odom [m, m, rad] at a time [s]."""
        tool, pace = self._tool, self._context.time_base.pace
        if self.idle or tool is None or at <= tool.correction.time:
            return  # a controller that was held up repeats a measurement
        if not self.output.is_covered(self._node.now()):
            return  # the next tick gives the motion up
        reference = self.platform_reference(pace.motion(at))
        if deviation := tool.correct(at, pose, reference):
            self.give_up(f"the platform is {deviation} off its path", brake=True)
        elif self._node.now() - self._corrected_at >= MIN_CORRECTION_PERIOD:
            self.publish(self._context.options.horizon, platform=False)

    def platform_reference(self, motion_time: float) -> Array:
        """Return the planned pose (3,) of the platform in odom at a motion time [s]."""
        return self.core.sample(np.array([motion_time]))[0][0, PLATFORM_COLUMNS]

    def publish(self, horizon: float, *, platform: bool = True) -> None:
        """Publish previews that are `horizon` long [s], of both parts or of the arm alone."""
        if self.idle:
            return
        if self._tool is None:
            super().publish(horizon)
            return
        time_base = self._context.time_base
        times = time_base.sample_times(horizon)
        try:
            stretch = self._tool.corrected(times, time_base.pace, self.core)
        except InputError as error:
            self.give_up(str(error), brake=True)
            return
        self._tool_reference.send(float(times[0]), stretch.tool)
        self._corrected_at = self._node.now()
        if platform:
            self.output.send(stretch.window)
        else:
            self.output.send_arm(stretch.window.columns(JOINT_COLUMNS))

    def _stop_window(self, now: float) -> Window | None:
        """Return the stretch that leads to rest, on which the arm keeps its present correction."""
        window = super()._stop_window(now)
        return window if window is None or self._tool is None else self._tool.offset(window)


Plan = TypeVar("Plan")
TOOL_POSE_PERIOD = 0.1  #: Period of `tool_pose` [s]
MAX_START_DRIFT = 0.005  #: Largest movement of the robot while a path is being planned [m, rad]


def in_background(plan: Callable[[], Plan]) -> Future[Plan]:
    """Plan in a thread, because planning takes up to seconds and must not delay stops.

    The thread does not delay the end of the process either: it is a daemon, which runs on if its
    plan is discarded.
    """
    future: Future[Plan] = Future()

    def work() -> None:
        try:
            future.set_result(plan())
        except BaseException as error:  # raised again by `result()`
            future.set_exception(error)

    threading.Thread(target=work, name="tool_path", daemon=True).start()
    return future


class ToolDriver(Protocol[Plan]):
    """Plans motions along paths of the tool, and drives them."""

    def planner(self, poses: Array, start: Array) -> Callable[[], Plan]:
        """Return what plans tool poses (k, 4, 4) in odom from axes (9,), also in a thread."""

    def drive(self, motion: LoggedMotion, plan: Plan) -> None:
        """Start a planned motion; raise InputError if it cannot be driven any more."""


class ToolInterface(Generic[Plan]):
    """Accepts paths of the tool, one at a time and from rest."""

    def __init__(
        self,
        context: BodyContext,
        whole_body: BodyInterface,
        driver: ToolDriver[Plan],
        on_accepted: Callable[[], None] = lambda: None,
    ) -> None:
        self._context, self._node, self._whole_body = context, context.node, whole_body
        self._driver, self._on_accepted = driver, on_accepted
        self._model = WholeBodyModel(context.options.mount)
        self.log = context.events.log(MotionInput.TOOL_PATH)
        self._pending = PendingMotion(
            self._node,
            context.stream_monitor,
            self.log,
            self._blocking_reason,
            conflict=self._conflict,
        )
        self.restart_timeout = self._pending.restart_timeout
        self._plan: tuple[LoggedMotion, Future[Plan]] | None = None
        self._running: Future[Plan] | None = None
        self._start_position: Array = np.zeros(0)
        self._tool_pose = ToolPosePublisher(
            self._node, "tool_pose", context.options.frames.odom.odom_frame
        )
        self._node.every(TOOL_POSE_PERIOD, self._publish_tool_pose)
        PathInput(
            context,
            "tool_path",
            self.log,
            max_poses=lambda: context.options.tool_path.max_poses,
            refusal=self._conflict,
            accept=self._accept,
        )

    def _publish_tool_pose(self) -> None:
        """Publish the pose of the tool if platform and arm are measured."""
        measured, context = self._whole_body.actual(), self._context
        timeout = context.options.odom_timeout
        measured_at = min(context.odom.time, context.arm_feed.time)
        if measured is not None and self._node.now() - measured_at < timeout:
            self._tool_pose.send(measured_at, self._model.forward(measured[0]))

    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Take a path, in odom as its frame is known now: it stays there."""
        max_poses = self._context.options.tool_path.max_poses
        try:
            place = self._context.frames.into_odom(message.header).matrix()
            self._poses(message, place, np.eye(3))
            if len(message.poses) > max_poses:
                raise InputError(f"{len(message.poses)} poses, at most {max_poses} are accepted")
            if self._context.is_ending():
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error

        def planner(start: Array) -> Callable[[], Plan]:
            poses = self._poses(message, place, self._model.forward(start)[:3, :3])
            return self._driver.planner(poses, start)

        return self._take(motion, planner, f"a tool path of {len(message.poses)} poses")

    def take(self, planner: Callable[[Array], Callable[[], Plan]], label: str) -> str:
        """Take a motion, planned from axes (9,) at rest; return why it is refused, or ""."""
        return self._take(self.log.receive(Time()), planner, label)

    def _take(
        self, motion: LoggedMotion, planner: Callable[[Array], Callable[[], Plan]], label: str
    ) -> str:
        self.discard(MotionEvent.REPLACED)
        self._on_accepted()
        return self._pending.accept(motion, lambda: self._start_planning(motion, planner, label))

    def _poses(self, message: Path, place: Array, here: Array) -> Array:
        """Return poses (k, 4, 4) in odom of a path in a frame at `place`; see `tool_poses`."""
        names = self._context.options.frames.odom.beside(message.header.frame_id)
        poses: Array = place @ arm_conversions.tool_poses(message, names, place[:3, :3].T @ here)
        return poses

    @property
    def idle(self) -> bool:
        """Whether no path of the tool is under way."""
        return self._whole_body.idle

    @property
    def is_planning(self) -> bool:
        """Whether a path is being planned."""
        return self._plan is not None and not self._plan[1].done()

    def discard(self, event: MotionEvent = MotionEvent.CANCELLED) -> bool:
        """Discard the path that waits or is being planned, and return whether there was one."""
        plan, self._plan = self._plan, None
        if plan is not None:
            self.log.report(plan[0], event)
        return self._pending.discard(event) or plan is not None

    def start(self) -> str:
        """Plan the path that waits, or start it once planned; return why it is refused, or ""."""
        why = self._pending.start() if self._plan is None else ""
        if self._plan is None:
            return why
        (motion, plan), why = self._plan, self._context.stream_monitor.blocking_reason
        why = why or self._conflict()
        if not why and not plan.done():  # a reset must not start the path
            return ""
        self._plan = None
        why = why or self._whole_body.blocking_reason() or self._start(motion, plan)
        if why:
            self.log.refuse(motion, why)
        return why

    def _conflict(self) -> str:
        if not self._whole_body.idle:
            return "a motion of the whole body is under way; ~/cancel ends it"
        return self._context.conflict(self._whole_body)

    def _blocking_reason(self) -> str:
        if self._running is not None and not self._running.done():
            return "a discarded path is still being planned"
        return self._whole_body.blocking_reason()

    def _start_planning(
        self, motion: LoggedMotion, planner: Callable[[Array], Callable[[], Plan]], label: str
    ) -> None:
        start = self._whole_body.rest_position()
        self._running, self._start_position = in_background(planner(start)), start
        self._plan = motion, self._running
        self.log.report(motion, MotionEvent.PLANNING, f"planning {label}")

    def _start(self, motion: LoggedMotion, future: Future[Plan]) -> str:
        """Start a planned path; return why that is impossible, or an empty string."""
        try:
            plan = future.result()
        except InputError as error:
            return str(error)
        except Exception as error:  # raised in the thread; it must not end the node
            why = f"it could not be planned: {type(error).__name__}: {error}"
            self._node.get_logger().error(why)
            return why
        offset = self._whole_body.rest_position() - self._start_position
        offset[2] = se2.wrap(float(offset[2]))
        drift = float(np.abs(offset).max())
        if drift > MAX_START_DRIFT:
            return f"the robot has moved by {drift:.3f} (m or rad) while it was planned"
        try:
            self._driver.drive(motion, plan)
        except InputError as error:
            return str(error)
        return ""
