"""A task of the whole body as a motion of nine axes, which can be paused, cancelled and slowed.

Time is an argument: the motion time, see `motion.path.pace`.
"""

import math

import numpy as np

from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.pace import LEAD, LimitUsage, Pace, Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.motion_choice import PREVIEW_DURATION
from omniman_ros.planning.whole_body.controller import PERIOD, CycleOutcome
from omniman_ros.planning.whole_body.obstacle_snapshot import SLOWEST_PACE, ObstacleSnapshot
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER
from omniman_ros.planning.whole_body.task import BodyTask

END_HOLD_TIME = 0.2  #: Time for which the end is sent repeatedly, in case messages are lost [s]
#: Step below which two motion times are the same, because motion time stands [s]
SHORTEST_STEP = 1e-6
#: Time by which setpoints of the arm are sent before they are due, as its servo lags, and what
#: transport takes [s]: until then, a new plan cannot move the arm
ARM_LEAD = 0.07
SAME = 1e-4  #: Difference up to which two positions of an axis are the same [m, rad]
#: Least motion time for which a motion is sent before it brakes [s]: a plan begins after a period
LEAST_AHEAD = 3.0 * PERIOD


class AvoidanceMotion:
    """Follows a task of the whole body at most at a time; other limits count from the next on."""

    def __init__(self, limits: WholeBodyLimits) -> None:
        self.limits = limits
        self.state = PathState.IDLE
        self._task: BodyTask | None = None
        self._sent: HermiteTrajectory | None = None
        self._brakes_at = math.inf  # motion time from which it does so, if sent by a cycle
        self._has_arrived = False
        self.branch = 0

    @property
    def task(self) -> BodyTask:
        """The task that is followed."""
        assert self._task is not None
        return self._task

    def follow(self, task: BodyTask) -> None:
        """Follow a task, which begins at rest, from now on."""
        self._task, self.state, self._has_arrived = task, PathState.FOLLOWING, False
        self._sent, self._brakes_at = task.controller.motion, math.inf
        self.branch = task.redundancy.model.arm.branch_of(task.redundancy.centre)

    def take_detour(self, now: float) -> bool:
        """Follow the detour that the task has found, and return whether there is one.

        One that does not begin where the tool rests at a motion time is dropped.
        """
        detour, self.task.detour = self.task.detour, None
        if detour is None or self.state is not PathState.FOLLOWING or not self.task.rests(now):
            return False
        at, begin = self.task.axes(np.array([now])), detour.begin.copy()
        begin[:PATH_PARAMETER] = at[0, :PATH_PARAMETER]
        detour.controller.begin(now, begin)
        if np.abs(detour.axes(np.array([now])) - at).max() > SAME:
            return False
        self.follow(detour)
        return True

    @property
    def sent(self) -> HermiteTrajectory:
        """Motion to send: the beginning of the one that is followed, then braking on its way.

        If the sender falls silent, the robot comes to rest on the path of its tool. It passes the
        places of a motion that was checked, only slower.
        """
        assert self._sent is not None
        return self._sent

    def cycle(
        self,
        now: float,
        pace: float,
        around: ObstacleSnapshot,
        delay: float = 0.0,
        ahead: float = PREVIEW_DURATION,
    ) -> CycleOutcome | None:
        """Choose the motion from a motion time on, which passes at a pace.

        The outcome is None while the robot does not follow its task, or has arrived.

        Args:
            around: What is around the robot now.
            delay: Time after which the result is used [s].
            ahead: Time for which the motion is sent, before it brakes [s].
        """
        if self.state is not PathState.FOLLOWING or self._has_arrived:
            return None
        controller = self.task.controller
        if now + PERIOD > self._brakes_at:  # this comes late: the robot brakes by now
            controller.motion = self.sent
        ready = now + pace * (delay + ARM_LEAD)
        outcome = self.task.cycle(now, around.slowed(now, pace), ready)
        self._brakes_at = now + max(pace * (delay + ahead), LEAST_AHEAD)
        self._sent = controller.braked(controller.motion, self._brakes_at)
        return outcome

    def time_to_rest(self, now: float, pace: float) -> float:
        """Return the time until the motion that is sent rests, at a pace [s]."""
        return max(self.sent.end - now, 0.0) / max(pace, SLOWEST_PACE)

    def platform(self, now: float) -> Array:
        """Return the pose (3,) of the platform at a motion time [s]."""
        return self.sent.sample(now)[0][:PATH_PARAMETER]

    def path_parameter(self, now: float) -> float:
        """Return the place on the path at a motion time [m]."""
        return float(self.sent.sample(now)[0][PATH_PARAMETER])

    def pause(self, now: float) -> None:
        """Come to rest on the path; a repeated request has no effect.

        Raises:
            RefusedError: There is nothing to pause.
        """
        if self.state in (PathState.PAUSING, PathState.PAUSED):
            return
        if self.state is not PathState.FOLLOWING:
            raise RefusedError(f"no motion to pause: {self.state.value}")
        self._brake(now)
        self.state = PathState.PAUSING

    def resume(self, now: float) -> None:
        """Continue after a pause, or during the braking for one.

        Raises:
            RefusedError: The motion is not paused.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            raise RefusedError(f"no pause to end: {self.state.value}")
        self.state = PathState.FOLLOWING

    def cancel(self, now: float) -> None:
        """Come to rest on the path, and forget the rest of it.

        Raises:
            RefusedError: There is nothing to cancel.
        """
        if self.state is PathState.IDLE:
            raise RefusedError(f"no motion to cancel: {self.state.value}")
        if self.state is PathState.FOLLOWING:
            self._brake(now)
        self.state = PathState.CANCELLING

    def abort(self) -> None:
        """Forget the task at once: the robot is at rest, or the receiver stops it."""
        self._task, self._sent, self.state = None, None, PathState.IDLE

    def _brake(self, now: float) -> None:
        controller = self.task.controller
        # What was sent is what the robot follows, even if it brakes already.
        self._sent = controller.motion = controller.braked(self.sent, now + LEAD * TICK)
        self._brakes_at = math.inf

    def update(self, now: float) -> None:
        """Update the state when the motion has come to rest."""
        if self.state is PathState.IDLE:
            return
        if self.state is PathState.FOLLOWING and not self._has_arrived:
            if self.task.is_completed(now):
                self._has_arrived = True
                self._brake(now)  # what is left of its speed
            return
        hold = END_HOLD_TIME if self._has_arrived else 0.0
        if now < self.task.controller.motion.end + hold:
            return
        if self.state in (PathState.PAUSING, PathState.PAUSED):
            self.state = PathState.PAUSED
        else:
            self.abort()

    def planned(self, times: Array) -> tuple[Array, Array, Array]:
        """Return what `sample` does, with zeros for the derivatives of the joints."""
        z, rates, change = self._platform_motion(times)
        none = np.zeros((len(times), JOINTS))
        v, a = (np.hstack([each[:, :PATH_PARAMETER], none]) for each in (rates, change))
        return self.task.redundancy.axes(z), v, a

    def _platform_motion(self, times: Array) -> tuple[Array, Array, Array]:
        """Return z, z', z'' (k, d) of the motion under way at motion times (k,) [s]."""
        half = 0.5 * TICK
        z, rates = self.sent.at(np.concatenate([times, times + half, times - half]))
        # Rates change by steps in their derivative: its mean over a tick is smooth enough.
        here, ahead, behind = np.split(rates, 3)
        return z[: len(times)], here, (ahead - behind) / TICK

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) of the motion under way at increasing motion times (k,) [s].

        The joints' x'' is the difference quotient of their x', and zero at a single time.
        """
        z, rates, change = self._platform_motion(times)
        at = self.task.redundancy.configurations(z)
        joint_rates = np.einsum("kij,kj->ki", at.rates, rates)
        joint_change = _slopes(times, joint_rates)
        return (
            at.q,
            np.hstack([rates[:, :PATH_PARAMETER], joint_rates]),
            np.hstack([change[:, :PATH_PARAMETER], joint_change]),
        )

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the task at motion times (k,) [s]: the same."""
        return times

    def tool(self, times: Array) -> Array:
        """Return planned poses (m, 4, 4) of `tool0` in odom at motion times (m,) [s]."""
        return self.task.redundancy.tool(self.sent.at(times)[0])

    def demand(self, times: Array) -> LimitUsage | None:
        """Return the use of the limits at increasing motion times (k,) [s]; None if idle."""
        if self._task is None:
            return None
        _, v, a = self.sample(times)
        return LimitUsage.of(self.limits.groups(1.0, 0.0), v, a)

    def paced_stop_window(self, now: float, pace: Pace) -> Window | None:
        """Return the last stretch of a stream at a pace, down to rest; None if it is at rest."""
        rate = pace.rate(now)
        if self._task is None or rate <= 0.0:
            return None
        begin, sent = pace.motion(now), self.sent
        self._sent = self.task.controller.braked(sent, begin + LEAD * TICK)
        end = max(self.sent.end, begin)
        times = begin + TICK * np.arange(math.ceil((end - begin) / TICK) + 2, dtype=float)
        window = Window(times, *self.sample(times))
        self._sent = sent
        return window.slowed(now, rate)

    def progress(self, now: float) -> float:
        """Return the completed fraction of the path, 0 to 1; 0 without one, or without length."""
        if self._task is None:
            return 0.0
        end = self.task.redundancy.path.end
        return min(max(self.path_parameter(now) / end, 0.0), 1.0) if end > 0.0 else 0.0

    def remaining(self, now: float) -> float:
        """Return the time to the end of the motion that is planned up to now [s]."""
        return 0.0 if self._task is None else max(self.task.controller.motion.end - now, 0.0)


def _slopes(times: Array, values: Array) -> Array:
    """Return the difference quotients (k, d) of values (k, d) at times (k,), which may repeat."""
    steps = np.maximum(np.diff(times), SHORTEST_STEP)
    slopes = np.diff(values, axis=0) / steps[:, None]
    sides = np.vstack([slopes[:1], slopes, slopes[-1:]])
    return 0.5 * (sides[:-1] + sides[1:]) if len(slopes) else np.zeros(values.shape)
