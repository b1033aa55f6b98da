"""Interpolator of joint trajectories: x, x', x'' of all joints on the time base.

The joints follow one trajectory at a time; a new trajectory replaces it without a jump. A
trajectory with times continues from the motion under way to its first point; a trajectory without
times starts where a stop on the path ends. Pause and cancel slow the motion down on its path. Time
is an argument: the motion time, see `pace`.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints, KinematicState
from omniman_ros.motion.path.moving_target import MovingTarget, curve_to
from omniman_ros.motion.path.pace import LEAD, LimitUsage, Pace, Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.timed_curve import TimedCurve

#: Time for which a replaced motion is kept, as measurements are older than now [s]
REPLACED_MOTION_MEMORY = 0.25
END_HOLD_TIME = 0.2  #: Time for which the end is sent repeatedly, in case messages are lost [s]


@dataclass(frozen=True)
class JointProposal:
    """A planned trajectory that has not been started."""

    curve: TimedCurve  #: Motion of the trajectory
    #: Time at which it replaces the motion under way [s]; None if it starts when the proposal is
    #: accepted.
    since: float | None
    replaces: "JointMotion | None"  #: Motion that it continues from; None if it starts at rest


class JointMotion:
    """A curve that the joints follow from a time on, with its own pace.

    The pace is 1 except for pauses and stops; its changes keep the limits.
    """

    def __init__(self, curve: TimedCurve, start: float, limits: AxisLimits) -> None:
        self.curve, self.start = curve, start
        self._groups = limits.groups(1.0, 0.0)
        self.pace = Pace(self._demand, TICK)

    @property
    def end(self) -> float:
        """End in its own time [s]."""
        return self.start + self.curve.duration

    def sample(self, times: Array, pace: Pace | None = None) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at times (k,) [s], at its own pace or at another."""
        paced = (pace or self.pace).sample(times)
        return paced.apply(*self.curve.sample(paced.motion - self.start))

    def state(self, time: float) -> KinematicState:
        """Return the state at a time [s]."""
        return KinematicState(*(part[0] for part in self.sample(np.array([time]))))

    def _demand(self, times: Array) -> LimitUsage:
        _, v, a = self.curve.sample(times - self.start)
        return LimitUsage.of(self._groups, v, a)


