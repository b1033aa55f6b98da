"""The planner without ROS: from goal and obstacles to a motion that was checked up to its end.

A cycle consists of two calls: `propose` plans from the predicted state at which the plan is due,
and `take` selects the plan, the rest of the last motion, or braking. The robot follows `motion`
until the next cycle. Time is always an argument.
"""

import math
from dataclasses import replace

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.planning.cycle import CycleReport, MeasuredState, PlannerState
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goal_tracking import GoalTracker, require_reachable
from omniman_ros.planning.goals import Goal, StateGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.motion_selection import MotionSelector, PlanProposal
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.mpc.solver import Solution
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.escape_path import EscapePath
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.plan_optimizer import PlanOptimizer, PlanRequest, SolverPool
from omniman_ros.planning.route.route_planner import (
    SEARCH_WORK,
    STATIC_SPEED,
    RoutePlanner,
    RouteSource,
)
from omniman_ros.planning.safety import Surroundings
from omniman_ros.planning.velocity_samples import VelocitySamples
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap

CROWD = 6  #: Number of things that move nearby from which on the planner samples velocities
#: The same for a robot that waits for a way: its optimum, to stay, makes way in one direction only
CROWD_AT_REST = 1
NEAR = 4.0  #: Distance below which they count [m]
LOOKAHEAD = 3.0  #: Part of a bent route at whose end samples aim [s]


