"""`omniman bench path`: planning time, how near to the least time, CPU time of the stream."""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from std_msgs.msg import Float64

from omniman_ros import conversions
from omniman_ros.cli import results
from omniman_ros.cli.bench_cpu import cpu_shares
from omniman_ros.cli.children import Children, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, tasks
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.cli.terminal import say, table
from omniman_ros.core.parameters import build
from omniman_ros.core.path.interpolator import PathInterpolator
from omniman_ros.core.path.parameters import TICK, PathParameters
from omniman_ros.robots import load_robot

Array = NDArray[np.float64]

COUNTS = (2, 100, 10_000)
LAPS = 10
"""Of the spiral that the poses are on."""


def spiral(count: int) -> Array:
    """Poses (count, 3) on a spiral of some 120 m that turn with it; two make a straight of 2 m."""
    if count == 2:
        return np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    phase = np.linspace(0.0, LAPS * 2.0 * np.pi, count)
    radius = 0.4 + 0.05 * phase
    x, y = radius * np.cos(phase) - radius[0], radius * np.sin(phase)
    return np.column_stack([x, y, 0.3 * phase])


def resampled(poses: Array, speed: float) -> Array:
    """The plainest interpolation: constant speed on straights, 125 Hz; it jumps in velocity."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    at = np.arange(0.0, length[-1], speed * TICK)
    return np.column_stack([np.interp(at, length, column) for column in poses.T])


def median_cpu(work: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of a call [s]."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return statistics.median(times)


def planning(parameters: PathParameters, repeats: int) -> dict[str, Any]:
    """CPU time of planning by number of poses, and the durations of the plans."""
    figures: dict[str, Any] = {}
    speed = parameters.groups()[0].velocity
    for count in COUNTS:
        poses = spiral(count)
        interpolator = PathInterpolator(parameters)

        def plan(poses: Array = poses, core: PathInterpolator = interpolator) -> Any:
            return core.propose(poses, (0.0, 0.0, 0.0), 0.0)

        made = plan().plan
        taken = median_cpu(plan, repeats)
        plain = median_cpu(lambda poses=poses: resampled(poses, speed), 5 * repeats)
        figures[str(count)] = {
            "planning_ms": 1e3 * taken,
            "plain_resampling_ms": 1e3 * plain,
            "duration_s": made.duration,
            "bound_s": made.bound,
            "duration_ratio": made.duration / made.bound,
        }
    return figures


def core_stream(parameters: PathParameters, repeats: int) -> dict[str, float]:
    """CPU time of a preview of 0.4 s, to compute and to write into its message [us]."""
    core = PathInterpolator(parameters)
    assert core.take(core.propose(spiral(100), (0.0, 0.0, 0.0), 0.0), 0.0)
    message = conversions.reference_message("odom", 51, TICK)
    stamp = conversions.Time()

    def compute() -> None:
        for k in range(200):
            core.window(0.04 * k, 0.4)

    def compute_and_fill() -> None:
        for k in range(200):
            window = core.window(0.04 * k, 0.4)
            assert window is not None
            conversions.fill_reference(message, stamp, window)

    return {
        "compute": 1e6 * median_cpu(compute, repeats) / 200,
        "compute_and_fill": 1e6 * median_cpu(compute_and_fill, repeats) / 200,
    }


def stream(args: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Share of a core of the running nodes, idle and while a path is driven."""
    names = ("path_interpolator", "platform_controller", "simulated_drive")
    log = NodeLog()
    children = Children(tasks(Setup(robot=args.robot, only=names)), on_line=log)
    with signals_to(children.interrupt):
        try:
            with children, Session("omniman_bench") as session:
                return _streamed(session, children, names, seconds)
        except CommandError:
            log.show()
            raise


def _streamed(
    session: Session, children: Children, names: tuple[str, ...], seconds: float
) -> dict[str, Any]:
    heard: list[float] = []
    session.node.create_subscription(
        Float64, "path_progress", lambda message: heard.append(message.data), 10
    )
    publisher = session.node.create_publisher(Path, "path", 10)

    def wait(condition: Callable[[], bool], what: str) -> None:
        def checked() -> bool:
            children.check()
            return condition()

        if not session.wait(checked, DISCOVERY):
            raise CommandError(f"{what} within {DISCOVERY:g} s")

    def serve() -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            children.check()
            session.spin(0.05)

    pids = {name: children.pid(name) for name in names}
    wait(lambda: publisher.get_subscription_count() > 0, "no path_interpolator")
    session.spin(2.0)  # discovery among the nodes
    idle = cpu_shares(pids, serve)
    publisher.publish(conversions.path_message(spiral(1000), "odom"))
    wait(lambda: bool(heard) and max(heard) > 0.0, "no path_progress")
    driving = cpu_shares(pids, serve)
    ours = driving["path_interpolator"]
    return {"idle": idle, "driving": driving, "cpu_per_tick_us": 1e6 * TICK * ours}


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench path`; returns 0 if it could be measured, whatever the figures."""
    parameters = build(PathParameters, load_robot(args.robot))
    say("planning ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["planning"] = planning(parameters, 1 if args.quick else 9)
    result["preview_us"] = core_stream(parameters, 2 if args.quick else 15)
    isolate(os.environ)
    seconds = 2.0 if args.quick else 15.0
    say(f"CPU of the nodes, twice {seconds:g} s ...")
    result["cpu_share"] = stream(args, seconds)
    say("\n".join(report(result)))
    results.publish("bench_path", result, args.results)
    return 0


def report(result: dict[str, Any]) -> list[str]:
    """The table at the end."""
    rows: list[tuple[str, ...]] = [("", "value", "next to it")]
    for count, row in result["planning"].items():
        rows.append(
            (f"planning {int(count):,} poses, CPU", f"{row['planning_ms']:.1f} ms",
             f"{row['plain_resampling_ms']:.2f} ms: plain resampling, which jumps in velocity")
        )  # fmt: skip
        rows.append(
            ("  duration", f"{row['duration_s']:.2f} s",
             f"{row['duration_ratio']:.3f} of the least without jerk limits")
        )  # fmt: skip
    preview, share = result["preview_us"], result["cpu_share"]
    rows.append(("a preview of 0.4 s, core", f"{preview['compute']:.0f} us", ""))
    rows.append(("  and its message", f"{preview['compute_and_fill']:.0f} us", ""))
    for name, driving in share["driving"].items():
        rows.append(
            (f"share of a core, {name}", f"{100 * driving:.1f} %",
             f"{100 * share['idle'][name]:.1f} % idle")
        )  # fmt: skip
    rows.append(("CPU time of a streamed tick of 8 ms", f"{share['cpu_per_tick_us']:.0f} us", ""))
    return ["", *table(rows), ""]
