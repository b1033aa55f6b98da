"""What the motions of a node share: one time base, limits, previews, supervision, requests."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, Protocol, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core.arrays import Array
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.axes import AXES, HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.pace import SpeedBound, Window, paced_window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionEvents,
    MotionInput,
    MotionLog,
    PendingMotion,
)
from omniman_ros.nodes.motion_time_base import (
    Interpolator,
    LimitInterface,
    MotionTimeBase,
    ScalingInterface,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.path_interpolator.parameters import StreamParameters
from omniman_ros.nodes.robot_streams import ArmFeed, OdomFeed, arm_previews, platform_previews
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface

#: Times from now at which the speed of a motion is compared with the limit [s]
LOOK_AHEAD = np.linspace(0.0, 0.4, 9)

Options = TypeVar("Options", bound=StreamParameters, covariant=True)


class WaitingMotion(Protocol):
    """A motion that is started as soon as that is possible."""

    def start(self) -> str:
        """Start the motion if possible; return why it is refused, or an empty string."""

    def discard(self) -> bool:
        """Discard the motion that waits, and return whether there was one."""

    def restart_timeout(self) -> None:
        """Let the motion wait for the whole timeout from now on."""


class MotionCoordinator(ABC, Generic[Options]):
    """The motions of a node side by side: what they share, what ends them, requests to them.

    A motion that the robot can no longer follow brakes on its path where its receivers still
    listen. Receivers that are stopped, or have been without a preview, come to rest by themselves.

    Args:
        cores: What generates the motions.
        source: Value of `active_source` while the node drives the platform.
        period: Period of the ticks [s].

    Attributes:
        interfaces: Those that drive motions, and `waiting`: the motions that wait, by what they
            are called. A subclass sets both.
        is_ending: Whether the node is shutting down.
    """

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[Options],
        cores: Sequence[Interpolator],
        source: str,
        period: float,
    ) -> None:
        p, odom_frame = settings.value, settings.value.frames.odom.odom_frame
        self.node, self._settings, self._period = node, settings, period
        self.interfaces: tuple[MotionInterface, ...] = ()
        self.waiting: dict[str, WaitingMotion] = {}
        self.is_ending = False
        self.events = MotionEvents(node)
        self.frames = FrameTransforms(node, lambda: settings.value.frames)
        self.stream_monitor = StreamMonitor(p.restart, source)
        self.odom = OdomFeed(node, "odom", odom_frame, self._on_pose)
        self.arm_feed = ArmFeed(node, p.arm.joints, self._on_arm_states)
        self.scaling = ScalingInterface(node, p.scaling_timeout, self.slow_down)
        self.time_base = MotionTimeBase(cores, node.now, self.scaling)
        self.platform_previews = platform_previews(
            node, f"{source}/reference", odom_frame, p.horizon
        )
        self.arm_previews = arm_previews(node, p.arm.joints, p.horizon)
        self._progress = node.create_publisher(Float64, "path_progress", 10)
        self.limits = LimitInterface(node, p.collision_monitor, self.slow_down)
        self._scales = LimitScales()
        on_health = node.guarded("wheel_health", self._on_health)
        node.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)
        StreamMonitorInterface(node, self.stream_monitor, self.check_control)
        self._slowed_at, self._ticked_at = float("-inf"), node.now()
        self.serve("pause", self.time_base.pause)
        self.serve("resume", self.time_base.resume)
        self.serve("cancel", self.cancel)

    @property
    def options(self) -> Options:
        """Current parameters of the node."""
        return self._settings.value

    def configure_streams(self, new: StreamParameters) -> None:
        """Set the parameters that all motions share."""
        self.limits.configure(new.collision_monitor)
        self.scaling.timeout = new.scaling_timeout
        self.stream_monitor.silence = new.restart

    # ---- requests -----------------------------------------------------------------------------

    def serve(self, name: str, request: Callable[[], None], log: MotionLog | None = None) -> None:
        """Serve `~/NAME`, a request that may raise RefusedError and takes effect at once.

        Its client is told the state of the motions, or what a log says.
        """
        self.node.create_service(Trigger, f"~/{name}", partial(self._serve, request, log))

    def _serve(
        self,
        request: Callable[[], None],
        log: MotionLog | None,
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        try:
            request()
        except RefusedError as error:
            response.success, response.message = False, str(error)
        else:
            self.refresh()
            answer = self.time_base.state.value if log is None else log.text
            response.success, response.message = True, answer
        return response

    def cancel(self) -> None:
        """Discard what waits and brake what moves; raise RefusedError if there is nothing."""
        discarded = [motion.discard() for motion in self.waiting.values()]
        discarded.append(self.events.cancel_received())
        if not self.time_base.idle or not any(discarded):
            self.time_base.cancel()

    def begin_shutdown(self) -> None:
        """Bring all motions to rest on their paths, and accept nothing new."""
        self.is_ending = True
        self.frames.end_waiting()
        for motion in self.waiting.values():
            motion.discard()
        if not self.time_base.idle:
            self.time_base.cancel()
            self.refresh()

    # ---- motions ------------------------------------------------------------------------------

    @abstractmethod
    def scale_limits(self, scale: float) -> None:
        """Scale the limits of the platform, 0 to 1, to what it is capable of now."""

    def refresh(self) -> None:
        """Publish previews at once, because something has changed."""
        self.stream()

    def slow_down(self) -> None:
        """Slow down at once; further changes within a tick wait for the next one."""
        if not self.time_base.idle and self.node.now() - self._slowed_at >= TICK:
            self._slowed_at = self.node.now()
            self.refresh()

    def release(self) -> None:
        """Publish the first preview of a motion that has started."""
        self.time_base.release()
        self.refresh()

    def conflict(self, interface: "MotionInterface") -> str:
        """Return why a motion cannot start next to those of the other interfaces, or ""."""
        for rival in self.interfaces:
            if rival is not interface and not rival.idle and rival.output.meets(interface.output):
                return rival.under_way
        return ""

    def control_wait_reason(self) -> str:
        """Return why a new stream must wait for the platform controller, or an empty string."""
        waits = self.stream_monitor.waiting_time(self.node.now()) > 0.0
        return "control was lost a moment ago" if waits else ""

    def publish_all(self, horizon: float) -> None:
        """Publish previews of the given length [s] of all motions under way."""
        for interface in self.interfaces:
            interface.publish(horizon)

    def supervise(self) -> None:
        """Give up what the robot can no longer follow, and start what waits."""
        since_tick, self._ticked_at = self.node.now() - self._ticked_at, self.node.now()
        self._check_time(since_tick)
        if since_tick < -TIME_JUMP:
            for motion in self.waiting.values():
                motion.restart_timeout()
        self.check_control()
        for kind, motion in self.waiting.items():
            if refusal := motion.start():
                self.node.warn(f"{kind} refused", f"{kind} not used: {refusal}")

    def stream(self) -> None:
        """Publish progress, the demand, and previews at the pace that is allowed now."""
        if self.time_base.idle:
            return
        self._progress.publish(Float64(data=self.time_base.progress()))
        allowed = self._allowed_pace(self.time_base.now())
        self._limit_pace(min(allowed, *(interface.max_pace for interface in self.interfaces)))
        for interface in self.interfaces:
            interface.tick()

    def _allowed_pace(self, motion_time: float) -> float:
        """Publish the demand from a motion time [s] on; return the highest pace in the limit."""
        p, fractions = self.options, self.limits.fractions
        is_limited = min(fractions) < 1.0
        if not (is_limited or p.collision_monitor.use):
            return 1.0
        heading, velocities = self._velocities(motion_time)
        self.limits.publish_demand(p.arm.joints, heading, velocities)
        if not is_limited:
            return 1.0
        bound = SpeedBound(*p.core.limits.velocity, np.array(p.arm.each("velocity")))
        return bound.pace(velocities, *fractions)

    def _velocities(self, motion_time: float) -> tuple[Array, Array]:
        """Return headings (k,) [rad] and velocities (k, 9) in odom over the next times."""
        times = motion_time + LOOK_AHEAD
        heading, velocities = np.zeros(len(times)), np.zeros((len(times), AXES))
        for interface in self.interfaces:
            if not interface.idle:
                position, velocity, _ = interface.core.sample(times)
                velocities[:, interface.output.columns] = velocity
                if interface.output.has_platform:
                    heading = position[:, HEADING_COLUMN]
        return heading, velocities

    def _on_health(self, message: DiagnosticStatus) -> None:
        before, self._scales = self._scales, reported_limit_scales(message)
        if self._scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self.stream_monitor.restart(self.node.now())
        if self._scales.total != before.total:
            self.scale_limits(self._scales.total)

    # ---- supervision --------------------------------------------------------------------------

    @property
    def _with_platform(self) -> "list[MotionInterface]":
        return [it for it in self.interfaces if it.output.has_platform]

    @property
    def _with_arm(self) -> "list[MotionInterface]":
        return [it for it in self.interfaces if it.output.has_arm]

    def _give_up(self, motions: "Sequence[MotionInterface]", why: str, *, brake: bool) -> None:
        for motion in motions:
            motion.give_up(why, brake=brake)

    def check_control(self) -> None:
        """Give up motions whose robot is stopped or no longer follows."""
        monitor = self.stream_monitor
        if why := monitor.loss_reason(self.node.now()):
            self._give_up(self._with_platform, why, brake=not monitor.stop_reason)
        for motion in self._with_arm:
            self._check_arm(motion)

    def _check_arm(self, motion: "MotionInterface") -> None:
        """Give a motion up whose previews the arm does not get, or that it does not report on."""
        silence = self.arm_feed.silence
        if motion.idle:
            return
        if self.stream_monitor.stop_reason:
            motion.give_up(self.stream_monitor.stop_reason, brake=False)
        elif not motion.output.is_covered(self.node.now()):
            motion.give_up("no preview was sent in time", brake=False)
        elif silence > self.options.joint_trajectory.states_timeout:
            motion.give_up(f"no arm/joint_states for {silence:.2f} s", brake=True)

    def _limit_pace(self, max_pace: float) -> None:
        """Limit the pace; a motion of platform and arm waits on its path while odom is late."""
        waits = self._is_platform_silent
        self.time_base.limit_pace(0.0 if waits else max_pace, at_once=waits)

    @property
    def _is_platform_silent(self) -> bool:
        moves_both = any(it.output.has_platform and not it.idle for it in self._with_arm)
        return moves_both and self.odom.age > self.options.odom_pause

    def _on_pose(self, pose: Array, at: float) -> None:
        for interface in self.interfaces:
            interface.update_pose(pose, at)

    def _on_arm_states(self) -> None:
        """Give up motions whose arm is too far from its reference; halt one without platform."""
        if all(motion.idle for motion in self._with_arm):
            return
        self.arm_feed.measure()
        max_error = self.options.joint_trajectory.following_error
        for motion in self._with_arm:
            error = "" if motion.idle else self.arm_feed.following_error(max_error)
            if error:
                motion.give_up(error, brake=True)
        if self._is_platform_silent and self.time_base.pace.target > 0.0:
            self._limit_pace(0.0)
            self.publish_all(self.options.horizon)

    def _check_time(self, since_tick: float) -> None:
        """Give up motions that a time [s] ends, and let it pass for inputs."""
        if since_tick < -TIME_JUMP:
            self._restart()
        else:
            self._check_platform(since_tick)
        # While this node is held up, the other nodes are not silent.
        elapsed = min(max(since_tick, 0.0), 2.0 * self._period)
        for feed in (self.odom, self.scaling, self.arm_feed):
            feed.pass_time(elapsed)
        if self.scaling.is_silent:
            why = f"no arm/speed_scaling for {self.scaling.silence:.2f} s"
            self._give_up(self._with_arm, why, brake=True)

    def _check_platform(self, since_tick: float) -> None:
        """Give up motions whose previews the platform does not get, or that it is silent about."""
        if self.node.now() > self.platform_previews.covered_until:
            why, can_brake = f"no preview for {since_tick:.2f} s", False
        elif self.odom.silence > self.options.odom_timeout:
            why, can_brake = f"no odom for {self.odom.silence:.2f} s", True
        else:
            return
        self._give_up(self._with_platform, why, brake=can_brake)

    def _restart(self) -> None:
        """Forget all that was received, because time went back."""
        self._give_up([*self._with_platform, *self._with_arm], "time went back", brake=False)
        self.stream_monitor.restart(self.node.now())
        self.odom.forget()
        self.arm_feed.forget()


class MotionOutput:
    """Sends a motion to platform, arm or both, and notes where it leads.

    Args:
        columns: Axes of the whole body that the motion moves: columns in arrays (k, 9).
    """

    def __init__(self, motions: MotionCoordinator[StreamParameters], columns: slice) -> None:
        self._motions, self.columns = motions, columns
        self.has_platform, self.has_arm = columns.start is None, columns.stop is None
        self._last_position: Array | None = None

    def meets(self, other: "MotionOutput") -> bool:
        """Return whether another motion moves the same part of the robot."""
        same_platform = self.has_platform and other.has_platform
        return same_platform or (self.has_arm and other.has_arm)

    def begin(self, *, from_rest: bool) -> None:
        """Note that a motion begins, from rest or in place of another one."""
        motions = self._motions
        if self.has_arm and from_rest:
            motions.arm_feed.start_motion()
            motions.arm_previews.covered_until = float("inf")
        if self.has_platform and from_rest:
            motions.odom.silence = 0.0
            motions.platform_previews.covered_until = float("inf")
        if self.has_platform:
            motions.stream_monitor.begin(motions.node.now())

    def send(self, window: Window, *, platform: bool = True) -> None:
        """Publish a stretch (k, d) of the motion, of all its parts or of the arm's alone."""
        motions = self._motions
        if self.has_platform and platform:
            motions.platform_previews.send(window.columns(PLATFORM_COLUMNS))
            motions.stream_monitor.sent(motions.node.now())
        if self.has_arm:
            arm = window.columns(JOINT_COLUMNS) if self.has_platform else window
            self._last_position = arm.positions[-1]
            motions.arm_feed.record_reference(arm.positions[0])
            motions.arm_previews.send(arm)

    def end(self, *, lost: bool) -> None:
        """Note that the motion came to rest where the last stretch ends, or that it was lost."""
        if self.has_arm:
            self._motions.arm_feed.rest_position = None if lost else self._last_position
        if self.has_platform:
            self._motions.stream_monitor.end(lost=lost)

    def is_covered(self, now: float) -> bool:
        """Return whether the receivers still have a reference."""
        is_platform = not self.has_platform or now <= self._motions.platform_previews.covered_until
        return is_platform and (
            not self.has_arm or now <= self._motions.arm_previews.covered_until
        )


