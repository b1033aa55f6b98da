"""`omniman bench tracker`: how well people are tracked by laser scans, and what it costs.

The physics world moves the people and measures the scans; the judge knows the true discs and the
beams. Times are CPU times of this process.
"""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.extras import TRACKING, WORLD
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    spread_text,
)
from omniman_ros.lab.bench.tracking_judge import TrackingJudge
from omniman_ros.lab.measurement import spread_ms
from omniman_ros.lab.studies.scanned_surroundings import new_tracker, scan_of
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from omniman_ros.simulation.world.parameters import IDEAL, WorldParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
from omniman_ros.simulation.world.scene import (
    REACTIVE,
    SCRIPTED,
    Crate,
    Person,
    Post,
    Scene,
    Wall,
)
from omniman_ros.simulation.world.scene import (
    Table as TableTop,
)

SCENES = 12  #: number of scenes of people who give way; the robot drives in half of them
SUDDEN_SHARE = 1 / 3  #: number of scenes of people who turn on the spot, relative to that
PERSONS, CROWD = 6, 20  #: number of persons in a scene, and where the CPU time is measured
SECONDS = 30.0  #: simulated duration of a scene [s]
VELOCITY_AIM = (
    0.1  #: aim: largest RMS error of the velocity from 0.5 s after the first sight [m/s]
)
FALSE_AIM = 0.01  #: aim: largest fraction of standing things reported as moving for over 0.5 s
IDENTITY_AIM = 0.95  #: aim: least fraction of crossings after which the identity is the same
CPU_AIM = 0.25  #: aim: largest fraction of a core for 720 beams at 20 Hz with 20 people
HALF = 5.0  #: half edge of the square room [m]
RADIUS = 0.25  #: radius of a person [m]
SPACE = 1.3  #: distance of what stands from the robot's place and from each other [m]
STAND = 0.05  #: time for which a person stands at each repetition of a way point [s]
PERIOD, TICK = 0.05, 0.01  #: periods of scans and odometry [s]
SWAY = (0.25, 0.5)  #: largest speed of a robot that drives [m/s] and its turn rate [rad/s]
WIDE = 4.71  #: field of view of the scanner [rad]: 270 degrees


@dataclass(frozen=True)
class TrackerCase:
    """A scene, and whether the robot drives in it."""

    seed: int  #: of all random choices
    persons: int = PERSONS
    behaviour: str = REACTIVE  #: give way, or turn on the spot and run into each other

    @property
    def drives(self) -> bool:
        """Whether the robot drives to and fro and turns; else it stands."""
        return self.seed % 2 == 1


@dataclass
class TrackerRun:
    """What a case has shown."""

    judge: TrackingJudge
    cpu: list[float] = field(default_factory=list)  #: CPU time of each scan [s]


def tracking_scene(case: TrackerCase) -> Scene:
    """Return the room of a case: walls, posts, a table, a crate, and persons on random ways.

    Each person walks at an own speed through way points, and stands for up to 2 s at some.
    """
    rng = np.random.default_rng(case.seed)
    taken: list[Array] = [np.zeros(2)]

    def free_place() -> dict[str, float]:
        for _ in range(200):
            place = rng.uniform(-HALF + 0.8, HALF - 0.8, 2)
            if min(float(np.hypot(*(place - other))) for other in taken) > SPACE:
                break
        taken.append(place)
        return {"x": float(place[0]), "y": float(place[1])}

    def way_point() -> tuple[float, float]:
        while True:
            x, y = rng.uniform(-HALF + 0.7, HALF - 0.7, 2).tolist()
            away = min(math.hypot(x - thing.x, y - thing.y) for thing in things)
            if math.hypot(x, y) > 1.5 and away > 0.9 and math.hypot(x - 2.2, y - 2.7) > 1.1:
                return x, y

    posts = tuple(
        Post(name=f"post {k}", **free_place(), radius=float(rng.uniform(0.05, 0.2)))
        for k in range(5)
    )
    table = TableTop(name="table", **free_place(), yaw=float(rng.uniform(0.0, 3.0)))
    crate = Crate(name="crate", **free_place(), yaw=float(rng.uniform(0.0, 3.0)))
    things: list[Any] = [*posts, table, crate]
    room = (-HALF, HALF, HALF, -HALF, -HALF), (-HALF, -HALF, HALF, HALF, -HALF)
    walls = (
        Wall(name="room", x=room[0], y=room[1]),
        Wall(name="screen", x=(2.2, 2.2), y=(2.0, 3.4), thickness=0.1),
    )
    persons = []
    for k in range(case.persons):
        way: list[tuple[float, float]] = []
        for _ in range(5):
            place = way_point()
            way += [place] * (1 + int(rng.random() < 0.4) * int(rng.uniform(0.5, 2.0) / STAND))
        x, y = zip(*way, strict=True)
        person = {"speed": float(rng.uniform(0.6, 1.4)), "radius": RADIUS}
        persons.append(Person(name=f"person {k}", x=x, y=y, **person, behaviour=case.behaviour))
    return Scene(
        walls=walls, posts=posts, tables=(table,), crates=(crate,), persons=tuple(persons)
    )


