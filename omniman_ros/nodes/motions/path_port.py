"""Paths of the platform: `path` in, `path/reference` out."""

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from omniman_ros import conversions
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import PathInterpolator, PathState, Window
from omniman_ros.nodes.motions.host import ATTEMPTS, PLANNING_LEAST, Host
from omniman_ros.nodes.motions.teller import Teller
from omniman_ros.nodes.motions.waiting import Waiting

Array = NDArray[np.float64]

POSE_BYTES = 160
"""A pose of a path takes less than this on the wire."""
PLANNING = 1e-4
"""Planning is expected to take less than this for each pose [s]."""


class PathPort(Teller):
    """Message plumbing around `core.path.interpolator.PathInterpolator`.

    Attributes:
        core: The interpolator.
        waiting: The path that waits.
    """

    def __init__(self, host: Host) -> None:
        self._host, self._node = host, host.node
        parameters = host.options.core
        parameters.planner()  # what it would refuse, it refuses now
        self.core = PathInterpolator(parameters)
        self.waiting = Waiting(self._node.now, host.watch)
        self._last = "no path yet"
        # Bytes, so that a path of a million poses is refused before it is unpacked.
        on_path = self._node.guarded("path", self._on_path)
        self._node.create_subscription(Path, "path", on_path, 10, raw=True)

    @property
    def idle(self) -> bool:
        """Whether no path is under way."""
        return self.core.state is PathState.IDLE

    def _on_path(self, data: bytes) -> str:
        p = self._host.options
        most = p.core.path.max_poses
        if len(data) > POSE_BYTES * (most + 100):
            raise self._refused(f"{len(data) / 1e6:.0f} MB, at most {most} poses are taken")
        try:
            message = deserialize_message(data, Path)
            poses = conversions.path_poses(message, p.frames, p.core.path.heading == "poses")
        except InputError as error:
            raise self._refused(str(error)) from error
        if self._host.ending:
            raise self._refused("the node ends")
        self.waiting.put(lambda: self._begin(poses))
        return self.try_waiting()

    def _refused(self, why: str) -> InputError:
        self.last = f"a path was refused: {why}"
        return InputError(why)

    def try_waiting(self) -> str:
        """Begin the path that waits, if it can be; returns why it never will."""
        obstacle = self._host.watch.obstacle or self._host.busy(self)
        why, waits = self.waiting.attempt(obstacle, self._not_yet)
        if waits:
            self.last = f"a path waits: {waits}"
        if why:
            self.last = f"a path was refused: {why}"
        return why

    def _not_yet(self) -> str:
        if not self.idle:
            return ""
        why = self._host.odom.not_yet(self._host.options.odom_timeout)
        waits = self._host.watch.wait(self._node.now()) > 0.0
        return why or ("control was lost a moment ago" if waits else "")

    def _begin(self, poses: Array) -> None:
        host, together = self._host, self._host.together
        lead = PLANNING_LEAST + PLANNING * len(poses)
        assert host.odom.pose is not None
        for _ in range(ATTEMPTS):
            host.cover(2.0 * lead + host.options.horizon)  # what covers the planning
            proposal = self.core.propose(poses, host.odom.pose, together.now(), lead)
            if self.core.take(proposal, together.now()):
                break
            lead *= 2.0
        else:
            raise InputError("it could not be planned in time; pause first")
        plan = proposal.plan
        if proposal.since is None:
            host.odom.silent, host.platform_previews.covered = 0.0, float("inf")
        host.watch.begin(self._node.now())
        self.last = (
            f"{len(poses)} poses in {plan.duration:.2f} s, {plan.duration / plan.bound:.3f} of "
            "what the limits allow without jerk limits"
        )
        self._node.get_logger().info(f"path: {self.last}")
        host.begun()

    def give_up(self, why: str) -> None:
        """Forget the path; somebody else drives, or the controller stops."""
        if not self.idle:
            self.last = f"the path was given up: {why}"
            self._node.warn("given up", self.last)
            self.core.abort()
            self._host.watch.end(lost=True)

    def look(self) -> None:
        """Give the path up if it is no longer ours to drive."""
        if not self.idle:
            why = self._host.watch.lost(self._node.now())
            if why:
                self.give_up(why)

    def check(self, held_up: float) -> None:
        """Give the path up if it cannot be followed; the node was held up for so long [s]."""
        odom = self._host.odom
        if self._node.now() > self._host.platform_previews.covered:
            self.give_up(f"no preview for {held_up:.2f} s")
        elif odom.silent > self._host.options.odom_timeout:
            self.give_up(f"no odom for {odom.silent:.2f} s")

    def tick(self) -> None:
        """Publish the next preview, and notice an end."""
        now, before = self._host.together.now(), self.core.state
        if before is PathState.IDLE:
            return
        horizon = self._host.options.horizon
        self.publish(horizon)
        try:
            self.core.update(now)
        except InputError as error:
            self.last = f"a path was paused: {error}"
            self._node.warn("path paused", self.last)
        if before is PathState.SLOWING and self.core.state is PathState.FOLLOWING:
            self.publish(horizon)  # it goes on before the next tick
        if before is PathState.CANCELLING and self._host.together.pace.stands(self._node.now()):
            self.core.abort()  # it is at rest where it is
        if self.idle:
            self._host.watch.end(lost=False)
            self.last = "cancelled" if before is PathState.CANCELLING else "arrived"
            self._node.get_logger().info(f"path: {self.last}")

    def publish(self, horizon: float) -> None:
        """Publish a preview that reaches so far [s]."""
        window = self._window(horizon)
        if window is not None:
            self._host.platform_previews.send(window)
            self._host.watch.sent(self._node.now())

    def _window(self, horizon: float) -> Window | None:
        """The stream from now to a horizon [s] later; None if it rests."""
        together = self._host.together
        if together.pace.plain or self.idle:
            return self.core.window(self._node.now(), horizon)
        times = together.sample_times(horizon)
        paced = together.pace.sample(times)
        return Window(times, *paced.apply(*self.core.sample(paced.motion)))
