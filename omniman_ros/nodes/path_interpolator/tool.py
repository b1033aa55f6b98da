"""Paths of the tool: accepted, planned in the background, driven by platform and arm."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
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
from omniman_ros.motion.path.pace import Pace, Window
from omniman_ros.motion.whole_body.correction import LedTool, PlatformCorrection, ToolStream
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionInput,
    MotionLog,
    PendingMotion,
)
from omniman_ros.nodes.motion_time_base import Interpolator
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator, MotionInterface
from omniman_ros.nodes.path_interpolator.parameters import StreamParameters
from omniman_ros.nodes.serialized import deserialized, serialized_stamp

Plan = TypeVar("Plan")
POSE_BYTES = 160  #: Upper bound of the size of a pose in a serialized path [bytes]
SPARE_POSES = 100  #: Number of poses whose bytes are allowed for the rest of the message
#: Shortest period of corrected previews of the arm between those of both parts [s]
MIN_CORRECTION_PERIOD = 0.018
TOOL_POSE_PERIOD = 0.1  #: Period of `tool_pose` [s]
MAX_START_DRIFT = 0.005  #: Largest movement of the robot while a path is being planned [m, rad]


class PathInput(ABC):
    """Accepts paths from a topic, each once the transform of its frame is known."""

    log: MotionLog

    def _subscribe(self, motions: MotionCoordinator[StreamParameters], topic: str) -> None:
        self._handle = motions.frames.deferred(
            topic, lambda received: [received[1].header], self._accept_received
        )
        # The message stays serialized, so that a path of a million poses is refused unread.
        on_data = motions.node.guarded(topic, self._on_data)
        motions.node.create_subscription(Path, topic, on_data, 10, raw=True)

    @property
    @abstractmethod
    def _max_poses(self) -> int:
        """Number of poses up to which a path is accepted."""

    def _refusal(self) -> str:
        """Return why any path is refused now, or an empty string."""
        return ""

    @abstractmethod
    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Start a path, or let it wait; return or raise (InputError) why it is refused."""

    def _accept_received(self, received: tuple[LoggedMotion, Path]) -> str:
        return "" if received[0].outcome is not None else self._accept(*received)

    def _on_data(self, data: bytes) -> str | None:
        motion = self.log.receive(serialized_stamp(data))
        max_poses = self._max_poses
        try:
            if len(data) > POSE_BYTES * (max_poses + SPARE_POSES):
                raise InputError(
                    f"{len(data) / 1e6:.0f} MB, at most {max_poses} poses are accepted"
                )
            if why := self._refusal():  # before unpacking, which would hold up the motion
                raise InputError(why)
            message = deserialized(data, Path)
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error
        return self._handle((motion, message))


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


