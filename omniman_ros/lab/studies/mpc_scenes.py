"""Random scenes for the MPC, and drives through them with the model itself as the robot.

There is no plant, no controller and no check of the plan: the drives show only how well and how
fast the problem is solved. The clock is an argument.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.solver import Solver, SolverError
from omniman_ros.planning.mpc.transcription import Stage, Transcription
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import PlannerParameters, Workspace
from omniman_ros.planning.plan_optimizer import COLD_ITERATIONS

DISTANCE = (2.5, 3.5)
"""Range of the distance from the start to the goal [m]."""
SEMI_AXES = (0.12, 0.4)
"""Range of the semi-axes of obstacles [m]."""
SPEED = 0.4
"""Largest speed of moving obstacles [m/s]."""
MOVING = 0.5
"""Share of obstacles that move."""
CORRIDOR = 1.6
"""Largest distance of obstacles from the line from start to goal [m]."""
ROOM = (0.35, 0.15)
"""Least gap of obstacles to the robot at the start, and of fixed obstacles at the goal [m]."""
MARGIN = 2.0
"""Distance of the border of the workspace from start and goal [m]."""
NOISE = (0.002, 0.002, 0.002, 0.01, 0.01, 0.01)
"""Standard deviations of the disturbance of a state per step: pose [m, m, rad], twist in base_link
[m/s, m/s, rad/s]."""
TRIES = 2000
"""Most draws of obstacles of a scene."""
STEP = 0.1
"""Step of the horizon and of the drive [s]."""
CLOSE = 0.03
"""Distance from the goal at which it counts as reached [m]."""


@dataclass(frozen=True)
class Scene:
    """A random scene.

    Attributes:
        seed: Seed of the scene.
        start: (3,) pose of the start in odom [m, m, rad].
        goal: (3,) pose of the goal in odom [m, m, rad].
        ellipses: Obstacles at time 0, which move at constant velocity.
        workspace: x_min, y_min, x_max, y_max in odom [m].
    """

    seed: int
    start: Array
    goal: Array
    ellipses: Ellipses
    workspace: tuple[float, float, float, float]


def draw_scene(seed: int, obstacles: int, half: Array) -> Scene:
    """Draw a scene, which is always the same for the same arguments.

    Args:
        seed: Seed of the random numbers.
        obstacles: Number of obstacles.
        half: (2,) half length and half width of the robot's box [m].

    Raises:
        ValueError: There is no room for that many obstacles.
    """
    random = np.random.default_rng([seed, obstacles])
    bearing, distance = random.uniform(-math.pi, math.pi), random.uniform(*DISTANCE)
    along = np.array([math.cos(bearing), math.sin(bearing)])
    across = np.array([-along[1], along[0]])
    start = np.array([0.0, 0.0, random.uniform(-math.pi, math.pi)])
    heading = start[2] + random.uniform(-1.5, 1.5)
    goal = np.append(distance * along, heading)
    places = np.vstack([start, goal])
    drawn: list[tuple[Array, Array, Array, float]] = []
    for _ in range(TRIES):
        if len(drawn) == obstacles:
            break
        ahead, beside = random.uniform(0.0, distance + 0.5), random.uniform(-CORRIDOR, CORRIDOR)
        center = ahead * along + beside * across
        axes, angle = random.uniform(*SEMI_AXES, 2), random.uniform(-math.pi, math.pi)
        moves = random.random() < MOVING
        speed, course = random.uniform(0.1, SPEED), random.uniform(-math.pi, math.pi)
        velocity = moves * speed * np.array([math.cos(course), math.sin(course)])
        gaps = box_gap(
            places, half, np.tile(center, (2, 1, 1)), np.tile(axes, (2, 1, 1)), np.array([angle])
        )[:, 0]
        if gaps[0] > ROOM[0] and (moves or gaps[1] > ROOM[1]):
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
    least, most = places[:, :2].min(axis=0) - MARGIN, places[:, :2].max(axis=0) + MARGIN
    workspace = (float(least[0]), float(least[1]), float(most[0]), float(most[1]))
    return Scene(seed, start, goal, ellipses, workspace)


def swept_angles(times: Array, poses: Array, ellipses: Ellipses) -> Array:
    """Return the angles (M,) by which the robot went around each obstacle, seen from it [rad].

    Two drives between the same positions pass an obstacle on the same side exactly if these
    angles differ by less than pi.

    Args:
        times: (K,) times [s].
        poses: (K, 3) poses of the robot at these times in odom [m, m, rad].
        ellipses: Obstacles.
    """
    seen = poses[:, None, :2] - ellipses.centers_at(times)
    bearing = np.arctan2(seen[..., 1], seen[..., 0])
    swept: Array = np.unwrap(bearing, axis=0)[-1] - bearing[0]
    return swept


def disturbances(seed: int, count: int) -> Array:
    """Return the disturbances (count, 6) of the states after each step, by seed."""
    noise: Array = np.random.default_rng([seed, 1]).normal(0.0, NOISE, (count, 6))
    return noise


def same_sides(first: Array, second: Array) -> bool:
    """Whether swept angles (M,) of two drives mean the same side of every obstacle."""
    return bool((np.abs(first - second) < math.pi).all())


def penalty(stage: Stage, slack: Array) -> float:
    """Return the cost [J] of slack (N,) [m]."""
    linear, quadratic = stage.slack
    return float(linear * slack.sum() + 0.5 * quadratic * (slack @ slack))


class Controller(Protocol):
    """Improves a guess of the currents."""

    def plan(self, task: "Task") -> tuple[Array, bool]:
        """Currents (N, n) [A] and whether the solver was content."""


@dataclass(frozen=True)
class Task:
    """One problem of a drive.

    Attributes:
        first: Whether it is the first of the drive.
        start: (6,) state.
        guess: (N, n) currents [A].
        states: (N + 1, 6) that follow from them.
        stage: Parameters of the problem.
    """

    first: bool
    start: Array
    guess: Array
    states: Array
    stage: Stage


@dataclass(frozen=True)
class Cycle:
    """A step of a drive.

    Attributes:
        task: What was to be solved.
        currents: (N, n) currents of the solution [A].
        solved: Whether the solver was content.
        whole: Time of the whole cycle, guess and stage included [s].
        alone: Time of the solver alone [s].
    """

    task: Task
    currents: Array
    solved: bool
    whole: float
    alone: float


@dataclass(frozen=True)
class Outcome:
    """Result of a drive.

    Attributes:
        cost: Losses, distance to the goal and penalties of all steps, and the weight of the last
            state [J].
        slack: Largest overlap with obstacles or edge, clearance included [m].
        distance: Distance from the goal at the end [m].
        failures: Number of steps at which the solver reported a failure.
        times: (K,) times [s].
        poses: (K, 3) poses [m, m, rad].
    """

    cost: float
    slack: float
    distance: float
    failures: int
    times: Array
    poses: Array


class RealTime:
    """The planner's own scheme: one iteration per step, several at the first step."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver

    def plan(self, task: Task) -> tuple[Array, bool]:
        """See `Controller`."""
        iterations = COLD_ITERATIONS if task.first else 1
        try:
            solution = self._solver.solve(task.start, task.guess, task.stage, iterations)
        except SolverError:
            return task.guess, False
        return solution.currents, True


