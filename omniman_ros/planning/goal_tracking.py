"""Tracking of the goal: state of the planner, route to the goal, arrival and blockage."""

import math
from dataclasses import replace

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.planning import passing
from omniman_ros.planning.cycle import AT_REST, MeasuredState, PlannerState
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import Goal, PlanTarget, StateGoal, TrajectoryGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.route.route_planner import CHECK_PERIOD, STATIC_SPEED, RoutePlanner
from omniman_ros.planning.safety import Surroundings
from omniman_ros.surroundings.ellipses import Ellipses

#: Growth of an obstacle's margin above which its velocity is not known yet [m/s]
NEW_OBSTACLE_GROWTH = 0.15
#: Time at rest before the goal is reached after which the robot counts as blocked [s]
BLOCKED_TIME = 2.0


class GoalTracker:
    """Tracks one goal at a time from its acceptance to its end."""

    def __init__(self) -> None:
        self.state = PlannerState.IDLE
        self.goal: Goal | None = None
        self._route_planner: RoutePlanner | None = None
        self._standing_since: float | None = None
        self._obstruction = -math.inf, ""

    @property
    def blocked_by(self) -> str:
        """What blocks the robot, and why there is no way; empty where it is not known."""
        if self.state is not PlannerState.BLOCKED:
            return ""
        planner = self.route_planner
        failure = "" if planner is None else planner.failure
        return failure or self._obstruction[1]

    @property
    def is_active(self) -> bool:
        """Whether there is a goal to drive to now."""
        return self.state in (PlannerState.DRIVING, PlannerState.BLOCKED)

    @property
    def route_planner(self) -> RoutePlanner | None:
        """Planner of the route to the goal; None without a goal, or if plans aim at the goal."""
        return None if self.goal is None or self.goal.moves else self._route_planner

    @property
    def is_waiting_for_route(self) -> bool:
        """Whether the first search of a route is not finished."""
        return self.route_planner is not None and self.route_planner.is_waiting

    @property
    def is_trapped(self) -> bool:
        """Whether the robot touches something, and no way leads out."""
        return self.route_planner is not None and self.route_planner.is_trapped

    def accept(self, goal: Goal, model: PlanningModel, limits: EffectiveLimits) -> None:
        """Track a goal from now on."""
        self.goal = goal
        self._route_planner = None
        if not isinstance(goal, TrajectoryGoal) and limits.parameters.weights.running != 0.0:
            self._route_planner = RoutePlanner(model, goal.targets(np.zeros(1))[0][0])
        self.resume()

    def pause(self) -> None:
        """Keep the goal, and do not drive to it until `resume`."""
        self.state = PlannerState.PAUSED

    def resume(self) -> None:
        """Drive to the goal."""
        self.state, self._standing_since = PlannerState.DRIVING, None
        self._obstruction = -math.inf, ""

    def discard(self) -> None:
        """Abandon the goal."""
        self.goal, self.state = None, PlannerState.IDLE

    def displace(self, change: PlanarPose) -> None:
        """Move the goal, as its frame has moved against odom.

        The change is the pose at which the odom frame would be if it moved along [m, m, rad].
        """
        if self.goal is not None:
            self.goal = self.goal.displaced(change)

    def target(self, start: Array, due: float, limits: EffectiveLimits) -> PlanTarget:
        """Return the goal of the plan that begins at a state (6,) at the time `due` [s]."""
        assert self.goal is not None
        planner = self.route_planner
        return self.goal if planner is None else planner.goal_from(start, due, limits)

    def schedule_passing(self, start: Array, due: float, limits: EffectiveLimits) -> None:
        """Set the time at which a pose is passed, if the goal is one and within reach."""
        if isinstance(self.goal, StateGoal):
            remaining = 0.0 if self.route_planner is None else self.route_planner.remaining
            self.goal = passing.scheduled(self.goal, start, due, remaining, limits)

    def update_route(
        self,
        now: float,
        pose: Array,
        environment: Environment,
        limits: EffectiveLimits,
        work: int,
    ) -> None:
        """Check the route, and search for another up to a work [expansions] if it is not clear.

        Args:
            pose: (3,) pose of the robot on the motion [m, m, rad].
        """
        planner = self.route_planner
        if planner is None or self.goal is None:
            return
        target = self.goal.targets(np.array([now]))[0][0]
        if not planner.follows(target):
            planner = self._route_planner = planner.restarted(target)
        known = environment.ellipses
        known = known.select(np.isfinite(known.centers.sum(axis=1)))
        if self.state is PlannerState.BLOCKED and now > self._obstruction[0] + CHECK_PERIOD:
            everything = replace(environment, ellipses=known)
            clearance = limits.parameters.safety.clearance
            self._obstruction = now, planner.obstruction(everything, clearance)
        # The robot waits for obstacles that move, but not for ever.
        if not (planner.was_stuck or planner.is_stuck(now)):
            speeds = np.hypot(known.velocities[:, 0], known.velocities[:, 1])
            known = known.select((speeds < STATIC_SPEED) & (known.growth < NEW_OBSTACLE_GROWTH))
        planner.update(now, pose, replace(environment, ellipses=known), limits, work)

    def error(self, measured: MeasuredState) -> tuple[float, float]:
        """Return distance [m] and angle [rad] to the goal; zeros without a goal."""
        if self.goal is None:
            return 0.0, 0.0
        poses, _ = self.goal.targets(np.array([measured.time]))
        error = poses[0] - measured.pose
        return math.hypot(error[0], error[1]), abs(se2.wrap(float(error[2])))

    def update_state(self, now: float, measured: MeasuredState, limits: EffectiveLimits) -> None:
        """Determine whether the goal is reached, or the robot is blocked."""
        if self.goal is None or not self.is_active:
            return
        if self._is_reached(self.goal, now, measured, limits):
            self.goal, self.state = None, PlannerState.ARRIVED
        elif not isinstance(self.goal, StateGoal):
            self._update_blocked(self.goal, now, measured)

    def _is_reached(
        self, goal: Goal, now: float, measured: MeasuredState, limits: EffectiveLimits
    ) -> bool:
        tolerance = limits.parameters.arrival
        if isinstance(goal, StateGoal):
            return passing.is_passed(goal, measured, tolerance)
        distance, angle = self.error(measured)
        near = distance <= tolerance.position and angle <= tolerance.heading
        return near and _is_standing(measured) and goal.until < now

    def _update_blocked(self, goal: Goal, now: float, measured: MeasuredState) -> None:
        """Set the state to BLOCKED if there is no route or the robot has been at rest too long."""
        if self.route_planner is not None and self.route_planner.failure:
            self.state = PlannerState.BLOCKED
        elif not _is_standing(measured) or self.is_waiting_for_route:
            self._standing_since, self.state = None, PlannerState.DRIVING
        elif self._standing_since is None:
            self._standing_since = now
        elif now - self._standing_since > BLOCKED_TIME and goal.until < now:
            self.state = PlannerState.BLOCKED


