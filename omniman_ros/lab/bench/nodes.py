"""`omniman bench nodes`: CPU time of platform_controller per tick, and until its first message.

A plain rclpy node with the same topics, `bare_controller`, gets the same messages at the same
time: the ratio of the two depends little on what else the machine does. This process takes the
place of the drives and of the arm.
"""

import argparse
import math
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.console.errors import CommandError
from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import PeriodicTicks, Session
from omniman_ros.console.terminal import say
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.lab.bench.harness import Rows, RunningNodes, conclude, running_nodes, tables
from omniman_ros.lab.measurement import cpu_time
from omniman_ros.lab.verdicts import verdict
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import node_command, resolve_robot
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import load_robot

AIM_TICK = 400.0
"""Aim: largest CPU time of a tick of platform_controller [us]."""
AIM_START = 0.6
"""Aim: largest time from the start of platform_controller to its first message [s]."""
PERIOD = 0.005
"""Period of the wheels' reports [s]."""
ARM_EVERY, TWIST_EVERY = 2, 10
"""Numbers of reports of the wheels from one report of the arm, and from one twist, to the next."""
WARM_UP = 1.0
"""Time for which the nodes are fed before the measurement [s]."""
START_TIMEOUT = 20.0
"""Longest time from the start of a node to its first message [s]."""
LONG_TIMEOUTS = ("-p", "timeouts.wheel_states:=5.0", "-p", "timeouts.cmd_vel:=5.0")
"""Timeouts with which the controller is not stopped while this process waits for a core."""
NAMESPACES = {"platform_controller": "", "bare_controller": "bare/"}
"""Prefix of the topics of each node that is measured, by its name."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement.

    Attributes:
        seconds: Time for which the ticks are measured [s].
        starts: Number of starts of each node.
    """

    seconds: float
    starts: int


FULL = Effort(seconds=20.0, starts=7)
"""Extent without options."""
QUICK = Effort(seconds=3.0, starts=1)
"""Extent with `--quick`."""