class JointInterpolator:
    """Follows trajectories of joints, and replaces them on the move.

    Attributes:
        planner: Planner of the motions; a new one counts from the next trajectory.
    """

    def __init__(self, limits: AxisLimits, options: JointTrajectoryOptions) -> None:
        self.planner = JointPlanner(limits, options)
        self.state = PathState.IDLE
        self._motion: JointMotion | None = None
        # Motions that were replaced, each after the time at which it was replaced [s].
        self._before: list[tuple[float, JointMotion]] = []
        self._since = -math.inf

    def propose(
        self,
        points: JointPoints,
        here: Array,
        now: float,
        lead: float = 0.0,
        start: float | None = None,
    ) -> JointProposal:
        """Plan a trajectory without changing the motion under way.

        Args:
            here: (d,) positions of the joints, used if no motion is under way.
            lead: Planning time that passes before a motion under way can change [s].
            start: Time 0 of the trajectory [s]; None if it starts as soon as possible.

        Raises:
            InputError: The trajectory cannot be driven from here.
        """
        if self._motion is None:
            if points.times is None:
                return JointProposal(self.planner.fastest(points, here), start, None)
            return JointProposal(
                self.planner.timed(points, KinematicState.rest(here)), start, None
            )
        since = max(now + lead + LEAD * TICK, self._since, -math.inf if start is None else start)
        motion = self._motion
        if points.times is None:
            curve = self._stop_and_go(motion, points, now, since)
        else:
            curve = self.planner.timed(points, motion.state(since))
        return JointProposal(curve, since, motion)

    def propose_meeting(
        self, target: MovingTarget, here: Array, now: float, lead: float
    ) -> JointProposal:
        """Plan a motion to a moving target without changing the motion under way.

        Raises:
            InputError: The target cannot be reached.
        """
        options, soonest = self.planner.options, now + LEAD * TICK
        motion, since, state = self._motion, None, KinematicState.rest(here)
        if motion is not None:
            soonest = since = max(soonest + lead, self._since)
            state = motion.state(since)
        curve = curve_to(
            target.after(soonest - now),
            state,
            self.planner.limits,
            options.reserve,
            options.stream_timeout,
        )
        return JointProposal(curve, since, motion)

    def take(self, proposal: JointProposal, now: float) -> bool:
        """Start a proposal; return False if it comes too late for the motion under way."""
        soonest, since = now + LEAD * TICK, proposal.since
        if proposal.replaces is None:
            soonest = TICK * math.ceil(soonest / TICK - 1e-6)  # on the ticks of the stream
            since = soonest if since is None else max(since, soonest)
        elif since is None or proposal.replaces is not self._motion or soonest - TICK > since:
            return False
        if self._motion is not None and (not self._before or self._before[-1][0] < since):
            self._before.append((since, self._motion))
        self._since = since
        self._motion = JointMotion(proposal.curve, since, self.planner.limits)
        self.state = PathState.FOLLOWING
        return True

    def _stop_and_go(
        self, motion: JointMotion, points: JointPoints, now: float, since: float
    ) -> TimedCurve:
        brake = motion.pace.copy()
        brake.aim(0.0, now, since)
        count = max(math.ceil((brake.settling(since) - since) / TICK - 1e-6), 0) + 1
        stop = motion.sample(since + TICK * np.arange(count, dtype=float), brake)
        stop[1][-1] = stop[2][-1] = 0.0
        after = self.planner.fastest(points, stop[0][-1])
        times: Array = TICK * np.arange(count + len(after.times) - 1, dtype=float)
        parts = (after.positions, after.velocities, after.accelerations)
        rows = (np.vstack([a, b[1:]]) for a, b in zip(stop, parts, strict=True))
        return TimedCurve(times, *rows)

    def pause(self, now: float) -> None:
        """Come to rest on the path as soon as the limits allow; a repeated request has no effect.

        Raises:
            RefusedError: There is nothing to pause.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            if self.state is not PathState.FOLLOWING:
                raise RefusedError(f"no trajectory to pause: {self.state.value}")
            self._aim(0.0, now)
            self.state = PathState.PAUSING

    def cancel(self, now: float) -> None:
        """Come to rest on the path as soon as the limits allow, and forget the rest of it.

        Raises:
            RefusedError: There is nothing to cancel.
        """
        if self.state is PathState.IDLE:
            raise RefusedError(f"no trajectory to cancel: {self.state.value}")
        self._aim(0.0, now)
        self.state = PathState.CANCELLING

    def resume(self, now: float) -> None:
        """Continue after a pause or during its braking; RefusedError if it is not paused."""
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            raise RefusedError(f"no pause to end: {self.state.value}")
        self._aim(1.0, now)
        self.state = PathState.FOLLOWING

    def abort(self) -> None:
        """Forget the motion at once: it is at rest, or the receiver stops it."""
        self._motion = None
        self._before.clear()
        self.state = PathState.IDLE

    def _aim(self, target: float, now: float) -> None:
        assert self._motion is not None
        self._motion.pace.aim(target, now, self._since)

    def update(self, now: float) -> None:
        """Update the state when the motion has come to rest."""
        motion = self._motion
        if motion is None:
            return
        while self._before and now >= self._before[0][0] + REPLACED_MOTION_MEMORY:
            self._before.pop(0)
        if self.state is PathState.FOLLOWING:
            if motion.pace.motion(now) >= motion.end + END_HOLD_TIME:
                self.abort()
        elif now >= self._since and motion.pace.stands(now):
            if self.state is PathState.PAUSING:
                self.state = PathState.PAUSED
            elif self.state is PathState.CANCELLING:
                self.abort()

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) of the motion under way at increasing times (k,) [s]."""
        assert self._motion is not None
        return self._sample(times, self._motion.pace)

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the last motion's own curve at increasing times (k,) [s]."""
        assert self._motion is not None
        return self._motion.pace.sample(times).motion - self._motion.start

    def demand(self, times: Array) -> LimitUsage | None:
        """Return the use of the limits at increasing times (k,) [s]; None if idle."""
        if self._motion is None:
            return None
        _, v, a = self.sample(times)
        return LimitUsage.of(self.planner.limits.groups(1.0, 0.0), v, a)

    def stop_window(self, now: float) -> Window | None:
        """Return the last stretch of a stream: from now on down to rest on the path.

        It is meant for streams that end here; the interpolator itself does not follow it.
        """
        motion = self._motion
        if motion is None:
            return None
        brake = motion.pace.copy()
        brake.aim(0.0, now, self._since)
        end = max(brake.settling(now), now)
        times = now + TICK * np.arange(math.ceil((end - now) / TICK) + 2, dtype=float)
        return Window(times, *self._sample(times, brake))

    def paced_stop_window(self, now: float, pace: Pace) -> Window | None:
        """Return the last stretch of a stream that runs at a pace: down to rest on the path.

        A stop from a lower pace has the same duration in motion time, on the same path. It is None
        if there is no motion or it stands still.
        """
        if pace.plain:
            return self.stop_window(now)
        window, rate = self.stop_window(pace.motion(now)), pace.rate(now)
        return None if window is None or rate <= 0.0 else window.slowed(now, rate)

    def _sample(self, times: Array, pace: Pace) -> tuple[Array, Array, Array]:
        assert self._motion is not None
        if not self._before:
            return self._motion.sample(times, pace)
        parts, begin = [], 0
        for until, motion in self._before:
            end = int(np.searchsorted(times, until))
            if end > begin:
                parts.append(motion.sample(times[begin:end]))
                begin = end
        if begin < len(times):
            parts.append(self._motion.sample(times[begin:], pace))
        x, v, a = (np.vstack(part) for part in zip(*parts, strict=True))
        return x, v, a

    def progress(self, now: float) -> float:
        """Return the elapsed fraction of the trajectory's time, 0 to 1; 0 without a motion."""
        if self._motion is None:
            return 0.0
        done = (self._motion.pace.motion(now) - self._motion.start) / self._motion.curve.duration
        return min(max(done, 0.0), 1.0)

    def remaining(self, now: float) -> float:
        """Return the time to the end of the motion under way [s]."""
        motion = self._motion
        if motion is None:
            return 0.0
        if self.state is PathState.FOLLOWING:
            return max(motion.end - motion.pace.motion(now), 0.0)
        return min(motion.pace.settling(now) - now, motion.curve.duration)
