"""`omniman bench collision`: CPU time of distances of the robot's parts, and of the monitor."""

import argparse
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.monitor import CollisionMonitor, MonitorParameters, RobotMotion
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.solids import UprightSolids
from omniman_ros.collision.surroundings import Surroundings
from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.bench.harness import Rows, conclude, tables
from omniman_ros.lab.measurement import best_cpu
from omniman_ros.nodes.collision_monitor_parameters import CollisionMonitorParameters
from omniman_ros.processes.robot_setup import resolve_robot
from omniman_ros.robots import load_robot

CONFIGURATIONS = 1000
"""Number of random configurations in a batch."""
SOLIDS = 20
"""Number of solids around the robot: half of them posts, half of them tables."""
REACH = 0.2
"""Distance above which a lower bound is enough [m]."""
AIM = 20.0
"""Aim: largest CPU time of the robot's distances from itself in a batch, without a load [ms]."""
MONITOR_AIM = 10.0
"""Aim: largest CPU time of a limit of the collision monitor, without a load [ms]."""
WALKING = 1.0
"""Largest speed of solids that move, along x and along y [m/s]."""
MOTION: Array = np.array([0.5, 0.1, 0.3, 0.2, 0.1, 0.0, 0.0, 0.0, 0.3])
"""Motion of platform and joints whose speed is limited [m/s, m/s, rad/s, rad/s ...]."""
POSTURE: Array = np.array([0.0, -1.57, 1.57, 0.0, 0.0, 0.0])
"""Joint angles of the arm meanwhile [rad]."""
TOOL = ToolShape(length=0.15)
"""Tool of the measurement."""
LOADS = {"empty": LoadShape(), "loaded": LoadShape(length=0.3, width=0.2, height=0.2)}
"""What the arm holds, by the name of the result."""


def surroundings(rng: np.random.Generator) -> UprightSolids:
    """Return random posts and tables within 3 m."""
    posts = [
        UprightSolids.cylinder(x, y, 0.15, (0.0, 1.5))
        for x, y in rng.uniform(-3.0, 3.0, (SOLIDS // 2, 2))
    ]
    tables = [
        UprightSolids.box((x, y, yaw), 1.2, 0.7, (0.7, 0.75))
        for x, y, yaw in rng.uniform(-3.0, 3.0, (SOLIDS - len(posts), 3))
    ]
    return UprightSolids.join([*posts, *tables])


def measure(robot: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Measure batches of configurations, with and without a load.

    Args:
        robot: Parameters of the robot by full name.
        seconds: CPU time of a block of measurements [s].
    """
    description = build(DescriptionParameters, robot)
    rng = np.random.default_rng(0)
    solids = surroundings(rng)
    q = rng.uniform(-math.pi, math.pi, (CONFIGURATIONS, 6))
    poses = rng.uniform(-1.0, 1.0, (CONFIGURATIONS, 3))
    result = {}
    for name, load in LOADS.items():
        body = BodyGeometry(description, TOOL, load)
        own = best_cpu(partial(body.self_distances, q, REACH), seconds)
        around = best_cpu(partial(body.distances, poses, q, solids, REACH), seconds)
        single = best_cpu(partial(body.self_distances, q[0], REACH), seconds)
        result[name] = {
            "self_ms": 1e3 * own,
            "solids_ms": 1e3 * around,
            "one_configuration_us": 1e6 * single,
            **measure_monitor(body, robot, solids, rng, seconds),
        }
    return result


def measure_monitor(
    body: BodyGeometry,
    robot: Mapping[str, Any],
    solids: UprightSolids,
    rng: np.random.Generator,
    seconds: float,
) -> dict[str, float]:
    """Measure the limit of a moving robot that is asked for another motion.

    Args:
        body: Shape of the robot.
        robot: Parameters of the robot by full name.
        solids: What stands or moves around the robot.
        rng: Source of the solids' velocities.
        seconds: CPU time of a block of measurements [s].
    """
    limits = build(CollisionMonitorParameters, robot).speed_limits
    monitor = CollisionMonitor(body, limits, MonitorParameters())
    state = RobotMotion(np.zeros(3), POSTURE, MOTION)
    velocities = rng.uniform(-WALKING, WALKING, (2, len(solids)))
    return {
        name: 1e3 * best_cpu(partial(monitor.limit, state, [2.0 * MOTION], around), seconds)
        for name, around in (
            ("monitor_ms", Surroundings.standing(solids)),
            ("monitor_moving_ms", Surroundings(solids, velocities)),
        )
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench collision`; return 0, the exit code of a successful measurement."""
    say("distances of the robot from itself and from solids ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    robot = load_robot(resolve_robot(args.robot))
    result |= measure(robot, 0.05 if args.quick else 0.5)
    return conclude("collision", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether a result meets the aim."""
    label = f"{CONFIGURATIONS} configurations against themselves in at most {AIM:g} ms"
    limit = f"a limit among {SOLIDS} solids that stand in at most {MONITOR_AIM:g} ms"
    moving = f"a limit among {SOLIDS} solids that move in at most {MONITOR_AIM:g} ms"
    return {
        label: result["empty"]["self_ms"] <= AIM,
        limit: result["empty"]["monitor_ms"] <= MONITOR_AIM,
        moving: result["empty"]["monitor_moving_ms"] <= MONITOR_AIM,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    aimed = {"self_ms": AIM, "monitor_ms": MONITOR_AIM, "monitor_moving_ms": MONITOR_AIM}
    rows: Rows = [(f"CPU time, {CONFIGURATIONS} configurations", *LOADS, "aim")]
    for key, text, unit in (
        ("self_ms", "between the robot's parts", "ms"),
        ("solids_ms", f"from {SOLIDS} solids within 3 m", "ms"),
        ("one_configuration_us", "one configuration, between its parts", "us"),
        ("monitor_ms", f"a limit of the speed among {SOLIDS} solids that stand", "ms"),
        ("monitor_moving_ms", f"a limit of the speed among {SOLIDS} solids that move", "ms"),
    ):
        aim = f"{aimed[key]:g} ms" if key in aimed else ""
        rows.append((text, *(f"{result[name][key]:.1f} {unit}" for name in LOADS), aim))
    missed = [label for label, is_met in result["aims"].items() if not is_met]
    return [*tables(rows), f"aims missed: {', '.join(missed) if missed else 'none'}"]