class Peers:
    """What the nodes talk to: wheels that turn as platform_controller commands, an arm, a teleop.

    Args:
        session: ROS session that talks.
        wheels: Names of the wheels.

    Attributes:
        commands: Number of wheel commands received so far, by the name of the node.
    """

    def __init__(self, session: Session, wheels: tuple[str, ...]) -> None:
        node = session.node
        self._clock = node.get_clock()
        self.commands = dict.fromkeys(NAMESPACES, 0)
        self._wheels = JointState(name=list(wheels), effort=[0.0] * len(wheels))
        self._angles = [0.0] * len(wheels)
        self._speeds = [0.0] * len(wheels)
        self._arm = JointState(name=list(UR_JOINTS), position=[0.0] * len(UR_JOINTS))
        self._publishers = {
            topic: [
                node.create_publisher(kind, prefix + topic, 10) for prefix in NAMESPACES.values()
            ]
            for kind, topic in (
                (JointState, "wheel_states"),
                (JointState, "arm/joint_states"),
                (Twist, "cmd_vel"),
            )
        }
        for name, prefix in NAMESPACES.items():
            topic = f"{prefix}wheel_commands"
            node.create_subscription(JointState, topic, self._counter(name), 100)
            # Readers as in a robot; what they get does not matter.
            for kind, other in ((Odometry, "odom"), (JointState, "coupling_error")):
                node.create_subscription(kind, prefix + other, lambda data: None, 1, raw=True)

    @property
    def driving(self) -> bool:
        """Whether the last command to the wheels turns them."""
        return any(self._speeds)

    def _counter(self, name: str) -> Callable[[JointState], None]:
        def count(message: JointState) -> None:
            self.commands[name] += 1
            if name == "platform_controller":
                self._speeds = list(message.velocity)

        return count

    def feed(self, session: Session, seconds: float, check: Callable[[], None]) -> None:
        """Send the nodes what they get in a driving robot.

        Args:
            session: The ROS session.
            seconds: Time for which they are fed [s].
            check: Called once a period.
        """
        before = 0.0
        for count, t in enumerate(PeriodicTicks(session, seconds, PERIOD, check)):
            step, before = t - before, t
            self._angles = [a + step * v for a, v in zip(self._angles, self._speeds, strict=True)]
            self._wheels.position, self._wheels.velocity = self._angles, self._speeds
            self._send("wheel_states", self._wheels)
            if count % ARM_EVERY == 0:
                self._send("arm/joint_states", self._arm)
            if count % TWIST_EVERY == 0:
                twist = (0.2 * math.cos(t), 0.2 * math.sin(t), 0.2 * math.sin(0.7 * t))
                self._send("cmd_vel", twist_message(twist))

    def _send(self, topic: str, message: Any) -> None:
        if isinstance(message, JointState):
            message.header.stamp = self._clock.now().to_msg()
        for publisher in self._publishers[topic]:
            publisher.publish(message)


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench nodes`; return 0, the exit code of a successful measurement.

    Raises:
        CommandError: A node does not drive, or a process has ended.
    """
    effort = QUICK if args.quick else FULL
    robot = resolve_robot(args.robot)
    given = ("--ros-args", "-p", f"robot:={robot}", *LONG_TIMEOUTS)
    specs = [
        ProcessSpec("platform_controller", node_command("platform_controller", given)),
        ProcessSpec(
            "bare_controller",
            node_command(
                "omniman_ros.lab.bench.bare_controller", ("--ros-args", "-r", "__ns:=/bare")
            ),
        ),
    ]
    isolate_ros_domain(os.environ)
    say(f"{effort.starts} starts of each node ...")
    starts: dict[str, list[Start]] = {spec.name: [] for spec in specs}
    for _ in range(effort.starts):
        for spec in specs:
            starts[spec.name].append(measure_start(spec))
    say(f"ticks, {effort.seconds:g} s ...")
    wheels = tuple(load_robot(args.robot)["wheels.names"])
    with running_nodes(specs) as nodes:
        ticks = measure_ticks(nodes, wheels, effort.seconds)
    result = {
        "robot": args.robot,
        "quick": args.quick,
        "tick_us": ticks,
        "tick_ratio": ticks["platform_controller"] / ticks["bare_controller"],
        "start_s": {name: statistics.median(s.elapsed for s in starts[name]) for name in starts},
        "start_cpu_s": {name: statistics.median(s.cpu for s in starts[name]) for name in starts},
    }
    return conclude("nodes", result, report, args.results, aims)


@dataclass(frozen=True)
class Start:
    """The start of a node, up to its first message.

    Attributes:
        elapsed: Elapsed time [s].
        cpu: CPU time of the node's process [s].
    """

    elapsed: float
    cpu: float


def measure_start(spec: ProcessSpec) -> Start:
    """Start a node and wait for its first message, the state of its stop latch.

    Args:
        spec: Process of the node.

    Raises:
        CommandError: There is no message, or the process has ended.
    """
    started: list[Start] = []
    begin = time.monotonic()
    with running_nodes([spec]) as nodes:

        def first(message: DiagnosticStatus) -> None:
            if not started:
                pid = nodes.pids([spec.name])[spec.name]
                started.append(Start(time.monotonic() - begin, cpu_time(pid)))

        topic = f"{NAMESPACES[spec.name]}stop_state"
        nodes.session.node.create_subscription(DiagnosticStatus, topic, first, LATCHED)
        nodes.wait(lambda: bool(started), START_TIMEOUT, f"{spec.name}: no {topic}")
    return started[0]


def measure_ticks(
    nodes: RunningNodes, wheels: tuple[str, ...], seconds: float
) -> dict[str, float]:
    """Measure the CPU time of each node per wheel command while the robot drives [us].

    Args:
        nodes: The running nodes.
        wheels: Names of the wheels.
        seconds: Duration of the measurement [s].

    Raises:
        CommandError: A node sends no commands, the wheels stand, or a process has ended.
    """
    peers = Peers(nodes.session, wheels)
    nodes.wait(lambda: all(peers.commands.values()), START_TIMEOUT, "no wheel_commands")
    peers.feed(nodes.session, WARM_UP, nodes.children.check)
    pids = nodes.pids(list(NAMESPACES))
    count, cpu = dict(peers.commands), {name: cpu_time(pid) for name, pid in pids.items()}
    peers.feed(nodes.session, seconds, nodes.children.check)
    if not peers.driving:
        raise CommandError("platform_controller: the wheels stand after a drive")
    return {
        name: 1e6 * (cpu_time(pid) - cpu[name]) / (peers.commands[name] - count[name])
        for name, pid in pids.items()
    }


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    return {
        "tick": result["tick_us"]["platform_controller"] <= AIM_TICK,
        "start": result["start_s"]["platform_controller"] <= AIM_START,
    }


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("", "tick, CPU", "start, CPU", "start")]
    for name, micros in result["tick_us"].items():
        cpu, elapsed = result["start_cpu_s"][name], result["start_s"][name]
        rows.append((name, f"{micros:.0f} us", f"{cpu:.2f} s", f"{elapsed:.2f} s"))
    rows.append(("ratio of the ticks", f"{result['tick_ratio']:.2f}", "", ""))
    rows.append(("aim", f"<= {AIM_TICK:g} us", "", f"<= {AIM_START:g} s"))
    met = {key: verdict(good) for key, good in result["aims"].items()}
    rows.append(("", met["tick"], "", met["start"]))
    return tables(rows)
