"""`omniman bench tracker`: how well people are tracked by laser scans, and what it costs.

The physics world moves the people and judges; times are CPU times of this process, but for the
latency, which is that of the running node on real time.
"""

import argparse
import math
import time
from array import array
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.extras import TRACKING, WORLD
from omniman_ros.lab.bench.harness import Rows, conclude, running_nodes, tables
from omniman_ros.lab.measurement import percentiles_ms
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import node_command, resolve_robot
from omniman_ros.robots import load_robot

SCENES = 12  # number of scenes of people who give way, in half of which the robot drives
SUDDEN_SCENES = 4  # number of scenes of people who turn on the spot
PERSONS, CROWD = 6, 20  # number of persons in a scene, and where the CPU time is measured
SECONDS = 30.0  # simulated duration of a scene [s]
RATE = 20.0  # rate of the scans [Hz]
VELOCITY_AIM = 0.1
"""Aim: largest root mean square of the velocity's error from 0.5 s after the first sight on
[m/s]."""
FALSE_AIM = 0.01
"""Aim: largest share of standing things that are reported as moving for longer than 0.5 s."""
IDENTITY_AIM = 0.95  # aim: least share of crossings after which the identity is the same
CPU_AIM = 0.25  # aim: largest share of a core for 720 beams at 20 Hz with 20 people
LATENCY_AIM = 60.0  # aim: largest 99th percentile of the time from a scan to its obstacles [ms]
SETTLING = 2.0  # time that the node has to see the crowd before the measurement [s]
START_TIMEOUT = 20.0  # longest time until the node answers [s]


def measure(robot: Mapping[str, Any], scenes: int, seconds: float) -> dict[str, Any]:
    """Track people in scenes of the physics world.

    Returns:
        Figures of people who give way, of those who turn on the spot, and of a crowd.
    """
    # The command line must do without the engine.
    from omniman_ros.lab.studies.tracking import TrackingCase, TrackingRun, run_case
    from omniman_ros.lab.studies.tracking_judge import root_mean_square
    from omniman_ros.simulation.world.scene import SCRIPTED

    def run(case: TrackingCase) -> TrackingRun:
        say(f"scene {case.seed}, {case.persons} persons ...")
        return run_case(case, robot, seconds)

    def figures(runs: Sequence[TrackingRun]) -> dict[str, Any]:
        judges = [run.judge for run in runs]
        walking = [error for judge in judges for error in judge.walking_errors]
        errors = [error for judge in judges for error in judge.errors]
        missed = sum(judge.missed for judge in judges)
        crossings = sum(judge.crossings for judge in judges)
        cpu = [each for run in runs for each in run.cpu]
        median, p99, largest = percentiles_ms(cpu)
        return {
            "scenes": len(runs),
            "velocity_rmse": root_mean_square(errors),
            "walking_velocity_rmse": root_mean_square(walking),
            "velocity_error_median": float(np.median(errors)) if errors else math.nan,
            "walking_missed_share": missed / max(missed + len(walking), 1),
            "static_things": sum(judge.statics for judge in judges),
            "false_movers": sum(len(judge.false_movers) for judge in judges),
            "crossings": crossings,
            "identities_kept": sum(judge.kept for judge in judges),
            "cpu_ms": {"median": median, "p99": p99, "max": largest},
            "cpu_share": RATE * float(np.mean(cpu)),
        }

    sudden = max(1, scenes * SUDDEN_SCENES // SCENES)
    calm = [run(TrackingCase(seed, PERSONS, seed % 2 == 1)) for seed in range(scenes)]
    turning = [
        run(TrackingCase(seed, PERSONS, seed % 2 == 1, behaviour=SCRIPTED))
        for seed in range(sudden)
    ]
    crowd = [run(TrackingCase(100, CROWD))]
    return {"people": figures(calm), "sudden": figures(turning), "crowd": figures(crowd)}


def measure_latency(robot_name: str, seconds: float) -> dict[str, float]:
    """Measure the time from the stamp of a scan to the arrival of its obstacles.

    Returns:
        Median, 99th percentile and maximum [ms], and the node's share of a core.
    """
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import LaserScan
    from visualization_msgs.msg import MarkerArray

    given = ["--ros-args", "-p", f"robot:={robot_name}", "-p", "scanners_by_tf:=false"]
    task = ProcessSpec("obstacle_tracker", node_command("obstacle_tracker", given))
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 720)
    rng = np.random.default_rng(0)
    sent: dict[int, float] = {}
    taken: list[float] = []

    with running_nodes([task]) as nodes:
        node = nodes.session.node
        scans = node.create_publisher(LaserScan, "scan", 5)
        odometry = node.create_publisher(Odometry, "odom", 5)

        def receive(message: Any) -> None:
            for marker in message.markers[-1:]:
                stamp = marker.header.stamp
                key = stamp.sec * 10**9 + stamp.nanosec
                near = min(sent, key=lambda other: abs(other - key), default=None)
                if near is not None and abs(near - key) < 2_000_000:
                    taken.append(time.monotonic() - sent.pop(near))

        node.create_subscription(MarkerArray, "obstacles", receive, 50)
        count = 0

        def feed(now: float) -> None:
            nonlocal count
            stamp = node.get_clock().now()
            message = Odometry(child_frame_id="base_link")
            message.header.frame_id, message.header.stamp = "odom", stamp.to_msg()
            odometry.publish(message)
            count += 1
            scan = LaserScan(
                angle_min=-0.5 * math.pi,
                angle_max=0.5 * math.pi,
                angle_increment=math.pi / 719.0,
                range_max=20.0,
                ranges=array("f", _crowd_ranges(now, angles, rng).astype(np.float32).tobytes()),
            )
            scan.header.frame_id, scan.header.stamp = "scanner", stamp.to_msg()
            sent[stamp.nanoseconds] = time.monotonic()
            scans.publish(scan)

        nodes.wait(lambda: scans.get_subscription_count() > 0, START_TIMEOUT, "no node")
        nodes.serve(SETTLING, feed)
        taken.clear()
        share = nodes.cpu_shares(["obstacle_tracker"], seconds, feed)["obstacle_tracker"]
    if not taken:
        raise CommandError("obstacle_tracker has sent no obstacles")
    median, p99, largest = percentiles_ms(taken)
    return {"median": median, "p99": p99, "max": largest, "scans": len(taken), "cpu_share": share}