class Planner:
    """Plans the motion of the robot to its goal among obstacles, MPC 2021; brakes without a plan.

    Robot and horizon are fixed as long as the robot moves.

    Attributes:
        anchored: Whether plans begin on the last motion, whose follower corrects deviations;
            otherwise they begin at the measured pose of the robot.
        footprint: Outline of the robot, by default that of its platform at all heights; it may be
            replaced between two cycles.
    """

    def __init__(
        self,
        parameters: PlannerParameters,
        anchored: bool = True,
        solvers: SolverPool | None = None,
    ) -> None:
        self.limits = EffectiveLimits(parameters)
        self.model = PlanningModel.of(parameters.robot)
        self.anchored = anchored
        self.footprint = Footprint(Rectangles.around(parameters.robot.body))
        self.grid: GridMap | None = None
        self._walls = Walls.none()
        self._tracker = GoalTracker()
        self._optimizer = PlanOptimizer(self.model, self.limits, solvers)
        self._selector = MotionSelector(self.model, self.limits)
        self._samples = VelocitySamples(self.model, self.limits)

    # ---- state and results ------------------------------------------------------------------

    @property
    def parameters(self) -> PlannerParameters:
        """Parameters of the planner."""
        return self.limits.parameters

    @property
    def solvers(self) -> SolverPool:
        """Solvers of the present model."""
        return self._optimizer.solvers

    @property
    def state(self) -> PlannerState:
        """State of the planner."""
        return self._tracker.state

    @property
    def blocked_by(self) -> str:
        """What blocks the robot, and why there is no way; empty where it is not known."""
        return self._tracker.blocked_by

    @property
    def active(self) -> bool:
        """Whether there is a goal to drive to now."""
        return self._tracker.is_active

    @property
    def goal(self) -> Goal | None:
        """Goal of the robot, or None."""
        return self._tracker.goal

    @property
    def route_planner(self) -> RoutePlanner | None:
        """Planner of the route to the goal; None without a goal, or if plans aim at the goal."""
        return self._tracker.route_planner

    @property
    def motion(self) -> HermiteTrajectory:
        """Motion to follow: it ends at rest and was checked up to its end."""
        return self._selector.motion

    @property
    def preview(self) -> HermiteTrajectory:
        """Motion to send; see `MotionSelector.preview`."""
        return self._selector.preview

    @property
    def report(self) -> CycleReport:
        """Result of the last cycle."""
        return self._selector.report

    def error(self, measured: MeasuredState) -> tuple[float, float]:
        """Return distance [m] and angle [rad] to the goal; zeros without a goal."""
        return self._tracker.error(measured)

    def voltages(self, now: float) -> Array | None:
        """Return the motor voltages (n,) [V] of the motion at a time [s]; None if not planned."""
        return motor_voltages(self.model, self.motion, now)

    def energy(self) -> float:
        """Return the electric energy that the whole motion is expected to consume [J]."""
        return expected_energy(self.model, self.motion)

    # ---- settings ---------------------------------------------------------------------------

    def configure(self, parameters: PlannerParameters) -> None:
        """Use other weights, limits and clearances from the next cycle on."""
        if parameters.robot != self.parameters.robot:
            self.model = PlanningModel.of(parameters.robot)
            self.footprint = Footprint(Rectangles.around(parameters.robot.body))
            self._samples = VelocitySamples(self.model, self.limits)
        self._apply(replace(self.limits, parameters=parameters))

    def set_limit_scale(self, limit_scale: float, braking_scale: float = 1.0) -> None:
        """Scale velocity and acceleration limits, and those of the deceleration, from now on."""
        self._apply(replace(self.limits, limit_scale=limit_scale, braking_scale=braking_scale))

    def _apply(self, limits: EffectiveLimits) -> None:
        self.limits = limits
        self._optimizer.configure(self.model, limits)
        self._selector.model, self._selector.limits = self.model, limits
        self._samples.limits = limits

    def set_map(self, grid: GridMap | None) -> None:
        """Use a map, whose occupied cells are static obstacles; None removes the map."""
        self.grid = grid
        self._walls = Walls.none() if grid is None else Walls(*grid.obstacles())

    # ---- goals ------------------------------------------------------------------------------

    def drive(self, goal: Goal, measured: MeasuredState, obstacles: Ellipses) -> None:
        """Drive to a goal; a moving robot changes its goal without stopping.

        Raises:
            InputError: The goal is in an obstacle at rest, or not within the workspace.
        """
        if self.state in (PlannerState.IDLE, PlannerState.ARRIVED):
            heading, time = float(self._selector.continuous_pose(measured)[2]), measured.time
        else:
            heading, time = float(self.motion.poses[-1, 2]), self.motion.end
        goal = goal.near(heading, time)
        require_reachable(goal, self._environment(obstacles))
        if not self.active:
            self._begin_at_rest(measured)
        self._tracker.accept(goal, self.model, self.limits)
        self.update_route(measured.time, obstacles, work=0)

    def displace_goal(self, change: PlanarPose, now: float, obstacles: Ellipses) -> None:
        """Move the goal by the displacement of its frame in odom; the motion under way goes on.

        Args:
            change: Displacement in odom [m, m, rad]: the pose at which the odom frame would be if
                it moved along.
        """
        self._tracker.displace(change)
        self.update_route(now, obstacles, work=0)

    def _begin_at_rest(self, measured: MeasuredState) -> None:
        """Begin a motion at the measured state if the last motion is over."""
        if self.motion.end <= measured.time:
            self._selector.begin(measured)
            self._optimizer.discard_warm_start()

    def brake(self, now: float) -> None:
        """Brake along the motion at once; the goal stays."""
        self._selector.brake(now)
        self._optimizer.discard_warm_start()

    def pause(self, now: float) -> None:
        """Brake, and wait for `resume`; without a goal this does nothing."""
        if self.active:
            self.brake(now)
            self._tracker.pause()

    def resume(self, measured: MeasuredState) -> bool:
        """Continue to the goal after a pause, and return whether the robot was paused."""
        if self.goal is None or self.state is not PlannerState.PAUSED:
            return False
        self._begin_at_rest(measured)
        self._tracker.resume()
        return True

    def cancel(self, now: float) -> None:
        """Brake, and discard the goal."""
        self.brake(now)
        self._tracker.discard()

    def abort(self, now: float, measured: MeasuredState | None) -> None:
        """Discard goal and motion: the robot no longer follows this planner."""
        self._selector.discard(now, measured)
        self._optimizer.discard_warm_start()
        self._tracker.discard()

    # ---- a cycle ----------------------------------------------------------------------------

    def cycle(self, now: float, measured: MeasuredState, obstacles: Ellipses) -> HermiteTrajectory:
        """Run one planning cycle at a time [s], and return the motion to follow until the next.

        It ends at rest and was checked up to its end. Where planning takes time on the clock that
        `now` is of, call :meth:`propose`, :meth:`take` and :meth:`update_route` instead, each
        with its own time.
        """
        if self.active:
            self.take(self.propose(now, measured, obstacles), now, measured, obstacles)
            self.update_route(now, obstacles)
        else:
            self.coast(now, measured, obstacles)
        return self.motion

    def propose(self, now: float, measured: MeasuredState, obstacles: Ellipses) -> PlanProposal:
        """Plan from the predicted state of the robot when the plan is due.

        A fault of the solver raises no exception, but results in an empty proposal.
        """
        due = now + self.parameters.safety.deadline
        if self.goal is None:
            return PlanProposal(due, fault="no goal")
        if self._tracker.is_waiting_for_route or self._tracker.is_trapped:
            return PlanProposal(due)
        start = self._selector.state_at(due, measured, self.anchored)
        self._tracker.schedule_passing(start, due, self.limits)
        try:
            solutions = self._solve(start, due, obstacles)
        except (SolverError, RuntimeError, ValueError, ArithmeticError) as error:
            self._optimizer.note_failure()
            return PlanProposal(due, fault=f"solver: {error}")
        self._optimizer.note_success()
        return PlanProposal(due, solutions)

    def _solve(self, start: Array, due: float, obstacles: Ellipses) -> tuple[Solution, ...]:
        """Optimise the plan that begins at a state (6,) at the time `due` [s]."""
        goal = self._tracker.target(start, due, self.limits)
        route = self.route_planner
        is_free = route is not None and route.escape_path is None  # that is left straight
        waits = route is not None and route.source is RouteSource.REST
        crowd = CROWD_AT_REST if waits else CROWD
        if is_free and self._moving_near(start, obstacles) >= crowd:
            return self._sampled(start, due, obstacles)
        clearance = None if route is None else route.clearance(self.limits)
        walls = self._walls_to_keep_from()
        request = PlanRequest(start, due, goal, self.footprint, obstacles, walls, clearance)
        return self._optimizer.solve(request, evade=self._selector.is_troubled)

    def _moving_near(self, pose: Array, obstacles: Ellipses) -> int:
        """Return how many things move near a pose (3,), or a state that begins with one."""
        offset = obstacles.centers - pose[:2]
        is_near = np.hypot(*offset.T) - obstacles.semi_axes.max(axis=1, initial=0.0) < NEAR
        moves = np.hypot(*obstacles.velocities.T) > STATIC_SPEED
        return int((is_near & moves).sum())

    def _sampled(self, start: Array, due: float, obstacles: Ellipses) -> tuple[Solution, ...]:
        """Return the best motions among things that move."""
        assert self.route_planner is not None
        moves = np.hypot(*obstacles.velocities.T) > STATIC_SPEED
        walls = self._walls_to_keep_from().near(start, NEAR).ellipses(obstacles.time)
        others = obstacles.select(~moves).joined(walls)
        target = self.route_planner.ahead(LOOKAHEAD)
        is_goal = self.route_planner.source is not RouteSource.REST
        return self._samples.best(
            start, due, target, obstacles.select(moves), others, is_goal=is_goal
        )

    def take(
        self, proposal: PlanProposal, now: float, measured: MeasuredState, obstacles: Ellipses
    ) -> None:
        """Follow the plan if it is in time and clear, else the last motion, or brake."""
        p = self.parameters
        in_crowd = self._moving_near(measured.pose, obstacles) >= CROWD
        surroundings = Surroundings(
            self.footprint,
            obstacles,
            p.workspace.bounds,
            p.safety.least_clearance + self._selector.deviation(measured, self.footprint.radius),
            -math.inf if in_crowd else now + p.horizon.duration,
            self._walls_to_keep_from(),
            self._escape_path,
        )
        chosen = self._selector.select(
            proposal, now, surroundings, active=self.active, in_crowd=in_crowd
        )
        if chosen is not None:
            if np.isfinite(chosen.currents).all():
                self._optimizer.keep(proposal.due, chosen)
            else:
                self._optimizer.discard_warm_start()
        goal = self.goal
        self._tracker.update_state(now, measured, self.limits)
        if goal is not None and self.goal is None:  # the goal has just been reached
            self._optimizer.discard_warm_start()
            if isinstance(goal, StateGoal):  # the goal was passed at a velocity
                self.brake(now)

    def coast(self, now: float, measured: MeasuredState, obstacles: Ellipses) -> None:
        """Do a cycle without a plan: the motion continues to its end, and is still checked.

        The report of the last plan is kept.
        """
        report = self.report
        self.take(PlanProposal(now), now, measured, obstacles)
        self._selector.report = report

    def update_route(self, now: float, obstacles: Ellipses, work: int = SEARCH_WORK) -> None:
        """Check the route, and do a slice of the search for another one at the end of a cycle."""
        if self.route_planner is not None:
            pose, _ = self.motion.sample(now)
            if self._moving_near(pose, obstacles) >= CROWD:
                speeds = np.hypot(*obstacles.velocities.T)
                obstacles = obstacles.select(speeds < STATIC_SPEED)
            environment = self._environment(obstacles)
            self._tracker.update_route(now, pose, environment, self.limits, work)

    @property
    def _escape_path(self) -> EscapePath | None:
        """Way on which the robot leaves what it touches, or None."""
        return None if self.route_planner is None else self.route_planner.escape_path

    def _walls_to_keep_from(self) -> Walls:
        """Return the walls without those that the way out leads along: that is checked instead."""
        way, margin = self._escape_path, self.parameters.safety.clearance
        return self._walls if way is None else way.without(self._walls, self.footprint, margin)

    def _environment(self, obstacles: Ellipses) -> Environment:
        bounds = self.parameters.workspace.bounds
        return Environment(self.footprint, obstacles, bounds, self.grid, self._walls)


