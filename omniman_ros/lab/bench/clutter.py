"""`omniman bench clutter`: the planner in worlds of BARN's kind, map known or by scanner alone.

The physics world judges contact, and times are CPU times of the planner's cycles.

Source: D. Perille, A. Truong, X. Xiao and P. Stone, "Benchmarking Metric Ground Navigation" (SSRR
2020), and the rules of the BARN Challenge from 2024 on: from one end of a corridor to a place 10 m
ahead, which is reached from 1 m on; the score is success * T / clip(t, 2 T, 8 T), where T is the
length of the shortest path over 2 m/s.
"""

import argparse
import heapq
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.extras import TRACKING, WORLD
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    cycle_figures,
    spread_text,
)
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
from omniman_ros.lab.studies.scanned_surroundings import ScannedSurroundings
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.lab.sweep import Sweep
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.clutter import Clutter, clutter_posts
from omniman_ros.simulation.world.occupancy import occupancy
from omniman_ros.simulation.world.parameters import IDEAL
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
from omniman_ros.simulation.world.scene import Scene, Wall
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.obstacles import Observation
from omniman_ros.surroundings.occupancy import OccupancyMap

WORLDS, QUICK_WORLDS = 300, 2  #: number of worlds, one drive each, and with `--quick`
SCORE_AIM = 0.49  #: aim: least mean score by scanner alone, at the size of a Jackal
TIME_AIM = 6.5  #: aim: largest mean time of those drives [s]
AIMED = "jackal_size scanner"  #: name of the drives that the aims are about
SENSES = ("known", "scanner")  #: what the robot knows: the map, or what its scanner has seen
GOAL = (10.0, 0.0, 0.0)  #: pose of the goal, seen from the start [m, m, rad]
GOAL_RADIUS = 1.0  #: distance from the goal from which on it is reached [m]
TIME_LIMIT = 50.0  #: time after which a drive has failed [s]
BEST_SPEED = 2.0  #: speed that counts as the fastest [m/s]
FACTORS = (2.0, 8.0)  #: multiples of the best time between which a time counts
FIELD = (2.75, 7.25)  #: extent of the field of posts along x [m]
HALF_WIDTH = 2.25  #: half of the corridor's width [m]
FILLS, SMOOTHINGS = (0.15, 0.18, 0.21, 0.24), (2, 3, 4)  #: of the automaton; all combinations
SPARE = 0.06  #: by how much the passage is wider than what the robot needs in any heading [m]
WALL = 0.1  #: thickness of the walls [m]
EDGE = 0.1  #: edge of a cell of the search for the shortest path [m]
RESOLUTION = 0.05  #: edge of a cell of the known map [m]
TRACK_LIFETIME = 0.5  #: time for which what moves is remembered without another observation [s]
JACKAL_SIZE: dict[str, Any] = {
    "wheels.x": [0.131, 0.131, -0.131, -0.131],
    "wheels.y": [0.187, -0.187, 0.187, -0.187],
    "body.mass": 17.0,
    "body.inertia": 0.6,
    "body.length": 0.508,
    "body.width": 0.43,
    "motor.gear_ratio": 12.0,
    "motor.max_speed": 40.0,
    "limits.linear_velocity": 2.0,
    "limits.linear_acceleration": 2.5,
    "limits.linear_deceleration": 2.5,
}  #: What a Mecanum robot of the size and the speed of a Clearpath Jackal has other than `ig42`


@dataclass(frozen=True)
class ClutterRun:
    """Result of a drive."""

    seed: int  #: seed of the world
    reached: bool  #: whether the goal was reached without contact
    touched: tuple[str, ...]  #: what the robot has touched
    seconds: float  #: duration of the drive [s]
    best_time: float  #: length of the shortest path to the goal over `BEST_SPEED` [s]
    cycle_times: tuple[float, ...] = ()  #: CPU times of the planner's cycles [s]

    @property
    def score(self) -> float:
        """Score of the drive in the BARN Challenge, 0 to 0.5."""
        low, high = (factor * self.best_time for factor in FACTORS)
        return float(self.reached) * self.best_time / min(max(self.seconds, low), high)


