"""The planner without ROS: goal and obstacles in, a motion that was checked to its end out.

One cycle is two calls: `propose` plans from where the robot will be when the answer is due, and
`take` uses the answer, or the rest of the last plan, or brakes. `motion` is followed until the
next cycle. Time is an argument everywhere.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.planning import passing
from omniman_ros.planning.cycle import Measured, PlannerState, Report
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.floor import Floor
from omniman_ros.planning.goals import Goal, StateGoal, TrajectoryGoal
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.guidance import STANDING, WORK, Guide
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.problem import Problem
from omniman_ros.planning.safety import Surroundings
from omniman_ros.planning.separation import box_gap
from omniman_ros.planning.solver import Answer, Solver, SolverError
from omniman_ros.planning.transcription import Transcription
from omniman_ros.planning.walls import REACH, Walls

Array = NDArray[np.float64]

WALL_SLOTS = 8
"""Further obstacles in the optimisation where there are walls."""
COLD_ITERATIONS = 5
"""Iterations on a new problem; then one a cycle."""
DIRECTIONS, MINDED = 16, 24
"""Of evasions; so many obstacles, the nearest, say which is the most promising."""
EVASION, EVASION_ITERATIONS = 0.625 * math.pi, (4, 2)
"""Angle between two directions that are tried [rad]; iterations on each, and where
there are walls, which make them dearer."""
ASTRAY = (0.15, 0.2)
"""Distance [m] and angle [rad] from the motion at which plans begin where the robot is."""
AT_REST = 0.02
"""Speed below which the robot stands [m/s, rad/s]."""
LEAST_SHARE = 0.01
"""Of the limits: with none at all there would be nothing to plan with."""
NEWCOMER = 0.15
"""Growth of an obstacle's margin above which it is not known to stand [m/s]."""
BLOCKED_AFTER = 2.0
"""The robot is blocked when it has stood for so long on its way to a goal [s]."""
WORTH = 0.1
"""By how much later contact must come for another motion to be better than braking now [s]."""
WIDER = 0.005
"""By how much wider a gap must be, where contact comes at the same time [m]."""
SENT = 0.4
"""How much of a motion is sent ahead before its braking [s]."""
HELD = 0.5
"""How much of the past of a motion is kept [s]."""


@dataclass(frozen=True)
class Proposal:
    """Answers that may be used until they are due.

    Attributes:
        due: When their plans begin [s]; later than that they are late.
        answers: The solver's: the last plan improved, and while that is no good an evasion.
        fault: Why there is none, or empty.
    """

    due: float
    answers: tuple[Answer, ...] = ()
    fault: str = ""


