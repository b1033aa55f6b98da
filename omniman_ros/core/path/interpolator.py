"""The path interpolator of CCTA 2017 V.B: takes paths and gives x, x', x'' on the time base.

One path at a time; a new one replaces it without a jump. Time is an argument.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.core.path import polyline
from omniman_ros.core.path.pace import LEAD, Demand
from omniman_ros.core.path.parameters import TICK, PathParameters
from omniman_ros.core.path.planner import STANDING, PathPlanner, Plan
from omniman_ros.core.path.trajectory import Trajectory

Array = NDArray[np.float64]

SPREAD = 4.0
"""Along a path the heading turns over so many corner tolerances on either side of a corner."""


class PathState(Enum):
    """What it does."""

    IDLE = "idle"
    FOLLOWING = "following"
    PAUSING = "pausing"
    PAUSED = "paused"
    CANCELLING = "cancelling"
    SLOWING = "slowing"


class RefusedError(OmnimanError):
    """A request that does not fit what goes on; the message says why."""


@dataclass(frozen=True)
class Window:
    """A part of the stream: times (k,) [s], x, x', x'' (k, d)."""

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array


@dataclass(frozen=True)
class Proposal:
    """A path that could be driven.

    Attributes:
        trajectory: The motion; from rest it begins whenever it is taken.
        since: Time from which it differs from the motion that goes on [s]; None from rest.
        plan: What it was made of.
        planner: What made it.
    """

    trajectory: Trajectory
    since: float | None
    plan: Plan
    planner: PathPlanner


