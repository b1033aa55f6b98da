"""`omniman bench control`: CPU time of a tick and of the nodes, latency compared with a relay.

The latency is the time from a step of the velocity to the first wheel command that is not zero.
"""

import argparse
import math
import os
import random
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState

from omniman_ros.console.errors import CommandError
from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.lab.bench.harness import (
    BenchmarkTable,
    Figure,
    RunningNodes,
    at_most,
    conclude,
    running_nodes,
)
from omniman_ros.lab.bench.relay import RATE, SETPOINT
from omniman_ros.lab.measurement import spread_ms
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import robot_parameters

AIM_TICK = 100.0  #: aim: largest CPU time of a tick of the controller's core, four wheels [us]
AIM_RATIO = 1.3  #: aim: largest ratio of the controller's median latency to the relay's
#: aim: largest fraction of one core that platform_controller uses at 200 Hz
AIM_CPU_FRACTION = 1.0 / 3.0
WARM_UP_TICKS = 200  #: number of ticks of the core that run before the measurement
SPEED_STEP = 0.002  #: step of the velocity, small so that the robot is soon at rest again [m/s]
REST: Triple = (0.0, 0.0, 0.0)  #: twist that commands rest [m/s, m/s, rad/s]
STEP_TIMEOUT = 2.0  #: longest time until the wheels react to a step [s]
WARM_UP_PERIOD = 0.1  #: period of the twists until the node reacts for the first time [s]


class ControlBenchmarkSize(NamedTuple):
    """Extent of the measurement."""

    blocks: int  #: number of blocks of core ticks
    ticks: int  #: number of ticks in a block
    cpu_seconds: float  #: time for which the nodes' CPU time is measured [s]
    samples: int  #: number of latencies of each node
    block: int  #: number of latencies of one node before the other node's turn


FULL, QUICK = (
    ControlBenchmarkSize(21, 1000, 15.0, 300, 25),
    ControlBenchmarkSize(3, 200, 2.0, 20, 10),
)


def tick_time(parameters: PlatformParameters, blocks: int, block: int) -> float:
    """Return the CPU time of `update_wheels`, `set_twist` and `tick` together [us].

    It is the mean over a block of ticks, the median of all blocks. The twist changes at every
    tick; the wheels turn as commanded at the previous tick.
    """
    core, period = PlatformController(parameters), 1.0 / RATE
    position = np.zeros(parameters.robot.wheel_count)
    twists = [
        np.array([0.3 * math.cos(k / 100), 0.3 * math.sin(k / 70), 0.3 * math.sin(k / 130)])
        for k in range(block)
    ]
    times, now = [], 100.0
    for run in range(blocks + 1):
        length = block if run else WARM_UP_TICKS
        before = time.process_time()
        for k in range(length):
            now += period
            speed = core.cascade.reference
            position = position + period * speed
            core.update_wheels(now, now, position, speed, core.cascade.demanded_torque)
            core.set_twist(twists[k % block], now)
            core.tick(now)
        times.append((time.process_time() - before) / length)
    if core.arbiter.active is not Source.CMD_VEL or not core.latch.released:
        raise RuntimeError(f"the controller did not drive: {core.latch.status}")
    return 1e6 * statistics.median(times[1:])


def core_ticks(robot: Mapping[str, Any], blocks: int, block: int) -> dict[str, float]:
    """Return the CPU time of a tick [us] by drive mode that the robot offers."""
    base = build(PlatformParameters, robot)
    modes = [mode.value for mode in DriveMode if mode.value in base.drive.offered]
    each = [replace(base, drive=replace(base.drive, mode=mode)) for mode in modes]
    return {m: tick_time(given, blocks, block) for m, given in zip(modes, each, strict=True)}