class Planner:
    """Weaves the robot to its goal, MPC 2021, with a safe answer to everything.

    Attributes:
        parameters: What it is set by; robot and horizon are fixed.
        state: What it does.
        goal: Where to, or None.
        motion: What is followed: it ends at rest and was checked to its end.
        report: What came of the last cycle.
        anchored: Whether plans begin on the last motion (its follower corrects what is off), or
            always where the robot is measured.
    """

    def __init__(self, parameters: PlannerParameters, anchored: bool = True) -> None:
        self.model = PlanningModel.of(parameters.robot)
        horizon = parameters.horizon
        steps, step = horizon.steps, horizon.step
        # Most of the time there is no obstacle, and nothing to pay for the slots of any.
        slots = sorted({0, horizon.slots, horizon.slots + WALL_SLOTS})
        self._solvers = {
            count: Solver(Transcription(self.model, steps, step, count)) for count in slots
        }
        self._problem = Problem(self.model, parameters)
        self.anchored = anchored
        self.state = PlannerState.IDLE
        self.goal: Goal | None = None
        self.motion = Motion.rest(-HELD, np.zeros(3), self.model.wheel_count)  # long ago
        self.report = Report()
        self._short: tuple[Motion, Motion] | None = None
        self._guess: tuple[float, Array] | None = None
        self._faulty = False
        self._guide: Guide | None = None
        self.grid: GridMap | None = None
        self._walls = Walls.none()
        self._turn = 0
        self._stood_since: float | None = None

    # ---- settings ---------------------------------------------------------------------------

    @property
    def parameters(self) -> PlannerParameters:
        """What it is set by."""
        return self._problem.parameters

    def configure(self, parameters: PlannerParameters) -> None:
        """Take over weights, limits, clearance; they count from the next cycle."""
        if parameters.robot != self.parameters.robot:
            self.model = PlanningModel.of(parameters.robot)
            horizon = parameters.horizon
            self._solvers = {
                count: Solver(Transcription(self.model, horizon.steps, horizon.step, count))
                for count in self._solvers
            }
            share = self._problem.share
            self._problem = Problem(self.model, parameters)
            self._problem.share = share
            self._guess = None
        self._problem.parameters = parameters

    def chart(self, grid: GridMap | None) -> None:
        """Take a map over: what is occupied on it stands. None: there is none any more."""
        self.grid = grid
        self._walls = Walls.none() if grid is None else Walls(*grid.obstacles())

    def scale(self, share: float) -> None:
        """Keep to a share of the velocity and acceleration limits from now on."""
        self._problem.share = max(share, LEAST_SHARE)

    @property
    def share(self) -> float:
        """Share of the limits that is kept to."""
        return self._problem.share

    # ---- goals ------------------------------------------------------------------------------

    def drive(self, goal: Goal, measured: Measured, around: Ellipses) -> None:
        """Go for a goal; a robot that drives goes over to it without stopping.

        Raises:
            InputError: It lies in an obstacle that stands, or not in the workspace.
        """
        goal = goal.near(self._heading(measured))
        self._refuse_unreachable(goal, around)
        if not self.active and self.motion.end <= measured.time:
            self._begin(measured)
        self.goal, self.state, self._stood_since = goal, PlannerState.DRIVING, None
        self._guide = self._guided(goal)
        self.look(measured.time, around, work=0)

    def _guided(self, goal: Goal) -> Guide | None:
        if isinstance(goal, TrajectoryGoal) or self.parameters.weights.running == 0.0:
            return None
        return Guide(self.model, goal.targets(np.zeros(1))[0][0])

    def _heading(self, measured: Measured) -> float:
        """Heading on the branch that the motion is on, if one is followed."""
        if self.state in (PlannerState.IDLE, PlannerState.ARRIVED):
            return float(self._unwound(measured)[2])
        return float(self.motion.poses[-1, 2])

    def _unwound(self, measured: Measured) -> Array:
        """The measured pose (3,), its heading on the branch of the motion: odometry may wrap."""
        heading = float(self.motion.sample(measured.time)[0][2])
        turned = se2.wrap(float(measured.pose[2]) - heading)
        return np.append(measured.pose[:2], heading + turned)

    def _refuse_unreachable(self, goal: Goal, around: Ellipses) -> None:
        if isinstance(goal, TrajectoryGoal):  # it moves: who knows what will be there then
            return
        poses, _ = goal.targets(np.array([around.time]))
        place = Motion.rest(around.time, poses[0], 1)
        # One that was just seen may move: nothing is known of its velocity yet.
        known = around.growth < NEWCOMER
        standing = around.select(known & (np.hypot(*around.velocities.T) < AT_REST))
        x, y, theta = poses[0]
        where = f"({x:.2f} m, {y:.2f} m, {theta:.2f} rad)"
        bounds = self.parameters.workspace.bounds
        empty = Surroundings(self.model.half, Ellipses.none(around.time), bounds, 0.0)
        if empty.outside(place.poses[:1]) > 0.0:
            raise InputError(f"the robot at the goal {where} is not within the workspace")
        standing_in = replace(empty, ellipses=standing, walls=self._walls).overlap(place.poses[:1])
        # Far within what is occupied there is no boundary that the robot could touch.
        within = self.grid is not None and self.grid.occupied_at(poses[:, :2]).any()
        if within or standing_in > 0.0:
            raise InputError(f"an obstacle stands where the robot would be at the goal {where}")

    def brake(self, now: float) -> None:
        """Brake along the motion at once; the goal stays."""
        if self.motion.end > now:
            self.motion = self._braked(now)
        self._guess = None

    def pause(self, now: float) -> None:
        """Brake, and wait for `resume`; without a goal nothing happens."""
        if self.active:
            self.brake(now)
            self.state = PlannerState.PAUSED

    def resume(self, measured: Measured) -> bool:
        """Go on to the goal of before the pause; whether there is one."""
        if self.goal is None or self.state is not PlannerState.PAUSED:
            return False
        if self.motion.end <= measured.time:
            self._begin(measured)
        self.state, self._stood_since = PlannerState.DRIVING, None
        return True

    def cancel(self, now: float) -> None:
        """Brake, and forget the goal."""
        self.brake(now)
        self.goal, self.state = None, PlannerState.IDLE

    def _begin(self, measured: Measured) -> None:
        """Begin where the robot is, and as fast as it is."""
        velocity = se2.to_world(float(measured.pose[2]), measured.twist)
        slow = float(np.abs(velocity).max()) < AT_REST
        moving = Motion.coasting(
            measured.time, self._unwound(measured), velocity * (not slow), self.model.wheel_count
        )
        self.motion, self._guess = moving.braked(measured.time, self._deceleration), None

    def abort(self, now: float, measured: Measured | None) -> None:
        """Forget goal and motion: somebody else moves the robot."""
        pose = self.motion.poses[-1] if measured is None else measured.pose
        self.motion = Motion.rest(now, pose, self.model.wheel_count)
        self.goal, self.state, self._guess = None, PlannerState.IDLE, None

    @property
    def active(self) -> bool:
        """Whether there is a goal to drive to."""
        return self.state in (PlannerState.DRIVING, PlannerState.BLOCKED)

    # ---- a cycle ----------------------------------------------------------------------------

    def propose(self, now: float, measured: Measured, around: Ellipses) -> Proposal:
        """Plan from where the robot will be when the answer is due.

        Solver faults are no exception: they make an empty proposal, and the next begins anew.
        """
        due = now + self.parameters.safety.deadline
        if self.goal is None:
            return Proposal(due, fault="no goal")
        if self.guide is not None and self.guide.waiting:
            return Proposal(due)
        start = self._start(due, measured)
        if isinstance(self.goal, StateGoal):
            left = 0.0 if self.guide is None else self.guide.left
            self.goal = passing.planned(self.goal, start, due, left, self.parameters, self.share)
        try:
            answers = self._solve(start, due, around)
        except (SolverError, RuntimeError, ValueError, ArithmeticError) as error:
            # Once the last good plan may serve again; then nothing of the past does.
            self._guess, self._faulty = (None if self._faulty else self._guess), True
            return Proposal(due, fault=f"solver: {error}")
        self._faulty = False
        return Proposal(due, answers)

    def _start(self, due: float, measured: Measured) -> Array:
        """State (6,) when the answer is due."""
        followed, velocity = self.motion.sample(due)
        then, _ = self.motion.sample(measured.time)
        error = measured.pose - then
        error[2] = se2.wrap(error[2])
        astray = math.hypot(error[0], error[1]) > ASTRAY[0] or abs(error[2]) > ASTRAY[1]
        if astray or not self.anchored:
            followed = followed + error
            lag = velocity - self.motion.sample(measured.time)[1]
            velocity = se2.to_world(float(measured.pose[2]), measured.twist) + lag
        twist = se2.to_robot(float(followed[2]), velocity)
        return np.concatenate([followed, twist])

    @property
    def guide(self) -> Guide | None:
        """What leads to the goal; None where the goal itself is aimed at, or there is none."""
        return None if self.goal is None or self.goal.moves else self._guide

    def look(self, now: float, around: Ellipses, work: int = WORK) -> None:
        """Look after the route: a slice of work for when a cycle is done.

        Args:
            now: Time [s].
            around: Obstacles.
            work: How much a search may do, in expansions.
        """
        guide = self.guide
        if guide is None:
            return
        known = around.select(np.isfinite(around.centers.sum(axis=1)))
        if not (guide.hindered or guide.stuck(now)):  # what moves is waited for, not for ever
            speeds = np.hypot(known.velocities[:, 0], known.velocities[:, 1])
            known = known.select((speeds < STANDING) & (known.growth < NEWCOMER))
        p = self.parameters
        floor = Floor(known, p.workspace.bounds, self.grid, self._walls)
        pose, _ = self.motion.sample(now)
        guide.look(now, pose, floor, p, self.share, work)

    def _solve(self, start: Array, due: float, around: Ellipses) -> tuple[Answer, ...]:
        """The last plan improved; where the last cycle was in trouble, an evasion, too."""
        walls = self._walls_near(start)
        solver = self._solver(around, walls)
        around = around.joined(walls.ellipses(around.time)) if len(walls) else around
        iterations = 1
        if self._guess is None:
            guess, iterations = solver.cold(), COLD_ITERATIONS
        else:
            since, currents = self._guess
            guess = solver.shifted(currents, due - since)
        assert self.goal is not None
        guide, p = self.guide, self.parameters
        goal = self.goal if guide is None else guide.along(start, due, p, self.share)
        answer = self._improved(solver, start, due, guess, around, goal, iterations)
        self._guess = due, answer.currents
        if not len(around) or not self._troubled:
            return (answer,)
        self._turn += 1
        guess = self._evasion(solver, start, due, around)
        tries = EVASION_ITERATIONS[len(walls) > 0]
        try:
            return answer, self._improved(solver, start, due, guess, around, goal, tries)
        except SolverError:
            return (answer,)

    def _evasion(self, solver: Solver, start: Array, due: float, around: Ellipses) -> Array:
        """Currents (N, n) to begin an evasion from: the most promising one and another in turn."""
        if self._turn % 2:
            return self._problem.evasion(start, self._turn * EVASION)
        distances = np.hypot(*(around.centers - start[:2]).T) - around.semi_axes.max(axis=1)
        near = around.select(np.argsort(distances)[:MINDED])
        guesses = [self._problem.evasion(start, k * EVASION) for k in range(DIRECTIONS)]
        ways = [solver.states(start, guess)[1:, :3] for guess in guesses]
        times: Array = due + self.parameters.horizon.step * np.arange(1.0, len(ways[0]) + 1.0)
        centers, axes = (
            np.tile(values, (DIRECTIONS, 1, 1))
            for values in (near.centers_at(times), near.axes_at(times))
        )
        gaps = box_gap(np.concatenate(ways), self.model.half, centers, axes, near.angles)
        gaps = gaps.min(axis=1).reshape(DIRECTIONS, -1)
        touched = gaps <= 0.0
        until = np.where(touched.any(axis=1), touched.argmax(axis=1), gaps.shape[1])
        return guesses[int(np.lexsort((gaps.min(axis=1), until))[-1])]

    def _solver(self, around: Ellipses, walls: Walls) -> Solver:
        """The one with room for all that there is: what is not there costs time, too."""
        slots = self.parameters.horizon.slots if len(around) else 0
        return self._solvers[max(self._solvers) if len(walls) else slots]

    def _walls_near(self, place: Array) -> Walls:
        """Walls that a plan from a place can come to: what the optimisation has to know."""
        if not len(self._walls):
            return self._walls
        p = self.parameters
        reach = p.limits.linear_velocity * p.horizon.duration
        return self._walls.near(place, reach + math.hypot(*self.model.half) + REACH)

    def _improved(
        self, solver: Solver, start: Array, due: float, guess: Array, around: Ellipses,
        goal: Goal, n: int,
    ) -> Answer:  # fmt: skip
        step = self.parameters.horizon.step
        along = Motion.of_states(due, step, solver.states(start, guess), guess)
        slots = solver.transcription.slots
        clearance = None if self.guide is None else self.guide.clearance(self.parameters)
        stage = self._problem.stage(start, along, goal, around, slots, clearance)
        return solver.solve(start, guess, stage, n)

    @property
    def _troubled(self) -> bool:
        """Whether the last plan was not good."""
        report = self.report
        tight = report.slack > self.parameters.safety.slack
        return not (report.used and report.clear) or tight

    def coast(self, now: float, measured: Measured, around: Ellipses) -> None:
        """A cycle without a plan: the motion comes to its end, what is in its way still counts.

        The report of the last plan stays.
        """
        report = self.report
        self.take(Proposal(now), now, measured, around)
        self.report = report

    def take(self, proposal: Proposal, now: float, measured: Measured, around: Ellipses) -> None:
        """Use the answer if it is in time and clear, else the last plan's rest, else brake."""
        surroundings = self._surroundings(around, self._off(measured), now)
        report = Report(late=now - proposal.due, why=proposal.fault)
        if proposal.answers:
            first = proposal.answers[0]
            report = replace(report, slack=float(first.slack.max()), cost=first.cost)
        self.report = replace(report, **self._choose(proposal, report, now, surroundings))
        self._shorten(now, surroundings)
        self._judge(now, measured)

    @property
    def preview(self) -> Motion:
        """What to send of the motion: its begin, and braking, where that is clear, too.

        Who sends it may die: then nobody looks out any more, and the robot should not go on to
        the end of a plan.
        """
        if self._short is not None and self._short[0] is self.motion:
            return self._short[1]
        return self.motion

    def _shorten(self, now: float, around: Surroundings) -> None:
        self._short, soon = None, now + SENT
        if self.motion.end > soon:
            begins = max(self.motion.start, now - HELD)
            short = self.motion.between(begins, self.motion.end).braked(soon, self._deceleration)
            if around.contact(short, now) == math.inf:
                self._short = self.motion, short

    def _choose(
        self, proposal: Proposal, report: Report, now: float, around: Surroundings
    ) -> dict[str, Any]:
        """Set the motion to the best there is; what of it is to be reported.

        As much of the plan as is clear with its braking, the last motion, as much of that. Where
        nothing is clear for as long as is looked ahead, what is clear longest: the obstacles may
        yet turn away, and an evasion may still be found.
        """
        why, plans = "", []
        if not self.active:
            why = "there is no goal any more"
        elif proposal.answers and report.late > 0.0:
            why = f"the answer came {1e3 * report.late:.0f} ms late"
        elif proposal.answers:
            why = "the plan is not clear of contact"
            plans = [self._joined(proposal, answer, now) for answer in proposal.answers]
        earliest = proposal.due + 0.5 * self.parameters.horizon.step
        for answer, plan in zip(proposal.answers, plans, strict=False):
            clear = around.longest(plan, now, earliest, self._deceleration)
            if clear is not None:
                self.motion, self._guess = clear, (proposal.due, answer.currents)
                return {"used": True}
        why = proposal.fault or why
        if around.contact(self.motion, now) == math.inf:
            return {"why": why}
        begins = max(self.motion.start, now - HELD)
        rest = self.motion.between(begins, max(self.motion.end, now + 1e-3))
        clear = around.longest(rest, now, now, self._deceleration)
        if clear is not None:
            self.motion = clear
            return {"why": why, "braking": True}
        self.motion = self._braked(now)
        contact, gap = around.threat(self.motion, now)
        told: dict[str, Any] = {"why": why, "braking": True}
        # Who flees goes on fleeing: a little of each, in turn, gets nowhere.
        flees = not self.report.clear and not self.report.braking
        more = -WORTH if flees else WORTH
        for k, other in enumerate([*plans, rest]):
            whole = other.braked(other.end, self._deceleration)
            later, wider = around.threat(whole, now)
            if later > contact + more or (later >= contact and wider > gap + WIDER):
                self.motion, contact, gap, told, more = whole, later, wider, {"why": why}, 0.0
                if k < len(plans):
                    self._guess = proposal.due, proposal.answers[k].currents
                    told = {"used": True}
        return {**told, "contact": contact - now, "clear": False}

    def voltages(self, now: float) -> Array | None:
        """Motor voltages (n,) [V] of the motion at a time [s]; None where it has none planned."""
        currents = self.motion.currents_at(now)
        if not np.isfinite(currents).all():
            return None
        pose, velocity = self.motion.sample(now)
        twist = se2.to_robot(float(pose[2]), velocity)
        volts = self.model.voltages(currents + self.model.dry_current(twist), twist)
        limit = self.model.max_voltage
        clipped: Array = np.clip(volts, -limit, limit)
        return clipped

    def energy(self) -> float:
        """Electric energy that the motion is expected to take from its begin to its end [J]."""
        motion = self.motion
        spans = np.diff(motion.times)
        middle, velocities = motion.at(0.5 * (motion.times[:-1] + motion.times[1:]))
        twists = velocities.copy()
        cos, sin = np.cos(middle[:, 2]), np.sin(middle[:, 2])
        twists[:, 0] = cos * velocities[:, 0] + sin * velocities[:, 1]
        twists[:, 1] = cos * velocities[:, 1] - sin * velocities[:, 0]
        currents = np.nan_to_num(motion.currents)  # a braking is not counted
        power = (self.model.voltages(currents, twists) * currents).sum(axis=1)
        return float((power * spans).sum())

    def _joined(self, proposal: Proposal, answer: Answer, now: float) -> Motion:
        """The last motion until the plan is due, then the plan."""
        step = self.parameters.horizon.step
        plan = Motion.of_states(proposal.due, step, answer.states, answer.currents)
        begins = max(min(now, proposal.due) - HELD, self.motion.start)
        if begins > proposal.due - 1e-3:
            return plan
        before = self.motion.between(begins, proposal.due)
        moved = plan.poses[0] - before.poses[-1]  # none, unless it begins where the robot is
        return replace(before, poses=before.poses + moved).then(plan)

    def _braked(self, now: float) -> Motion:
        begins = max(self.motion.start, now - HELD)
        rest = self.motion.between(begins, max(self.motion.end, now + 1e-3))
        return rest.braked(max(now, rest.start), self._deceleration)

    @property
    def _deceleration(self) -> tuple[float, float]:
        left = 1.0 - self.parameters.reserve
        linear, angular = self.parameters.limits.deceleration
        return left * linear, left * angular

    def _off(self, measured: Measured) -> float:
        """How far a corner of the robot may be from where the motion has it [m]."""
        pose, _ = self.motion.sample(measured.time)
        error = measured.pose - pose
        turned = abs(se2.wrap(float(error[2])))
        return math.hypot(error[0], error[1]) + turned * math.hypot(*self.model.half)

    def _surroundings(self, around: Ellipses, off: float, now: float) -> Surroundings:
        p = self.parameters
        margin = p.safety.least_clearance + off
        until = now + p.horizon.duration
        return Surroundings(
            self.model.half, around, p.workspace.bounds, margin, until, self._walls
        )

    # ---- how far it has come ----------------------------------------------------------------

    def error(self, measured: Measured) -> tuple[float, float]:
        """Distance [m] and angle [rad] to the goal, zeros without one."""
        if self.goal is None:
            return 0.0, 0.0
        poses, _ = self.goal.targets(np.array([measured.time]))
        error = poses[0] - measured.pose
        return math.hypot(error[0], error[1]), abs(se2.wrap(float(error[2])))

    def _judge(self, now: float, measured: Measured) -> None:
        """Whether the goal is reached, or the way there is blocked."""
        if self.goal is None or not self.active:
            return
        distance, angle = self.error(measured)
        tolerance = self.parameters.arrival
        there = distance <= tolerance.position and angle <= tolerance.heading
        standing = float(np.abs(measured.twist).max()) < AT_REST
        stands_still = self.goal.until < now
        if isinstance(self.goal, StateGoal):
            if passing.passed(self.goal, measured, self.parameters.arrival):
                self._arrive()
                self.brake(now)
        elif there and standing and stands_still:
            self._arrive()
        elif self.guide is not None and self.guide.lost:
            self.state = PlannerState.BLOCKED
        elif not standing or (self.guide is not None and self.guide.waiting):
            self._stood_since, self.state = None, PlannerState.DRIVING
        elif self._stood_since is None:
            self._stood_since = now
        elif now - self._stood_since > BLOCKED_AFTER and stands_still:
            self.state = PlannerState.BLOCKED

    def _arrive(self) -> None:
        self.goal, self.state, self._guess = None, PlannerState.ARRIVED, None
