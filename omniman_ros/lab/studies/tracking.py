"""People who walk, stop, turn and pass behind each other, and how well the tracker follows them.

The physics world moves them and measures the scans. The judge knows the true discs and the beams
only: whom the scanner sees follows from the distance of each beam to each disc, and shares no code
with the tracker.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.studies.tracking_judge import Sighting, TrackingJudge
from omniman_ros.perception.obstacle_tracker import ObstacleTracker
from omniman_ros.perception.parameters import MapParameters, TrackerParameters
from omniman_ros.perception.scan import Scan
from omniman_ros.planning.obstacles.tracking import TrackingParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from omniman_ros.simulation.world.parameters import IDEAL, WorldParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
from omniman_ros.simulation.world.scene import REACTIVE, Crate, Person, Post, Scene, Table, Wall

HALF = 5.0  # half edge of the square room [m]
RADIUS = 0.25  # radius of a person [m]
SPACE = 1.3
"""Distance of way points and of what stands from the robot's place and from each other [m]."""
STAND = 0.05  # time for which a person stands at each repetition of a way point [s]
PERIOD = 0.05  # period of the scans [s]
TICK = 0.01  # period of the odometry [s]
SWAY = (0.25, 0.5)  # largest speed of a robot that drives [m/s] and its turn rate [rad/s]
WIDE = 4.71  # field of view of the scanner [rad]: 270 degrees


@dataclass(frozen=True)
class TrackingCase:
    """A scene, and whether the robot drives in it.

    Attributes:
        behaviour: Whether the persons give way, or turn on the spot and run into each other.
    """

    seed: int  # seed of all random choices
    persons: int = 6  # number of persons
    drives: bool = False  # whether the robot drives to and fro and turns; else it stands
    noise: float = 0.01  # standard deviation of a range [m]
    dropouts: float = 0.002  # share of lost beams
    behaviour: str = REACTIVE


@dataclass
class TrackingRun:
    """What a case has shown."""

    judge: TrackingJudge  # the judge with its figures
    cpu: list[float] = field(default_factory=list)  # CPU time of each scan [s]


def tracking_scene(case: TrackingCase) -> Scene:
    """Return the room of a case: walls, posts, tables, crates, and persons on random ways.

    Each person walks at an own speed through way points, and stands for up to 2 s at some.
    """
    rng = np.random.default_rng(case.seed)
    taken: list[Array] = [np.zeros(2)]

    def free_place() -> tuple[float, float]:
        for _ in range(200):
            place = rng.uniform(-HALF + 0.8, HALF - 0.8, 2)
            if min(float(np.hypot(*(place - other))) for other in taken) > SPACE:
                break
        taken.append(place)
        return float(place[0]), float(place[1])

    posts = tuple(
        Post(name=f"post {k}", x=x, y=y, radius=float(rng.uniform(0.05, 0.2)))
        for k, (x, y) in enumerate(free_place() for _ in range(5))
    )
    x, y = free_place()
    table = Table(name="table", x=x, y=y, yaw=float(rng.uniform(0.0, 3.0)))
    x, y = free_place()
    crate = Crate(name="crate", x=x, y=y, yaw=float(rng.uniform(0.0, 3.0)))
    corners = [(-HALF, -HALF), (HALF, -HALF), (HALF, HALF), (-HALF, HALF), (-HALF, -HALF)]
    xs, ys = zip(*corners, strict=True)
    walls = (
        Wall(name="room", x=xs, y=ys),
        Wall(name="screen", x=(2.2, 2.2), y=(2.0, 3.4), thickness=0.1),
    )
    persons = []
    for k in range(case.persons):
        way: list[tuple[float, float]] = []
        for _ in range(5):
            place = free_place_for_person(rng, [*posts, table, crate])
            way += [place] * (1 + int(rng.random() < 0.4) * int(rng.uniform(0.5, 2.0) / STAND))
        speed = float(rng.uniform(0.6, 1.4))
        px, py = zip(*way, strict=True)
        persons.append(
            Person(
                name=f"person {k}",
                x=px,
                y=py,
                speed=speed,
                radius=RADIUS,
                behaviour=case.behaviour,
            )
        )
    return Scene(
        walls=walls,
        posts=posts,
        tables=(table,),
        crates=(crate,),
        persons=tuple(persons),
    )


