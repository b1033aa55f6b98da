"""`omniman bench crowd`: the planner among discs that cross a square and give way to nobody.

The drives are in simulated time on the plant; times are CPU times of the planner's cycles.
"""

import argparse
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.console.terminal import say
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_most,
    conclude,
    cycle_figures,
    in_processes,
    spread_text,
)
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
from omniman_ros.lab.studies.scene_geometry import MovingObstacle
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

CROWDS, QUICK_CROWDS = 6, 1  #: number of crowds of each kind, and with `--quick`
SECONDS, QUICK_SECONDS = 60.0, 10.0  #: simulated duration of a drive, and with `--quick` [s]
DISCS = 20  #: number of discs
P99_AIM = 40.0  #: aim: largest 99th percentile of the CPU time of a cycle [ms]
HALF = 5.0  #: half of the square's edge [m]
RADIUS = 0.25  #: radius of the discs [m]
SPEEDS = (0.4, 1.0)  #: range of the discs' speeds [m/s]
NEAR = 0.3  #: distance from its target at which a disc takes another one [m]
FREE_START = 1.5  #: radius around the robot's start without discs [m]
GOAL_HALF = 3.5  #: half edge of the square of the goals [m]
GOAL_DISTANCE = 4.0  #: least distance between two goals in a row [m]
NOISE = 0.01  #: standard deviation of the observed positions [m]


class DiscCrowd:
    """Discs that cross straight from side to side, through each other, too."""

    def __init__(self, count: int, seed: int) -> None:
        self._random = np.random.default_rng([seed, 0])
        places: list[Array] = []
        while len(places) < count:
            place = self._random.uniform(-HALF, HALF, 2)
            apart = [math.dist(place, other) for other in places]
            if np.hypot(*place) > FREE_START and min(apart, default=HALF) > 3.0 * RADIUS:
                places.append(place)
        self.positions: Array = np.array(places)  #: (n, 2) [m]
        self._speeds = self._random.uniform(*SPEEDS, count)
        self._targets = np.array([self._target(place) for place in self.positions])

    def _target(self, place: Array) -> Array:
        """Return a place on the opposite side, left and right or up and down at random."""
        target: Array = self._random.uniform(-HALF, HALF, 2)
        axis = int(self._random.integers(2))
        target[axis] = -math.copysign(HALF, place[axis])
        return target

    def advance(self) -> None:
        """Advance by one tick."""
        away = self._targets - self.positions
        for k in np.flatnonzero(np.hypot(*away.T) < NEAR).tolist():
            self._targets[k] = self._target(self.positions[k])
            away[k] = self._targets[k] - self.positions[k]
        steps = away / np.hypot(*away.T)[:, None] * self._speeds[:, None]
        self.positions = self.positions + PERIOD * steps


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

    seconds: float  #: duration [s]
    goals: int  #: number of goals that were reached
    contacts: int  #: number of contacts in which the robot moved
    contacts_at_rest: int  #: number of contacts with the robot at rest
    cycle_times: tuple[float, ...]  #: CPU times of the planner's cycles [s]


def drive_in_crowd(robot: Mapping[str, Any], seed: int, seconds: float, count: int) -> CrowdRun:
    """Drive from goal to goal."""
    crowd = DiscCrowd(count, seed)
    edges = {"x_min": -HALF, "y_min": -HALF, "x_max": HALF, "y_max": HALF}
    values = {**robot, **{f"workspace.{name}": edge for name, edge in edges.items()}}
    parameters = build(PlannerParameters, values)
    half = np.array([parameters.robot.body.length, parameters.robot.body.width]) / 2.0
    touching: set[int] = set()
    contacts = [0, 0]  # while the robot moves, and at rest

    def tick(loop: MpcLoop) -> None:
        crowd.advance()
        touched = set(
            np.flatnonzero(disc_gaps(loop.loop.truth, half, crowd.positions) < 0.0).tolist()
        )
        twist = loop.loop.controller.odometry.twist
        rests = float(np.abs(twist).max()) < 0.02
        contacts[rests] += len(touched - touching)
        touching.clear()
        touching.update(touched)

    def disc_place(k: int, _time: float) -> Array:
        position: Array = crowd.positions[k]
        return position

    obstacles = [MovingObstacle((RADIUS, RADIUS), partial(disc_place, k)) for k in range(count)]
    options = LoopOptions(
        obstacles=obstacles, noise=NOISE, seed=seed, timer=time.process_time, on_tick=tick
    )
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
        loop.now - since,
        goals + (loop.planner.state is PlannerState.ARRIVED),
        contacts[0],
        contacts[1],
        tuple(each.cycle_time for each in loop.cycles if each.cycle_time > 0.0),
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


def figures(runs: Sequence[CrowdRun]) -> dict[str, Any]:
    """Return the figures of drives."""
    minutes = sum(run.seconds for run in runs) / 60.0
    goals = sum(run.goals for run in runs)
    return {
        "crowds": len(runs),
        "minutes": minutes,
        "goals": goals,
        "goals_per_minute": goals / minutes,
        "contacts": sum(run.contacts for run in runs),
        "contacts_at_rest": sum(run.contacts_at_rest for run in runs),
        "cycle": cycle_figures([run.cycle_times for run in runs]),
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench crowd`; return 0, the exit code of a successful measurement."""
    crowds = args.worlds or (QUICK_CROWDS if args.quick else CROWDS)
    seconds = QUICK_SECONDS if args.quick else SECONDS
    jobs = args.jobs or os.cpu_count() or 1
    robot = dict(robot_parameters(resolve_robot("ig42")))
    conditions = {"discs": DISCS, "seconds": seconds, "first_seed": args.seed, "jobs": jobs}
    say(f"{crowds} crowds of {DISCS} ...")
    tasks = [(robot, seed, seconds, DISCS) for seed in range(args.seed, args.seed + crowds)]
    runs = in_processes(drive_in_crowd, tasks, jobs)
    result = {"quick": args.quick, "conditions": conditions, **figures(runs)}
    return conclude("crowd", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = [
        Figure("goals per minute", (f"{result['goals_per_minute']:.1f}",)),
        at_most("contacts while the robot moves", result["contacts"], 0),
        Figure("contacts with the robot at rest", (f"{result['contacts_at_rest']}",)),
        Figure("CPU of a cycle: median, p99, max", (spread_text(result["cycle"]),)),
        at_most("p99 of a cycle's CPU time", result["cycle"]["p99_ms"], P99_AIM, "{:.0f} ms"),
    ]
    return [BenchmarkTable(("value",), rows)]
