"""What the motions of a node share: services, previews, limits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.collision.self_collision import SelfCollisionCheck
from omniman_ros.conversions.headers import is_stamped
from omniman_ros.conversions.motion_limits import motion_demand_message
from omniman_ros.conversions.wheels import LimitScales, reported_limit_scales
from omniman_ros.core import se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.motion_limit import MotionLimit
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.motion.axes import HEADING_COLUMN, JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.pace import Pace
from omniman_ros.motion.path.speed_bound import SpeedBound
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionEvents,
    MotionInput,
    MotionLog,
)
from omniman_ros.nodes.motion_time_base import Interpolator, MotionTimeBase
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.path_interpolator.parameters import (
    PathInterpolatorParameters,
    StreamParameters,
)
from omniman_ros.nodes.robot_streams import ArmFeed, OdomFeed, Previews
from omniman_ros.nodes.stop_interface import LATCHED

#: Number of attempts to plan from a motion under way, each with twice the time of the last
PLANNING_ATTEMPTS = 3
MAX_STAMP_AGE = 0.5  #: Age of a stamp up to which a trajectory is accepted, and starts at once [s]
MIN_PLANNING_TIME = 0.03  #: Shortest planning time that is expected of a motion [s]

Proposal = TypeVar("Proposal")
Options = TypeVar("Options", bound=StreamParameters, covariant=True)


@dataclass(frozen=True)
class StreamContext(Generic[Options]):
    """Services and state that the interfaces share; the node builds it once."""

    node: OmnimanNode  #: ROS node that owns topics, timers and the clock
    read_options: Callable[[], Options]  #: Returns the current parameters of the node
    events: MotionEvents  #: Tells clients what becomes of motions
    frames: FrameTransforms  #: Transforms into odom
    #: Monitor of the source that drives the platform, and of stopped nodes
    stream_monitor: StreamMonitor
    odom: OdomFeed  #: Measured pose and velocity of the platform
    arm_feed: ArmFeed  #: Measured joint states of the arm
    time_base: MotionTimeBase  #: Time base that all motions share
    platform_previews: Previews  #: Output `path/reference` or `body/reference`
    arm_previews: Previews  #: Output `arm/joint_reference`
    #: Publishes previews of the given length [s] of all motions under way
    publish_all: Callable[[float], None]
    #: Called after a motion has started; publishes its first preview
    on_started: Callable[[], None]
    #: Returns why a motion of the given interface cannot start next to those of the others, or an
    #: empty string.
    conflict: Callable[[object], str]
    is_ending: Callable[[], bool]  #: Returns whether the node is shutting down

    @property
    def options(self) -> Options:
        """Current parameters of the node."""
        return self.read_options()

    def control_wait_reason(self) -> str:
        """Return why a new stream must wait for the platform controller, or an empty string."""
        waits = self.stream_monitor.waiting_time(self.node.now()) > 0.0
        return "control was lost a moment ago" if waits else ""


#: What interfaces need that serve more than one node
BodyContext = StreamContext[StreamParameters]


@dataclass(frozen=True)
class MotionContext(StreamContext[PathInterpolatorParameters]):
    """Services and state that the interfaces of `path_interpolator` share."""

    #: Returns the check of motions for collisions of the robot with itself
    self_collision: Callable[[], SelfCollisionCheck]

    def start_delay(self, stamp: Time) -> float | None:
        """Return the time until a stamp [s]; None: now; InputError if it is far from now."""
        if not is_stamped(stamp):
            return None
        delay = self.time_to(stamp)
        max_delay = self.options.joint_trajectory.max_delay
        if delay < -MAX_STAMP_AGE:
            raise InputError(f"the stamp is {-delay:.2f} s old")
        if delay > max_delay:
            raise InputError(f"the stamp is {delay:.2f} s ahead, at most {max_delay:g} s")
        return delay if delay > 0.0 else None

    def time_to(self, stamp: Time) -> float:
        """Return the time from now to a stamp [s]; 0 for a zero stamp, which means now."""
        if not is_stamped(stamp):
            return 0.0
        now = self.node.get_clock().now().nanoseconds
        return float((stamp.sec * 1_000_000_000 + stamp.nanosec - now) * 1e-9)

    def propose_in_time(
        self,
        propose: Callable[[float], Proposal],
        take: Callable[[Proposal, float], bool],
        planning_time: float,
    ) -> Proposal:
        """Plan a motion while the one under way goes on, and start it.

        Before each attempt, previews are published that last longer than the planning.

        Raises:
            InputError: The motion cannot be driven, or cannot be planned in time.
        """
        for _ in range(PLANNING_ATTEMPTS):
            self.publish_all(2.0 * planning_time + self.options.horizon)
            proposal = propose(planning_time)
            if take(proposal, self.time_base.now()):
                return proposal
            planning_time *= 2.0
        raise InputError("the motion could not be planned in time; pause first")


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


#: Times from now at which the speed of a motion is compared with the limit [s]
LOOK_AHEAD = np.linspace(0.0, 0.4, 9)
#: Smallest change of a fraction that is acted upon at once; others wait for the next tick
CHANGE = 0.01
REST = 1e-6  #: Speed up to which a motion rests [m/s, rad/s]


class HealthInput:
    """Scales the limits of the motions that move the platform."""

    def __init__(self, context: BodyContext, use: Callable[[float], None]) -> None:
        self._context, self._use = context, use
        self._scales = LimitScales()
        on_health = context.node.guarded("wheel_health", self._on_health)
        context.node.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)

    def _on_health(self, message: DiagnosticStatus) -> None:
        before, self._scales = self._scales, reported_limit_scales(message)
        if self._scales.wheels > before.wheels:  # the controller was reset, and expects a silence
            self._context.stream_monitor.restart(self._context.node.now())
        if self._scales.total != before.total:
            self._use(self._scales.total)


class SampledMotion(Protocol):
    """Motion of the platform, the arm or both."""

    state: PathState

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at motion times (k,) [s]."""


