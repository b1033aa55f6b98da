"""Takes trajectories of joints and gives x, x', x'' of all of them on the time base.

One trajectory at a time; a new one replaces it without a jump. One that has times goes on from the
motion under way to its first point; one without times begins where a stop on the path ends. Pause
and cancel slow the motion down on its path. Time is an argument: motion time, see `pace`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.axis_limits import AxisLimits
from omniman_ros.core.path.interpolator import PathState, RefusedError, Window
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.joint_points import JointPlanner, JointPoints, State
from omniman_ros.core.path.pace import LEAD, Demand, Pace
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.path.timed_curve import TimedCurve

Array = NDArray[np.float64]

KEPT = 0.25
"""So long a motion that was replaced is known: measurements are older than now [s]."""
SETTLE = 0.2
"""How long the end is held, so that the receiver has it whatever is lost [s]."""


@dataclass(frozen=True)
class JointProposal:
    """A trajectory that could be driven.

    Attributes:
        curve: Its motion.
        since: When it begins, and the motion under way ends [s]; None: whenever it is taken.
        replaces: The motion that it goes on from; None from rest.
    """

    curve: TimedCurve
    since: float | None
    replaces: "JointMotion | None"


class JointMotion:
    """A curve from a time on, and the pace at which it is driven.

    Args:
        curve: Where.
        start: When [s].
        limits: What a change of the pace keeps.

    Attributes:
        start, curve: As above.
        pace: 1 but for pauses and stops.
    """

    def __init__(self, curve: TimedCurve, start: float, limits: AxisLimits) -> None:
        self.curve, self.start = curve, start
        self._groups = limits.groups(1.0, 0.0)
        self.pace = Pace(self._demand, TICK)

    @property
    def end(self) -> float:
        """Its end in its own time [s]."""
        return self.start + self.curve.duration

    def sample(self, times: Array, pace: Pace | None = None) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) at times (k,) [s], at its pace or at another."""
        paced = (pace or self.pace).sample(times)
        return paced.apply(*self.curve.sample(paced.motion - self.start))

    def state(self, time: float) -> State:
        """The state at a time [s]."""
        return State(*(part[0] for part in self.sample(np.array([time]))))

    def _demand(self, times: Array) -> Demand:
        _, v, a = self.curve.sample(times - self.start)
        return Demand.of(self._groups, v, a)


