"""The time base that all motions of a node share, and what slows all of them down together."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from omniman_ros.conversions.motion_limits import motion_demand_message
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.motion_limit import MotionLimit, MotionLimitParameters
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.pace import LimitUsage, Pace
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Excess over the range 0 to 1 that is accepted, distance from its ends that counts as none, and
#: smallest change that counts.
SCALING_TOLERANCE = 1e-3
#: Lowest pace for which the end of the node waits until its motions are at rest
SLOWEST_SHUTDOWN_PACE = 0.1
#: Smallest change of a fraction that is acted upon at once; others wait for the next tick
CHANGE = 0.01
REST = 1e-6  #: Speed up to which a motion rests [m/s, rad/s]


class ScalingInterface:
    """Subscribes to `arm/speed_scaling`, 0 to 1."""

    def __init__(self, node: OmnimanNode, timeout: float, on_change: Callable[[], None]) -> None:
        self.value, self.silence, self.timeout = 1.0, 0.0, timeout
        self._received = False
        self._on_change = on_change
        node.create_subscription(
            Float64, "arm/speed_scaling", node.guarded("arm/speed_scaling", self._on_scaling), 1
        )

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the time that has elapsed [s]."""
        if self._received:
            self.silence += elapsed

    @property
    def is_silent(self) -> bool:
        """Whether there has been no message for the timeout, since the first one."""
        return self.silence > self.timeout

    def forget(self) -> None:
        """Return to the state before the first message."""
        self.value, self.silence, self._received = 1.0, 0.0, False

    def _on_scaling(self, message: Float64) -> None:
        if not -SCALING_TOLERANCE <= message.data <= 1.0 + SCALING_TOLERANCE:
            raise InputError(f"{message.data} must be 0 to 1; {self.value:.3f} is kept")
        self._received, self.silence = True, 0.0
        value = min(max(message.data, 0.0), 1.0)
        # The ends of the range must be exact: at 0 nothing moves, at 1 nothing is slowed down.
        is_end = min(value, 1.0 - value) <= SCALING_TOLERANCE
        value = float(round(value)) if is_end else value
        if value != self.value and (is_end or abs(value - self.value) > SCALING_TOLERANCE):
            self.value = value
            self._on_change()


class LimitInterface:
    """Subscribes to `motion_limit`, and publishes what motions ask for on `motion_demand`.

    A motion that stands because of the limit still asks for its direction: the limit depends on
    it.
    """

    def __init__(
        self, node: OmnimanNode, options: MotionLimitParameters, on_change: Callable[[], None]
    ) -> None:
        self._node, self._on_change = node, on_change
        self._platform, self._arm = MotionLimit(options), MotionLimit(options)
        self._acted_on = (1.0, 1.0)
        subscribe_to_motion_limit(
            node, platform=self._platform, arm=self._arm, on_update=self._act
        )
        self._demands = node.create_publisher(JointState, "motion_demand", QoSProfile(depth=1))

    def configure(self, options: MotionLimitParameters) -> None:
        """Use other parameters."""
        self._platform.parameters = self._arm.parameters = options

    def _act(self) -> None:
        """Report a change of a fraction that is large enough."""
        if np.abs(np.array(self.fractions) - self._acted_on).max() > CHANGE:
            self._acted_on = self.fractions
            self._on_change()

    @property
    def fractions(self) -> tuple[float, float]:
        """Fractions of the speed limits that platform and arm may use now, 0 to 1."""
        now = self._node.now()
        return self._platform.fraction(now), self._arm.fraction(now)

    def publish_demand(self, joints: Sequence[str], heading: Array, velocities: Array) -> None:
        """Publish the first motion among velocities (k, 9) in odom, where a limit is used.

        Args:
            heading: (k,) headings of the platform [rad].
            velocities: Velocities at full pace [m/s, m/s, rad/s, rad/s ...].
        """
        if not self._platform.parameters.use:
            return
        # At its begin a motion rests: it asks for what comes next.
        moving = np.flatnonzero(np.abs(velocities).max(axis=1) > REST)
        k = int(moving[0]) if len(moving) else 0
        twist = se2.to_robot(float(heading[k]), velocities[k, PLATFORM_COLUMNS])
        motion = [*twist.tolist(), *velocities[k, JOINT_COLUMNS].tolist()]
        message = motion_demand_message(joints, motion, self._node.stamp(), "base_link")
        self._demands.publish(message)


