"""`omniman bench arm`: setpoints at 125 Hz in the whole running robot, next to a bare loop.

All nodes run and work, in a ROS domain of their own, in all blocks. In every second block a bare
loop runs as well: a process that sleeps to absolute deadlines and sends, in the same scheduling
class as the streaming process. Each block of a pair is the first one in every second pair.
"""

import argparse
import os
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.arm.parameters import PERIOD
from omniman_ros.cli import results
from omniman_ros.cli.arm import PORTS
from omniman_ros.cli.bench_arm_figures import (
    Block,
    Pair,
    aims,
    figures,
    of_controller,
    report,
)
from omniman_ros.cli.bench_arm_load import Load
from omniman_ros.cli.bench_cpu import cpu_time
from omniman_ros.cli.children import Children, Task, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, node_command, tasks
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.cli.terminal import say

SETTLE = 0.5
"""Between two blocks [s]: what is said of the one before has come by then."""
COMPLETE = 0.5
"""Least share of a block's intervals that must have been reported; the last ones come later."""
SHORTEST = 1.0
"""Block [s]."""
ANSWER = 5.0
"""How long a last word may take [s]."""
PATIENT = (
    "timeouts.wheel_states:=2.0", "firmware.watchdog:=2.0", "safety.deadline:=0.05",
    "odom_timeout:=1.0", "joint_trajectory.states_timeout:=1.0", "scaling_timeout:=2.0",
    "ur.feedback_timeout:=1.0", "ur.following_error:=1.0",
    "joint_trajectory.following_error:=1.0", "ur.read_timeout:=0.04",
    "drive.dead_wheel:=drive_on",
)  # fmt: skip
"""Simulated parts are processes that wait for their turn; the read time-out is what is tried."""
EXTRA = ("joint_state_broadcaster", "viewer")
"""Nodes that no robot needs."""
HARDWARE, FAVOUR = ("simulated_drive", "simulated_ur"), -10
"""A real robot's has CPUs of its own; niceness of the simulated one, where it is permitted."""
STREAMING = "omniman_ros.arm.loop"
POLICIES = {
    os.SCHED_OTHER: "SCHED_OTHER",
    os.SCHED_FIFO: "SCHED_FIFO",
    os.SCHED_RR: "SCHED_RR",
}


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        pairs: Of blocks.
        seconds: Length of a block [s].
    """

    pairs: int
    seconds: float


FULL = Effort(pairs=5, seconds=8.0)
QUICK = Effort(pairs=2, seconds=2.0)


def effort_of(args: argparse.Namespace) -> Effort:
    """How much is to be measured.

    Raises:
        CommandError: No pair, blocks too short, or no such priority.
    """
    usual = QUICK if args.quick else FULL
    pairs = usual.pairs if args.pairs is None else args.pairs
    seconds = usual.seconds if args.seconds is None else args.seconds
    if pairs < 1:
        raise CommandError(f"--pairs {pairs}: at least 1", 2)
    if not SHORTEST <= seconds <= 600.0:
        raise CommandError(f"--seconds {seconds:g}: {SHORTEST:g} to 600 s", 2)
    if not 0 <= args.priority <= 99:
        raise CommandError(f"--priority {args.priority}: 0 to 99", 2)
    return Effort(pairs, seconds)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench arm`; returns 0 if it could be measured, whatever the figures."""
    effort = effort_of(args)
    os.environ.pop("ROS_DOMAIN_ID", None)  # no other robot may move by this
    isolate(os.environ)
    bare = Bare()
    chosen = [*robot(args), *bare.tasks(args.priority)]
    log = NodeLog()
    children = Children(chosen, on_line=log)
    result: dict[str, Any] = {
        "robot": args.robot, "quick": args.quick, "pairs": effort.pairs,
        "block_s": effort.seconds, "priority": args.priority,
    }  # fmt: skip
    with signals_to(children.interrupt):
        try:
            with bare, children, Session("omniman_bench") as session:
                bench = ArmBench(Load(session, children.check), bare, children)
                result |= bench.measure(effort)
        except CommandError:
            log.show()
            raise
    result["aims"] = aims(result)
    say("\n".join(report(result)))
    results.publish("bench_arm", result, args.results)
    return 0


def robot(args: argparse.Namespace) -> list[Task]:
    """All nodes of the robot, its controller's ports its own."""
    ports = dict(zip(PORTS, free_ports(len(PORTS)), strict=True))
    private = [
        *(f"ports.{name}:={port}" for name, port in ports.items()),
        f"ur.dashboard_port:={ports['dashboard']}", f"ur.script_port:={ports['secondary']}",
        f"ur.rtde_port:={ports['rtde']}", "ur.reverse_port:=0", "ur.host:=127.0.0.1",
        f"ur.priority:={args.priority}",
    ]  # fmt: skip
    setup = Setup(robot=args.robot, params=[*PATIENT, *private, *args.param], arm="simulated")
    chosen = [task for task in tasks(setup) if task.name not in EXTRA]
    if not any(task.name == "mpc_planner" for task in chosen):
        raise CommandError("mpc_planner cannot run here (no casadi): not the whole robot")
    return chosen


