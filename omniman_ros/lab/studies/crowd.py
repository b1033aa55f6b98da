"""Drives among discs that cross a square, giving way or not, on the plant in simulated time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
from omniman_ros.lab.studies.scene_geometry import MovingObstacle
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.avoidance import DIRECTIONS, Surroundings, half_planes, outline
from omniman_ros.simulation.world.velocity_program import nearest_velocity

HALF = 5.0  # half of the square's edge [m]
RADIUS = 0.25  # radius of the discs [m]
SPEEDS = (0.4, 1.0)  # range of the discs' speeds [m/s]
AGILITY = 12.0  # rate at which a disc reaches the wanted velocity [1/s]
DECISION_TICKS = 10  # number of ticks between two decisions of the discs
HORIZON = 2.5  # how far ahead discs that give way look [s]
CLEARANCE = 0.1  # gap that they keep to each other and to the robot [m]
NEAR = 0.3  # distance from its target at which a disc takes another one [m]
FREE_START = 1.5  # radius around the robot's start without discs [m]
GOAL_HALF, GOAL_DISTANCE = 3.5, 4.0
"""Half edge of the square of the goals, and least distance between two in a row [m]."""
NOISE = 0.01  # standard deviation of the observed positions [m]


class DiscCrowd:
    """Discs that walk from target to target.

    Discs that give way do so by optimal reciprocal collision avoidance among each other and half
    towards the robot; the others cross straight from side to side, through each other, too.

    Attributes:
        positions: (n, 2) positions [m].
        velocities: (n, 2) velocities [m/s].
    """

    def __init__(self, count: int, gives_way: bool, seed: int) -> None:
        self._random = np.random.default_rng([seed, gives_way])
        self._gives_way = gives_way
        places: list[Array] = []
        while len(places) < count:
            place = self._random.uniform(-HALF, HALF, 2)
            apart = [math.dist(place, other) for other in places]
            if np.hypot(*place) > FREE_START and min(apart, default=HALF) > 3.0 * RADIUS:
                places.append(place)
        self.positions: Array = np.array(places).reshape(-1, 2)
        self.velocities: Array = np.zeros((count, 2))
        self._speeds = self._random.uniform(*SPEEDS, count)
        self._targets = np.array([self._target(place) for place in self.positions])
        self._wanted = np.zeros((count, 2))
        self._tick = 0

    def _target(self, place: Array) -> Array:
        """Return another target: anywhere, or on the opposite side for who crosses."""
        target: Array = self._random.uniform(-HALF, HALF, 2)
        if not self._gives_way:
            axis = int(self._random.integers(2))
            target[axis] = -math.copysign(HALF, place[axis])
        return target

    def advance(self, corners: Array, velocity: Array) -> None:
        """Advance by one tick.

        Args:
            corners: (4, 2) corners of the robot [m].
            velocity: (2,) its velocity [m/s].
        """
        if self._tick % DECISION_TICKS == 0:
            self._decide(corners, velocity)
        self._tick += 1
        share = AGILITY * PERIOD if self._gives_way else 1.0
        self.velocities = self.velocities + share * (self._wanted - self.velocities)
        self.positions = self.positions + PERIOD * self.velocities

    def _decide(self, corners: Array, velocity: Array) -> None:
        """Choose the wanted velocities."""
        away = self._targets - self.positions
        for k in np.flatnonzero(np.hypot(*away.T) < NEAR).tolist():
            self._targets[k] = self._target(self.positions[k])
        away = self._targets - self.positions
        wishes = away / np.hypot(*away.T)[:, None] * self._speeds[:, None]
        self._wanted = wishes.copy()
        if not self._gives_way:
            return
        count = len(self.positions)
        outlines = np.vstack([self.positions @ DIRECTIONS.T + RADIUS, outline(corners)[None]])
        velocities = np.vstack([self.velocities, velocity])
        moving = np.vstack([wishes, velocity])
        for k in range(count):
            others = np.arange(count + 1) != k
            around = Surroundings(
                outlines=outlines[others],
                velocities=velocities[others],
                wishes=moving[others],
                reaches=np.full(count, RADIUS + CLEARANCE),
                horizons=np.full(count, HORIZON),
                shares=np.full(count, 0.5),
                fixed=0,
            )
            planes = half_planes(self.positions[k], self.velocities[k], wishes[k], around)
            wish = float(wishes[k, 0]), float(wishes[k, 1])
            self._wanted[k] = nearest_velocity(wish, float(self._speeds[k]), [], planes)


def disc_gaps(pose: Array, half: Array, positions: Array) -> Array:
    """Return the gaps (n,) of discs at positions (n, 2) to a box, half (2,), at a pose [m]."""
    offset = positions - pose[:2]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = np.abs(c * offset[:, 0] + s * offset[:, 1]) - half[0]
    y = np.abs(c * offset[:, 1] - s * offset[:, 0]) - half[1]
    gaps: Array = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) - RADIUS
    return gaps


@dataclass(frozen=True)
class CrowdRun:
    """Result of a drive in a crowd."""

    seed: int  # seed of crowd and goals
    gives_way: bool  # whether the discs give way
    seconds: float  # duration [s]
    goals: int  # number of goals that were reached
    contacts: int  # number of contacts in which the robot moved
    contacts_at_rest: int  # number of contacts with the robot at rest
    cycle_times: tuple[float, ...]  # CPU times of the planner's cycles [s]


def drive_in_crowd(
    robot: Mapping[str, Any],
    seed: int,
    gives_way: bool,
    seconds: float,
    count: int,
    timer: Callable[[], float],
) -> CrowdRun:
    """Drive from goal to goal."""
    crowd = DiscCrowd(count, gives_way, seed)
    edges = {"x_min": -HALF, "y_min": -HALF, "x_max": HALF, "y_max": HALF}
    values = {**robot, **{f"workspace.{name}": edge for name, edge in edges.items()}}
    parameters = build(PlannerParameters, values)
    half = np.array([parameters.robot.body.length, parameters.robot.body.width]) / 2.0
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    touching: set[int] = set()
    contacts = [0, 0]  # while the robot moves, and at rest

    def tick(loop: MpcLoop) -> None:
        pose, theta = loop.loop.truth, float(loop.loop.truth[2])
        twist = np.array(loop.loop.controller.odometry.twist)
        velocity = se2.to_world(theta, twist)
        turn = np.array([[math.cos(theta), math.sin(theta)], [-math.sin(theta), math.cos(theta)]])
        crowd.advance(pose[:2] + (signs * half) @ turn, velocity[:2])
        touched = set(np.flatnonzero(disc_gaps(pose, half, crowd.positions) < 0.0).tolist())
        rests = float(np.abs(twist).max()) < 0.02
        contacts[rests] += len(touched - touching)
        touching.clear()
        touching.update(touched)

    def disc_place(k: int, _time: float) -> Array:
        position: Array = crowd.positions[k]
        return position

    obstacles = [MovingObstacle((RADIUS, RADIUS), partial(disc_place, k)) for k in range(count)]
    options = LoopOptions(obstacles=obstacles, noise=NOISE, seed=seed, timer=timer, on_tick=tick)
    platform, simulation = build(PlatformParameters, robot), build(SimulationParameters, {})
    loop = MpcLoop(parameters, platform, simulation, options)
    random = np.random.default_rng([seed, 1])
    goals, place, since = -1, np.zeros(2), loop.now
    while loop.now - since < seconds:
        if loop.planner.state in (PlannerState.IDLE, PlannerState.ARRIVED):
            goals += 1
            place = _next_goal(loop, place, random)
        loop.cycle()
    return CrowdRun(
        seed,
        gives_way,
        loop.now - since,
        goals + (loop.planner.state is PlannerState.ARRIVED),
        contacts[0],
        contacts[1],
        tuple(cycle.cycle_time for cycle in loop.cycles if cycle.cycle_time > 0.0),
    )


def _next_goal(loop: MpcLoop, place: Array, random: np.random.Generator) -> Array:
    """Send the robot to the next goal that it accepts; return the goal's position."""
    while True:
        other: Array = random.uniform(-GOAL_HALF, GOAL_HALF, 2)
        if math.dist(place, other) < GOAL_DISTANCE:
            continue
        try:
            loop.drive(PoseGoal(np.append(other, random.uniform(-math.pi, math.pi))))
        except InputError:  # somebody stands there
            continue
        return other
