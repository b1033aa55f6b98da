"""`omniman bench arm`: timing of the arm's setpoints at 125 Hz, compared with a bare loop.

The measurement consists of pairs of blocks. In both blocks, all nodes of the robot run under load,
in a ROS domain of their own. In one of the two, a bare loop runs beside them: a process that
only sleeps until absolute deadlines and sends, in the same scheduling class as the streaming
process of `arm_streamer`. The order of the two blocks changes from pair to pair.
"""

import argparse
import os
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.lab.bench.arm_figures import (
    Block,
    Pair,
    aims,
    controller_figures,
    figures,
    report,
)
from omniman_ros.lab.bench.arm_load import Load
from omniman_ros.lab.bench.harness import conclude, free_ports, running_nodes
from omniman_ros.lab.measurement import cpu_time
from omniman_ros.lab.priority import set_niceness
from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.ur.parameters import PERIOD

PAUSE = 0.5
"""Time between two blocks, in which the last reports on the previous block arrive [s]."""
MIN_REPORTED_SHARE = 0.5
"""Smallest share of a block's intervals that must be reported within the block.

The last ones are reported after its end.
"""
MIN_BLOCK = 1.0
"""Shortest permitted duration of a block [s]."""
MAX_BLOCK = 600.0
"""Longest permitted duration of a block [s]."""
REPORT_TIMEOUT = 5.0
"""Longest time until the reports on a block arrive [s]."""
LENIENT = (
    "timeouts.wheel_states:=2.0",
    "firmware.watchdog:=2.0",
    "safety.deadline:=0.05",
    "odom_timeout:=1.0",
    "odom_pause:=1.0",
    "joint_trajectory.states_timeout:=1.0",
    "scaling_timeout:=2.0",
    "ur.feedback_timeout:=1.0",
    "ur.following_error:=1.0",
    "joint_trajectory.following_error:=1.0",
    "ur.read_timeout:=0.04",
    "drive.dead_wheel:=drive_on",
)
"""Arguments that set long time-outs and wide tolerances of the nodes.

Simulated hardware has to share the CPU with the nodes, and must not stop the robot when it is
late. The read time-out of the UR program is short, as its expiry is what the benchmark counts.
"""
UNNEEDED_NODES = ("joint_states_merger", "viewer")
"""Nodes that are left out, as a robot moves without them."""
HARDWARE_NODES = ("simulated_drive", "simulated_ur")
"""Nodes that simulate hardware; the hardware of a real robot has CPUs of its own."""
HARDWARE_NICENESS = -10
"""Niceness of the simulated hardware, if the system permits it."""
STREAMING_MODULE = "omniman_ros.ur.streaming_loop"
"""Module that the streaming process of `arm_streamer` runs, a word of its command line."""
POLICIES = {
    os.SCHED_OTHER: "SCHED_OTHER",
    os.SCHED_FIFO: "SCHED_FIFO",
    os.SCHED_RR: "SCHED_RR",
}
"""Names of the scheduling classes."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement.

    Attributes:
        pairs: Number of pairs of blocks.
        seconds: Duration of a block [s].
    """

    pairs: int
    seconds: float


FULL = Effort(pairs=5, seconds=8.0)
"""Extent without options."""
QUICK = Effort(pairs=2, seconds=2.0)
"""Extent with `--quick`."""