def free_ports(count: int) -> list[int]:
    """TCP ports of this machine that nobody has."""
    with ExitStack() as stack:
        listeners = [
            stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)
        ]
        return [listener.getsockname()[1] for listener in listeners]


def child_of(pid: int, word: str) -> int:
    """Process id of the child of a process that has a word in its command line.

    Raises:
        CommandError: There is none, or no /proc.
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
    """Scheduling class and priority of a process' first thread."""
    try:
        policy, given = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
    except OSError as error:
        raise CommandError(f"scheduling of process {pid}: {error}") from error
    name = POLICIES.get(policy, f"policy {policy}")
    return f"{name} {given}" if given else name


def favour(pid: int, niceness: int) -> bool:
    """Set the niceness of all threads of a process; whether it was permitted."""
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.setpriority(os.PRIO_PROCESS, int(thread), niceness)
    except OSError:
        return False
    return True


class Bare:
    """The bare loop and its sink: their tasks, and the loop's orders.

    As a context manager it ends what it has opened.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._orders: socket.socket | None = None
        self._heard = b""

    def __enter__(self) -> "Bare":
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()
        if self._orders is not None:
            self._orders.close()

    def tasks(self, priority: int) -> list[Task]:
        """What to run."""
        (port,) = free_ports(1)
        control = self._listener.getsockname()[1]
        module = "omniman_ros.cli.bench_arm_bare"
        return [
            Task("sink", node_command(module, ("sink", str(port))), stage=1),
            Task("bare", node_command(module, ("loop", str(port), str(control), str(priority)))),
        ]

    def is_there(self) -> bool:
        """Whether the loop has called."""
        if self._orders is None:
            try:
                self._orders, _ = self._listener.accept()
            except BlockingIOError:
                return False
            self._orders.setblocking(False)
        return True

    def begin(self, seconds: float) -> None:
        """Have it run a block [s]."""
        assert self._orders is not None
        self._heard = b""
        self._orders.sendall(f"{seconds}\n".encode())

    def intervals(self) -> list[float]:
        """Intervals of the block [s]; none before its end.

        Raises:
            CommandError: It has ended.
        """
        assert self._orders is not None
        try:
            while not self._heard.endswith(b"\n"):
                data = self._orders.recv(1 << 16)
                if not data:
                    raise CommandError("the bare loop has ended")
                self._heard += data
        except BlockingIOError:
            return []
        return [float(value) for value in self._heard.decode().strip("[]\n").split(",")]


class ArmBench:
    """Measures in alternating blocks.

    Args:
        load: The robot's work.
        bare: The bare loop.
        children: The processes.
    """

    def __init__(self, load: Load, bare: Bare, children: Children) -> None:
        self._load, self._bare, self._children = load, bare, children
        self._pids: dict[str, int] = {}
        self._cpu = dict.fromkeys(("streaming", "node", "bare"), 0.0)
        self._wall = dict.fromkeys(("streaming", "node", "bare"), 0.0)

    def measure(self, effort: Effort) -> dict[str, Any]:
        """All blocks.

        Raises:
            CommandError: The robot stopped, or the two loops cannot be compared.
        """
        load = self._load
        say("starting ...")
        load.begin()
        favoured = [favour(self._children.pid(name), FAVOUR) for name in HARDWARE]
        self._until(self._bare.is_there, DISCOVERY, "the bare loop is not there")
        node = self._children.pid("arm_streamer")
        self._pids = {
            "streaming": child_of(node, STREAMING), "node": node,
            "bare": self._children.pid("bare"),
        }  # fmt: skip
        classes = {
            "streamer": scheduling(self._pids["streaming"]),
            "bare": scheduling(self._pids["bare"]),
        }
        if len(set(classes.values())) > 1:
            raise CommandError(f"not the same scheduling class: {classes}")
        before = load.controller
        say(f"{effort.pairs} pairs of blocks of {effort.seconds:g} s, {classes['bare']} ...")
        pairs = [self._pair(k, effort) for k in range(effort.pairs)]
        told = load.told
        self._until(lambda: load.told > told, ANSWER, "the simulated controller says nothing")
        return {
            "scheduling": classes,
            "hardware_niceness": FAVOUR if all(favoured) else 0,
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
        self._load.run(SETTLE)
        return self._timed(("streaming", "node"), lambda: self._measure(seconds))

    def _bare_block(self, seconds: float) -> tuple[Block, Block]:
        self._load.run(SETTLE)
        found: list[float] = []

        def answered() -> bool:
            found.extend(self._bare.intervals())
            return bool(found)

        def both() -> Block:
            self._bare.begin(seconds)
            beside = self._measure(seconds)
            self._until(answered, ANSWER, "the bare loop does not answer")
            return beside

        beside = self._timed(("bare",), both)
        return Block(tuple(found)), beside

    def _measure(self, seconds: float) -> Block:
        block = self._load.measure(seconds)
        expected = seconds / PERIOD
        if len(block.intervals) < COMPLETE * expected:
            raise CommandError(
                f"{len(block.intervals)} send intervals were reported in {seconds:g} s, "
                f"of about {expected:.0f}"
            )
        return block

    def _timed(self, names: Sequence[str], work: Callable[[], Block]) -> Block:
        """Do something, and note the CPU time that processes take for it."""
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