def require_reachable(goal: Goal, environment: Environment) -> None:
    """Check that the robot fits at the pose of a goal.

    A trajectory is not checked, as the obstacles at its time are not known.

    Raises:
        InputError: The robot would not be within the workspace, or touch an obstacle at rest.
    """
    if isinstance(goal, TrajectoryGoal):
        return
    known = environment.ellipses
    poses, _ = goal.targets(np.array([known.time]))
    rest = HermiteTrajectory.rest(known.time, poses[0], 1)
    # An obstacle that was just seen may move: its velocity is not known yet.
    is_tracked = known.growth < NEW_OBSTACLE_GROWTH
    standing = known.select(is_tracked & (np.hypot(*known.velocities.T) < AT_REST))
    x, y, theta = poses[0]
    pose_text = f"({x:.2f} m, {y:.2f} m, {theta:.2f} rad)"
    free = Surroundings(
        environment.footprint, Ellipses.none(known.time), environment.workspace, 0.0
    )
    if free.outside(rest.poses[:1]) > 0.0:
        raise InputError(f"the robot at the goal {pose_text} is not within the workspace")
    occupied = replace(free, ellipses=standing, walls=environment.walls)
    # Far inside an occupied area there is no boundary that the robot could touch.
    grid = environment.grid
    inside = grid is not None and grid.occupied_at(poses[:, :2]).any()
    if inside or occupied.overlap(rest.poses[:1]) > 0.0:
        what = replace(environment, ellipses=standing).nearest(poses[0])
        raise InputError(
            f"an obstacle stands where the robot would be at the goal {pose_text}: {what}"
        )


def _is_standing(measured: MeasuredState) -> bool:
    return float(np.abs(measured.twist).max()) < AT_REST