class Interpolator(Protocol):
    """What generates a motion of d axes: of the platform, the arm or the whole body."""

    state: PathState

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) of the motion under way at increasing times (k,) [s]."""

    def update(self, now: float) -> None:
        """Update the state when the motion has come to rest."""

    def abort(self) -> None:
        """Discard the motion at once: it is at rest, or the receiver stops it."""

    def demand(self, times: Array) -> LimitUsage | None:
        """Return what the motion uses of its limits at motion times (k,) [s]; None if idle."""

    def progress(self, now: float) -> float:
        """Return the completed fraction of the motion, 0 to 1."""

    def remaining(self, now: float) -> float:
        """Return the time to the end of the motion [s]."""

    def pause(self, now: float) -> None:
        """Come to rest on the path, and keep the rest of it."""

    def resume(self, now: float) -> None:
        """Continue after a pause."""

    def cancel(self, now: float) -> None:
        """Come to rest on the path, and forget the rest of it."""


class MotionTimeBase:
    """Motion time of several interpolators, and requests that concern all of them."""

    def __init__(
        self,
        interpolators: Sequence[Interpolator],
        clock: Callable[[], float],
        scaling: ScalingInterface,
    ) -> None:
        self._interpolators = tuple(interpolators)
        self._clock, self._scaling = clock, scaling
        self.pace = Pace(self._demand, TICK)
        self._paused_at_rest = False

    @property
    def moving(self) -> tuple[Interpolator, ...]:
        """Interpolators that are not idle."""
        return tuple(i for i in self._interpolators if i.state is not PathState.IDLE)

    @property
    def idle(self) -> bool:
        """Whether no motion is under way."""
        return not self.moving

    @property
    def state(self) -> PathState:
        """State of the first interpolator that is not idle."""
        return next((interpolator.state for interpolator in self.moving), PathState.IDLE)

    def now(self) -> float:
        """Return the current motion time [s]: the clock's time while nothing is slowed down."""
        now = self._clock()
        if self.idle:
            if self._scaling.is_silent:
                self._scaling.forget()
            self._paused_at_rest = False
            self.pace.reset(now, self._scaling.value)
        return self.pace.motion(now)

    def limit_pace(self, max_pace: float, *, at_once: bool) -> None:
        """Aim for the highest allowed pace; one that falls `at_once` breaks the jerk limits."""
        now = self._clock()
        self.pace.refresh(now)  # the motions may have changed since
        target = 0.0 if self._paused_at_rest else min(self._scaling.value, max_pace)
        self.pace.aim(target, now, at_once=at_once)

    def sample_times(self, horizon: float) -> Array:
        """Return the times (k,) of the ticks from the last one to `horizon` later [s]."""
        first = np.floor(self._clock() / TICK + 1e-6)
        count = max(int(horizon / TICK), 1) + 1
        times: Array = TICK * (first + np.arange(count, dtype=float))
        return times

    def release(self) -> None:
        """Let motion time advance again after a pause, because a new motion starts."""
        self._paused_at_rest = False

    def pause(self) -> None:
        """Bring all motions to rest on their paths; raise RefusedError if none can be paused."""
        now = self.now()
        self._request([partial(motion.pause, now) for motion in self._addressed()])
        self._paused_at_rest = self.pace.stands(self._clock())

    def resume(self) -> None:
        """Continue all paused motions; raise RefusedError if there is none."""
        now = self.now()
        self._request([partial(motion.resume, now) for motion in self._addressed()])
        self._paused_at_rest = False

    def cancel(self) -> None:
        """Bring all motions to rest, and forget them; raise RefusedError if there is none."""
        now = self.now()
        self._request([partial(motion.cancel, now) for motion in self._addressed()])

    def _addressed(self) -> tuple[Interpolator, ...]:
        return self.moving or self._interpolators[:1]

    def _request(self, requests: Sequence[Callable[[], None]]) -> None:
        """Make all requests, and refuse only if each of them is refused."""
        refusals = []
        for request in requests:
            try:
                request()
            except RefusedError as error:
                refusals.append(error)
        if len(refusals) == len(requests):
            raise refusals[-1]

    def progress(self) -> float:
        """Return the completed fraction, 0 to 1, of the motion that has completed least."""
        now = self.now()
        return min(interpolator.progress(now) for interpolator in self.moving)

    def remaining(self) -> float:
        """Return the time to the end of all motions or stops [s], at the present pace."""
        now = self.now()
        pace = max(min(self.pace.rate(self._clock()), self._scaling.value), SLOWEST_SHUTDOWN_PACE)
        return max((i.remaining(now) for i in self._interpolators), default=0.0) / pace

    def _demand(self, times: Array) -> LimitUsage:
        demands = [interpolator.demand(times) for interpolator in self._interpolators]
        parts = [demand for demand in demands if demand]
        if not parts:
            return LimitUsage.none(len(times))
        total, *others = parts
        for part in others:
            total = total.beside(part)
        return total