def run_case(case: TrackerCase, robot: Mapping[str, Any], seconds: float) -> TrackerRun:
    """Let people walk around a robot, and track them by its scans."""
    # The command line must do without the engine.
    from omniman_ros.simulation.world.scanner import Scanner
    from omniman_ros.simulation.world.world import World

    say(f"scene {case.seed}, {case.persons} persons ...")
    description = build(DescriptionParameters, robot)
    simulation, scene = build(SimulationParameters, robot), tracking_scene(case)
    world = World(description, simulation, build(WorldParameters, {"wheels": IDEAL}), scene)
    drives = SimulatedDrives(description.robot, simulation, case.seed, world)
    inverse = PlatformKinematics(description.robot.wheels).J
    mounting = ScannerParameters(
        field_of_view=WIDE, noise=0.01, dropouts=0.002, sees_robot=False, x=0.3
    )
    scanner, tracker = Scanner(world, mounting, case.seed), new_tracker()
    own = BodyOutline(description).footprint(np.zeros((1, 6)), 0.05)
    standing = len(scene.walls) + len(scene.posts) + 4 * len(scene.tables) + len(scene.crates)
    run = TrackerRun(TrackingJudge(standing))
    drives.advance(0.0)
    for tick in range(1, round(seconds / TICK) + 1):
        now = tick * TICK
        side = math.sin(0.7 * now)
        twist = np.array([SWAY[0] * side, 0.1 * math.cos(0.5 * now), SWAY[1] * side])
        drives.command_velocity(inverse @ (case.drives * twist), None, now - TICK)
        drives.advance(now)
        theta = float(world.pose[2])
        tracker.add_pose(now, world.pose, se2.to_world(theta, world.twist))
        if tick % round(PERIOD / TICK):
            continue
        scan = scan_of(scanner, now)
        begin = time.process_time()
        tracker.add_scan(scan, own)
        obstacles = tracker.obstacles(now)
        run.cpu.append(time.process_time() - begin)
        people = np.array([[*thing.pose[:2], *thing.velocity] for thing in world.obstacles])
        offset = se2.to_world(theta, np.array([mounting.x, mounting.y, 0.0]))
        beams = world.pose[:2] + offset[:2], theta + scanner.angles, scan.ranges
        run.judge.judge(now, beams, people[: case.persons], RADIUS, obstacles)
    run.judge.finish()
    return run


def figures(runs: Sequence[TrackerRun]) -> dict[str, Any]:
    """Return the figures of cases."""
    judges = [run.judge for run in runs]
    walking = [error for judge in judges for error in judge.walking_errors]
    errors = [error for judge in judges for error in judge.errors]
    missed = sum(judge.missed for judge in judges)
    cpu = [each for run in runs for each in run.cpu]
    return {
        "scenes": len(runs),
        "velocity_rmse": _root_mean_square(errors),
        "walking_velocity_rmse": _root_mean_square(walking),
        "velocity_error_median": float(np.median(errors)) if errors else math.nan,
        "walking_missed_share": missed / max(missed + len(walking), 1),
        "static_things": sum(judge.statics for judge in judges),
        "false_movers": sum(len(judge.false_movers) for judge in judges),
        "crossings": sum(judge.crossings for judge in judges),
        "identities_kept": sum(judge.kept for judge in judges),
        "cpu": spread_ms(cpu),
        "cpu_share": float(np.mean(cpu)) / PERIOD,
    }


def _root_mean_square(errors: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else math.nan


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench tracker`; return 0, the exit code of a successful measurement."""
    for extra in (WORLD, TRACKING):
        if not extra.is_available:
            raise CommandError(extra.hint)
    robot = robot_parameters(resolve_robot(args.robot))
    scenes, seconds = (2, 10.0) if args.quick else (SCENES, SECONDS)
    sudden = range(max(1, round(scenes * SUDDEN_SHARE)))
    groups = {
        "people": [TrackerCase(seed) for seed in range(scenes)],
        "sudden": [TrackerCase(seed, behaviour=SCRIPTED) for seed in sudden],
        "crowd": [TrackerCase(100, CROWD)],
    }
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    for name, cases in groups.items():
        result[name] = figures([run_case(case, robot, seconds) for case in cases])
    return conclude("tracker", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    people, sudden, crowd = result["people"], result["sudden"], result["crowd"]
    rows = [
        at_most(f"velocity, RMSE, people {who}", each["velocity_rmse"], VELOCITY_AIM, "{:.3g} m/s")
        for who, each in (("who give way", people), ("who turn on the spot", sudden))
    ]
    walking = f"{people['walking_velocity_rmse']:.3f} m/s"
    rows.append(Figure("velocity, RMSE, who give way, while they walk", (walking,)))
    missed = f"{people['walking_missed_share']:.1%}"
    rows.append(Figure("walking and seen, but not reported", (missed,)))
    fractions = people["false_movers"] / people["static_things"], FALSE_AIM
    rows.append(at_most("standing things reported as moving", *fractions, "{:.1%}"))
    kept, of = people["identities_kept"], people["crossings"]
    about = f"identity kept in {of} crossings, who give way"
    rows.append(at_least(about, kept / of if of else None, IDENTITY_AIM, "{:.1%}"))
    kept = f"{sudden['identities_kept']} of {sudden['crossings']}"
    rows.append(Figure("identity kept, who turn on the spot", (kept,)))
    rows.append(at_most(f"share of a core, {CROWD} people", crowd["cpu_share"], CPU_AIM, "{:.1%}"))
    about = f"CPU of a scan, {CROWD} people: median, p99, max"
    rows.append(Figure(about, (spread_text(crowd["cpu"], 1),)))
    return [BenchmarkTable(("measured",), rows)]
