"""`omniman bench control`: time of a tick, CPU of the nodes, latency next to a bare relay."""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from omniman_ros.cli import results
from omniman_ros.cli.bench_core import core_ticks
from omniman_ros.cli.bench_cpu import cpu_shares
from omniman_ros.cli.bench_latency import Path, measure_paths
from omniman_ros.cli.children import Children, Task, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, node_command, tasks
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.relay import RATE
from omniman_ros.cli.session import Session
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.robots import load_robot

AIM_TICK = 100.0
"""Core tick of four wheels [us]."""
AIM_RATIO = 1.3
"""Median latency over the relay's."""
AIM_SHARE = 1.0 / 3.0
"""Share of one core of a 200 Hz node."""
FEED_PERIOD = 0.05
"""Of cmd_vel while the nodes' CPU time is measured [s]."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    blocks: int
    ticks: int
    cpu_seconds: float
    samples: int
    block: int


FULL = Effort(blocks=21, ticks=1000, cpu_seconds=15.0, samples=300, block=25)
QUICK = Effort(blocks=3, ticks=200, cpu_seconds=2.0, samples=20, block=10)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench`; returns 0 if it could be measured, whatever the figures."""
    if args.name == "path":
        from omniman_ros.cli import bench_path

        return bench_path.run(args)
    if args.name == "mpc":
        from omniman_ros.cli import bench_mpc

        return bench_mpc.run(args)
    if args.name == "can":
        from omniman_ros.cli import bench_can

        return bench_can.run(args)
    if args.name == "arm":
        from omniman_ros.cli import bench_arm

        return bench_arm.run(args)
    if args.name == "whole_body":
        from omniman_ros.cli import bench_whole_body

        return bench_whole_body.run(args)
    effort = QUICK if args.quick else FULL
    chosen = tasks(Setup(robot=args.robot, arm="none"))
    say("core tick ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["core_tick_us"] = core_ticks(load_robot(args.robot), effort.blocks, effort.ticks)
    isolate(os.environ)
    log = NodeLog()
    relay = Task("relay", node_command("omniman_ros.cli.relay", ()))
    children = Children([*chosen, relay], on_line=log)
    with signals_to(children.interrupt):
        try:
            with children, Session("omniman_bench") as session:
                result |= measure(session, children, effort)
        except CommandError:
            log.show()
            raise
    result["aims"] = aims(result)
    say("\n".join(report(result)))
    results.publish("bench_control", result, args.results)
    return 0


def measure(session: Session, children: Children, effort: Effort) -> dict[str, Any]:
    """CPU shares and latencies of the running nodes."""
    ours = Path(session, "platform_controller", "cmd_vel", "wheel_commands")
    relay = Path(session, "relay", "relay/cmd_vel", "relay/wheel_commands")
    say(f"latency, {effort.samples} samples each ...")
    measure_paths([ours, relay], effort.samples, effort.block, children.check)
    say(f"CPU of the nodes, {effort.cpu_seconds:g} s ...")
    pids = {name: children.pid(name) for name in ("platform_controller", "simulated_drive")}
    shares = cpu_shares(pids, feeder(session, ours, effort.cpu_seconds, children.check))
    latency = {path.name: path.summary() for path in (ours, relay)}
    return {
        "cpu_share": shares,
        "node_tick_us": 1e6 * shares["platform_controller"] / RATE,
        "latency": latency,
        "latency_ratio": latency["platform_controller"]["median_ms"]
        / latency["relay"]["median_ms"],
    }


def feeder(
    session: Session, path: Path, seconds: float, poll: Callable[[], None]
) -> Callable[[], None]:
    """A function that drives the robot along a slowly changing twist for some seconds."""

    def feed() -> None:
        start = time.monotonic()
        while (t := time.monotonic() - start) < seconds:
            poll()
            path.send((0.3 * math.cos(t), 0.3 * math.sin(t), 0.3 * math.sin(0.7 * t)))
            session.spin(FEED_PERIOD)

    return feed


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Which aims were met."""
    return {
        "core_tick": max(result["core_tick_us"].values()) < AIM_TICK,
        "latency_ratio": result["latency_ratio"] <= AIM_RATIO,
        "cpu_share": result["cpu_share"]["platform_controller"] <= AIM_SHARE,
    }


def report(result: dict[str, Any]) -> list[str]:
    """The table at the end."""
    met = {
        key: paint("met", GREEN, sys.stdout) if good else paint("MISSED", RED, sys.stdout)
        for key, good in result["aims"].items()
    }
    rows: list[tuple[str, ...]] = [("", "median", "p99", "aim", "")]
    for mode, micros in result["core_tick_us"].items():
        rows.append(
            (f"core tick, {mode} mode", f"{micros:.1f} us", "", f"< {AIM_TICK:g} us", ""),
        )
    rows[-1] = (*rows[-1][:-1], met["core_tick"])
    for name, path in result["latency"].items():
        rows.append(
            (f"cmd_vel to wheel_commands, {name}", f"{path['median_ms']:.2f} ms",
             f"{path['p99_ms']:.2f} ms", "", "")
        )  # fmt: skip
    rows.append(
        ("ratio of the two", f"{result['latency_ratio']:.3f}", "", f"<= {AIM_RATIO:g}",
         met["latency_ratio"])
    )  # fmt: skip
    for name, share in result["cpu_share"].items():
        ours = name == "platform_controller"
        rows.append(
            (f"share of a core, {name}", f"{100 * share:.1f} %", "",
             f"<= {100 * AIM_SHARE:.0f} %" if ours else "", met["cpu_share"] if ours else "")
        )  # fmt: skip
    rows.append(("CPU time of a node tick", f"{result['node_tick_us']:.0f} us", "", "", ""))
    return ["", *table(rows), ""]
