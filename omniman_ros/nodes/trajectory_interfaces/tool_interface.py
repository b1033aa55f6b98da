"""Paths of the tool: `tool_path` in, planned in the background, driven by the whole body."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, Protocol, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Path

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionInput
from omniman_ros.nodes.pending_motion import PendingMotion
from omniman_ros.nodes.trajectory_interfaces.body_interface import BodyInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext
from omniman_ros.nodes.trajectory_interfaces.path_input import PathInput
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolPosePublisher

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
