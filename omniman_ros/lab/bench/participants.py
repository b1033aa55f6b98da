"""`omniman bench participants`: a robot that drives while participants come and go.

On real time, with every core busy, half of the guests are killed. A process that is killed while
it holds a lock in the shared memory of Fast DDS leaves it locked; who publishes to it then waits
for a second, again and again. The robot drives once with the middleware's default transports, and
once without shared memory. What a call of publish() takes is divided by the kernel's account: it
runs, it waits for a core, or it is blocked, which no other process of the machine is to blame for.
"""

import argparse
import contextlib
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import PeriodicTicks, Session
from omniman_ros.console.terminal import say
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.lab.bench.guests import AT_ONCE, PROBE
from omniman_ros.lab.bench.harness import Rows, RunningNodes, conclude, running_nodes, tables
from omniman_ros.lab.verdicts import verdict
from omniman_ros.nodes.stop_interface import ALL_LATCHED, STOP_STATE
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import node_command, resolve_robot
from omniman_ros.processes.ros_domain import free_domain

GUESTS, QUICK_GUESTS = 200, 6
"""Number of guests without options, and with `--quick`."""
NODES = ("simulated_drive", "platform_controller")
"""Nodes of the robot."""
TRANSPORTS = {"default": "DEFAULT", "UDP only": "UDPv4"}
"""Value of FASTDDS_BUILTIN_TRANSPORTS for each run, by its name."""
NICENESS = -10
"""Niceness of the robot's nodes and of this process, where the system permits it."""
TWIST = (0.2, 0.0, 0.3)
"""The twist that is driven [m/s, m/s, rad/s]."""
AIM_BLOCKED = 0.1
"""Aim: longest time for which a call of publish() is blocked without shared memory [s]: the
drives ramp to rest after as long without a command."""
PERIOD, TWIST_EVERY = 0.01, 5
"""Period of the probe [s], and the number of periods from one twist to the next."""
START_TIMEOUT = 60.0
"""Longest time until the robot moves [s]."""


@dataclass(frozen=True)
class Run:
    """How the robot fared.

    Attributes:
        blocked: Longest time for which a call of publish() was blocked [s].
        longest_gap: Longest time between the stamps of two commands to the wheels [s].
        stops: Why each node that was stopped had latched, by its name.
        prioritised: Whether the system permitted the niceness.
    """

    blocked: float
    longest_gap: float
    stops: Mapping[str, str]
    prioritised: bool