class PathInterpolator:
    """Follows a path, pauses, resumes, cancels, and takes new paths on the move.

    Attributes:
        parameters: What it is set by; new ones count from the next path that begins at rest.
        state: What it does.
        plan: The last plan, or None.
        share: Of all speeds and accelerations that is used, see :meth:`scale`.
    """

    def __init__(self, parameters: PathParameters) -> None:
        self.parameters = parameters
        self.state = PathState.IDLE
        self.plan: Plan | None = None
        self.share = 1.0
        self._planner = parameters.planner()
        self._trajectory: Trajectory | None = None
        self._since = 0.0

    # ---- paths --------------------------------------------------------------------------------

    def propose(
        self, poses: Array, pose: tuple[float, float, float], now: float, lead: float = 0.0
    ) -> Proposal:
        """Plan a path of the platform; what goes on is not changed.

        Args:
            poses: (k, 3) x, y, theta in odom [m, m, rad].
            pose: Where the robot is; it counts if the robot is not on a path already.
            now: Time [s].
            lead: Time from now to the first change of a motion that goes on [s]: what planning
                may take.

        Raises:
            InputError: No path that can be driven from here.
        """
        self._check(poses)
        if self._trajectory is None:
            return self._from_rest(poses, np.array(pose))
        return self._on_the_move(poses, self._trajectory, now, lead)

    def take(self, proposal: Proposal, now: float) -> bool:
        """Drive a proposal; False if it comes too late for the motion that goes on."""
        trajectory, since = proposal.trajectory, proposal.since
        if since is None:
            since = trajectory.start = now + LEAD * TICK
        elif self._trajectory is None or now + (LEAD - 1) * TICK > since:
            return False
        self._planner = proposal.planner
        self._go_on(trajectory, since, proposal.plan)
        self.scale(self.share, now)
        return True

    def _from_rest(self, poses: Array, pose: Array) -> Proposal:
        self._near(poses[0], pose)
        planner = self.parameters.planner().slower(self.share)
        plan = planner.plan(np.vstack([pose, self._headed(poses, float(pose[2]))]))
        return Proposal(Trajectory(0.0, TICK, plan.ticks, planner.smoother), None, plan, planner)

    def _on_the_move(
        self, poses: Array, trajectory: Trajectory, now: float, lead: float
    ) -> Proposal:
        i, planner = self._next(trajectory, now + lead), self._planner
        position, velocity = self._motion(trajectory, i)
        headed = self._headed(poses, float(position[2]))
        if np.abs(velocity).max() > STANDING:
            way_out = planner.stop_point(position, velocity)
            headed = polyline.joined(headed, way_out[:2])
            self._near(headed[0], way_out)
            plan = planner.plan_on(position, velocity, headed)
        else:
            self._near(headed[0], position)
            planner = planner.slower(self.share)
            plan = planner.plan(np.vstack([position, headed]))
        return Proposal(
            trajectory.continued(now, i, plan.ticks), trajectory.time(i), plan, planner
        )

    def _check(self, poses: Array) -> None:
        options = self.parameters.path
        if poses.ndim != 2 or poses.shape[1] != 3:
            raise InputError(f"poses of shape {poses.shape}, expected (k, 3)")
        if len(poses) == 0:
            raise InputError("an empty path; ~/cancel ends the one that is driven")
        if len(poses) > options.max_poses:
            raise InputError(f"{len(poses)} poses, at most {options.max_poses} are taken")
        plausible.demand(poses[:, :2], plausible.LENGTH, "positions")
        plausible.demand(poses[:, 2], plausible.ANGLE, "headings")

    def _near(self, first: Array, here: Array) -> None:
        distance = float(np.hypot(*(first - here)[:2]))
        if distance > self.parameters.path.start_distance:
            raise InputError(
                f"it begins {distance:.2f} m from the robot, at most "
                f"{self.parameters.path.start_distance:g} m are driven to its begin"
            )

    def _headed(self, poses: Array, heading: float) -> Array:
        options = self.parameters.path
        if options.heading == "along":
            kept = np.column_stack([poses[:, :2], np.full(len(poses), heading)])
            poses = polyline.along(kept, SPREAD * options.corner_tolerance)
        return polyline.unwrapped(poses, heading)

    def _go_on(self, trajectory: Trajectory, since: float, plan: Plan) -> None:
        self._trajectory, self._since, self.plan = trajectory, since, plan
        self.state = PathState.FOLLOWING

    def _next(self, trajectory: Trajectory, now: float) -> int:
        """The first tick that a decision can still change."""
        return max(trajectory.index(now) + LEAD, trajectory.index(self._since))

    def _place(self, trajectory: Trajectory, i: int) -> tuple[int, float, float]:
        """Section of the plan's route, u and u' at a tick."""
        ticks = trajectory.ticks
        i = min(i, len(ticks) - 1)
        return int(ticks.section[i]), float(ticks.u[i]), float(ticks.rate[i])

    def _motion(self, trajectory: Trajectory, i: int) -> tuple[Array, Array]:
        """Position and velocity (d,) at a tick, before the smoothing."""
        assert self.plan is not None
        section, u, rate = self._place(trajectory, i)
        curve, at = self.plan.route.curves[section], np.array([u])
        return curve.at(at)[0], curve.slope(at)[0] * rate

    # ---- requests -----------------------------------------------------------------------------

    def pause(self, now: float) -> None:
        """Come to rest on the path, as soon as the limits allow; ask again, and nothing changes.

        Raises:
            RefusedError: There is nothing to pause.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            self._stop(now, "pause")
            self.state = PathState.PAUSING

    def cancel(self, now: float) -> None:
        """Come to rest on the path, as soon as the limits allow, and forget it.

        Raises:
            RefusedError: There is nothing to cancel.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED, PathState.CANCELLING):
            self._stop(now, "cancel")
        self.state = PathState.CANCELLING

    def _stop(self, now: float, what: str) -> None:
        trajectory, plan = self._trajectory, self.plan
        if self.state is PathState.SLOWING:
            return  # it brakes already
        if self.state is not PathState.FOLLOWING or trajectory is None or plan is None:
            raise RefusedError(f"no path to {what}: {self.state.value}")
        i = self._next(trajectory, now)
        ticks = self._planner.stop(plan.route, *self._place(trajectory, i))
        self._go_on(trajectory.continued(now, i, ticks), trajectory.time(i), plan)

    def resume(self, now: float) -> None:
        """Go on from a pause, or from the braking for one.

        Raises:
            RefusedError: It does not pause, or the rest would take too long with the share of
                the limits that is left.
        """
        if self.state not in (PathState.PAUSING, PathState.PAUSED):
            raise RefusedError(f"no pause to end: {self.state.value}")
        if self.state is PathState.PAUSING and self._planner.share > self.share:
            self.state = PathState.SLOWING
            return
        try:
            self._drive_on(now)
        except InputError as error:
            raise RefusedError(f"cannot go on: {error}") from error

    def scale(self, share: float, now: float) -> None:
        """Use a share (0, 1] of all speeds and accelerations from the next rest on.

        A path that is driven faster is braked for it, and goes on by itself.
        """
        self.share = share
        if self.state is PathState.FOLLOWING and self._planner.share > share:
            self._stop(now, "slow down")
            self.state = PathState.SLOWING

    def _drive_on(self, now: float) -> None:
        trajectory, plan = self._trajectory, self.plan
        assert trajectory is not None and plan is not None
        if self.state is not PathState.PAUSING:
            self._planner = self._planner.slower(self.share)
        i = self._next(trajectory, now)
        ticks = self._planner.drive(plan.route, *self._place(trajectory, i))
        self._go_on(trajectory.continued(now, i, ticks), trajectory.time(i), plan)

    def abort(self) -> None:
        """Forget the path at once: somebody else drives, or nothing may move."""
        self._trajectory = None
        self.state = PathState.IDLE

    # ---- output -------------------------------------------------------------------------------

    def update(self, now: float) -> None:
        """Notice that it has come to rest.

        Raises:
            InputError: It was slowed down so much that the rest would take too long; it is
                paused.
        """
        if self._trajectory is None or now < self._trajectory.end:
            return
        if self.state is PathState.PAUSING:
            self.state = PathState.PAUSED
        if self.state is PathState.SLOWING:
            self.state = PathState.PAUSED
            self._drive_on(now)
        held = now - self._trajectory.end >= self.parameters.path.settle
        if held and self.state in (PathState.FOLLOWING, PathState.CANCELLING):
            self.abort()

    def window(self, now: float, horizon: float) -> Window | None:
        """The stream from now to a horizon [s] later, at least two ticks; None if it rests."""
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
        """x, x', x'' (k, d) at times (k,) [s], on the ticks or not, with a path."""
        assert self._trajectory is not None
        return self._trajectory.sample(times)

    def demand(self, times: Array) -> Demand | None:
        """What it asks of its limits at times (k,) [s]; None without a path."""
        if self._trajectory is None:
            return None
        _, v, a = self.sample(times)
        return Demand.of(self._planner.groups, v, a)

    def progress(self, now: float) -> float:
        """How much of the path is behind, 0 to 1; 0 without a path."""
        return 0.0 if self._trajectory is None else self._trajectory.progress(now)

    def remaining(self, now: float) -> float:
        """Time to the end of the motion that goes on [s]."""
        return 0.0 if self._trajectory is None else max(self._trajectory.end - now, 0.0)
