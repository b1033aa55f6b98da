"""`omniman bench arm`: setpoints at 125 Hz in the whole running robot, against a bare loop.

All nodes run under load, in a ROS domain of their own, in all blocks. In every second block a bare
loop runs as well: a process that sleeps until absolute deadlines and sends, in the same scheduling
class as the streaming process. The order of the two blocks changes from pair to pair.
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
from omniman_ros.lab.bench.arm_figures import Block, Pair, aims, figures, of_controller, report
from omniman_ros.lab.bench.arm_load import Load
from omniman_ros.lab.bench.harness import conclude, free_ports, running_nodes
from omniman_ros.lab.bench.measurement import cpu_time
from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.ur.parameters import PERIOD

PAUSE = 0.5
"""Time between two blocks, in which the reports on the block before arrive [s]."""
COMPLETE = 0.5
"""Least share of a block's intervals that must have been reported; the last ones arrive later."""
SHORTEST = 1.0
"""Least length of a block [s]."""
LONGEST = 600.0
"""Largest length of a block [s]."""
ANSWER_TIMEOUT = 5.0
"""Longest time until a last report arrives [s]."""
LENIENT = (
    "timeouts.wheel_states:=2.0",
    "firmware.watchdog:=2.0",
    "safety.deadline:=0.05",
    "odom_timeout:=1.0",
    "joint_trajectory.states_timeout:=1.0",
    "scaling_timeout:=2.0",
    "ur.feedback_timeout:=1.0",
    "ur.following_error:=1.0",
    "joint_trajectory.following_error:=1.0",
    "ur.read_timeout:=0.04",
    "drive.dead_wheel:=drive_on",
)
"""Parameters with long time-outs, as simulated hardware has to wait for its turn on the CPU; the
read time-out is short, as it is under test."""
EXTRA = ("joint_state_broadcaster", "viewer")
"""Nodes that are not needed to drive a robot."""
HARDWARE = ("simulated_drive", "simulated_ur")
"""Simulated hardware; the hardware of a real robot has CPUs of its own."""
HARDWARE_NICENESS = -10
"""Niceness of the simulated hardware, where it is permitted."""
STREAMING = "omniman_ros.ur.streaming_loop"
POLICIES = {
    os.SCHED_OTHER: "SCHED_OTHER",
    os.SCHED_FIFO: "SCHED_FIFO",
    os.SCHED_RR: "SCHED_RR",
}


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement.

    Attributes:
        pairs: Number of pairs of blocks.
        seconds: Length of a block [s].
    """

    pairs: int
    seconds: float


FULL = Effort(pairs=5, seconds=8.0)
QUICK = Effort(pairs=2, seconds=2.0)


def effort_of(args: argparse.Namespace) -> Effort:
    """Return how much is to be measured.

    Raises:
        CommandError: An option is out of its range.
    """
    usual = QUICK if args.quick else FULL
    pairs = usual.pairs if args.pairs is None else args.pairs
    seconds = usual.seconds if args.seconds is None else args.seconds
    if pairs < 1:
        raise CommandError(f"--pairs {pairs}: at least 1", 2)
    if not SHORTEST <= seconds <= LONGEST:
        raise CommandError(f"--seconds {seconds:g}: {SHORTEST:g} to {LONGEST:g} s", 2)
    if not 0 <= args.priority <= 99:
        raise CommandError(f"--priority {args.priority}: 0 to 99", 2)
    return Effort(pairs, seconds)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench arm`; return 0 if it could be measured, whatever the figures."""
    effort = effort_of(args)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must reach no other robot
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
    """Return all nodes of the robot, with free ports for its simulated UR controller.

    Raises:
        CommandError: The planner cannot run on this machine.
    """
    ports = dict(zip(UR_PORTS, free_ports(len(UR_PORTS)), strict=True))
    private = [
        *(f"ports.{name}:={port}" for name, port in ports.items()),
        f"ur.dashboard_port:={ports['dashboard']}",
        f"ur.script_port:={ports['secondary']}",
        f"ur.rtde_port:={ports['rtde']}",
        "ur.reverse_port:=0",
        "ur.host:=127.0.0.1",
        f"ur.priority:={args.priority}",
    ]
    setup = RobotSetup(robot=args.robot, params=[*LENIENT, *private, *args.param], arm="simulated")
    chosen = [task for task in robot_processes(setup) if task.name not in EXTRA]
    if not any(task.name == "mpc_planner" for task in chosen):
        raise CommandError("mpc_planner cannot run here (no casadi): the robot is not complete")
    return chosen


