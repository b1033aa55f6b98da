"""Paths of the platform: `path` in, `path/reference` out."""

from typing import Any

import numpy as np
from nav_msgs.msg import Path

from omniman_ros.conversions.poses import path_poses
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.interpolator import PathInterpolator, PathProposal, PathState
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionInput
from omniman_ros.nodes.pending_motion import PendingMotion
from omniman_ros.nodes.trajectory_interfaces.motion_context import MIN_PLANNING_TIME, MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import note_pause
from omniman_ros.nodes.trajectory_interfaces.path_input import PathInput

SAMPLES = 100  #: Number of poses by which the length of the rest of a path is measured
PLANNING_TIME_PER_POSE = 1e-4  #: Planning time that is expected for each pose of a path [s]


class PathInterface:
    """Connects a `PathInterpolator` to the messages of the node."""

    def __init__(self, context: MotionContext, core: PathInterpolator) -> None:
        self._context, self._node = context, context.node
        self.core = core
        self.log = context.events.log(MotionInput.PATH)
        self.pending = PendingMotion(
            self._node,
            context.stream_monitor,
            self.log,
            self._blocking_reason,
            conflict=lambda: context.conflict(self),
        )
        PathInput(
            context,
            "path",
            self.log,
            max_poses=lambda: context.options.core.path.max_poses,
            refusal=lambda: "",
            accept=self._accept,
        )

    @property
    def idle(self) -> bool:
        """Whether no path is under way."""
        return self.core.state is PathState.IDLE

    def _accept(self, motion: LoggedMotion, message: Path) -> str:
        """Start a path, placed in odom now, or let it wait; return or raise why it is refused."""
        p, frames = self._context.options, self._context.frames
        try:
            place = frames.into_odom(message.header).planar()
            names = p.frames.odom.beside(message.header.frame_id)
            poses = path_poses(message, names, p.core.path.heading == "poses")
            poses = se2.displaced(poses, place)
            if self._context.is_ending():
                raise InputError("the node is shutting down")
        except InputError as error:
            raise self.log.refuse(motion, str(error)) from error
        return self.pending.accept(motion, lambda: self._start(motion, poses))

    def _blocking_reason(self) -> str:
        if not self.idle:
            return ""
        why = self._context.odom.blocking_reason(self._context.options.odom_timeout)
        return why or self._context.control_wait_reason()

    def _start(self, motion: LoggedMotion, poses: Array) -> None:
        context = self._context
        pose = context.odom.pose
        assert pose is not None

        def propose(lead: float) -> PathProposal:
            return self.core.propose(poses, pose, context.time_base.now(), lead)

        planning_time = MIN_PLANNING_TIME + PLANNING_TIME_PER_POSE * len(poses)
        proposal = context.propose_in_time(propose, self.core.take, planning_time)
        plan = proposal.plan
        if proposal.since is None:
            context.odom.silence = 0.0
            context.platform_previews.covered_until = float("inf")
        context.stream_monitor.begin(self._node.now())
        text = (
            f"{len(poses)} poses in {plan.duration:.2f} s, {plan.duration / plan.bound:.3f} times "
            "the shortest duration without jerk limits"
        )
        self.log.start(motion, text)
        context.on_started()

    def give_up(self, why: str) -> None:
        """Discard the path, because the platform no longer follows it."""
        if not self.idle:
            self.log.note(MotionEvent.GIVEN_UP, why)
            self.core.abort()
            self._context.stream_monitor.end(lost=True)

    def tick(self) -> None:
        """Publish the next preview, and report the end of the path."""
        time_base, before = self._context.time_base, self.core.state
        motion_time, why = time_base.now(), ""
        if before is PathState.IDLE:
            return
        horizon = self._context.options.horizon
        self.publish(horizon)
        try:
            self.core.update(motion_time)
        except InputError as error:
            why = str(error)
            self._node.warn("path paused", f"a path was paused: {why}")
        note_pause(self.log, self.core.state, why)
        if before is PathState.SLOWING and self.core.state is PathState.FOLLOWING:
            self.publish(horizon)  # the path continues before the next tick
        if before is PathState.CANCELLING and time_base.pace.stands(self._node.now()):
            self.core.abort()
        if self.idle:
            self._context.stream_monitor.end(lost=False)
            is_cancelled = before is PathState.CANCELLING
            self.log.note(MotionEvent.CANCELLED if is_cancelled else MotionEvent.ARRIVED)

    def publish(self, horizon: float) -> None:
        """Publish a preview of the path under way that is `horizon` long [s]."""
        window = self._window(horizon)
        if window is not None:
            self._context.platform_previews.send(window)
            self._context.stream_monitor.sent(self._node.now())

    def _window(self, horizon: float) -> Window | None:
        """Return the stream from now on; None while the platform rests."""
        time_base = self._context.time_base
        if time_base.pace.plain or self.idle:
            return self.core.window(self._node.now(), horizon)
        times = time_base.sample_times(horizon)
        return paced_window(time_base.pace, self.core.sample, times)

    def send(self, request: Any) -> LoggedMotion:
        """Follow the path of a goal of the action `follow_path`.

        `controller_id` and the checkers of goal and progress name plugins of Nav2, and count for
        nothing here.
        """
        motion = self.log.receive(request.path.header.stamp)
        refusal = self._accept(motion, request.path)
        if refusal:
            raise InputError(refusal)
        return motion

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard the path if it waits, or bring the platform to rest on it."""
        if motion is self.pending.motion:
            self.pending.discard()
        elif motion is self.log.driven:
            self.core.cancel(self._context.time_base.now())
            self._context.on_started()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the length of the rest of the path, and the speed, into the feedback."""
        now = self._context.time_base.now()
        if self.idle:
            return False
        ahead = self.core.sample(np.linspace(now, now + self.core.remaining(now), SAMPLES))[0]
        steps = np.diff(ahead[:, :2], axis=0)
        feedback.distance_to_goal = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        feedback.speed = float(np.hypot(*self._context.odom.velocity[:2]))
        return True
