"""`omniman bench world`: how fast the physics world runs, and what its node and a scan cost.

The plant is its peer. All times are CPU times, of this process and of the node's, as the machine
may be busy with other work.
"""

import argparse
import math
import os
import time
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock

from omniman_ros.console.errors import CommandError
from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.terminal import say
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.extras import WORLD
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    at_least,
    at_most,
    conclude,
    running_nodes,
)
from omniman_ros.lab.measurement import best_cpu, cpu_time
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.parameters import IDEAL, ROLLERS

SCENE = "corridor"  #: scene of the measurement: a corridor with four persons
SPEED = 0.3  #: speed at which the robot drives [m/s]
REVERSAL = 0.5  #: time between two changes of direction [s]
PERIOD = 0.005  #: period of the commands [s]
SCAN_RATE = 40.0  #: rate of the scans whose fraction of a core is computed [Hz]
AIMS = {IDEAL: 6.0, ROLLERS: 5.0}  #: least speed over real time, by the kind of wheels
SCAN_AIM, NODE_AIM = 0.02, 0.3  #: largest fractions of a core for the scans, and for the node
NODE = "simulated_world"  #: the node that is measured
START_TIMEOUT = 60.0  #: longest time from the start of the nodes to simulated time [s]
WARM_UP = 4.0  #: simulated time up to the measurement: all nodes run, the robot rests [s]
CIRCLES = 3.0  #: angular frequency of the circles that the robot drives, without rotation [rad/s]


def real_time_factor(drives: SimulatedDrives, direction: Any, seconds: float) -> float:
    """Return how much faster than real time drives run on their body, the best of three runs.

    The robot goes at wheel speeds (n,) [rad/s] to one side and back.
    """
    best, tick = 0.0, 0
    drives.advance(0.0)
    for _ in range(3):
        begin = time.process_time()
        for _ in range(round(seconds / PERIOD)):
            side = 1.0 if int(tick * PERIOD / REVERSAL) % 2 == 0 else -1.0
            drives.command_velocity(side * direction, None, tick * PERIOD)
            tick += 1
            drives.wheel_states(tick * PERIOD)
        best = max(best, seconds / (time.process_time() - begin))
    return best


def measure(robot: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Measure the speed of plant and world over real time, and the CPU time of a scan."""
    # The command line must do without the engine.
    from omniman_ros.simulation.world.parameters import WorldParameters
    from omniman_ros.simulation.world.scanner import Scanner
    from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
    from omniman_ros.simulation.world.world import World

    description = build(DescriptionParameters, robot)
    simulation, scene = build(SimulationParameters, robot), load_scene(SCENE)
    sideways = PlatformKinematics(description.robot.wheels).J @ (0.0, SPEED, 0.0)
    plant = SimulatedDrives(description.robot, simulation)
    factor = {"plant": real_time_factor(plant, sideways, seconds)}
    for kind in (IDEAL, ROLLERS):
        world = World(description, simulation, build(WorldParameters, {"wheels": kind}), scene)
        drives = SimulatedDrives(description.robot, simulation, body=world)
        factor[kind] = real_time_factor(drives, sideways, seconds)
    scanner = Scanner(world, build(ScannerParameters, {}))
    taken = best_cpu(scanner.scan, 0.1 * seconds)
    scan = {"beams": len(scanner.angles), "cpu_us": 1e6 * taken, "core_share": SCAN_RATE * taken}
    return {"factor": factor, "scan": scan}


def node_shares(robot: str, wheels: str, seconds: float) -> dict[str, float]:
    """Measure the node among all nodes of `omniman up --world` but the viewer.

    The result is its CPU time per simulated time while the robot rests, and while it drives.
    """
    setup = RobotSetup(
        robot=robot, sim_time=True, world=SCENE, params=(f"world.wheels:={wheels}",)
    )
    specs = [spec for spec in robot_processes(setup) if spec.name != "viewer"]
    with running_nodes(specs) as nodes:
        pid, clock = nodes.children.pid(NODE), nodes.received(Clock, "/clock", 1)
        publisher = nodes.session.node.create_publisher(Twist, "cmd_vel", 1)

        def now() -> float:
            return time_seconds(clock[-1].clock) if clock else 0.0

        nodes.wait(lambda: now() > WARM_UP, START_TIMEOUT, "simulated time does not begin")

        def fraction(speed: float) -> float:
            def feed(_: float) -> None:
                angle = CIRCLES * now()
                twist = (speed * math.cos(angle), speed * math.sin(angle), 0.0)
                publisher.publish(twist_message(twist))

            begin, cpu = now(), cpu_time(pid)
            nodes.serve(seconds, feed)
            return (cpu_time(pid) - cpu) / (now() - begin)

        return {"rest": fraction(0.0), "driving": fraction(SPEED)}


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench world`; return 0, the exit code of a successful measurement."""
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    say("plant, ideal wheels, rollers and scans ...")
    name = resolve_robot(args.robot)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "scene": SCENE}
    result |= measure(robot_parameters(name), 0.5 if args.quick else 5.0)
    result["node"] = {}
    isolate_ros_domain(os.environ)
    for kind in (IDEAL, ROLLERS):
        say(f"{NODE} in a running robot, {kind} ...")
        result["node"][kind] = node_shares(name, kind, 2.0 if args.quick else 15.0)
    return conclude("world", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    factor, scan = result["factor"], result["scan"]
    rows = [Figure("plant, times real time", (f"{factor['plant']:.1f}",))]
    for kind, aim in AIMS.items():
        about = f"world on wheels: {kind}, times real time"
        rows.append(at_least(about, factor[kind], aim, "{:.1f}"))
    for kind, fractions in result["node"].items():
        for state, fraction in fractions.items():
            rows.append(at_most(f"{NODE}, {kind}, {state}", fraction, NODE_AIM, "{:.1%}"))
    rows.append(Figure(f"CPU of a scan of {scan['beams']} beams", (f"{scan['cpu_us']:.0f} us",)))
    rows.append(at_most(f"  at {SCAN_RATE:g} Hz", scan["core_share"], SCAN_AIM, "{:.2%}"))
    return [BenchmarkTable(("value",), rows)]
