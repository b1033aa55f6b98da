"""`omniman bench participants`: a robot that drives while participants come and go.

On real time, with every core busy, half of the guests are killed. A process that is killed while
it holds a lock in the shared memory of Fast DDS leaves it locked; who publishes to it then waits
for a second, again and again. The robot drives once with the middleware's default transports, and
once without shared memory. What a call of publish() takes is divided by the kernel's account: it
runs, it waits for a core, or it is blocked, which no other process of the machine is to blame for.

The drives are silent while their process waits for a core. Silences that are longer than
`timeouts.wheel_states` are counted; the controller latches a stop at the first of them.
"""

import argparse
import contextlib
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import PeriodicTicks, Session
from omniman_ros.console.terminal import say
from omniman_ros.control.platform_parameters import Timeouts
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.lab.bench.guests import AT_ONCE, PROBE
from omniman_ros.lab.bench.harness import Rows, RunningNodes, conclude, running_nodes, tables
from omniman_ros.lab.priority import set_niceness
from omniman_ros.lab.soak.waiting import WaitingWatch
from omniman_ros.lab.verdicts import verdict
from omniman_ros.nodes.stop_interface import ALL_LATCHED, STOP_STATE
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import node_command, resolve_robot
from omniman_ros.processes.ros_domain import free_domain
from omniman_ros.robots import load_robot

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
        longest_silence: Longest time between the stamps of two reports of the wheels [s].
        silences: Number of times between two reports that were longer than
            `timeouts.wheel_states`.
        waited: Longest time for which a thread of the nodes has waited for a core between two
            samples [s].
        stops: Why each node that was stopped had latched, by its name.
        prioritised: Whether the system permitted the niceness.
    """

    blocked: float
    longest_gap: float
    longest_silence: float
    silences: int
    waited: float
    stops: Mapping[str, str]
    prioritised: bool


class Gaps:
    """Notes the times between the stamps of two messages of a topic.

    Args:
        limit: Time from which on a gap counts [s].

    Attributes:
        longest: Longest gap so far [s].
        count: Number of gaps so far that are longer than the limit.
    """

    def __init__(self, limit: float) -> None:
        self._limit, self._stamp = limit, math.inf
        self.longest, self.count = 0.0, 0

    def add(self, stamp: float) -> None:
        """Note a message with a stamp [s]."""
        gap = stamp - self._stamp
        self.longest = max(self.longest, gap)
        self.count += gap > self._limit
        self._stamp = stamp

    def clear(self) -> None:
        """Forget the gaps."""
        self.longest, self.count = 0.0, 0


class Witness:
    """Publishes as the robot does, and receives commands, reports of the wheels, and stops.

    Args:
        session: ROS session that receives.
        limit: Age from which the wheels' reports are stale to the controller [s].

    Attributes:
        blocked: Longest time for which a call of publish() was blocked so far [s].
        commands: Gaps between the commands to the wheels.
        reports: Gaps between the reports of the wheels.
        stops: Why each node that was stopped had latched, by its name.
        moves: Whether the last command turns the wheels.
    """

    def __init__(self, session: Session, limit: float) -> None:
        self.blocked, self.moves = 0.0, False
        self.commands, self.reports = Gaps(limit), Gaps(limit)
        self.stops: dict[str, str] = {}
        node = session.node
        self._twists = node.create_publisher(Twist, "cmd_vel", 1)
        self._probe = node.create_publisher(JointState, PROBE, 1)
        node.create_subscription(JointState, "wheel_commands", self._on_command, 1000)
        node.create_subscription(JointState, "wheel_states", self._on_report, 1000)
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
        self.commands.add(time_seconds(message.header.stamp))
        self.moves = any(message.velocity)

    def _on_report(self, message: JointState) -> None:
        self.reports.add(time_seconds(message.header.stamp))

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
    limit = float(load_robot(robot).get("timeouts.wheel_states", Timeouts().wheel_states))
    given = ("--ros-args", "-p", f"robot:={robot}")
    specs = [ProcessSpec(name, node_command(name, given)) for name in NODES]
    with (
        running_nodes(specs) as nodes,
        busy_cores(),
        preferred(nodes.pids(NODES).values()) as prioritised,
    ):
        return _witnessed(nodes, Witness(nodes.session, limit), count, prioritised)


def _witnessed(nodes: RunningNodes, witness: Witness, count: int, prioritised: bool) -> Run:
    watch, pids = WaitingWatch(), nodes.pids(NODES).values()

    def moves() -> bool:
        witness.drive()
        return witness.moves

    nodes.wait(moves, START_TIMEOUT, "the robot does not move")
    witness.commands.clear()
    witness.reports.clear()
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
            watch.look(pids, time.monotonic())
            if k % TWIST_EVERY == 0:
                witness.drive()
                if guests.poll() is not None:
                    break
    finally:
        guests.kill()
        guests.wait()
    return Run(
        witness.blocked,
        witness.commands.longest,
        witness.reports.longest,
        witness.reports.count,
        watch.longest,
        witness.stops,
        prioritised,
    )


def scheduled() -> float:
    """Return for how long this thread has run, or waited for a core, so far [s]."""
    running, waiting, _ = Path("/proc/thread-self/schedstat").read_text().split()
    return 1e-9 * (int(running) + int(waiting))


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy."""
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            command = [sys.executable, "-c", "while True: pass"]
            loop = subprocess.Popen(command, start_new_session=True)
            stack.enter_context(loop)
            stack.callback(loop.kill)
        yield


@contextlib.contextmanager
def preferred(pids: Iterable[int]) -> Iterator[bool]:
    """Prefer the nodes and this process to others, and tell whether the system permits it.

    Args:
        pids: Process ids of the nodes.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    permitted = [set_niceness(pid, NICENESS) for pid in (*pids, os.getpid())]
    try:
        yield all(permitted)
    finally:
        if all(permitted):
            set_niceness(os.getpid(), before)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met without shared memory."""
    lean = result["runs"]["UDP only"]
    return {"blocked": lean["blocked"] <= AIM_BLOCKED, "no_stop": not lean["stops"]}


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    runs, met = result["runs"], {key: verdict(good) for key, good in result["aims"].items()}
    rows: Rows = [("transports", *runs, "aim, UDP only", "")]
    for text, key, aim in (
        ("publish() blocked at most", "blocked", AIM_BLOCKED),
        ("largest gap of wheel_commands", "longest_gap", None),
        ("largest gap of wheel_states", "longest_silence", None),
        ("a node's thread waited for a core", "waited", None),
    ):
        times = [f"{1e3 * each[key]:.0f} ms" for each in runs.values()]
        aimed = ("", "") if aim is None else (f"<= {1e3 * aim:g} ms", met[key])
        rows.append((text, *times, *aimed))
    counts = [f"{each['silences']}" for each in runs.values()]
    rows.append(("silences of wheel_states", *counts, "", ""))
    stops = [
        "; ".join(f"{node}: {why}" for node, why in each["stops"].items()) or "none"
        for each in runs.values()
    ]
    rows.append(("latched stops", *stops, "none", met["no_stop"]))
    return tables(rows)