class JointInterpolator:
    """Follows trajectories of joints, pauses, resumes, cancels, and takes new ones on the move.

    Args:
        limits: Names and limits of all joints.
        options: How trajectories are taken.

    Attributes:
        planner: What makes motions; a new one counts from the next trajectory.
        state: What it does.
        held: Where (d,) the last motion ended that was driven to a rest, or None.
    """

    def __init__(self, limits: AxisLimits, options: JointTrajectoryOptions) -> None:
        self.planner = JointPlanner(limits, options, TICK)
        self.state = PathState.IDLE
        self.held: Array | None = None
        self._motion: JointMotion | None = None
        self._before: list[tuple[float, JointMotion]] = []  # until when each still counts
        self._since = -math.inf

    # ---- trajectories -------------------------------------------------------------------------

    def propose(
        self,
        points: JointPoints,
        here: Array,
        now: float,
        lead: float = 0.0,
        start: float | None = None,
    ) -> JointProposal:
        """Plan a trajectory; what goes on is not changed.

        Args:
            points: Where, and perhaps when.
            here: (d,) where the joints are; it counts if none of them is under way.
            now: Time [s].
            lead: What planning may take, from a motion that goes on [s].
            start: Time 0 of the trajectory [s]; None for as soon as possible.

        Raises:
            InputError: It cannot be driven from here.
        """
        if self._motion is None:
            if points.times is None:
                return JointProposal(self.planner.fastest(points, here), start, None)
            return JointProposal(self.planner.timed(points, State.rest(here)), start, None)
        since = max(now + lead + LEAD * TICK, self._since, -math.inf if start is None else start)
        old = self._motion
        if points.times is None:
            curve = self._stop_and_go(old, points, now, since)
        else:
            curve = self.planner.timed(points, old.state(since))
        return JointProposal(curve, since, old)

    def take(self, proposal: JointProposal, now: float) -> bool:
        """Drive a proposal; False if it comes too late for the motion that goes on."""
        soonest, since = now + LEAD * TICK, proposal.since
        if proposal.replaces is None:
            soonest = TICK * math.ceil(soonest / TICK - 1e-6)  # on the ticks of the stream
            since = soonest if since is None else max(since, soonest)
        elif since is None or proposal.replaces is not self._motion or soonest - TICK > since:
            return False
        if self._motion is not None:
            self._before.append((since, self._motion))
        self._since = since
        self._motion = JointMotion(proposal.curve, since, self.planner.limits)
        self.state = PathState.FOLLOWING
        return True

    def _stop_and_go(
        self, old: JointMotion, points: JointPoints, now: float, since: float
    ) -> TimedCurve:
        """Down to rest on the path, from a time on, then through points without times."""
        brake = old.pace.copy()
        brake.aim(0.0, now, since)
        count = max(math.ceil((brake.settling(since) - since) / TICK - 1e-6), 0) + 1
        down = old.sample(since + TICK * np.arange(count, dtype=float), brake)
        down[1][-1] = down[2][-1] = 0.0
        after = self.planner.fastest(points, down[0][-1])
        times: Array = TICK * np.arange(count + len(after.times) - 1, dtype=float)
        parts = (after.positions, after.velocities, after.accelerations)
        rows = (np.vstack([a, b[1:]]) for a, b in zip(down, parts, strict=True))
        return TimedCurve(times, *rows)

    # ---- requests -----------------------------------------------------------------------------

    def pause(self, now: float) -> None:
        """Come to rest on the path, as soon as the limits allow; ask again, and nothing changes.

        Raises:
            RefusedError: There is nothing to pause.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            if self.state is not PathState.FOLLOWING:
                raise RefusedError(f"no trajectory to pause: {self.state.value}")
            self._aim(0.0, now)
            self.state = PathState.PAUSING

    def cancel(self, now: float) -> None:
        """Come to rest on the path, as soon as the limits allow, and forget it.

        Raises:
            RefusedError: There is nothing to cancel.
        """
        if self.state is PathState.IDLE:
            raise RefusedError(f"no trajectory to cancel: {self.state.value}")
        self._aim(0.0, now)
        self.state = PathState.CANCELLING

    def resume(self, now: float) -> None:
        """Go on from a pause, or from the braking for one.

        Raises:
            RefusedError: It does not pause.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            raise RefusedError(f"no pause to end: {self.state.value}")
        self._aim(1.0, now)
        self.state = PathState.FOLLOWING

    def abort(self) -> None:
        """Forget it at once: it stands, or somebody else stops it."""
        self._motion = self.held = None
        self._before.clear()
        self.state = PathState.IDLE

    def finish(self, now: float) -> None:
        """It stands: end it here."""
        if self._motion is not None:
            here = self.sample(np.array([now]))[0][0]
            self.abort()
            self.held = here

    def _aim(self, target: float, now: float) -> None:
        assert self._motion is not None
        self._motion.pace.aim(target, now, self._since)

    # ---- output -------------------------------------------------------------------------------

    def update(self, now: float) -> None:
        """Notice that it has come to rest."""
        motion = self._motion
        if motion is None:
            return
        while self._before and now >= self._before[0][0] + KEPT:
            self._before.pop(0)
        if self.state is PathState.FOLLOWING:
            if motion.pace.motion(now) >= motion.end + SETTLE:
                self.finish(now)
        elif now >= self._since and motion.pace.stands(now):
            if self.state is PathState.PAUSING:
                self.state = PathState.PAUSED
            elif self.state is PathState.CANCELLING:
                self.finish(now)

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) at times (k,) [s] that increase, with a motion under way."""
        assert self._motion is not None
        return self._sample(times, self._motion.pace)

    def along(self, times: Array) -> Array:
        """Times (k,) of the curve of the last motion at times (k,) [s] that increase."""
        assert self._motion is not None
        return self._motion.pace.sample(times).motion - self._motion.start

    def demand(self, times: Array) -> Demand | None:
        """What it asks of its limits at times (k,) [s] that increase; None without a motion."""
        if self._motion is None:
            return None
        _, v, a = self.sample(times)
        return Demand.of(self.planner.limits.groups(1.0, 0.0), v, a)

    def stop_window(self, now: float) -> Window | None:
        """A last stretch of the stream: down to rest on the path, from now on.

        For when no other can follow; it is not driven by this interpolator.
        """
        motion = self._motion
        if motion is None:
            return None
        brake = motion.pace.copy()
        brake.aim(0.0, now, self._since)
        end = max(brake.settling(now), now)
        times = now + TICK * np.arange(math.ceil((end - now) / TICK) + 2, dtype=float)
        return Window(times, *self._sample(times, brake))

    def _sample(self, times: Array, pace: Pace) -> tuple[Array, Array, Array]:
        """The motions one after the other, the last of them at a pace."""
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
        """How much of the trajectory's time is behind, 0 to 1; 0 without one."""
        if self._motion is None:
            return 0.0
        done = (self._motion.pace.motion(now) - self._motion.start) / self._motion.curve.duration
        return min(max(done, 0.0), 1.0)

    def remaining(self, now: float) -> float:
        """Time to the end of the motion that goes on [s]."""
        motion = self._motion
        if motion is None:
            return 0.0
        if self.state is PathState.FOLLOWING:
            return max(motion.end - motion.pace.motion(now), 0.0)
        return min(motion.pace.settling(now) - now, motion.curve.duration)