class Rig:
    """A robot's problem with N steps and M obstacles, and what solves it.

    Args:
        robot: Parameters of the robot.
        steps: N.
        obstacles: M.
    """

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
        """Drive a scene, at most so many steps; without noise the robot does what it should."""
        bounds = Workspace(*scene.workspace)
        problem = Problem(self.model, EffectiveLimits(replace(self._parameters, workspace=bounds)))
        goal, solver, slots = PoseGoal(scene.goal), self.solver, self.transcription.slots
        x, currents = np.concatenate([scene.start, np.zeros(3)]), solver.cold()
        for k, noise in enumerate(disturbances(scene.seed, count)):
            begin = clock()
            guess = solver.shifted(currents, STEP) if k else currents
            states = solver.states(x, guess)
            along = Motion.of_states(k * STEP, STEP, states, guess)
            stage = problem.stage(x, along, goal, scene.ellipses, slots)
            task = Task(k == 0, x, guess, states, stage)
            between = clock()
            currents, solved = controller.plan(task)
            end = clock()
            yield Cycle(task, currents, solved, end - begin, end - between)
            x = np.asarray(self.transcription.transition(x, currents[0])).ravel() + noise

    def drive(self, scene: Scene, controller: Controller, count: int) -> Outcome:
        """Drive a scene to its end and judge it."""
        t = self.transcription
        cost, slack, failures = 0.0, 0.0, 0
        poses: list[Array] = []
        for cycle in self.cycles(scene, controller, count, lambda: 0.0):
            stage, x, u = cycle.task.stage, cycle.task.start, cycle.currents[0]
            row = stage.table()[0]
            value, low, _ = (np.asarray(part).ravel() for part in t.stage_rows(x, u, row))
            short = max(float((low - value)[t.relaxed :].max(initial=0.0)), 0.0)
            cost += float(t.stage_cost(x, u, row)) + penalty(stage, np.array([short]))
            slack, failures = max(slack, short), failures + (not cycle.solved)
            poses.append(x[:3])
        end = np.asarray(t.transition(x, u)).ravel()
        # What the end weighs beside the share that the last step has paid.
        position, heading, _, _, kinetic = stage.weights[-1] - stage.weights[0]
        error = end[:3] - stage.target[-1, :3]
        distance = float(np.hypot(error[0], error[1]))
        cost += float(position * distance**2 + heading * error[2] ** 2)
        cost += float(kinetic * self.model.kinetic_energy(end[3:]))
        poses.append(end[:3])
        times: Array = STEP * np.arange(len(poses), dtype=np.float64)
        return Outcome(cost, slack, distance, failures, times, np.array(poses))


def arrived(cycle: Cycle) -> bool:
    """Whether the robot is at its goal: what follows is no work for a solver."""
    error = cycle.task.start[:2] - cycle.task.stage.target[-1, :2]
    return bool(np.hypot(error[0], error[1]) < CLOSE)