def motor_voltages(model: PlanningModel, motion: HermiteTrajectory, time: float) -> Array | None:
    """Return the motor voltages (n,) [V] of a motion at a time [s]; None if none are planned."""
    currents = motion.currents_at(time)
    if not np.isfinite(currents).all():
        return None
    pose, velocity = motion.sample(time)
    twist = se2.to_robot(float(pose[2]), velocity)
    volts = model.voltages(currents + model.dry_current(twist), twist)
    limit = model.max_voltage
    clipped: Array = np.clip(volts, -limit, limit)
    return clipped


def expected_energy(model: PlanningModel, motion: HermiteTrajectory) -> float:
    """Return the electric energy that a whole motion is expected to consume [J].

    Spans without planned currents, which are those of a braking, count as zero.
    """
    spans = np.diff(motion.times)
    poses, velocities = motion.at(0.5 * (motion.times[:-1] + motion.times[1:]))
    twists = velocities.copy()
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    twists[:, 0] = cos * velocities[:, 0] + sin * velocities[:, 1]
    twists[:, 1] = cos * velocities[:, 1] - sin * velocities[:, 0]
    currents = np.nan_to_num(motion.currents)
    power = (model.voltages(currents, twists) * currents).sum(axis=1)
    return float((power * spans).sum())
