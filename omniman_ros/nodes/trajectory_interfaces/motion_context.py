"""Services that the node provides to its interfaces."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from builtin_interfaces.msg import Time

from omniman_ros.collision.self_collision import SelfCollisionCheck
from omniman_ros.conversions.headers import is_stamped
from omniman_ros.core.errors import InputError
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_events import MotionEvents
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.trajectory_interfaces.arm_feed import ArmFeed
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import MotionTimeBase
from omniman_ros.nodes.trajectory_interfaces.odom_feed import OdomFeed
from omniman_ros.nodes.trajectory_interfaces.parameters import (
    PathInterpolatorParameters,
    StreamParameters,
)
from omniman_ros.nodes.trajectory_interfaces.previews import Previews

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
