"""Random scenes for the MPC, and drives through them in which the planner's model is the robot.

There is no plant, no platform controller and no check of the plan: the drives show only how well
and how fast the problem is solved.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.mpc.transcription import Stage, Transcription
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import PlannerParameters, Workspace
from omniman_ros.planning.plan_optimizer import COLD_ITERATIONS

DISTANCE = (2.5, 3.5)  # range of the distance from the start to the goal [m]
SEMI_AXES = (0.12, 0.4)  # range of the semi-axes of obstacles [m]
MAX_SPEED = 0.4  # largest speed of moving obstacles [m/s]
MOVING_SHARE = 0.5  # probability that an obstacle moves
MAX_LATERAL_OFFSET = 1.6
"""Largest distance of obstacles' centres from the line from start to goal [m]."""
MIN_GAPS = (0.35, 0.15)
"""Smallest gap from obstacles to the robot at the start, and from fixed obstacles to the robot
at the goal [m]."""
WORKSPACE_MARGIN = 2.0  # distance from start and goal to the border of the workspace [m]
NOISE = (0.002, 0.002, 0.002, 0.01, 0.01, 0.01)
"""Standard deviations of the disturbance of the state in a step: pose in odom [m, m, rad] and
twist in base_link [m/s, m/s, rad/s]."""
MAX_DRAWS = 2000  # largest number of draws of obstacles for one scene
STEP = 0.1  # duration of a step of the horizon, and of a step of a drive [s]
REACHED_DISTANCE = 0.03  # distance from the goal below which it counts as reached [m]


@dataclass(frozen=True)
class Scene:
    """A random scene.

    Attributes:
        workspace: x_min, y_min, x_max, y_max of the robot's workspace in odom [m].
    """

    seed: int  # seed of the scene
    start: Array  # (3,) pose of the start in odom [m, m, rad]
    goal: Array  # (3,) pose of the goal in odom [m, m, rad]
    ellipses: Ellipses  # obstacles at time 0, which move at constant velocity
    workspace: tuple[float, float, float, float]


def draw_scene(seed: int, obstacles: int, half: Array) -> Scene:
    """Return a random scene, which is always the same for the same arguments.

    Args:
        half: (2,) half length and half width of the robot's box [m].
    """
    random = np.random.default_rng([seed, obstacles])
    bearing, distance = random.uniform(-math.pi, math.pi), random.uniform(*DISTANCE)
    along = np.array([math.cos(bearing), math.sin(bearing)])
    across = np.array([-along[1], along[0]])
    start = np.array([0.0, 0.0, random.uniform(-math.pi, math.pi)])
    heading = start[2] + random.uniform(-1.5, 1.5)
    goal = np.append(distance * along, heading)
    places, box = np.vstack([start, goal]), Rectangles.centred(half)
    drawn: list[tuple[Array, Array, Array, float]] = []
    for _ in range(MAX_DRAWS):
        if len(drawn) == obstacles:
            break
        ahead, beside = (
            random.uniform(0.0, distance + 0.5),
            random.uniform(-MAX_LATERAL_OFFSET, MAX_LATERAL_OFFSET),
        )
        center = ahead * along + beside * across
        axes, angle = random.uniform(*SEMI_AXES, 2), random.uniform(-math.pi, math.pi)
        moves = random.random() < MOVING_SHARE
        speed, course = random.uniform(0.1, MAX_SPEED), random.uniform(-math.pi, math.pi)
        velocity = moves * speed * np.array([math.cos(course), math.sin(course)])
        gaps = box_gap(
            places, box, np.tile(center, (2, 1, 1)), np.tile(axes, (2, 1, 1)), np.array([angle])
        )[:, 0]
        if gaps[0] > MIN_GAPS[0] and (moves or gaps[1] > MIN_GAPS[1]):
            drawn.append((center, velocity, axes, angle))
    else:
        raise ValueError(f"no room for {obstacles} obstacles (seed {seed})")
    ellipses = Ellipses(
        time=0.0,
        centers=np.array([c for c, _, _, _ in drawn]).reshape(-1, 2),
        velocities=np.array([v for _, v, _, _ in drawn]).reshape(-1, 2),
        semi_axes=np.array([a for _, _, a, _ in drawn]).reshape(-1, 2),
        angles=np.array([angle for _, _, _, angle in drawn]),
        growth=np.zeros(obstacles),
    )
    least, most = (
        places[:, :2].min(axis=0) - WORKSPACE_MARGIN,
        places[:, :2].max(axis=0) + WORKSPACE_MARGIN,
    )
    workspace = (float(least[0]), float(least[1]), float(most[0]), float(most[1]))
    return Scene(seed, start, goal, ellipses, workspace)


def swept_angles(times: Array, poses: Array, ellipses: Ellipses) -> Array:
    """Return the angles (M,) by which the robot travels around each obstacle, seen from it [rad].

    Two drives between the same positions pass an obstacle on the same side if and only if these
    angles differ by less than pi.

    Args:
        times: (K,) times [s].
        poses: (K, 3) poses of the robot at these times in odom [m, m, rad].
    """
    seen = poses[:, None, :2] - ellipses.centers_at(times)
    bearing = np.arctan2(seen[..., 1], seen[..., 0])
    swept: Array = np.unwrap(bearing, axis=0)[-1] - bearing[0]
    return swept


def disturbances(seed: int, count: int) -> Array:
    """Return the disturbances (count, 6) of the state after each step, for the seed of a scene."""
    noise: Array = np.random.default_rng([seed, 1]).normal(0.0, NOISE, (count, 6))
    return noise


