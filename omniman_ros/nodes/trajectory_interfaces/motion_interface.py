"""Common part of the interfaces that drive motions of the arm and of the whole body."""

from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.pace import Pace
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent, MotionInput, MotionLog
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import Interpolator


class ArmOutput:
    """Sends motions of the arm, and notes where they lead."""

    def __init__(self, context: BodyContext) -> None:
        self._context = context
        self._last_position: Array | None = None

    def begin(self, *, from_rest: bool) -> None:
        """Note that a motion begins, from rest or in place of another one."""
        if from_rest:
            self._context.arm_feed.start_motion()
            self._context.arm_previews.covered_until = float("inf")

    def send(self, window: Window) -> None:
        """Publish a stretch of the motion under way."""
        self.send_arm(window)

    def send_arm(self, window: Window) -> None:
        """Publish a stretch (k, 6) of the arm's part of the motion."""
        self._last_position = window.positions[-1]
        self._context.arm_feed.record_reference(window.positions[0])
        self._context.arm_previews.send(window)

    def end(self) -> None:
        """Note that the motion came to rest where the last stretch ends."""
        self._context.arm_feed.rest_position = self._last_position

    def give_up(self) -> None:
        """Note that the motion was given up: it is not known where it comes to rest."""
        self._context.arm_feed.rest_position = None

    def is_covered(self, now: float) -> bool:
        """Return whether the receivers still have a reference."""
        return now <= self._context.arm_previews.covered_until


class WholeBodyOutput(ArmOutput):
    """Sends motions of all nine axes, each part to its receiver."""

    def begin(self, *, from_rest: bool) -> None:
        """Note that a motion begins; see the base class."""
        super().begin(from_rest=from_rest)
        if from_rest:
            self._context.odom.silence = 0.0
            self._context.platform_previews.covered_until = float("inf")
        self._context.stream_monitor.begin(self._context.node.now())

    def send(self, window: Window) -> None:
        """Publish a stretch (k, 9) of both parts."""
        self._context.platform_previews.send(window.columns(PLATFORM_COLUMNS))
        self._context.stream_monitor.sent(self._context.node.now())
        self.send_arm(window.columns(JOINT_COLUMNS))

    def end(self) -> None:
        """Note that the motion came to rest; see the base class."""
        super().end()
        self._context.stream_monitor.end(lost=False)

    def give_up(self) -> None:
        """Note that the motion was given up; see the base class."""
        super().give_up()
        self._context.stream_monitor.end(lost=True)

    def is_covered(self, now: float) -> bool:
        """Return whether the receivers of both parts still have a reference."""
        return super().is_covered(now) and now <= self._context.platform_previews.covered_until


class DrivenMotion(Interpolator, Protocol):
    """A motion of d axes in motion time, which an interface drives."""

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) of the motion under way at increasing times (k,) [s]."""

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the planned motion at increasing times (k,) [s]."""

    def update(self, now: float) -> None:
        """Update the state when the motion has come to rest."""

    def abort(self) -> None:
        """Discard the motion at once: it is at rest, or the receiver stops it."""

    def paced_stop_window(self, now: float, pace: Pace) -> Window | None:
        """Return the final window of a stream at a pace, which ends at rest on the path."""


def note_pause(log: MotionLog, state: PathState, reason: str = "") -> None:
    """Record whether the motion under way is paused; a reason says why the node has done it."""
    if state is PathState.FOLLOWING:
        log.note(MotionEvent.RESUMED)
    elif state in (PathState.PAUSING, PathState.PAUSED) and not log.is_paused:
        log.note(MotionEvent.PAUSED, reason)


class MotionInterface:
    """Drives a motion: sends its previews, and reports its end."""

    core: DrivenMotion  #: Motion that is driven

    def __init__(
        self, context: BodyContext, core: DrivenMotion, output: ArmOutput, kind: MotionInput
    ) -> None:
        self._context, self._node = context, context.node
        self.core, self.output = core, output
        self.log = context.events.log(kind)

    @property
    def idle(self) -> bool:
        """Whether no motion is under way."""
        return self.core.state is PathState.IDLE

    def _desired_at(self, time: float) -> tuple[Array, Array, Array]:
        pace = self._context.time_base.pace
        window = paced_window(pace, self.core.sample, np.array([time]))
        return window.positions[0], window.velocities[0], window.accelerations[0]

    def _announce(self, motion: LoggedMotion, text: str) -> None:
        self.log.start(motion, text)
        self._context.on_started()

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion under way; the axes come to rest.

        Args:
            brake: Whether to send a last preview that leads to rest on the path. Receivers that
                are stopped come to rest by themselves, as do those that have run out of
                references, which would start again.
        """
        if self.idle:
            return
        now = self._node.now()
        window = self._stop_window(now) if brake and self.output.is_covered(now) else None
        self.core.abort()
        self.log.note(MotionEvent.GIVEN_UP, why)
        if window is not None:
            self.output.send(window)
        self.output.give_up()

    def _stop_window(self, now: float) -> Window | None:
        return self.core.paced_stop_window(now, self._context.time_base.pace)

    def tick(self) -> None:
        """Publish the next preview, and report the end of the motion."""
        before, time_base = self.core.state, self._context.time_base
        if before is PathState.IDLE:
            return
        self.publish(self._context.options.horizon)
        if self.idle:
            return  # given up, which has been reported
        motion_time = time_base.now()
        self.core.update(motion_time)
        if self.core.state is PathState.CANCELLING and time_base.pace.stands(self._node.now()):
            self.core.abort()
        note_pause(self.log, self.core.state)
        if self.idle:
            is_cancelled = before is PathState.CANCELLING
            self.log.note(MotionEvent.CANCELLED if is_cancelled else MotionEvent.ARRIVED)
            self.output.end()

    def publish(self, horizon: float) -> None:
        """Publish a preview of the motion under way that is `horizon` long [s]."""
        if not self.idle:
            time_base = self._context.time_base
            times = time_base.sample_times(horizon)
            self.output.send(paced_window(time_base.pace, self.core.sample, times))