def clutter_world(seed: int, robot: Platform) -> tuple[Scene, float]:
    """Return a world through which the robot gets in any heading, and its best time [s].

    The start is at the origin of the scene.
    """
    half = np.array([robot.body.length, robot.body.width]) / 2.0
    kind = seed % (len(FILLS) * len(SMOOTHINGS))
    field = Clutter(
        name="post",
        seed=seed,
        fill=FILLS[kind % len(FILLS)],
        smoothing=SMOOTHINGS[kind // len(FILLS)],
        x_min=FIELD[0],
        x_max=FIELD[1],
        y_min=-HALF_WIDTH,
        y_max=HALF_WIDTH,
        passage=2.0 * math.hypot(*half) + SPARE,
    )
    posts = clutter_posts(field)
    aside = HALF_WIDTH + 0.5 * WALL
    ends = (-1.5, GOAL[0] + 1.5)
    walls = (
        Wall(name="left", x=ends, y=(aside, aside), thickness=WALL),
        Wall(name="right", x=ends, y=(-aside, -aside), thickness=WALL),
    )
    places = np.array([[post.x, post.y] for post in posts]).reshape(-1, 2)
    length = shortest_length(places, field.radius + float(half.min()))
    return Scene(walls=walls, posts=posts), length / BEST_SPEED


def shortest_length(posts: Array, reach: float) -> float:
    """Return the length of the shortest path from start to goal around posts (n, 2) [m]."""
    columns, rows = round(GOAL[0] / EDGE) + 1, 2 * round((HALF_WIDTH - EDGE) / EDGE) + 1
    x = EDGE * np.arange(columns)
    y = EDGE * (np.arange(rows) - rows // 2)
    blocked = np.zeros((columns, rows), dtype=bool)
    for post in posts:
        blocked |= np.hypot(x[:, None] - post[0], y[None, :] - post[1]) < reach
    moves = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1]
    start, goal = (0, rows // 2), (columns - 1, rows // 2)
    best = {start: 0.0}
    queue = [(0.0, start)]
    while queue:
        length, (column, row) = heapq.heappop(queue)
        if (column, row) == goal:
            return length
        if length > best[column, row]:
            continue
        for i, j in moves:
            place = column + i, row + j
            inside = 0 <= place[0] < columns and 0 <= place[1] < rows
            if not inside or blocked[place]:
                continue
            longer = length + EDGE * math.hypot(i, j)
            if longer < best.get(place, math.inf):
                best[place] = longer
                heapq.heappush(queue, (longer, place))
    return math.inf


class ScannerSenses:
    """Obstacles and map of a planner by one laser scanner of 270 degrees, 720 beams and 10 m."""

    def __init__(self, robot: Platform, seed: int) -> None:
        self._mounting = ScannerParameters(
            x=0.4 * robot.body.length,
            field_of_view=1.5 * math.pi,
            range_max=10.0,
            noise=0.01,
            sees_robot=False,
        )
        self._seed = seed
        self._scanned: ScannedSurroundings | None = None

    def add_pose(self, loop: MpcLoop) -> None:
        """Pass the odometry of the latest tick on."""
        world = loop.loop.world
        assert world is not None
        if self._scanned is None:
            self._scanned = ScannedSurroundings(world, [self._mounting], self._seed)
        measured = loop.measured()
        self._scanned.add_pose(measured.time, measured.pose, measured.twist)

    def observe(self, loop: MpcLoop) -> None:
        """Scan if it is time to, and tell the planner what was seen."""
        self.add_pose(loop)
        assert self._scanned is not None
        time = loop.measured().time
        seen = self._scanned.scan(time, loop.planner.footprint)
        for thing in seen or ():
            observation = Observation(
                key=("tracker", thing.number),
                time=time,
                x=thing.center[0],
                y=thing.center[1],
                angle=0.0,
                semi_axes=(thing.radius, thing.radius),
                lifetime=TRACK_LIFETIME,
                velocity=thing.velocity,
                velocity_deviation=math.sqrt(thing.covariance[2]),
            )
            loop.observed.add(observation, loop.now)
        if seen is not None and self._scanned.is_map_due(time):
            tracker = self._scanned.tracker
            origin = np.append(tracker.map.origin, 0.0)
            seen_map = OccupancyMap(tracker.occupancy(), tracker.map.resolution, origin)
            loop.planner.set_map(GridMap.of_occupancy(seen_map))


def drive_clutter(robot: Mapping[str, Any], seed: int, by_scanner: bool) -> ClutterRun:
    """Drive through a world until the goal is reached, something touched, or time is up."""
    parameters = build(PlannerParameters, robot)
    scene, best_time = clutter_world(seed, parameters.robot)
    senses = ScannerSenses(parameters.robot, seed) if by_scanner else None
    options = LoopOptions(
        timer=time.process_time,
        world=WorldChoice.of(robot, IDEAL, scene),
        observe=senses.observe if senses else None,
        on_tick=senses.add_pose if senses else None,
    )
    platform, simulation = build(PlatformParameters, robot), build(SimulationParameters, {})
    loop = MpcLoop(parameters, platform, simulation, options)
    if senses is None:
        known = occupancy(scene, RESOLUTION)
        origin = np.append(known.origin, 0.0)
        loop.planner.set_map(GridMap(known.occupied, known.resolution, origin))
    goal, since = np.array(GOAL), loop.now
    loop.drive(PoseGoal(goal))

    def is_near() -> bool:
        return bool(np.hypot(*(loop.loop.truth - goal)[:2]) <= GOAL_RADIUS)

    loop.run(TIME_LIMIT, until=lambda: bool(loop.touched) or is_near())
    return ClutterRun(
        seed=seed,
        reached=is_near() and not loop.touched,
        touched=tuple(loop.touched),
        seconds=loop.now - since - PERIOD,
        best_time=best_time,
        cycle_times=tuple(each.cycle_time for each in loop.cycles if each.cycle_time > 0.0),
    )


def figures(runs: Sequence[ClutterRun]) -> dict[str, Any]:
    """Return the figures of drives."""
    times = [run.seconds for run in runs if run.reached]
    return {
        "worlds": len(runs),
        "reached": len(times),
        "contacts": sum(bool(run.touched) for run in runs),
        "score": sum(run.score for run in runs) / len(runs),
        "mean_time_s": sum(times) / len(times) if times else None,
        "failed_seeds": [run.seed for run in runs if not run.reached],
        "cycle": cycle_figures([run.cycle_times for run in runs]),
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench clutter`; return 0, the exit code of a successful measurement."""
    for extra in (WORLD, TRACKING):
        if not extra.is_available:
            raise CommandError(extra.hint)
    worlds = args.worlds or (QUICK_WORLDS if args.quick else WORLDS)
    sweep = Sweep.of(args)
    robot = dict(robot_parameters(resolve_robot("ig42")))
    robots = {"jackal_size": {**robot, **JACKAL_SIZE}, "ig42": robot}
    conditions = {"first_seed": args.seed, **sweep.conditions}
    result: dict[str, Any] = {"quick": args.quick, "conditions": conditions, "drives": {}}
    for name, values in robots.items():
        for sense in SENSES:
            say(f"{name}, {sense}, {worlds} worlds ...")
            seeds = range(args.seed, args.seed + worlds)
            drive = partial(drive_clutter, values, by_scanner=sense == "scanner")
            runs = sweep.collect(drive, seeds)
            result["drives"][f"{name} {sense}"] = figures(runs)
    return conclude("clutter", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = []
    for name, each in result["drives"].items():
        mean = each["mean_time_s"]
        values = (
            f"{each['reached']} of {each['worlds']}",
            f"{each['contacts']}",
            f"{each['score']:.3f}",
            "-" if mean is None else f"{mean:.2f} s",
            spread_text(each["cycle"]),
        )
        rows.append(Figure(name, values))
    found = result["drives"][AIMED]
    aimed = [
        at_least(f"{AIMED}: reached", found["reached"], found["worlds"]),
        at_most("contacts", found["contacts"], 0),
        at_least("score", found["score"], SCORE_AIM),
        at_most("mean time", found["mean_time_s"] or math.inf, TIME_AIM, "{:.2f} s"),
    ]
    titles = ("reached", "contacts", "score", "mean time", "CPU of a cycle: median, p99, max")
    return [BenchmarkTable(titles, rows), BenchmarkTable(("value",), aimed)]
