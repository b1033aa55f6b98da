"""Random scenes for the MPC, and drives through them in which the planner's model is the robot.

There is no plant, no platform controller and no check of the plan: the drives show only how well
and how fast the problem is solved.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.nodes.mpc_planner.compiled_functions import (
    CompiledFunctions,
    default_folder,
)
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.mpc.transcription import Stage, Transcription
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import PlannerParameters, Workspace
from omniman_ros.planning.plan_optimizer import COLD_ITERATIONS
from omniman_ros.surroundings.ellipses import Ellipses

DISTANCE = (2.5, 3.5)  #: range of the distance from the start to the goal [m]
SEMI_AXES = (0.12, 0.4)  #: range of the semi-axes of obstacles [m]
SPEEDS = (0.1, 0.4)  #: range of the speed of the half of the obstacles that moves [m/s]
LATERAL = 1.6  #: largest distance of obstacles' centres from the line from start to goal [m]
START_GAP, GOAL_GAP = 0.35, 0.15  #: least gaps to the robot at start and goal [m]
#: Distance from start and goal to the border of the workspace [m]: the robot never comes near it
WORKSPACE_MARGIN = 5.0
#: Standard deviations of the disturbance of the state in a step: pose in odom [m, m, rad] and
#: twist in base_link [m/s, m/s, rad/s].
NOISE = (0.002, 0.002, 0.002, 0.01, 0.01, 0.01)
POLL_PERIOD = 0.05  #: time between two looks at the compiler [s]
STEP = 0.1  #: duration of a step of the horizon, and of a step of a drive [s]


class MpcScene(NamedTuple):
    """A random scene."""

    seed: int
    start: Array  #: (3,) pose of the start in odom [m, m, rad]
    goal: Array  #: (3,) pose of the goal in odom [m, m, rad]
    ellipses: Ellipses  #: obstacles at time 0, which move at constant velocity
    workspace: Workspace


class Task(NamedTuple):
    """The problem of one step of a drive."""

    first: bool  #: whether it is the first step of the drive
    start: Array  #: (6,) state at the start: pose in odom, twist in base_link
    guess: Array  #: (N, n) guess of the motor currents [A]
    states: Array  #: (N + 1, 6) states that follow from the guess, the first being the start
    stage: Stage


#: A solver: from a task to currents (N, n) [A], and whether it reports success
Plan = Callable[[Task], tuple[Array, bool]]


class Step(NamedTuple):
    """The solution of one step of a drive."""

    task: Task
    currents: Array  #: (N, n) motor currents [A]
    solved: bool
    cycle_time: float  #: duration of the whole cycle, including guess and stage [s]
    solver_time: float  #: duration of the solver's call alone [s]


def draw_scene(seed: int, count: int, half: Array) -> MpcScene:
    """Return a random scene of `count` obstacles for a robot with half its size (2,) [m]."""
    random = np.random.default_rng([seed, count])
    bearing, distance = random.uniform(-math.pi, math.pi), random.uniform(*DISTANCE)
    along = np.array([math.cos(bearing), math.sin(bearing)])
    across = np.array([-along[1], along[0]])
    start = np.array([0.0, 0.0, random.uniform(-math.pi, math.pi)])
    goal = np.append(distance * along, start[2] + random.uniform(-1.5, 1.5))
    places, box = np.vstack([start, goal]), Rectangles.centred(half)
    drawn: list[tuple[Any, ...]] = []
    while len(drawn) < count:
        ahead, beside = random.uniform(0.0, distance + 0.5), random.uniform(-LATERAL, LATERAL)
        center = ahead * along + beside * across
        axes, angle = random.uniform(*SEMI_AXES, 2), random.uniform(-math.pi, math.pi)
        moves = random.random() < 0.5
        speed, course = random.uniform(*SPEEDS), random.uniform(-math.pi, math.pi)
        velocity = moves * speed * np.array([math.cos(course), math.sin(course)])
        twice = [np.tile(each, (2, 1, 1)) for each in (center, axes)]
        at_start, at_goal = box_gap(places, box, twice[0], twice[1], np.array([angle]))[:, 0]
        if at_start > START_GAP and (moves or at_goal > GOAL_GAP):
            drawn.append((center, velocity, axes, angle))
    centers, velocities, semi_axes, angles = map(np.array, zip(*drawn, strict=True))
    ellipses = Ellipses(0.0, centers, velocities, semi_axes, angles, np.zeros(count))
    low = places[:, :2].min(axis=0) - WORKSPACE_MARGIN
    high = places[:, :2].max(axis=0) + WORKSPACE_MARGIN
    return MpcScene(seed, start, goal, ellipses, Workspace(*low.tolist(), *high.tolist()))


class Rig:
    """The MPC problem of a robot, the planner's solver, and drives with the model."""

    def __init__(self, robot: Mapping[str, Any], steps: int, obstacles: int) -> None:
        values = {"horizon.steps": steps, "horizon.step": STEP, "horizon.slots": obstacles}
        self._parameters = build(PlannerParameters, {**robot, **values})
        self._model = PlanningModel.of(self._parameters.robot)
        self.transcription = Transcription(self._model, steps, STEP, obstacles, confined=False)
        self._solver = Solver(self.transcription)

    def compile(self) -> bool:
        """Have the planner's solver use compiled functions; return whether it does."""
        functions = CompiledFunctions([self._solver], default_folder(), say)
        while not functions.is_done:
            functions.poll()
            time.sleep(POLL_PERIOD)
        return not functions.failure

    def scene(self, seed: int) -> MpcScene:
        """Return a random scene with as many obstacles as the problem has."""
        return draw_scene(seed, self.transcription.slots, self._model.half)

    def plan(self, task: Task) -> tuple[Array, bool]:
        """Solve a task by the planner's own scheme: one iteration, more in the first step."""
        iterations = COLD_ITERATIONS if task.first else 1
        try:
            solution = self._solver.solve(task.start, task.guess, task.stage, iterations)
        except SolverError:
            return task.guess, False
        return solution.currents, True

    def steps(
        self, scene: MpcScene, plan: Plan, count: int, clock: Callable[[], float]
    ) -> Iterator[Step]:
        """Yield the steps of a drive through a scene.

        After each step, the state is the one that the model predicts for the first currents, plus
        a disturbance.
        """
        limits = EffectiveLimits(replace(self._parameters, workspace=scene.workspace))
        problem = Problem(self._model, limits)
        pairs = Pairs.of(Footprint(Rectangles.centred(self._model.half)), scene.ellipses)
        goal, solver, t = PoseGoal(scene.goal), self._solver, self.transcription
        x, currents = np.concatenate([scene.start, np.zeros(3)]), solver.cold()
        disturbances = np.random.default_rng([scene.seed, 1]).normal(0.0, NOISE, (count, 6))
        for k, noise in enumerate(disturbances):
            begin = clock()
            guess = solver.shifted(currents, STEP) if k else currents
            states = solver.states(x, guess)
            expected = HermiteTrajectory.of_states(k * STEP, STEP, states, guess)
            stage = problem.stage(x, expected, goal, pairs, t.slots, confined=t.confined)
            task = Task(k == 0, x, guess, states, stage)
            between = clock()
            currents, solved = plan(task)
            end = clock()
            yield Step(task, currents, solved, end - begin, end - between)
            x = np.asarray(t.transition(x, currents[0])).ravel() + noise

    def drive(self, scene: MpcScene, plan: Plan, count: int) -> tuple[float, Array]:
        """Drive through a scene for a number of steps.

        The result is the cost [J] of all stages and slacks, with the terminal cost of the last
        state, and the angles (M,) by which the robot travels around each obstacle [rad]. Two
        drives between the same positions pass an obstacle on the same side if and only if these
        angles differ by less than pi.
        """
        t, cost, poses = self.transcription, 0.0, list[Array]()
        for step in self.steps(scene, plan, count, lambda: 0.0):
            stage, x, u = step.task.stage, step.task.start, step.currents[0]
            row = stage.table()[0]
            value, low, _ = (np.asarray(part).ravel() for part in t.stage_rows(x, u, row))
            slack = max(float((low - value)[t.relaxed :].max(initial=0.0)), 0.0)
            linear, quadratic = stage.slack
            cost += float(t.stage_cost(x, u, row)) + linear * slack + 0.5 * quadratic * slack**2
            poses.append(x[:3])
        end = np.asarray(t.transition(x, u)).ravel()
        poses.append(end[:3])
        # The terminal weights, less the running weights that the last step has paid for already.
        position, heading, _, _, kinetic = stage.weights[-1] - stage.weights[0]
        error = end[:3] - stage.target[-1, :3]
        cost += float(position * (error[:2] @ error[:2]) + heading * error[2] ** 2)
        cost += float(kinetic * self._model.kinetic_energy(end[3:]))
        times = STEP * np.arange(len(poses), dtype=np.float64)
        seen = np.array(poses)[:, None, :2] - scene.ellipses.centers_at(times)
        bearing = np.unwrap(np.arctan2(seen[..., 1], seen[..., 0]), axis=0)
        return cost, bearing[-1] - bearing[0]
