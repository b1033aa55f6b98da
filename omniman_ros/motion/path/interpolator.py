"""Path interpolator of CCTA 2017 V.B: converts paths to x, x', x'' on the time base.

The platform follows one path at a time, which a new path replaces without a jump. Time is an
argument.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.motion.path import polyline
from omniman_ros.motion.path.pace import LEAD, LimitUsage, Window
from omniman_ros.motion.path.parameters import TICK, PathParameters
from omniman_ros.motion.path.planner import AT_REST, PathPlanner, Plan
from omniman_ros.motion.path.trajectory import Trajectory

#: Distance before and after a corner over which the heading changes, in corner tolerances
HEADING_BLEND = 4.0


class PathState(Enum):
    """State of an interpolator."""

    IDLE = "idle"
    FOLLOWING = "following"
    PAUSING = "pausing"
    PAUSED = "paused"
    CANCELLING = "cancelling"
    SLOWING = "slowing"


class RefusedError(OmnimanError):
    """A request does not fit the present state; the message gives the reason."""


@dataclass(frozen=True)
class PathProposal:
    """A planned path that has not been started."""

    #: Motion along the path; from rest, it starts when the proposal is accepted
    trajectory: Trajectory
    #: Time from which it differs from the motion under way [s]; None if it starts at rest
    since: float | None
    plan: Plan  #: Plan of the motion
    planner: PathPlanner  #: Planner that made the plan


class PathInterpolator:
    """Follows paths of the platform, and replaces them on the move.

    Attributes:
        parameters: New ones count from the next path that starts at rest.
        limit_scale: Fraction of all speeds and accelerations in use, see :meth:`scale_limits`.
    """

    def __init__(self, parameters: PathParameters) -> None:
        self.parameters = parameters
        self.state = PathState.IDLE
        self.plan: Plan | None = None
        self.limit_scale = 1.0
        self._planner = parameters.planner()
        self._trajectory: Trajectory | None = None
        self._since = 0.0

    def propose(
        self, poses: Array, pose: tuple[float, float, float], now: float, lead: float = 0.0
    ) -> PathProposal:
        """Plan a path of the platform without changing the motion under way.

        Args:
            poses: (k, 3) x, y, theta in odom [m, m, rad].
            pose: Measured pose of the robot [m, m, rad], used if no path is under way.
            lead: Planning time: from now to the first change of a motion under way [s].

        Raises:
            InputError: The path cannot be driven from here.
        """
        self._check(poses)
        if self._trajectory is None:
            return self._from_rest(poses, np.array(pose))
        return self._on_the_move(poses, self._trajectory, now, lead)

    def take(self, proposal: PathProposal, now: float) -> bool:
        """Start a proposal; return False if it comes too late for the motion under way."""
        trajectory, since = proposal.trajectory, proposal.since
        if since is None:
            since = trajectory.start = now + LEAD * TICK
        elif self._trajectory is None or now + (LEAD - 1) * TICK > since:
            return False
        self._planner = proposal.planner
        self._go_on(trajectory, since, proposal.plan)
        self.scale_limits(self.limit_scale, now)
        return True

    def _from_rest(self, poses: Array, pose: Array) -> PathProposal:
        self._near(poses[0], pose)
        planner = self.parameters.planner().slower(self.limit_scale)
        plan = planner.plan(np.vstack([pose, self._headed(poses, float(pose[2]))]))
        return PathProposal(
            Trajectory(0.0, TICK, plan.ticks, planner.smoother), None, plan, planner
        )

    def _on_the_move(
        self, poses: Array, trajectory: Trajectory, now: float, lead: float
    ) -> PathProposal:
        i, planner = self._next(trajectory, now + lead), self._planner
        position, velocity = self._motion(trajectory, i)
        headed = self._headed(poses, float(position[2]))
        if np.abs(velocity).max() > AT_REST:
            stop_point = planner.stop_point(position, velocity)
            headed = polyline.remaining_path(headed, stop_point[:2])
            self._near(headed[0], stop_point)
            plan = planner.plan_on(position, velocity, headed)
        else:
            self._near(headed[0], position)
            planner = planner.slower(self.limit_scale)
            plan = planner.plan(np.vstack([position, headed]))
        return PathProposal(
            trajectory.continued(now, i, plan.ticks), trajectory.time(i), plan, planner
        )

    def _check(self, poses: Array) -> None:
        options = self.parameters.path
        if poses.ndim != 2 or poses.shape[1] != 3:
            raise InputError(f"poses have shape {poses.shape}, expected (k, 3)")
        if len(poses) == 0:
            raise InputError("the path is empty; ~/cancel ends the path under way")
        if len(poses) > options.max_poses:
            raise InputError(
                f"the path has {len(poses)} poses, at most {options.max_poses} are accepted"
            )
        plausible.demand(poses[:, :2], plausible.LENGTH, "positions")
        plausible.demand(poses[:, 2], plausible.ANGLE, "headings")

    def _near(self, first: Array, here: Array) -> None:
        distance = float(np.hypot(*(first - here)[:2]))
        if distance > self.parameters.path.start_distance:
            raise InputError(
                f"the path starts {distance:.2f} m from the robot, at most "
                f"{self.parameters.path.start_distance:g} m are allowed"
            )

    def _headed(self, poses: Array, heading: float) -> Array:
        options = self.parameters.path
        if options.heading == "along":
            present = np.column_stack([poses[:, :2], np.full(len(poses), heading)])
            poses = polyline.headings_along(present, HEADING_BLEND * options.corner_tolerance)
        return polyline.unwrap_headings(poses, heading)

    def _go_on(self, trajectory: Trajectory, since: float, plan: Plan) -> None:
        self._trajectory, self._since, self.plan = trajectory, since, plan
        self.state = PathState.FOLLOWING

    def _next(self, trajectory: Trajectory, now: float) -> int:
        return max(trajectory.index(now) + LEAD, trajectory.index(self._since))

    def _place(self, trajectory: Trajectory, i: int) -> tuple[int, float, float]:
        """Return the section of the plan's route, u [s] and u' at a tick."""
        ticks = trajectory.ticks
        i = min(i, len(ticks) - 1)
        return int(ticks.section[i]), float(ticks.u[i]), float(ticks.rate[i])

    def _motion(self, trajectory: Trajectory, i: int) -> tuple[Array, Array]:
        """Return position and velocity (d,) at a tick, before the smoothing."""
        assert self.plan is not None
        section, u, rate = self._place(trajectory, i)
        curve, at = self.plan.route.curves[section], np.array([u])
        return curve.at(at)[0], curve.slope(at)[0] * rate

    def pause(self, now: float) -> None:
        """Come to rest on the path as soon as the limits allow; a repeated request has no effect.

        Raises:
            RefusedError: There is nothing to pause.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            self._stop(now, "pause")
            self.state = PathState.PAUSING

    def cancel(self, now: float) -> None:
        """Come to rest on the path as soon as the limits allow, and forget the rest of it.

        Raises:
            RefusedError: There is nothing to cancel.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED, PathState.CANCELLING):
            self._stop(now, "cancel")
        self.state = PathState.CANCELLING

    def _stop(self, now: float, request: str) -> None:
        trajectory, plan = self._trajectory, self.plan
        if self.state is PathState.SLOWING:
            return  # braking already
        if self.state is not PathState.FOLLOWING or trajectory is None or plan is None:
            raise RefusedError(f"no path to {request}: {self.state.value}")
        i = self._next(trajectory, now)
        ticks = self._planner.stop(plan.route, *self._place(trajectory, i))
        self._go_on(trajectory.continued(now, i, ticks), trajectory.time(i), plan)

    def resume(self, now: float) -> None:
        """Continue after a pause, or during the braking for one.

        Raises:
            RefusedError: The motion is not paused, or the rest of the path would take too long
                within the limits that are left.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            raise RefusedError(f"no pause to end: {self.state.value}")
        if self.state is PathState.PAUSING and self._planner.limit_scale > self.limit_scale:
            self.state = PathState.SLOWING
            return
        try:
            self._drive_on(now)
        except InputError as error:
            raise RefusedError(f"cannot continue: {error}") from error

    def scale_limits(self, limit_scale: float, now: float) -> None:
        """Use a fraction (0, 1] of all speeds and accelerations from the next rest on.

        A path that is driven faster is stopped for this, and continues by itself.
        """
        self.limit_scale = limit_scale
        if self.state is PathState.FOLLOWING and self._planner.limit_scale > limit_scale:
            self._stop(now, "slow down")
            self.state = PathState.SLOWING

    def _drive_on(self, now: float) -> None:
        trajectory, plan = self._trajectory, self.plan
        assert trajectory is not None and plan is not None
        if self.state is not PathState.PAUSING:
            self._planner = self._planner.slower(self.limit_scale)
        i = self._next(trajectory, now)
        ticks = self._planner.drive(plan.route, *self._place(trajectory, i))
        self._go_on(trajectory.continued(now, i, ticks), trajectory.time(i), plan)

    def abort(self) -> None:
        """Forget the path at once, as another source drives or nothing may move."""
        self._trajectory = None
        self.state = PathState.IDLE

    def update(self, now: float) -> None:
        """Update the state when the motion has come to rest.

        Raises:
            InputError: The limits were scaled down so much that the rest of the path would take
                too long; the path is paused.
        """
        if self._trajectory is None or now < self._trajectory.end:
            return
        if self.state is PathState.PAUSING:
            self.state = PathState.PAUSED
        if self.state is PathState.SLOWING:
            self.state = PathState.PAUSED
            self._drive_on(now)
        settled = now - self._trajectory.end >= self.parameters.path.settle
        if settled and self.state in (PathState.FOLLOWING, PathState.CANCELLING):
            self.abort()

    def window(self, now: float, horizon: float) -> Window | None:
        """Return the stream from now on for `horizon` [s], at least two ticks; None if idle."""
        trajectory = self._trajectory
        if trajectory is None:
            return None
        first = trajectory.index(now)
        count = max(int(horizon / TICK), 1) + 1
        rows = trajectory.rows(first, count)
        return Window(
            trajectory.start + TICK * np.arange(first, first + count, dtype=float),
            trajectory.positions[rows],
            trajectory.velocities[rows],
            trajectory.accelerations[rows],
        )

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) of the path under way at any times (k,) [s]."""
        assert self._trajectory is not None
        return self._trajectory.sample(times)

    def demand(self, times: Array) -> LimitUsage | None:
        """Return the use of the limits at times (k,) [s]; None without a path."""
        if self._trajectory is None:
            return None
        _, v, a = self.sample(times)
        return LimitUsage.of(self._planner.groups, v, a)

    def progress(self, now: float) -> float:
        """Return the completed fraction of the path, 0 to 1; 0 without a path."""
        return 0.0 if self._trajectory is None else self._trajectory.progress(now)

    def remaining(self, now: float) -> float:
        """Return the time to the end of the motion under way [s]."""
        return 0.0 if self._trajectory is None else max(self._trajectory.end - now, 0.0)
