"""`omniman bench crowd`: the planner among 20 discs, beside ORCA and a dynamic window.

The drives are in simulated time, and each answer takes in it what it took of CPU time. The planner
drives the plant and sees the discs with noise; the others are kinematic and know all.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.console.terminal import say
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    cycle_figures,
    spread_text,
)
from omniman_ros.lab.studies.crowd_baselines import (
    KinematicRobot,
    Method,
    OnTick,
    dynamic_window,
    orca,
)
from omniman_ros.lab.studies.crowds import HALF, RADIUS, ContactJudge, DiscCrowd
from omniman_ros.lab.studies.mpc_loop import PLANNER_PERIOD, LoopOptions, MpcLoop
from omniman_ros.lab.studies.mppi_baseline import Mppi
from omniman_ros.lab.studies.scene_geometry import MovingObstacle
from omniman_ros.lab.sweep import Sweep
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

CROWDS, QUICK_CROWDS = 12, 1  #: number of crowds of each kind, and with `--quick`
SECONDS, QUICK_SECONDS = 60.0, 10.0  #: simulated duration of a drive, and with `--quick` [s]
DISCS = 20  #: number of discs
KINDS = {"crossing": False, "giving way": True}  #: whether the discs of a crowd give way
PLANNER = "planner"
#: Makes the methods beside the planner for a seed of their random choices
BASELINES: Mapping[str, Callable[[int], Method]] = {
    "orca": lambda _: orca,
    "dynamic window": lambda _: dynamic_window,
    "MPPI of Nav2": Mppi,
}
GOALS_AIM = 5.0  #: aim: least number of goals a minute in each kind of crowd
AT_REST_AIM = 1.0  #: aim: most contacts a minute at rest, among discs that see nobody
P99_AIM = 25.0  #: aim: largest 99th percentile of the CPU time of a cycle [ms]
GOAL_HALF = 3.5  #: half edge of the square of the goals [m]
GOAL_DISTANCE = 4.0  #: least distance between two goals in a row [m]
NOISE = 0.01  #: standard deviation of the positions that the planner observes [m]


def goal_poses(seed: int) -> Iterator[Array]:
    """Yield the goals (3,) of a drive [m, m, rad], the same for all methods."""
    random, place = np.random.default_rng([seed, 1]), np.zeros(2)
    while True:
        other: Array = random.uniform(-GOAL_HALF, GOAL_HALF, 2)
        if math.dist(place, other) >= GOAL_DISTANCE:
            place = other
            yield np.append(place, random.uniform(-math.pi, math.pi))


class PlannedRobot:
    """A robot on the plant that the planner drives; it sees the discs with noise."""

    def __init__(
        self,
        robot: Mapping[str, Any],
        crowd: DiscCrowd,
        seed: int,
        timer: Callable[[], float],
        on_tick: OnTick,
    ) -> None:
        def place(k: int, _time: float) -> Array:
            position: Array = crowd.positions[k]
            return position

        def tick(loop: MpcLoop) -> None:
            pose = loop.loop.truth
            on_tick(pose, se2.to_world(pose[2], np.array(loop.loop.controller.odometry.twist)))

        discs = range(len(crowd.positions))
        options = LoopOptions(
            obstacles=[MovingObstacle((RADIUS, RADIUS), partial(place, k)) for k in discs],
            noise=NOISE,
            seed=seed,
            timer=timer,
            timed=True,
            on_tick=tick,
        )
        parameters, platform = build(PlannerParameters, robot), build(PlatformParameters, robot)
        self._loop = MpcLoop(parameters, platform, build(SimulationParameters, {}), options)

    @property
    def now(self) -> float:
        """Present time of the simulation [s]."""
        return self._loop.now

    @property
    def cycle_times(self) -> list[float]:
        """CPU times of the cycles in which the planner planned [s]."""
        return [each.cycle_time for each in self._loop.cycles if each.cycle_time > 0.0]

    def reach(self, pose: Array, end: float) -> bool:
        """Drive to a pose (3,) until a time [s]; return whether the robot rests there.

        The goal is sent until the planner accepts it, and again if the planner gives it up.
        """
        loop, accepted = self._loop, False
        while loop.now < end:
            if not accepted or loop.planner.state is PlannerState.IDLE:
                accepted = self._accepts(pose)
            loop.cycle()
            if accepted and loop.planner.state is PlannerState.ARRIVED:
                return True
        return False

    def _accepts(self, pose: Array) -> bool:
        try:
            self._loop.drive(PoseGoal(pose))
        except InputError:  # somebody stands there
            return False
        return True


@dataclass(frozen=True)
class CrowdRun:
    """Result of a drive in a crowd."""

    seconds: float  #: duration [s]
    goals: int  #: number of goals that were reached
    contacts: int  #: number of contacts in which the robot moved
    contacts_at_rest: int  #: number of contacts with the robot at rest
    cycle_times: tuple[float, ...]  #: CPU times of the cycles [s]


def drive_in_crowd(
    robot: Mapping[str, Any],
    kind: str,
    method: str,
    seed: int,
    seconds: float,
    count: int,
    timer: Callable[[], float] = time.process_time,
) -> CrowdRun:
    """Drive from goal to goal in a kind of crowd by a method, whose answers the timer measures."""
    edges = {"x_min": -HALF, "y_min": -HALF, "x_max": HALF, "y_max": HALF}
    values = {**robot, **{f"workspace.{name}": edge for name, edge in edges.items()}}
    parameters = build(PlannerParameters, values)
    body, crowd = parameters.robot.body, DiscCrowd(count, seed, gives_way=KINDS[kind])
    judge = ContactJudge(np.array([body.length, body.width]) / 2.0)

    def tick(pose: Array, velocity: Array) -> None:
        crowd.advance(body.outline_at(pose), velocity[:2])
        judge.add(pose, velocity, crowd.positions)

    driven: PlannedRobot | KinematicRobot
    if method == PLANNER:
        driven = PlannedRobot(values, crowd, seed, timer, tick)
    else:
        driven = KinematicRobot(parameters, BASELINES[method](seed), crowd, timer, tick)
    begin, goals = driven.now, 0
    for pose in goal_poses(seed):
        goals += driven.reach(pose, begin + seconds)
        if driven.now >= begin + seconds:
            break
    times = tuple(driven.cycle_times)
    return CrowdRun(driven.now - begin, goals, judge.moving, judge.at_rest, times)


def figures(runs: Sequence[CrowdRun]) -> dict[str, Any]:
    """Return the figures of drives."""
    minutes = sum(run.seconds for run in runs) / 60.0
    times = [taken for run in runs for taken in run.cycle_times]
    goals = [run.goals for run in runs]
    at_rest = sum(run.contacts_at_rest for run in runs)
    return {
        "crowds": len(runs),
        "minutes": minutes,
        "goals": goals,
        "goals_per_minute": sum(goals) / minutes,
        "contacts": sum(run.contacts for run in runs),
        "contacts_at_rest": at_rest,
        "contacts_at_rest_per_minute": at_rest / minutes,
        "cycle": cycle_figures([run.cycle_times for run in runs]),
        "late_share": sum(taken > PLANNER_PERIOD for taken in times) / len(times),
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench crowd`; return 0, the exit code of a successful measurement."""
    crowds = args.worlds or (QUICK_CROWDS if args.quick else CROWDS)
    seconds = QUICK_SECONDS if args.quick else SECONDS
    sweep = Sweep.of(args)
    robot = dict(robot_parameters(resolve_robot("ig42")))
    conditions = {"discs": DISCS, "seconds": seconds, "first_seed": args.seed}
    conditions |= sweep.conditions
    result: dict[str, Any] = {"quick": args.quick, "conditions": conditions, "drives": {}}
    for kind in KINDS:
        found = result["drives"][kind] = {}
        for method in (PLANNER, *BASELINES):
            say(f"{method}, {crowds} crowds of {DISCS}, {kind} ...")
            seeds = range(args.seed, args.seed + crowds)
            drive = partial(drive_in_crowd, robot, kind, method, seconds=seconds, count=DISCS)
            found[method] = figures(sweep.collect(drive, seeds))
    return conclude("crowd", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows, aimed = [], []
    for kind, methods in result["drives"].items():
        for method, each in methods.items():
            values = (
                f"{each['goals_per_minute']:.1f}",
                f"{each['contacts']} / {each['contacts_at_rest']}",
                spread_text(each["cycle"]),
                f"{each['late_share']:.1%}",
            )
            rows.append(Figure(f"{kind}: {method}", values))
        found = methods[PLANNER]
        aimed += [
            at_least(f"{kind}: goals a minute", found["goals_per_minute"], GOALS_AIM),
            at_most(f"{kind}: contacts in motion", found["contacts"], 0),
            at_most(f"{kind}: p99 of a cycle", found["cycle"]["p99_ms"], P99_AIM, "{:.0f} ms"),
            at_most(f"{kind}: cycles above the period", found["late_share"], 0.0, "{:.2%}"),
        ]
        if not KINDS[kind]:
            rate = found["contacts_at_rest_per_minute"]
            aimed.append(at_most(f"{kind}: contacts at rest a minute", rate, AT_REST_AIM))
    titles = ("goals a minute", "contacts in motion / at rest", "CPU of a cycle", "above 50 ms")
    return [BenchmarkTable(titles, rows), BenchmarkTable(("value",), aimed)]