class CommandPath:
    """The path of a command through a node, from a twist to wheel commands."""

    def __init__(self, nodes: RunningNodes, name: str, prefix: str = "") -> None:
        self.name, self.latencies = name, list[float]()
        self._nodes, self._moving, self._received, self._changed_at = nodes, False, 0, 0.0
        node = nodes.session.node
        self._publisher = node.create_publisher(Twist, f"{prefix}cmd_vel", SETPOINT)
        topic = f"{prefix}wheel_commands"
        node.create_subscription(JointState, topic, self._on_command, SETPOINT)

    def _on_command(self, message: JointState) -> None:
        moving = any(message.velocity)
        if moving != self._moving:
            self._changed_at, self._moving = time.monotonic(), moving
        self._received += 1

    def send(self, twist: Triple) -> None:
        """Publish a twist (v_x, v_y, omega) [m/s, m/s, rad/s]."""
        self._publisher.publish(twist_message(twist))

    def measure(self, pause: float) -> None:
        """Measure one latency after a pause [s]; the robot rests before it, and at the end."""
        self._nodes.session.spin(pause)
        before = time.monotonic()
        self.send((SPEED_STEP, 0.0, 0.0))
        self._await(lambda: self._moving, "move")
        self.latencies.append(self._changed_at - before)
        self._come_to_rest()

    def _come_to_rest(self) -> None:
        self.send(REST)
        self._await(lambda: not self._moving, "come to rest")

    def _await(self, condition: Callable[[], bool], action: str) -> None:
        missing = f"{self.name}: the wheels do not {action} after a step"
        self._nodes.wait(condition, STEP_TIMEOUT, missing)

    def warm_up(self) -> None:
        """Send twists until the node reacts for the first time, then wait for rest.

        A platform controller ignores twists until it receives wheel states.
        """

        def reacts() -> bool:
            connected = self._publisher.get_subscription_count() > 0
            return self._received > 0 and connected and self._moving

        end = time.monotonic() + DISCOVERY_TIMEOUT
        while not reacts():
            if time.monotonic() > end:
                raise CommandError(f"{self.name}: no connection within {DISCOVERY_TIMEOUT:g} s")
            self.send((SPEED_STEP, 0.0, 0.0))
            self._nodes.session.wait(reacts, WARM_UP_PERIOD)
        self._come_to_rest()


def measure(nodes: RunningNodes, effort: ControlBenchmarkSize) -> dict[str, Any]:
    """Measure latencies in alternating blocks of both nodes, then the fractions of a core."""
    ours, relay = CommandPath(nodes, "platform_controller"), CommandPath(nodes, "relay", "relay/")
    say(f"latency, {effort.samples} samples each ...")
    draw = random.Random(1)
    ours.warm_up()
    relay.warm_up()
    for _ in range(-(-effort.samples // effort.block)):
        for path in (ours, relay):
            for _ in range(effort.block):
                # Random pauses make the steps fall on random phases of the nodes' timers.
                path.measure(draw.uniform(0.02, 0.04))
    say(f"CPU of the nodes, {effort.cpu_seconds:g} s ...")

    def drive(t: float) -> None:
        ours.send((0.3 * math.cos(t), 0.3 * math.sin(t), 0.3 * math.sin(0.7 * t)))

    names = ("platform_controller", "simulated_drive")
    fractions = nodes.cpu_fractions(names, effort.cpu_seconds, drive)
    latency = {path.name: spread_ms(path.latencies) for path in (ours, relay)}
    return {
        "cpu_share": fractions,
        "node_tick_us": 1e6 * fractions["platform_controller"] / RATE,
        "latency": latency,
        "latency_ratio": latency[ours.name]["median_ms"] / latency[relay.name]["median_ms"],
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench control`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL
    robot = robot_processes(RobotSetup(robot=args.robot, arm="none"))
    relay = ProcessSpec("relay", node_command("omniman_ros.lab.bench.relay", ()))
    say("core tick ...")
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    result["core_tick_us"] = core_ticks(robot_parameters(args.robot), effort.blocks, effort.ticks)
    isolate_ros_domain(os.environ)
    with running_nodes([*robot, relay]) as nodes:
        result |= measure(nodes, effort)
    return conclude("control", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    figures = [
        at_most(f"core tick, {mode} mode", taken, AIM_TICK, "{:.1f} us")
        for mode, taken in result["core_tick_us"].items()
    ]
    for name, path in result["latency"].items():
        times = f"{path['median_ms']:.2f} ms", f"{path['p99_ms']:.2f} ms"
        figures.append(Figure(f"cmd_vel to wheel_commands, {name}", times))
    fractions, about = result["cpu_share"], "share of a core, {}".format
    figures += [
        at_most("ratio of the median latencies", result["latency_ratio"], AIM_RATIO, "{:.3f}"),
        at_most(
            about("platform_controller"),
            fractions["platform_controller"],
            AIM_CPU_FRACTION,
            "{:.1%}",
        ),
        Figure(about("simulated_drive"), (f"{fractions['simulated_drive']:.1%}",)),
        Figure("CPU time of a node tick", (f"{result['node_tick_us']:.0f} us",)),
    ]
    return [BenchmarkTable(("median", "p99"), figures)]