def same_sides(first: Array, second: Array) -> bool:
    """Return whether two drives with swept angles (M,) pass every obstacle on the same side."""
    return bool((np.abs(first - second) < math.pi).all())


def penalty(stage: Stage, slack: Array) -> float:
    """Return the cost [J] of the slacks (N,) [m] of N stages."""
    linear, quadratic = stage.slack
    return float(linear * slack.sum() + 0.5 * quadratic * (slack @ slack))


class Controller(Protocol):
    """Solves the problem of each step of a drive, beginning with a guess of the currents."""

    def plan(self, task: "Task") -> tuple[Array, bool]:
        """Return currents (N, n) [A], and whether the solver reported success."""


@dataclass(frozen=True)
class Task:
    """The problem of one step of a drive."""

    first: bool  # whether it is the first step of the drive
    start: Array  # (6,) state at the start: pose in odom, twist in base_link
    guess: Array  # (N, n) guess of the motor currents [A]
    states: Array  # (N + 1, 6) states that follow from the guess, the first being the start
    stage: Stage  # parameters of the problem


@dataclass(frozen=True)
class Cycle:
    """The solution of one step of a drive."""

    task: Task  # the problem
    currents: Array  # (N, n) motor currents of the solution [A]
    solved: bool  # whether the solver reported success
    cycle_time: float  # duration of the whole cycle, including guess and stage [s]
    solver_time: float  # duration of the controller's call alone [s]


class Outcome(NamedTuple):
    """Cost [J] of a drive, its times (K,) [s] and poses (K, 3) [m, m, rad]."""

    cost: float
    times: Array
    poses: Array


class RealTime:
    """The planner's own scheme: one iteration in each step, and more in the first step."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver

    def plan(self, task: Task) -> tuple[Array, bool]:
        """Return currents (N, n) [A], and whether the solver reported success."""
        iterations = COLD_ITERATIONS if task.first else 1
        try:
            solution = self._solver.solve(task.start, task.guess, task.stage, iterations)
        except SolverError:
            return task.guess, False
        return solution.currents, True


class Rig:
    """A test rig: the MPC problem of a robot, the planner's solver, and drives with the model."""

    def __init__(self, robot: Mapping[str, Any], steps: int, obstacles: int) -> None:
        values = {
            **robot,
            "horizon.steps": steps,
            "horizon.step": STEP,
            "horizon.slots": obstacles,
        }
        self._parameters = build(PlannerParameters, values)
        self.model = PlanningModel.of(self._parameters.robot)
        self.transcription = Transcription(self.model, steps, STEP, obstacles)
        self.solver = Solver(self.transcription)

    def cycles(
        self, scene: Scene, controller: Controller, count: int, clock: Callable[[], float]
    ) -> Iterator[Cycle]:
        """Yield the steps of a drive through a scene.

        After each step, the state is the one that the model predicts for the controller's first
        currents, plus a disturbance.
        """
        bounds = Workspace(*scene.workspace)
        problem = Problem(self.model, EffectiveLimits(replace(self._parameters, workspace=bounds)))
        pairs = Pairs.of(Footprint(Rectangles.centred(self.model.half)), scene.ellipses)
        goal, solver, slots = PoseGoal(scene.goal), self.solver, self.transcription.slots
        x, currents = np.concatenate([scene.start, np.zeros(3)]), solver.cold()
        for k, noise in enumerate(disturbances(scene.seed, count)):
            begin = clock()
            guess = solver.shifted(currents, STEP) if k else currents
            states = solver.states(x, guess)
            expected = Motion.of_states(k * STEP, STEP, states, guess)
            stage = problem.stage(x, expected, goal, pairs, slots)
            task = Task(k == 0, x, guess, states, stage)
            between = clock()
            currents, solved = controller.plan(task)
            end = clock()
            yield Cycle(task, currents, solved, end - begin, end - between)
            x = np.asarray(self.transcription.transition(x, currents[0])).ravel() + noise

    def drive(self, scene: Scene, controller: Controller, count: int) -> Outcome:
        """Drive through a scene for a number of steps.

        The cost is that of all stages and slacks, and the terminal cost of the last state.
        """
        t = self.transcription
        cost = 0.0
        poses: list[Array] = []
        for cycle in self.cycles(scene, controller, count, lambda: 0.0):
            stage, x, u = cycle.task.stage, cycle.task.start, cycle.currents[0]
            row = stage.table()[0]
            value, low, _ = (np.asarray(part).ravel() for part in t.stage_rows(x, u, row))
            violation = max(float((low - value)[t.relaxed :].max(initial=0.0)), 0.0)
            cost += float(t.stage_cost(x, u, row)) + penalty(stage, np.array([violation]))
            poses.append(x[:3])
        end = np.asarray(t.transition(x, u)).ravel()
        # The terminal weights, less the running weights that the last step has paid for already.
        position, heading, _, _, kinetic = stage.weights[-1] - stage.weights[0]
        error = end[:3] - stage.target[-1, :3]
        cost += float(position * (error[:2] @ error[:2]) + heading * error[2] ** 2)
        cost += float(kinetic * self.model.kinetic_energy(end[3:]))
        poses.append(end[:3])
        return Outcome(cost, STEP * np.arange(len(poses), dtype=np.float64), np.array(poses))


def arrived(cycle: Cycle) -> bool:
    """Return whether the robot is at its goal in a step, which makes the problem trivial."""
    error = cycle.task.start[:2] - cycle.task.stage.target[-1, :2]
    return bool(np.hypot(error[0], error[1]) < REACHED_DISTANCE)