def child_of(pid: int, word: str) -> int:
    """Return the id of a process' child whose command line contains a word.

    Raises:
        CommandError: There is no such child, or no /proc.
    """
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            words = (folder / "cmdline").read_text().split("\0")
        except OSError:  # it has ended meanwhile
            continue
        if int(parent) == pid and word in words:
            return int(folder.name)
    raise CommandError(f"process {pid} has no child {word} (this needs Linux)")


def scheduling(pid: int) -> str:
    """Return scheduling class and priority of a process' first thread."""
    try:
        policy, given = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
    except OSError as error:
        raise CommandError(f"scheduling of process {pid}: {error}") from error
    name = POLICIES.get(policy, f"policy {policy}")
    return f"{name} {given}" if given else name


def set_niceness(pid: int, niceness: int) -> bool:
    """Set the niceness of all threads of a process; return whether it was permitted."""
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.setpriority(os.PRIO_PROCESS, int(thread), niceness)
    except OSError:
        return False
    return True


class BareLoop:
    """Controls the bare loop, which runs as a process beside its sink.

    As a context manager it closes its connection to the loop.
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
        """Return the processes of loop and sink.

        Args:
            priority: SCHED_FIFO priority of the loop; 0: the normal scheduling class.
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
        """Return whether the loop has connected."""
        if self._orders is None:
            try:
                self._orders, _ = self._listener.accept()
            except BlockingIOError:
                return False
            self._orders.setblocking(False)
        return True

    def begin(self, seconds: float) -> None:
        """Start a block of a length [s]."""
        assert self._orders is not None
        self._received = b""
        self._orders.sendall(f"{seconds}\n".encode())

    def intervals(self) -> list[float]:
        """Return the intervals of the block [s]; none before its end.

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
    """Measures streamer and bare loop in alternating blocks.

    Args:
        load: Keeps the robot working.
        bare: The bare loop.
        children: The processes.
    """

    def __init__(self, load: Load, bare: BareLoop, children: ProcessGroup) -> None:
        self._load, self._bare, self._children = load, bare, children
        self._pids: dict[str, int] = {}
        self._cpu = dict.fromkeys(("streaming", "node", "bare"), 0.0)
        self._wall = dict.fromkeys(("streaming", "node", "bare"), 0.0)

    def measure(self, effort: Effort) -> dict[str, Any]:
        """Measure all blocks.

        Raises:
            CommandError: The robot stopped, or the two loops cannot be compared.
        """
        load = self._load
        say("starting ...")
        load.begin()
        favoured = [set_niceness(self._children.pid(name), HARDWARE_NICENESS) for name in HARDWARE]
        self._until(self._bare.is_connected, DISCOVERY_TIMEOUT, "the bare loop does not connect")
        node = self._children.pid("arm_streamer")
        self._pids = {
            "streaming": child_of(node, STREAMING),
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
            ANSWER_TIMEOUT,
            "no diagnostics of the simulated controller",
        )
        return {
            "scheduling": classes,
            "hardware_niceness": HARDWARE_NICENESS if all(favoured) else 0,
            **figures(pairs),
            "cpu_share": {name: self._cpu[name] / self._wall[name] for name in self._cpu},
            "controller": of_controller(before, load.controller),
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
        found: list[float] = []

        def answered() -> bool:
            found.extend(self._bare.intervals())
            return bool(found)

        def both() -> Block:
            self._bare.begin(seconds)
            beside = self._measure(seconds)
            self._until(answered, ANSWER_TIMEOUT, "the bare loop does not answer")
            return beside

        beside = self._timed(("bare",), both)
        return Block(tuple(found)), beside

    def _measure(self, seconds: float) -> Block:
        block = self._load.measure(seconds)
        expected = seconds / PERIOD
        if len(block.intervals) < COMPLETE * expected:
            raise CommandError(
                f"only {len(block.intervals)} of about {expected:.0f} send intervals were "
                f"reported in {seconds:g} s"
            )
        return block

    def _timed(self, names: Sequence[str], work: Callable[[], Block]) -> Block:
        """Measure a block, and add up the CPU time that processes use in it."""
        start, before = time.monotonic(), {name: cpu_time(self._pids[name]) for name in names}
        block = work()
        for name in names:
            self._cpu[name] += cpu_time(self._pids[name]) - before[name]
            self._wall[name] += time.monotonic() - start
        return block

    def _until(self, done: Callable[[], bool], timeout: float, what: str) -> None:
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                raise CommandError(f"{what} within {timeout:g} s")
            self._load.run(0.02)
