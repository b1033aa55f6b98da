"""`omniman bench world`: how fast the physics world runs, and what its node and a scan cost.

All times are CPU times, of this process and of the node's, as the machine may be busy with other
work.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.extras import WORLD
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.bench.world_node import NODE, node_share
from omniman_ros.lab.measurement import best_cpu
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.parameters import IDEAL, ROLLERS

SCENE = "corridor"  # scene of the measurement: a corridor with four persons
SPEED = 0.3  # speed at the wheels' rims [m/s]; the robot drives to its side and back
REVERSAL = 0.5  # time between two changes of direction [s]
PERIOD = 0.005  # period of the commands [s]
SCAN_RATE = 40.0  # rate of the scans whose share of a core is computed [Hz]
AIMS = {IDEAL: 6.0, ROLLERS: 5.0}
"""Smallest speed of the simulation over real time, by the kind of wheels."""
SCAN_AIM = 2.0  # largest share of a core for the scans [%]
NODE_AIM = 30.0  # largest share of a core for the node in real time [%]


def real_time_factor(drives: SimulatedDrives, direction: Any, seconds: float) -> float:
    """Return how much faster than real time drives run on their body.

    It is the best of three runs that follow one another.

    Args:
        direction: Wheel speeds (n,) of a motion to the robot's left at `SPEED` [rad/s].
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
    """Measure the plant and the world on both kinds of wheels.

    Returns:
        Speeds over real time, and the CPU time of a scan.
    """
    # The command line must do without the engine.
    from omniman_ros.simulation.world.parameters import WorldParameters
    from omniman_ros.simulation.world.scanner import Scanner
    from omniman_ros.simulation.world.scanner_parameters import ScannerParameters
    from omniman_ros.simulation.world.world import World

    description = build(DescriptionParameters, robot)
    simulation = build(SimulationParameters, robot)
    wheels = description.robot.wheels
    angles = np.add(wheels.heading, wheels.roller_angle)
    grip = np.multiply(wheels.radius, np.cos(wheels.roller_angle))
    sideways = SPEED * np.sin(angles) / grip
    scene = load_scene(SCENE)
    result: dict[str, Any] = {"factor": {}}
    plant = SimulatedDrives(description.robot, simulation)
    result["factor"]["plant"] = real_time_factor(plant, sideways, seconds)
    for kind in (IDEAL, ROLLERS):
        parameters = build(WorldParameters, {"wheels": kind})
        world = World(description, simulation, parameters, scene)
        drives = SimulatedDrives(description.robot, simulation, body=world)
        result["factor"][kind] = real_time_factor(drives, sideways, seconds)
    scanner = Scanner(world, build(ScannerParameters, {}))
    cpu_time = best_cpu(scanner.scan, 0.1 * seconds)
    result["scan"] = {
        "beams": len(scanner.angles),
        "cpu_us": 1e6 * cpu_time,
        "core_percent": 100.0 * SCAN_RATE * cpu_time,
    }
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench world`; return 0, the exit code of a successful measurement."""
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    say("plant, ideal wheels, rollers and scans ...")
    name = resolve_robot(args.robot)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "scene": SCENE}
    result |= measure(load_robot(name), 0.5 if args.quick else 5.0)
    result["node"] = {}
    for kind in (IDEAL, ROLLERS):
        say(f"{NODE} in a running robot, {kind} ...")
        share = node_share(name, SCENE, kind, 2.0 if args.quick else 15.0, SPEED)
        result["node"][kind] = asdict(share)
    return conclude("world", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether a result meets each aim."""
    met = {
        f"{kind} at least {aim:g} times real time": result["factor"][kind] >= aim
        for kind, aim in AIMS.items()
    }
    met |= {
        f"{NODE}, {kind}, at most {NODE_AIM:g} % of a core": (
            max(share["rest"], share["driving"]) <= NODE_AIM
        )
        for kind, share in result["node"].items()
    }
    label = f"scans at {SCAN_RATE:g} Hz at most {SCAN_AIM:g} % of a core"
    return {**met, label: result["scan"]["core_percent"] <= SCAN_AIM}


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    scan = result["scan"]
    rows: Rows = [("", "value", "aim")]
    for name, text in (
        ("plant", "plant, drives included"),
        (IDEAL, "world on ideal wheels"),
        (ROLLERS, "world on rollers"),
    ):
        aim = f"{AIMS[name]:g}" if name in AIMS else ""
        rows.append((f"{text}, times real time", f"{result['factor'][name]:.1f}", aim))
    for kind, share in result["node"].items():
        figures = f"{share['rest']:.1f} %, {share['driving']:.1f} %"
        rows.append((f"{NODE}, {kind}: at rest, driving", figures, f"{NODE_AIM:g} %"))
    rows.append((f"scan of {scan['beams']} beams, CPU", f"{scan['cpu_us']:.0f} us", ""))
    share = f"{scan['core_percent']:.2f} %"
    rows.append((f"  at {SCAN_RATE:g} Hz, share of a core", share, f"{SCAN_AIM:g} %"))
    missed = [label for label, is_met in result["aims"].items() if not is_met]
    return [*tables(rows), f"aims missed: {', '.join(missed) if missed else 'none'}"]