def _crowd_ranges(now: float, angles: Any, rng: np.random.Generator) -> Any:
    """Return ranges to 20 people on circles within a round room, from its middle."""
    found = np.full(len(angles), 9.0)
    for k in range(CROWD):
        phase = 0.9 * k + (0.3 if k % 2 else -0.3) * now
        distance = 2.0 + 0.3 * k
        aside = np.sin(phase - angles) * distance
        along = np.cos(phase - angles) * distance
        chord = np.sqrt(np.maximum(0.0625 - aside * aside, 0.0))
        met = (np.abs(aside) < 0.25) & (along > 0.0)
        found = np.where(met, np.minimum(found, along - chord), found)
    return found + rng.normal(0.0, 0.01, len(angles))


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench tracker`; return 0, the exit code of a successful measurement."""
    for extra in (WORLD, TRACKING):
        if not extra.is_available:
            raise CommandError(extra.hint)
    robot_name = resolve_robot(args.robot)
    scenes, seconds = (2, 10.0) if args.quick else (SCENES, SECONDS)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result |= measure(load_robot(robot_name), scenes, seconds)
    say("latency of the running node ...")
    result["latency_ms"] = measure_latency(robot_name, 4.0 if args.quick else 20.0)
    return conclude("tracker", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    people, sudden, crowd = result["people"], result["sudden"], result["crowd"]
    latency = result["latency_ms"]
    return {
        "velocity": people["velocity_rmse"] <= VELOCITY_AIM,
        "sudden_velocity": sudden["velocity_rmse"] <= VELOCITY_AIM,
        "false_movers": people["false_movers"] <= FALSE_AIM * people["static_things"],
        "identity": people["identities_kept"] >= IDENTITY_AIM * people["crossings"],
        "cpu": max(crowd["cpu_share"], latency["cpu_share"]) <= CPU_AIM,
        "latency": latency["p99"] <= LATENCY_AIM,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    people, sudden, crowd = result["people"], result["sudden"], result["crowd"]
    latency = result["latency_ms"]
    rows: Rows = [("", "measured", "aim", "")]
    for name, label, key in (
        ("people", "who give way", "velocity"),
        ("sudden", "who turn on the spot", "sudden_velocity"),
    ):
        value = f"{result[name]['velocity_rmse']:.3f} m/s"
        rows.append((f"velocity, RMSE, people {label}", value, f"{VELOCITY_AIM:g} m/s", met[key]))
    walking = f"{people['walking_velocity_rmse']:.3f} m/s"
    rows.append(("the same, while they walk", walking, "", ""))
    missed = f"{100.0 * people['walking_missed_share']:.1f} %"
    rows.append(("walking and seen, but not reported", missed, "", ""))
    false = f"{people['false_movers']} of {people['static_things']}"
    rows.append(("standing things reported as moving", false, "1 %", met["false_movers"]))
    kept = f"{people['identities_kept']} of {people['crossings']}"
    rows.append(("identity kept in crossings", kept, "95 %", met["identity"]))
    kept = f"{sudden['identities_kept']} of {sudden['crossings']}"
    rows.append(("the same, who turn on the spot", kept, "", ""))
    share = f"{100.0 * crowd['cpu_share']:.1f} %"
    rows.append((f"share of a core, core alone, {CROWD} people", share, "", ""))
    share = f"{100.0 * latency['cpu_share']:.1f} %"
    rows.append((f"share of a core, the node, {CROWD} people", share, "25 %", met["cpu"]))
    times = f"{latency['median']:.1f} / {latency['p99']:.1f} ms"
    rows.append(
        ("scan to obstacle, median / p99", times, f"p99 {LATENCY_AIM:g} ms", met["latency"])
    )
    return tables(rows)
