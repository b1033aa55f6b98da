"""`omniman bench path`: planning time, duration relative to the optimum, CPU time of previews."""

import argparse
import os
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from std_msgs.msg import Float64

from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.conversions.poses import path_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    conclude,
    cpu_share_figures,
    running_nodes,
)
from omniman_ros.lab.measurement import median_cpu
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.parameters import TICK, PathParameters
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import robot_parameters

NODES = ("path_interpolator", "platform_controller", "simulated_drive")
COUNTS = (2, 100, 10_000)  #: numbers of poses of the planned paths
LAPS = 10  #: number of revolutions of the spiral on which the poses lie
DISCOVERY_AMONG_NODES = 2.0  #: time allowed for the nodes to discover each other [s]


def spiral(count: int) -> Array:
    """Return poses (count, 3) in odom along a spiral of about 120 m, from the origin [m, m, rad].

    Two poses are a straight line of 2 m. The heading turns along the spiral.
    """
    if count == 2:
        return np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    phase = np.linspace(0.0, LAPS * 2.0 * np.pi, count)
    radius = 0.4 + 0.05 * phase
    x, y = radius * np.cos(phase) - radius[0], radius * np.sin(phase)
    return np.column_stack([x, y, 0.3 * phase])


def resampled(poses: Array, speed: float) -> Array:
    """Interpolate poses (n, 3) [m, m, rad] linearly at 125 Hz and constant speed [m/s].

    The velocity jumps at each pose. This is the plainest interpolation possible, the baseline of
    the planning time.
    """
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    at = np.arange(0.0, length[-1], speed * TICK)
    return np.column_stack([np.interp(at, length, column) for column in poses.T])


def planning(parameters: PathParameters, repeats: int) -> dict[str, Any]:
    """Measure the CPU time of planning and the durations of the plans, by number of poses."""
    figures: dict[str, Any] = {}
    speed = parameters.groups()[0].velocity
    for count in COUNTS:
        poses = spiral(count)
        interpolator = PathInterpolator(parameters)

        def plan(poses: Array = poses, core: PathInterpolator = interpolator) -> Any:
            return core.propose(poses, (0.0, 0.0, 0.0), 0.0)

        made = plan().plan
        cpu_time = median_cpu(plan, repeats)
        plain = median_cpu(partial(resampled, poses, speed), 5 * repeats)
        figures[str(count)] = {
            "planning_ms": 1e3 * cpu_time,
            "plain_resampling_ms": 1e3 * plain,
            "duration_s": made.duration,
            "bound_s": made.bound,
            "duration_ratio": made.duration / made.bound,
        }
    return figures


def stream(args: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Measure the load of a core by the running nodes, idle and while following a path."""
    with running_nodes(robot_processes(RobotSetup(robot=args.robot, only=NODES))) as nodes:
        progress = nodes.received(Float64, "path_progress")
        publisher = nodes.session.node.create_publisher(Path, "path", 10)
        missing = "no path_interpolator"
        nodes.wait(lambda: publisher.get_subscription_count() > 0, DISCOVERY_TIMEOUT, missing)
        nodes.session.spin(DISCOVERY_AMONG_NODES)
        idle = nodes.cpu_fractions(NODES, seconds)
        publisher.publish(path_message(spiral(1000), "odom"))
        begun = lambda: any(message.data > 0.0 for message in progress)  # noqa: E731
        nodes.wait(begun, DISCOVERY_TIMEOUT, "no path_progress")
        driving = nodes.cpu_fractions(NODES, seconds)
    ours = driving["path_interpolator"]
    return {"idle": idle, "driving": driving, "cpu_per_tick_us": 1e6 * TICK * ours}


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench path`; return 0, the exit code of a successful measurement."""
    parameters = build(PathParameters, robot_parameters(args.robot))
    say("planning ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["planning"] = planning(parameters, 1 if args.quick else 9)
    isolate_ros_domain(os.environ)
    seconds = 2.0 if args.quick else 15.0
    say(f"CPU of the nodes, twice {seconds:g} s ...")
    result["cpu_share"] = stream(args, seconds)
    return conclude("path", result, report(result), args.results)


def report(result: dict[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = []
    for count, row in result["planning"].items():
        plain = f"{row['plain_resampling_ms']:.2f} ms: plain resampling, which jumps in velocity"
        planning = f"planning {int(count):,} poses, CPU"
        rows.append(Figure(planning, (f"{row['planning_ms']:.1f} ms", plain)))
        ratio = f"{row['duration_ratio']:.3f} of the optimum without jerk limits"
        rows.append(Figure("  duration", (f"{row['duration_s']:.2f} s", ratio)))
    fraction = result["cpu_share"]
    rows += cpu_share_figures(fraction, "idle")
    tick = f"{fraction['cpu_per_tick_us']:.0f} us"
    rows.append(Figure("CPU time per streamed tick of 8 ms", (tick,)))
    return [BenchmarkTable(("value", "compared with"), rows)]