class Witness:
    """Publishes as the robot does, and hears the commands to the wheels and the stops.

    Args:
        session: ROS session that hears.

    Attributes:
        blocked: Longest time for which a call of publish() was blocked so far [s].
        longest_gap: Longest time between the stamps of two commands so far [s].
        stops: Why each node that was stopped had latched, by its name.
        moves: Whether the last command turns the wheels.
    """

    def __init__(self, session: Session) -> None:
        self.blocked, self.longest_gap, self.moves = 0.0, 0.0, False
        self.stops: dict[str, str] = {}
        self._stamp: float | None = None
        node = session.node
        self._twists = node.create_publisher(Twist, "cmd_vel", 1)
        self._probe = node.create_publisher(JointState, PROBE, 1)
        node.create_subscription(JointState, "wheel_commands", self._on_command, 1000)
        node.create_subscription(DiagnosticStatus, STOP_STATE, self._on_stop, ALL_LATCHED)

    def drive(self) -> None:
        """Ask for the twist."""
        self._twists.publish(twist_message(TWIST))

    def probe(self) -> None:
        """Publish to the guests, and note for how long that was blocked."""
        before, begin = scheduled(), time.monotonic()
        self._probe.publish(JointState(name=["probe"], position=[0.0]))
        elapsed = time.monotonic() - begin
        self.blocked = max(self.blocked, elapsed - (scheduled() - before))

    def _on_command(self, message: JointState) -> None:
        stamp = time_seconds(message.header.stamp)
        if self._stamp is not None:
            self.longest_gap = max(self.longest_gap, stamp - self._stamp)
        self._stamp, self.moves = stamp, any(message.velocity)

    def _on_stop(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self.stops.setdefault(message.name, message.message)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench participants`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: The robot does not move, or a process has ended.
    """
    count, robot = QUICK_GUESTS if args.quick else GUESTS, resolve_robot(args.robot)
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    # With LOCALHOST, rmw_fastrtps of Jazzy uses shared memory whatever the transports are.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    runs = {}
    for name, transports in TRANSPORTS.items():
        say(f"{count} guests, {AT_ONCE} at a time, transports: {name} ...")
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = transports
        runs[name] = asdict(measure(robot, count))
    result = {"robot": args.robot, "quick": args.quick, "guests": count, "runs": runs}
    return conclude("participants", result, report, args.results, aims)


def measure(robot: str, count: int) -> Run:
    """Drive a robot while guests come and go.

    Args:
        robot: Path of the robot's file.
        count: Number of guests.

    Raises:
        CommandError: The robot does not move, or a process has ended.
    """
    given = ("--ros-args", "-p", f"robot:={robot}")
    specs = [ProcessSpec(name, node_command(name, given)) for name in NODES]
    with running_nodes(specs) as nodes, busy_cores():
        pids = [os.getpid(), *nodes.pids(NODES).values()]
        with reniced(pids) as prioritised:
            return _witnessed(nodes, count, prioritised)


def _witnessed(nodes: RunningNodes, count: int, prioritised: bool) -> Run:
    witness = Witness(nodes.session)

    def moves() -> bool:
        witness.drive()
        return witness.moves

    nodes.wait(moves, START_TIMEOUT, "the robot does not move")
    witness.longest_gap = 0.0
    command = [sys.executable, "-m", "omniman_ros.lab.bench.guests", str(count)]
    environment = {**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
    if prioritised:
        command = ["nice", "-n", str(-NICENESS), *command]  # it would inherit that of this process
    guests = subprocess.Popen(command, env=environment)
    try:
        for k, _ in enumerate(
            PeriodicTicks(nodes.session, math.inf, PERIOD, nodes.children.check)
        ):
            witness.probe()
            if k % TWIST_EVERY == 0:
                witness.drive()
                if guests.poll() is not None:
                    break
    finally:
        guests.kill()
        guests.wait()
    return Run(witness.blocked, witness.longest_gap, witness.stops, prioritised)


def scheduled() -> float:
    """Return for how long this thread has run, or waited for a core, so far [s]."""
    running, waiting, _ = Path("/proc/thread-self/schedstat").read_text().split()
    return 1e-9 * (int(running) + int(waiting))


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy."""
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.enter_context(loop)
            stack.callback(loop.kill)
        yield


@contextlib.contextmanager
def reniced(pids: list[int]) -> Iterator[bool]:
    """Prefer the threads of processes to others, and tell whether the system permits it.

    Args:
        pids: Process ids; the first one gets its niceness back.
    """
    before = os.getpriority(os.PRIO_PROCESS, pids[0])
    try:
        for pid in pids:
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.setpriority(os.PRIO_PROCESS, int(thread), NICENESS)
        permitted = True
    except PermissionError:
        permitted = False
    try:
        yield permitted
    finally:
        os.setpriority(os.PRIO_PROCESS, pids[0], before)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met without shared memory."""
    lean = result["runs"]["UDP only"]
    return {"blocked": lean["blocked"] <= AIM_BLOCKED, "no_stop": not lean["stops"]}


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("transports", "publish() blocked", "gap of wheel_commands", "latched stops")]
    for name, figures in result["runs"].items():
        stops = "; ".join(f"{node}: {why}" for node, why in figures["stops"].items())
        blocked, gap = (f"{1e3 * figures[key]:.0f} ms" for key in ("blocked", "longest_gap"))
        rows.append((name, blocked, gap, stops or "none"))
    met = {key: verdict(good) for key, good in result["aims"].items()}
    rows.append(("aim, UDP only", f"<= {1e3 * AIM_BLOCKED:g} ms", "", "none"))
    rows.append(("", met["blocked"], "", met["no_stop"]))
    return tables(rows)
