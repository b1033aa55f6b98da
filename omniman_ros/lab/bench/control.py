"""`omniman bench control`: CPU time of a tick and of the nodes, latency compared with a relay."""

import argparse
import math
import os
from dataclasses import dataclass
from typing import Any

from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.control_tick import core_ticks
from omniman_ros.lab.bench.harness import Rows, RunningNodes, conclude, running_nodes, tables
from omniman_ros.lab.bench.latency import CommandPath, measure_paths
from omniman_ros.lab.bench.relay import RATE
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import load_robot

AIM_TICK = 100.0  # aim: largest CPU time of a tick of the controller's core, with four wheels [us]
AIM_RATIO = 1.3  # aim: largest ratio of the controller's median latency to the relay's
AIM_SHARE = 1.0 / 3.0  # aim: largest share of one core that platform_controller uses at 200 Hz


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement."""

    blocks: int  # number of blocks of core ticks
    ticks: int  # ticks in a block
    cpu_seconds: float  # time for which the nodes' CPU time is measured [s]
    samples: int  # number of latencies measured of each node
    block: int  # number of latencies measured of one node before the other node's turn


FULL = Effort(blocks=21, ticks=1000, cpu_seconds=15.0, samples=300, block=25)
"""Extent without options."""
QUICK = Effort(blocks=3, ticks=200, cpu_seconds=2.0, samples=20, block=10)  # extent with `--quick`


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench control`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL
    robot = robot_processes(RobotSetup(robot=args.robot, arm="none"))
    relay = ProcessSpec("relay", node_command("omniman_ros.lab.bench.relay", ()))
    say("core tick ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["core_tick_us"] = core_ticks(load_robot(args.robot), effort.blocks, effort.ticks)
    isolate_ros_domain(os.environ)
    with running_nodes([*robot, relay]) as nodes:
        result |= measure(nodes, effort)
    return conclude("control", result, report, args.results, aims)


def measure(nodes: RunningNodes, effort: Effort) -> dict[str, Any]:
    """Measure CPU shares and latencies of the running nodes."""
    ours = CommandPath(nodes.session, "platform_controller", "cmd_vel", "wheel_commands")
    relay = CommandPath(nodes.session, "relay", "relay/cmd_vel", "relay/wheel_commands")
    say(f"latency, {effort.samples} samples each ...")
    measure_paths([ours, relay], effort.samples, effort.block, nodes.children.check)
    say(f"CPU of the nodes, {effort.cpu_seconds:g} s ...")

    def drive(t: float) -> None:
        ours.send((0.3 * math.cos(t), 0.3 * math.sin(t), 0.3 * math.sin(0.7 * t)))

    names = ("platform_controller", "simulated_drive")
    shares = nodes.cpu_shares(names, effort.cpu_seconds, drive)
    latency = {path.name: path.summary() for path in (ours, relay)}
    return {
        "cpu_share": shares,
        "node_tick_us": 1e6 * shares["platform_controller"] / RATE,
        "latency": latency,
        "latency_ratio": latency["platform_controller"]["median_ms"]
        / latency["relay"]["median_ms"],
    }


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    return {
        "core_tick": max(result["core_tick_us"].values()) < AIM_TICK,
        "latency_ratio": result["latency_ratio"] <= AIM_RATIO,
        "cpu_share": result["cpu_share"]["platform_controller"] <= AIM_SHARE,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    rows: Rows = [("", "median", "p99", "aim", "")]
    for mode, micros in result["core_tick_us"].items():
        rows.append(
            (f"core tick, {mode} mode", f"{micros:.1f} us", "", f"< {AIM_TICK:g} us", ""),
        )
    rows[-1] = (*rows[-1][:-1], met["core_tick"])
    for name, path in result["latency"].items():
        rows.append(
            (
                f"cmd_vel to wheel_commands, {name}",
                f"{path['median_ms']:.2f} ms",
                f"{path['p99_ms']:.2f} ms",
                "",
                "",
            )
        )
    rows.append(
        (
            "ratio of the median latencies",
            f"{result['latency_ratio']:.3f}",
            "",
            f"<= {AIM_RATIO:g}",
            met["latency_ratio"],
        )
    )
    for name, share in result["cpu_share"].items():
        ours = name == "platform_controller"
        rows.append(
            (
                f"share of a core, {name}",
                f"{100 * share:.1f} %",
                "",
                f"<= {100 * AIM_SHARE:.0f} %" if ours else "",
                met["cpu_share"] if ours else "",
            )
        )
    rows.append(("CPU time of a node tick", f"{result['node_tick_us']:.0f} us", "", "", ""))
    return tables(rows)