def free_place_for_person(rng: np.random.Generator, things: list[Any]) -> tuple[float, float]:
    """Return a way point beside the robot's place and what stands."""
    while True:
        x, y = rng.uniform(-HALF + 0.7, HALF - 0.7, 2).tolist()
        away = min(math.hypot(x - thing.x, y - thing.y) for thing in things)
        if math.hypot(x, y) > 1.5 and away > 0.9 and math.hypot(x - 2.2, y - 2.7) > 1.1:
            return x, y


def run_case(
    case: TrackingCase,
    robot: Mapping[str, Any],
    seconds: float,
    parameters: TrackerParameters | None = None,
    motion: TrackingParameters | None = None,
) -> TrackingRun:
    """Let people walk around a robot, and track them by its scans."""
    # The command line must do without the engine.
    from omniman_ros.simulation.world.scanner import Scanner
    from omniman_ros.simulation.world.world import World

    description = build(DescriptionParameters, robot)
    simulation = build(SimulationParameters, robot)
    scene = tracking_scene(case)
    world = World(description, simulation, build(WorldParameters, {"wheels": IDEAL}), scene)
    drives = SimulatedDrives(description.robot, simulation, case.seed, world)
    wheels = description.robot.wheels
    mounting = ScannerParameters(
        field_of_view=WIDE, noise=case.noise, dropouts=case.dropouts, sees_robot=False, x=0.3
    )
    scanner = Scanner(world, mounting, case.seed)
    tracker = ObstacleTracker(
        parameters or TrackerParameters(), MapParameters(), motion or TrackingParameters()
    )
    own = BodyOutline(description).footprint(np.zeros((1, 6)), 0.05)
    run = TrackingRun(TrackingJudge(statics=statics(scene)))
    angles = np.add(wheels.heading, wheels.roller_angle)
    grip = np.multiply(wheels.radius, np.cos(wheels.roller_angle))
    x, y = np.array(wheels.x), np.array(wheels.y)
    inverse = np.column_stack(
        (np.cos(angles), np.sin(angles), x * np.sin(angles) - y * np.cos(angles))
    )
    drives.advance(0.0)
    every = round(PERIOD / TICK)
    for tick in range(1, round(seconds / TICK) + 1):
        now = tick * TICK
        twist = np.zeros(3)
        if case.drives:
            side = math.sin(0.7 * now)
            twist = np.array([SWAY[0] * side, 0.1 * math.cos(0.5 * now), SWAY[1] * side])
        drives.command_velocity(inverse @ twist / grip, None, now - TICK)
        drives.advance(now)
        theta = float(world.pose[2])
        c, s = math.cos(theta), math.sin(theta)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        tracker.add_pose(now, world.pose, turn @ world.twist)
        if tick % every:
            continue
        ranges = scanner.scan()
        assert ranges is not None
        scan = Scan(
            now,
            ranges,
            -0.5 * WIDE,
            WIDE / (mounting.beams - 1),
            mounting.range_max,
            (mounting.x, mounting.y, mounting.yaw),
            heights=(mounting.z, mounting.z),
        )
        begin = time.process_time()
        tracker.add_scan(scan, own)
        obstacles = tracker.obstacles(now)
        run.cpu.append(time.process_time() - begin)
        truth = np.array([[*thing.pose[:2], *thing.velocity] for thing in world.obstacles])
        origin = world.pose[:2] + turn[:2, :2] @ (mounting.x, mounting.y)
        directions = theta + scanner.angles
        people = truth[: case.persons]
        run.judge.judge(now, Sighting(origin, directions, ranges), people, RADIUS, obstacles)
    run.judge.finish()
    return run


def statics(scene: Scene) -> int:
    """Return the number of things that stand in a scene."""
    return len(scene.walls) + len(scene.posts) + 4 * len(scene.tables) + len(scene.crates)
