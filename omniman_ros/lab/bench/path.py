"""`omniman bench path`: planning time, duration relative to the optimum, CPU time of previews."""

import argparse
import os
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Path
from std_msgs.msg import Float64

from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.conversions.poses import path_message
from omniman_ros.conversions.trajectories import fill_reference, reference_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.harness import (
    Rows,
    RunningNodes,
    conclude,
    cpu_share_rows,
    running_nodes,
    tables,
)
from omniman_ros.lab.measurement import median_cpu
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.parameters import TICK, PathParameters
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import load_robot

NODES = ("path_interpolator", "platform_controller", "simulated_drive")
"""Nodes whose CPU time is measured."""
COUNTS = (2, 100, 10_000)  # numbers of poses of the planned paths
LAPS = 10  # number of revolutions of the spiral on which the poses lie
DISCOVERY_AMONG_NODES = 2.0  # time allowed for the nodes to discover each other [s]


def spiral(count: int) -> Array:
    """Return poses of the platform along a spiral of about 120 m, with a turning heading.

    Returns:
        (count, 3) poses in odom [m, m, rad]; the first is the origin.
    """
    if count == 2:
        return np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    phase = np.linspace(0.0, LAPS * 2.0 * np.pi, count)
    radius = 0.4 + 0.05 * phase
    x, y = radius * np.cos(phase) - radius[0], radius * np.sin(phase)
    return np.column_stack([x, y, 0.3 * phase])


def resampled(poses: Array, speed: float) -> Array:
    """Interpolate poses linearly at constant speed; the velocity jumps at each pose.

    This is the plainest interpolation possible, the baseline of the planning time.

    Args:
        poses: (n, 3) poses [m, m, rad].

    Returns:
        (k, 3) poses at 125 Hz [m, m, rad].
    """
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    at = np.arange(0.0, length[-1], speed * TICK)
    return np.column_stack([np.interp(at, length, column) for column in poses.T])


def planning(parameters: PathParameters, repeats: int) -> dict[str, Any]:
    """Measure the CPU time of planning, and the durations of the plans.

    Returns:
        Figures of each path by its number of poses.
    """
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


def core_stream(parameters: PathParameters, repeats: int) -> dict[str, float]:
    """Measure the CPU time of a preview of 0.4 s, with and without its ROS message.

    Returns:
        CPU time of a preview under `compute`, that of preview and message under
        `compute_and_fill` [us].
    """
    core = PathInterpolator(parameters)
    assert core.take(core.propose(spiral(100), (0.0, 0.0, 0.0), 0.0), 0.0)
    message = reference_message("odom", 51, TICK)
    stamp = Time()

    def compute() -> None:
        for k in range(200):
            core.window(0.04 * k, 0.4)

    def compute_and_fill() -> None:
        for k in range(200):
            window = core.window(0.04 * k, 0.4)
            assert window is not None
            fill_reference(message, stamp, window)

    return {
        "compute": 1e6 * median_cpu(compute, repeats) / 200,
        "compute_and_fill": 1e6 * median_cpu(compute_and_fill, repeats) / 200,
    }


def stream(args: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Measure the share of a core that the running nodes use, idle and while following a path."""
    with running_nodes(robot_processes(RobotSetup(robot=args.robot, only=NODES))) as nodes:
        return _streamed(nodes, seconds)


def _streamed(nodes: RunningNodes, seconds: float) -> dict[str, Any]:
    progress: list[float] = []
    node = nodes.session.node

    def on_progress(message: Any) -> None:
        progress.append(message.data)

    node.create_subscription(Float64, "path_progress", on_progress, 10)
    publisher = node.create_publisher(Path, "path", 10)
    nodes.wait(
        lambda: publisher.get_subscription_count() > 0, DISCOVERY_TIMEOUT, "no path_interpolator"
    )
    nodes.session.spin(DISCOVERY_AMONG_NODES)
    idle = nodes.cpu_shares(NODES, seconds)
    publisher.publish(path_message(spiral(1000), "odom"))
    nodes.wait(
        lambda: bool(progress) and max(progress) > 0.0, DISCOVERY_TIMEOUT, "no path_progress"
    )
    driving = nodes.cpu_shares(NODES, seconds)
    ours = driving["path_interpolator"]
    return {"idle": idle, "driving": driving, "cpu_per_tick_us": 1e6 * TICK * ours}


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench path`; return 0, the exit code of a successful measurement."""
    parameters = build(PathParameters, load_robot(args.robot))
    say("planning ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["planning"] = planning(parameters, 1 if args.quick else 9)
    result["preview_us"] = core_stream(parameters, 2 if args.quick else 15)
    isolate_ros_domain(os.environ)
    seconds = 2.0 if args.quick else 15.0
    say(f"CPU of the nodes, twice {seconds:g} s ...")
    result["cpu_share"] = stream(args, seconds)
    return conclude("path", result, report, args.results)


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("", "value", "compared with")]
    for count, row in result["planning"].items():
        rows.append(
            (
                f"planning {int(count):,} poses, CPU",
                f"{row['planning_ms']:.1f} ms",
                f"{row['plain_resampling_ms']:.2f} ms: plain resampling, which jumps in velocity",
            )
        )
        rows.append(
            (
                "  duration",
                f"{row['duration_s']:.2f} s",
                f"{row['duration_ratio']:.3f} of the optimum without jerk limits",
            )
        )
    preview, share = result["preview_us"], result["cpu_share"]
    rows.append(("CPU time of a preview of 0.4 s", f"{preview['compute']:.0f} us", ""))
    rows.append(("  including its message", f"{preview['compute_and_fill']:.0f} us", ""))
    rows += cpu_share_rows(share, "idle")
    rows.append(("CPU time per streamed tick of 8 ms", f"{share['cpu_per_tick_us']:.0f} us", ""))
    return tables(rows)