class LimitInterface:
    """Subscribes to `motion_limit`, and publishes the demand of motions on `motion_demand`.

    A motion that stands because of the limit still asks for its direction: the limit depends on
    it.

    Args:
        motions: Motions, each with the axes of the whole body that it moves.
    """

    def __init__(
        self,
        node: OmnimanNode,
        read_options: Callable[[], StreamParameters],
        motions: Sequence[tuple[SampledMotion, slice]],
        on_change: Callable[[], None],
    ) -> None:
        self._node, self._read_options = node, read_options
        self._motions, self._on_change = tuple(motions), on_change
        options = read_options().collision_monitor
        self._platform, self._arm = MotionLimit(options), MotionLimit(options)
        self._acted_on = (1.0, 1.0)
        subscribe_to_motion_limit(
            node, platform=self._platform, arm=self._arm, on_update=self._act
        )
        self._demands = node.create_publisher(JointState, "motion_demand", QoSProfile(depth=1))

    def configure(self, new: StreamParameters) -> None:
        """Use other parameters."""
        self._platform.parameters = self._arm.parameters = new.collision_monitor

    def _act(self) -> None:
        """Report a change of a fraction that is large enough."""
        change = np.abs(np.array(self.fractions) - self._acted_on).max()
        if change > CHANGE:
            self._acted_on = self.fractions
            self._on_change()

    @property
    def fractions(self) -> tuple[float, float]:
        """Fractions of the speed limits that platform and arm may use now, 0 to 1."""
        now = self._node.now()
        return self._platform.fraction(now), self._arm.fraction(now)

    def max_pace(self, motion_time: float) -> float:
        """Return the highest pace, 0 to 1, within the limit from a motion time [s]."""
        fractions = self.fractions
        if min(fractions) >= 1.0:
            return 1.0
        p = self._read_options()
        bound = SpeedBound(*p.core.limits.velocity, np.array(p.arm.each("velocity")))
        return bound.pace(self._velocities(motion_time)[1], *fractions)

    def publish_demand(self, motion_time: float) -> None:
        """Publish what the motions ask for at full pace, where a limit is used."""
        p = self._read_options()
        if not p.collision_monitor.use:
            return
        heading, velocities = self._velocities(motion_time)
        # At its begin a motion rests: it asks for what comes next.
        moving = np.flatnonzero(np.abs(velocities).max(axis=1) > REST)
        k = int(moving[0]) if len(moving) else 0
        twist = se2.to_robot(float(heading[k]), velocities[k, PLATFORM_COLUMNS])
        motion = [*twist.tolist(), *velocities[k, JOINT_COLUMNS].tolist()]
        message = motion_demand_message(p.arm.joints, motion, self._node.stamp(), "base_link")
        self._demands.publish(message)

    def _velocities(self, motion_time: float) -> tuple[Array, Array]:
        """Return headings (k,) [rad] and velocities (k, 9) in odom over the next times."""
        times = motion_time + LOOK_AHEAD
        heading = np.zeros(len(times))
        velocities = np.zeros((len(times), PLATFORM_COLUMNS.stop + JOINTS))
        for motion, columns in self._motions:
            if motion.state is not PathState.IDLE:
                position, velocity, _ = motion.sample(times)
                velocities[:, columns] = velocity
                if columns.start is None:
                    heading = position[:, HEADING_COLUMN]
        return heading, velocities