class MotionInterface:
    """Drives a motion: sends its previews, and reports its end."""

    core: Interpolator  #: What generates the motion
    pending: PendingMotion | None = None  #: Motion that waits, where one can
    under_way = ""  #: Says that a motion is under way, and what ends it
    spacing = 1  #: Ticks between two points of a preview

    def __init__(
        self,
        motions: MotionCoordinator[StreamParameters],
        core: Interpolator,
        columns: slice,
        kind: MotionInput,
    ) -> None:
        self._motions, self._node = motions, motions.node
        self.core, self.output = core, MotionOutput(motions, columns)
        self.log = motions.events.log(kind)

    @property
    def idle(self) -> bool:
        """Whether no motion is under way."""
        return self.core.state is PathState.IDLE

    @property
    def max_pace(self) -> float:
        """Highest pace at which the motion may be driven, 0 to 1."""
        return 1.0

    def update_pose(self, pose: Array, at: float) -> None:
        """Take the platform's pose (3,) in odom [m, m, rad] at a time [s]."""

    def _pending_motion(self, blocking_reason: Callable[[], str]) -> PendingMotion:
        """Return a place for a motion that waits as long as there is a reason."""
        monitor = self._motions.stream_monitor
        return PendingMotion(self._node, monitor, self.log, blocking_reason, self._conflict)

    def _conflict(self) -> str:
        return self._motions.conflict(self)

    def _desired_at(self, time: float) -> tuple[Array, Array, Array]:
        pace = self._motions.time_base.pace
        window = paced_window(pace, self.core.sample, np.array([time]))
        return window.positions[0], window.velocities[0], window.accelerations[0]

    def _announce(self, motion: LoggedMotion, text: str) -> None:
        self.log.start(motion, text)
        self._motions.release()

    def stop(self) -> None:
        """Bring the motion to rest on its path."""
        if not self.idle:
            self.core.cancel(self._motions.time_base.now())

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard a motion that waits, or bring the one under way to rest on its path."""
        if self.pending is not None and motion is self.pending.motion:
            self.pending.discard()
        elif motion is self.log.driven:
            self.stop()
            self._motions.release()

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
        self.output.end(lost=True)

    def _stop_window(self, now: float) -> Window | None:
        """Return the last preview of a motion that is given up, if it has one."""
        return None

    def tick(self) -> None:
        """Publish the next preview, and report the end of the motion."""
        before, time_base = self.core.state, self._motions.time_base
        if before is PathState.IDLE:
            return
        self.publish(self._motions.options.horizon)
        if self.idle:
            return  # given up, which has been reported
        why = self._update(time_base.now())
        if self.core.state is PathState.CANCELLING and time_base.pace.stands(self._node.now()):
            self.core.abort()
        self._note_pause(why)
        if self.idle:
            is_cancelled = before is PathState.CANCELLING
            self.log.note(MotionEvent.CANCELLED if is_cancelled else MotionEvent.ARRIVED)
            self.output.end(lost=False)

    def _update(self, motion_time: float) -> str:
        """Update the state of the motion; return why that pauses it, or an empty string."""
        self.core.update(motion_time)
        return ""

    def _note_pause(self, reason: str) -> None:
        """Record whether the motion is paused; a reason says why the node has done it."""
        state = self.core.state
        if state is PathState.FOLLOWING:
            self.log.note(MotionEvent.RESUMED)
        elif state in (PathState.PAUSING, PathState.PAUSED) and not self.log.is_paused:
            self.log.note(MotionEvent.PAUSED, reason)

    def publish(self, horizon: float) -> None:
        """Publish a preview of the motion under way that is `horizon` long [s]."""
        if not self.idle:
            time_base = self._motions.time_base
            times = time_base.sample_times(horizon)[:: self.spacing]
            self.output.send(paced_window(time_base.pace, self.core.sample, times))