class DrivenAxes(Interpolator, Protocol):
    """What generates a motion whose last preview, if it is given up, leads to rest on its path."""

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the planned motion at increasing times (k,) [s]."""

    def paced_stop_window(self, now: float, pace: Pace) -> Window | None:
        """Return the final window of a stream at a pace, which ends at rest on the path."""


class BodyInterface(MotionInterface, Generic[Plan], ABC):
    """Drives motions of the whole body; where the tool is led, the arm corrects the platform."""

    core: DrivenAxes
    under_way = "a motion of the whole body is under way; ~/cancel ends it"

    def __init__(
        self, motions: MotionCoordinator[StreamParameters], core: DrivenAxes, kind: MotionInput
    ) -> None:
        super().__init__(motions, core, slice(None), kind)
        options = motions.options
        self.model, self.limit_scale = WholeBodyModel(options.mount), 1.0
        self._tool: ToolStream | None = None
        self._platform: PlatformCorrection | None = None  # where its error is bounded
        self._corrected_at = float("-inf")
        self._tool_reference = ToolPosePublisher(
            self._node, "tool_reference", options.frames.odom.odom_frame
        )

    @abstractmethod
    def planner(self, poses: Array, start: Array) -> Callable[[], Plan]:
        """Return what plans tool poses (k, 4, 4) in odom from axes (9,), also in a thread."""

    @abstractmethod
    def drive(self, motion: LoggedMotion, plan: Plan) -> None:
        """Start a planned motion; raise InputError if it cannot be driven any more."""

    def expect_path(self) -> None:
        """Prepare for a path of the tool, which has been accepted."""

    def _lead(self, tool: LedTool | None) -> None:
        """Bound the platform's error from now on, and correct the arm for it if a tool is led."""
        p, self._tool = self._motions.options, None
        self._platform = PlatformCorrection(p.tool_path)
        if tool is not None:
            self._tool = ToolStream(self.model, tool, self._platform, p.arm.each("velocity"))

    def configure_tool(self, new: StreamParameters) -> None:
        """Bound and correct the platform's error of the motion under way as new parameters say."""
        if self._platform is not None:
            self._platform.options = new.tool_path

    @property
    def max_pace(self) -> float:
        """Highest pace at which the motion may be driven, 0 to 1."""
        if self.idle:
            return 1.0
        return min(self.limit_scale, 1.0 if self._tool is None else self._tool.max_pace)

    def blocking_reason(self) -> str:
        """Return why no motion can start yet, or an empty string."""
        options, motions = self._motions.options, self._motions
        why = motions.arm_feed.blocking_reason(options.joint_trajectory, idle=self.idle)
        if why or not self.idle:
            return why
        why = motions.odom.blocking_reason(options.odom_timeout)
        return why or motions.control_wait_reason()

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (9,), with odom's heading as it is."""
        odom, arm = self._motions.odom, self._motions.arm_feed.state()
        if odom.pose is None or arm is None:
            return None
        return np.concatenate([odom.pose, arm[0]]), np.concatenate([odom.velocity, arm[1]])

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return references (9,) and two rates, each part's at its own time of measurement."""
        if self.idle:
            return None
        platform = self._desired_at(self._motions.odom.time)
        arm = self._desired_at(self._motions.arm_feed.time)
        x, v, a = (
            np.concatenate([p[PLATFORM_COLUMNS], q[JOINT_COLUMNS]])
            for p, q in zip(platform, arm, strict=True)
        )
        return x, v, a

    def rest_position(self) -> Array:
        """Return the positions (9,) at which platform and arm are at rest [m, m, rad, ...]."""
        tolerance = self._motions.options.joint_trajectory.start_tolerance
        arm = self._motions.arm_feed.start_position(tolerance)
        assert self._motions.odom.pose is not None and arm is not None
        return np.concatenate([self._motions.odom.pose, arm])

    def update_pose(self, pose: Array, at: float) -> None:
        """Take the platform's pose (3,) in odom [m, m, rad] at a time [s]; correct a led tool."""
        platform, pace = self._platform, self._motions.time_base.pace
        if self.idle or platform is None or at <= platform.time:
            return  # a controller that was held up repeats a measurement
        if not self.output.is_covered(self._node.now()):
            return  # the next tick gives the motion up
        platform.update(at, pose, self.platform_reference(pace.motion(at)))
        if platform.excess:
            self.give_up(f"the platform is {platform.excess} off its path", brake=True)
        elif (
            self._tool is not None
            and self._node.now() - self._corrected_at >= MIN_CORRECTION_PERIOD
        ):
            self.publish(self._motions.options.horizon, platform=False)

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
        time_base, core = self._motions.time_base, self.core
        times = time_base.sample_times(horizon)[:: self.spacing]
        try:
            window, tool = self._tool.corrected(
                times, time_base.pace, self._planned, core.plan_times
            )
        except InputError as error:
            self.give_up(str(error), brake=True)
            return
        self._tool_reference.send(float(times[0]), tool)
        self._corrected_at = self._node.now()
        self.output.send(window, platform=platform)

    def _planned(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) for the correction, see `ToolStream.corrected`."""
        return self.core.sample(times)

    def _stop_window(self, now: float) -> Window | None:
        """Return the stretch that leads to rest, on which the arm keeps its present correction."""
        window = self.core.paced_stop_window(now, self._motions.time_base.pace)
        return window if window is None or self._tool is None else self._tool.offset(window)


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


class ToolInterface(PathInput, Generic[Plan]):
    """Accepts paths of the tool, one at a time and from rest."""

    def __init__(
        self, motions: MotionCoordinator[StreamParameters], whole_body: BodyInterface[Plan]
    ) -> None:
        self._motions, self._node, self._whole_body = motions, motions.node, whole_body
        self.log = motions.events.log(MotionInput.TOOL_PATH)
        self._pending = PendingMotion(
            self._node, motions.stream_monitor, self.log, self._blocking_reason, self._refusal
        )
        self.restart_timeout = self._pending.restart_timeout
        self._plan: tuple[LoggedMotion, Future[Plan]] | None = None
        self._running: Future[Plan] | None = None
        self._start_position: Array = np.zeros(0)
        odom_frame = motions.options.frames.odom.odom_frame
        self._tool_pose = ToolPosePublisher(self._node, "tool_pose", odom_frame)
        self._node.every(TOOL_POSE_PERIOD, self._publish_tool_pose)
        self._subscribe(motions, "tool_path")

    @property
    def _max_poses(self) -> int:
        return self._motions.options.tool_path.max_poses

    def _publish_tool_pose(self) -> None:
        """Publish the pose of the tool if platform and arm are measured."""
        measured, motions = self._whole_body.actual(), self._motions
        timeout = motions.options.odom_timeout
        measured_at = min(motions.odom.time, motions.arm_feed.time)
        if measured is not None and self._node.now() - measured_at < timeout:
            self._tool_pose.send(measured_at, self._whole_body.model.forward(measured[0]))

    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Take a path, in odom as its frame is known now: it stays there."""
        label = f"a tool path of {len(message.poses)} poses"
        planner = self._planner(motion, message, self._whole_body.planner)
        return self._take(motion, planner, label)

    def _planner(
        self,
        motion: LoggedMotion,
        message: Path,
        plan: Callable[[Array, Array], Callable[[], Plan]],
    ) -> Callable[[Array], Callable[[], Plan]]:
        """Return what plans poses (k, 4, 4) in odom from axes (9,); InputError for bad poses."""
        max_poses = self._max_poses
        try:
            place = self._motions.frames.into_odom(message.header).matrix()
            self._poses(message, place, np.eye(3))
            if len(message.poses) > max_poses:
                raise InputError(f"{len(message.poses)} poses, at most {max_poses} are accepted")
            if self._motions.is_ending:
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error

        def planner(start: Array) -> Callable[[], Plan]:
            poses = self._poses(message, place, self._whole_body.model.forward(start)[:3, :3])
            return plan(poses, start)

        return planner

    def take(self, planner: Callable[[Array], Callable[[], Plan]], label: str) -> str:
        """Take a motion, planned from axes (9,) at rest; return why it is refused, or ""."""
        return self._take(self.log.receive(Time()), planner, label)

    def _take(
        self, motion: LoggedMotion, planner: Callable[[Array], Callable[[], Plan]], label: str
    ) -> str:
        self._require_newest(motion)
        self.discard(motion)
        self._whole_body.expect_path()
        return self._pending.accept(motion, lambda: self._start_planning(motion, planner, label))

    def _require_newest(self, motion: LoggedMotion) -> None:
        """Refuse a motion that was received before the one that it would replace."""
        planned = None if self._plan is None else self._plan[0]
        for other in (planned, self._pending.motion, self._whole_body.log.driven):
            if other is not None and other.number > motion.number:
                raise self.log.refuse(motion, f"a newer {other.kind.label} came")

    def _poses(self, message: Path, place: Array, here: Array) -> Array:
        """Return poses (k, 4, 4) in odom of a path in a frame at `place`; see `tool_poses`."""
        names = self._motions.options.frames.odom.beside(message.header.frame_id)
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

    def discard(self, by: LoggedMotion | None = None) -> bool:
        """Cancel what waits or is being planned, or replace it; return whether there was one."""
        plan, self._plan = self._plan, None
        if plan is not None:
            self.log.end(plan[0], by)
        return self._pending.discard(by) or plan is not None

    def start(self) -> str:
        """Plan the path that waits, or start it once planned; return why it is refused, or ""."""
        why = self._pending.start() if self._plan is None else ""
        if self._plan is None:
            return why
        (motion, plan), why = self._plan, self._motions.stream_monitor.blocking_reason
        why = why or self._refusal()
        if not why and not plan.done():  # a reset must not start the path
            return ""
        self._plan = None
        why = why or self._whole_body.blocking_reason() or self._start(motion, plan)
        if why:
            self.log.refuse(motion, why)
        return why

    def _refusal(self) -> str:
        body = self._whole_body
        return self._motions.conflict(body) if body.idle else body.under_way

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
            self._whole_body.drive(motion, plan)
        except InputError as error:
            return str(error)
        return ""