def effort_of(args: argparse.Namespace) -> Effort:
    """Return the extent of the measurement that the command line requests.

    Args:
        args: Parsed command line.

    Raises:
        CommandError: An option is out of its range.
    """
    usual = QUICK if args.quick else FULL
    pairs = usual.pairs if args.pairs is None else args.pairs
    seconds = usual.seconds if args.seconds is None else args.seconds
    if pairs < 1:
        raise CommandError(f"--pairs {pairs}: must be at least 1", 2)
    if not MIN_BLOCK <= seconds <= MAX_BLOCK:
        raise CommandError(
            f"--seconds {seconds:g}: must be from {MIN_BLOCK:g} to {MAX_BLOCK:g} s", 2
        )
    if not 0 <= args.priority <= 99:
        raise CommandError(f"--priority {args.priority}: must be from 0 to 99", 2)
    return Effort(pairs, seconds)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench arm`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: An option is out of its range, or the measurement failed.
    """
    effort = effort_of(args)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must not reach another robot
    isolate_ros_domain(os.environ)
    result: dict[str, Any] = {
        "robot": args.robot,
        "quick": args.quick,
        "pairs": effort.pairs,
        "block_s": effort.seconds,
        "priority": args.priority,
    }
    bare = BareLoop()
    with bare, running_nodes([*robot(args), *bare.tasks(args.priority)]) as nodes:
        load = Load(nodes.session, nodes.children.check)
        result |= ArmBench(load, bare, nodes.children).measure(effort)
    return conclude("arm", result, report, args.results, aims)


def robot(args: argparse.Namespace) -> list[ProcessSpec]:
    """Return the processes of the robot's nodes; its simulated UR controller uses free ports.

    Args:
        args: Parsed command line.

    Raises:
        CommandError: The planner cannot run on this machine.
    """
    ports = dict(zip(UR_PORTS, free_ports(len(UR_PORTS)), strict=True))
    port_arguments = [
        *(f"ports.{name}:={port}" for name, port in ports.items()),
        f"ur.dashboard_port:={ports['dashboard']}",
        f"ur.script_port:={ports['secondary']}",
        f"ur.rtde_port:={ports['rtde']}",
        "ur.reverse_port:=0",
        "ur.host:=127.0.0.1",
        f"ur.priority:={args.priority}",
    ]
    setup = RobotSetup(
        robot=args.robot, params=[*LENIENT, *port_arguments, *args.param], arm="simulated"
    )
    tasks = [task for task in robot_processes(setup) if task.name not in UNNEEDED_NODES]
    if not any(task.name == "mpc_planner" for task in tasks):
        raise CommandError("mpc_planner cannot run on this machine, as casadi is not installed")
    return tasks


def child_of(pid: int, word: str) -> int:
    """Return the process id of a child process, identified by its command line.

    Args:
        pid: Process id of the parent.
        word: Word that is one argument of the child's command line.

    Raises:
        CommandError: There is no such child, or no /proc.
    """
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            words = (folder / "cmdline").read_text().split("\0")
        except OSError:  # the process has ended meanwhile
            continue
        if int(parent) == pid and word in words:
            return int(folder.name)
    raise CommandError(f"process {pid} has no child {word} (the search needs Linux)")


def scheduling(pid: int) -> str:
    """Return the scheduling class and priority of a process's main thread, as text.

    Raises:
        CommandError: There is no such process.
    """
    try:
        policy, priority = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
    except OSError as error:
        raise CommandError(f"scheduling of process {pid}: {error}") from error
    name = POLICIES.get(policy, f"policy {policy}")
    return f"{name} {priority}" if priority else name


class BareLoop:
    """Controls the bare loop, which runs in a process and sends to a sink in another process.

    Used as a context manager, it closes its connection to the loop at the end.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._orders: socket.socket | None = None
        self._received = b""

    def __enter__(self) -> "BareLoop":
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()
        if self._orders is not None:
            self._orders.close()

    def tasks(self, priority: int) -> list[ProcessSpec]:
        """Return the processes of the loop and of its sink.

        Args:
            priority: SCHED_FIFO priority of the loop; 0 for the normal scheduling class.
        """
        (port,) = free_ports(1)
        control = self._listener.getsockname()[1]
        module = "omniman_ros.lab.bench.arm_bare"
        return [
            ProcessSpec("sink", node_command(module, ("sink", str(port))), stage=1),
            ProcessSpec(
                "bare", node_command(module, ("loop", str(port), str(control), str(priority)))
            ),
        ]

    def is_connected(self) -> bool:
        """Accept the connection of the loop if it is pending; return whether it is connected."""
        if self._orders is None:
            try:
                self._orders, _ = self._listener.accept()
            except BlockingIOError:
                return False
            self._orders.setblocking(False)
        return True

    def begin(self, seconds: float) -> None:
        """Start a block of the given duration [s]; the loop must be connected."""
        assert self._orders is not None
        self._received = b""
        self._orders.sendall(f"{seconds}\n".encode())

    def intervals(self) -> list[float]:
        """Return the intervals between the sends of the last block [s]; empty until it has ended.

        Raises:
            CommandError: The loop has ended.
        """
        assert self._orders is not None
        try:
            while not self._received.endswith(b"\n"):
                data = self._orders.recv(1 << 16)
                if not data:
                    raise CommandError("the bare loop has ended")
                self._received += data
        except BlockingIOError:
            return []
        return [float(value) for value in self._received.decode().strip("[]\n").split(",")]


class ArmBench:
    """Measures the streaming process and the bare loop in alternating blocks.

    Args:
        load: Load that keeps the robot moving and collects the timing of its setpoints.
        bare: Connection to the bare loop.
        children: Processes of the robot and of the bare loop.
    """

    def __init__(self, load: Load, bare: BareLoop, children: ProcessGroup) -> None:
        self._load, self._bare, self._children = load, bare, children
        self._pids: dict[str, int] = {}
        self._cpu = dict.fromkeys(("streaming", "node", "bare"), 0.0)
        self._wall = dict.fromkeys(("streaming", "node", "bare"), 0.0)

    def measure(self, effort: Effort) -> dict[str, Any]:
        """Measure all blocks.

        Args:
            effort: Extent of the measurement.

        Returns:
            Figures of the measurement.

        Raises:
            CommandError: The robot stopped, or the two loops differ in their scheduling class.
        """
        load = self._load
        say("starting ...")
        load.begin()
        permitted = [
            set_niceness(self._children.pid(name), HARDWARE_NICENESS) for name in HARDWARE_NODES
        ]
        self._until(self._bare.is_connected, DISCOVERY_TIMEOUT, "the bare loop did not connect")
        node = self._children.pid("arm_streamer")
        self._pids = {
            "streaming": child_of(node, STREAMING_MODULE),
            "node": node,
            "bare": self._children.pid("bare"),
        }
        classes = {
            "streamer": scheduling(self._pids["streaming"]),
            "bare": scheduling(self._pids["bare"]),
        }
        if len(set(classes.values())) > 1:
            raise CommandError(f"the loops differ in their scheduling class: {classes}")
        before = load.controller
        say(f"{effort.pairs} pairs of blocks of {effort.seconds:g} s, {classes['bare']} ...")
        pairs = [self._pair(k, effort) for k in range(effort.pairs)]
        reports = load.controller_reports
        self._until(
            lambda: load.controller_reports > reports,
            REPORT_TIMEOUT,
            "the simulated controller published no diagnostics",
        )
        return {
            "scheduling": classes,
            "hardware_niceness": HARDWARE_NICENESS if all(permitted) else 0,
            **figures(pairs),
            "cpu_share": {name: self._cpu[name] / self._wall[name] for name in self._cpu},
            "controller": controller_figures(before, load.controller),
            "load": {
                "goals": load.goals,
                "driving_share": load.driving / load.statuses,
                "arm_previews": load.previews,
            },
        }

    def _pair(self, number: int, effort: Effort) -> Pair:
        if number % 2:
            bare, beside = self._bare_block(effort.seconds)
            streamer = self._streamer_block(effort.seconds)
        else:
            streamer = self._streamer_block(effort.seconds)
            bare, beside = self._bare_block(effort.seconds)
        pair = Pair(streamer, bare, beside)
        say(f"  pair {number + 1}: p99 ratio {pair.ratio:.3f}")
        return pair

    def _streamer_block(self, seconds: float) -> Block:
        self._load.run(PAUSE)
        return self._timed(("streaming", "node"), lambda: self._measure(seconds))

    def _bare_block(self, seconds: float) -> tuple[Block, Block]:
        self._load.run(PAUSE)
        intervals: list[float] = []

        def has_reported() -> bool:
            intervals.extend(self._bare.intervals())
            return bool(intervals)

        def measure_both() -> Block:
            self._bare.begin(seconds)
            beside = self._measure(seconds)
            self._until(has_reported, REPORT_TIMEOUT, "the bare loop did not report its intervals")
            return beside

        beside = self._timed(("bare",), measure_both)
        return Block(tuple(intervals)), beside

    def _measure(self, seconds: float) -> Block:
        block = self._load.measure(seconds)
        expected = seconds / PERIOD
        if len(block.intervals) < MIN_REPORTED_SHARE * expected:
            raise CommandError(
                f"only {len(block.intervals)} of about {expected:.0f} send intervals were "
                f"reported in {seconds:g} s"
            )
        return block

    def _timed(self, names: Sequence[str], work: Callable[[], Block]) -> Block:
        """Measure a block; add the CPU time of the named processes in it to their totals."""
        start, before = time.monotonic(), {name: cpu_time(self._pids[name]) for name in names}
        block = work()
        for name in names:
            self._cpu[name] += cpu_time(self._pids[name]) - before[name]
            self._wall[name] += time.monotonic() - start
        return block

    def _until(self, done: Callable[[], bool], timeout: float, failure: str) -> None:
        """Run the load until a condition holds; raise CommandError after `timeout` [s]."""
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                raise CommandError(f"{failure} within {timeout:g} s")
            self._load.run(0.02)
