"""The time base that all motions share, which can be slowed down for all of them together."""

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.pace import LimitUsage, Pace
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Excess over the range 0 to 1 that is accepted, distance from its ends that counts as none, and
#: smallest change that counts.
SCALING_TOLERANCE = 1e-3
#: Lowest pace for which the end of the node waits until its motions are at rest
SLOWEST_SHUTDOWN_PACE = 0.1


class ScalingInterface:
    """Subscribes to `arm/speed_scaling`, 0 to 1."""

    def __init__(self, node: OmnimanNode, on_change: Callable[[], None]) -> None:
        self.value, self.silence = 1.0, 0.0
        self._received = False
        self._on_change = on_change
        node.create_subscription(
            Float64, "arm/speed_scaling", node.guarded("arm/speed_scaling", self._on_scaling), 1
        )

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the time that has elapsed [s]."""
        if self._received:
            self.silence += elapsed

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


class Interpolator(Protocol):
    """Common interface of the interpolators of the platform, the arm and the whole body."""

    state: PathState

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
        scaling_timeout: Callable[[], float],
    ) -> None:
        self._interpolators = tuple(interpolators)
        self._clock, self._scaling_timeout = clock, scaling_timeout
        self._scaling = scaling
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
            if self._scaling.silence > self._scaling_timeout():
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


class MotionServices:
    """Serves requests that concern all motions of a node.

    Args:
        publish: Called after a request was accepted, so that it takes effect at once.
    """

    def __init__(
        self,
        node: OmnimanNode,
        time_base: MotionTimeBase,
        cancel: Callable[[], None],
        publish: Callable[[], None],
    ) -> None:
        self._node, self._publish = node, publish
        for name, request in (
            ("pause", time_base.pause),
            ("resume", time_base.resume),
            ("cancel", cancel),
        ):
            self.add(name, request, lambda: time_base.state.value)

    def add(self, name: str, request: Callable[[], None], answer: Callable[[], str]) -> None:
        """Serve `~/NAME`: a request that may raise RefusedError, and the answer after it."""
        serve = functools.partial(self._serve, request, answer)
        self._node.create_service(Trigger, f"~/{name}", serve)

    def _serve(
        self,
        request: Callable[[], None],
        answer: Callable[[], str],
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        try:
            request()
        except RefusedError as error:
            response.success, response.message = False, str(error)
        else:
            self._publish()
            response.success, response.message = True, answer()
        return response
