"""Paths of the tool: `tool_path` in; planned beside the node's cycle, driven by the whole body."""

import threading
from collections.abc import Callable
from concurrent.futures import Future

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from omniman_ros import arm_conversions
from omniman_ros.core import se2
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motions.body_port import BodyPort
from omniman_ros.nodes.motions.host import Host
from omniman_ros.nodes.motions.path_port import POSE_BYTES
from omniman_ros.nodes.motions.teller import Teller
from omniman_ros.nodes.motions.tool_stream import ToolOutput, ToolStream
from omniman_ros.nodes.motions.waiting import Waiting

Array = NDArray[np.float64]

TOLD = 0.1
"""Period in which is said where the tool is [s]."""
MOVED = 0.005
"""The robot must not move by more while a path is planned [m, rad]."""


class ToolPort(Teller):
    """Takes paths of the tool, one at a time, from rest.

    Args:
        host: The node.
        body: What drives them.

    Attributes:
        waiting: The path that waits for the robot.
    """

    def __init__(self, host: Host, body: BodyPort) -> None:
        self._host, self._node, self._body = host, host.node, body
        self._model = BodyModel(host.options.mount)
        self.waiting = Waiting(self._node.now, host.watch)
        self._last = "no path of the tool yet"
        self._planned: Future[ToolPlan] | None = None
        self._running: Future[ToolPlan] | None = None
        self._start: Array = np.zeros(0)
        self._pose = ToolOutput(self._node, "tool_pose", host.options.odom_frame)
        self._node.every(TOLD, self._tell_pose)
        # Bytes, so that a path of a million poses is refused before it is unpacked.
        on_path = self._node.guarded("tool_path", self._on_path)
        self._node.create_subscription(Path, "tool_path", on_path, 10, raw=True)

    def _tell_pose(self) -> None:
        """Say where the tool is, as long as that is measured."""
        measured, host = self._body.actual(), self._host
        late, since = host.options.odom_timeout, min(host.odom.time, host.arm_feed.time)
        if measured is not None and self._node.now() - since < late:
            self._pose.send(since, self._model.forward(measured[0]))

    def _on_path(self, data: bytes) -> str:
        p = self._host.options
        most = p.tool_path.max_poses
        if len(data) > POSE_BYTES * (most + 100):
            raise self._refused(f"{len(data) / 1e6:.0f} MB, at most {most} poses are taken")
        why = self._obstacle()
        if why:  # before it is unpacked: what moves would have to wait for that
            raise self._refused(why)
        message = deserialize_message(data, Path)
        try:
            arm_conversions.tool_poses(message, p.frames, np.eye(3))
            if len(message.poses) > most:
                raise InputError(f"{len(message.poses)} poses, at most {most} are taken")
            if self._host.ending:
                raise InputError("the node ends")
        except InputError as error:
            raise self._refused(str(error)) from error
        self.drop()
        self.waiting.put(lambda: self._plan(message))
        return self.try_waiting()

    @property
    def idle(self) -> bool:
        """Whether no path of the tool is under way."""
        return self._body.idle

    @property
    def planning(self) -> bool:
        """Whether a path is planned, and that is not done yet."""
        return self._planned is not None and not self._planned.done()

    def _refused(self, why: str) -> InputError:
        self.last = f"a tool path was refused: {why}"
        return InputError(why)

    def drop(self) -> bool:
        """Forget the path that waits or is planned; returns whether there was one."""
        planned, self._planned = self._planned, None
        return self.waiting.drop() or planned is not None

    def try_waiting(self) -> str:
        """Go on with the path that waits or is planned; returns why it never will begin."""
        obstacle = self._obstacle()
        if self._planned is not None and obstacle:  # a reset must not begin it
            self.drop()
            self.last = f"a tool path was refused: {obstacle}"
            return obstacle
        why, waits = self.waiting.attempt(obstacle, self._not_yet)
        if waits:
            self.last = f"a tool path waits: {waits}"
        if self._planned is not None and self._planned.done():
            planned, self._planned = self._planned, None
            why = self._obstacle() or self._body.not_yet() or self._begin(planned)
        if why:
            self.last = f"a tool path was refused: {why}"
        return why

    def _obstacle(self) -> str:
        if not self._body.idle:
            return "a motion of the whole body is under way; ~/cancel ends it"
        return self._host.watch.obstacle or self._host.busy(self._body)

    def _not_yet(self) -> str:
        if self._running is not None and not self._running.done():
            return "one that is not wanted any more is still planned"
        return self._body.not_yet()

    def _plan(self, message: Path) -> None:
        p, start = self._host.options, self._body.here()
        here = self._model.forward(start)[:3, :3]
        poses = arm_conversions.tool_poses(message, p.frames, here)
        planner = ToolPlanner(self._model, BodyLimits.of_body(p.core, p.arm), p.tool_path)
        self._planned, self._start = in_background(lambda: planner.plan(poses, start)), start
        self._running = self._planned
        self.last = f"planning a tool path of {len(poses)} poses"

    def _begin(self, planned: Future[ToolPlan]) -> str:
        """Drive a plan; returns why that cannot be."""
        try:
            plan = planned.result()
        except InputError as error:
            return str(error)
        except Exception as error:  # the thread's: the node must not die of a path
            why = f"it could not be planned: {type(error).__name__}: {error}"
            self._node.get_logger().error(why)
            return why
        away = self._body.here() - self._start
        away[2] = se2.wrap(float(away[2]))
        moved = float(np.abs(away).max())
        if moved > MOVED:
            return f"the robot has moved by {moved:.3f} (m or rad) while it was planned"
        p = self._host.options
        self._body.follow(ToolStream(self._model, plan, p.tool_path, p.arm.each("velocity")))
        self.last = self._body.last
        return ""


def in_background(plan: Callable[[], ToolPlan]) -> Future[ToolPlan]:
    """Plan in a thread: that takes up to seconds, and stops and services must not wait for it.

    Nor does the end of the process: a plan that is not wanted any more is left alone.
    """
    future: Future[ToolPlan] = Future()

    def work() -> None:
        try:
            future.set_result(plan())
        except BaseException as error:  # told by the one who asks for the result
            future.set_exception(error)

    threading.Thread(target=work, name="tool_path", daemon=True).start()
    return future
