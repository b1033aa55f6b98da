"""`omniman bench arm`: timing of the arm's setpoints at 125 Hz, compared with a bare loop.

The measurement consists of pairs of blocks. In both blocks, all nodes of the robot run under load,
in a ROS domain of their own: the robot drives to goals among obstacles while its arm follows
trajectories. In one of the two, a bare loop runs beside them: a process that only sleeps until
absolute deadlines and sends, in the same scheduling class as the streaming process of
`arm_streamer`. The order of the two blocks changes from pair to pair.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from omniman_ros.client.messages import RoundObstacle
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.conversions.poses import pose_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.lab.bench.harness import (
    LENIENT,
    BenchmarkTable,
    Figure,
    RunningNodes,
    at_most,
    conclude,
    running_nodes,
)
from omniman_ros.lab.faults.robot_processes import children
from omniman_ros.lab.measurement import cpu_time, spread_ms
from omniman_ros.lab.priority import scheduling, set_niceness
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.processes.free_ports import find_free_ports
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.ur.parameters import PERIOD

AIM_RATIO = 1.5  #: largest median of all pairs' ratios of the p99 send intervals
LATE = (0.012, 0.020)  #: intervals above which sends are counted as late [s]
PAUSE = 0.5  #: between two blocks, in which the last reports on the previous one arrive [s]
MIN_REPORTED_FRACTION = 0.5  #: of a block's intervals, within the block
BARE_TIMEOUT = 20.0  #: longest time that starting and ending the bare loop take [s]
UNNEEDED_NODES = ("joint_states_merger", "viewer")
HARDWARE_NODES = ("simulated_drive", "simulated_ur")  #: real hardware has CPUs of its own
HARDWARE_NICENESS = -10
READ_TIMEOUT = "ur.read_timeout:=0.04"  #: as its expiry is what the benchmark counts
OBSTACLES = ((1.3, 0.15), (1.3, -1.6), (3.5, 1.0), (-1.2, -0.3))  #: one between the goals [m]
OBSTACLE_RADIUS = 0.25  #: [m]
GOALS = ((2.6, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0))  #: in odom [m, m, rad]
#: Points of a round of the arm, as offsets from the initial joint angles [rad]. They are small, so
#: that a short delay of the simulated controller does not look like a fault of the setpoints.
JOINT_OFFSETS = ((0.3, -0.2, 0.3, -0.2, 0.2, 0.3), (-0.2, -0.1, 0.2, -0.3, -0.3, -0.2), (0.0,) * 6)
ROUNDS = 30  #: of the arm in a trajectory
FEED_PERIOD = 0.05  #: of the observations of the obstacles [s]
GOAL_PERIOD, GOAL_TIMEOUT = 1.0, 20.0  #: shortest and longest time between two goals [s]
PREVIEW_TIMEOUT = 0.3  #: without a preview, after which the arm's trajectory has ended [s]


class ArmBenchmarkLoad:
    """Keeps platform, planner and arm moving, and collects the timing of the arm's setpoints."""

    def __init__(self, nodes: RunningNodes) -> None:
        self._session, self._children = nodes.session, nodes.children
        self.controller: dict[str, str] = {}
        self.timing: dict[str, list[float]] = {"intervals": [], "ages": []}
        self._stopped: dict[str, str] = {}
        self._home: list[float] = []
        self._goals_sent = self._previews = self._driven = 0
        self._state = ""
        self._arm_commanded = self._goal_sent = -math.inf
        self._surroundings = [
            RoundObstacle(f"obstacle {k}", x, y, OBSTACLE_RADIUS, (0.0, 0.0))
            for k, (x, y) in enumerate(OBSTACLES)
        ]
        node = self._session.node
        publish, subscribe = node.create_publisher, node.create_subscription
        self._goals = publish(PoseStamped, "goal_pose", 10)
        self._obstacles = publish(MarkerArray, "obstacles", 50)
        self._joints = publish(JointTrajectory, "joint_trajectory", 10)
        subscribe(DiagnosticStatus, "stop_state", self.on_stop_state, ALL_LATCHED)
        subscribe(DiagnosticStatus, "mpc/status", self._on_planner, 10)
        subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        subscribe(Float64MultiArray, "arm/timing", self.on_timing, 50)
        # Raw messages are not deserialised: only their arrival matters.
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, 10, raw=True)
        self._home_input = subscribe(JointState, "arm/joint_states", self._on_joints, 10)

    def on_stop_state(self, message: DiagnosticStatus) -> None:
        """Record whether the node that sent a stop state is stopped."""
        self._stopped.pop(message.name, None)
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message

    def on_timing(self, message: Float64MultiArray) -> None:
        """Collect the send intervals and setpoint ages, distinguished by their labels."""
        first = 0
        for dimension in message.layout.dim:
            self.timing[dimension.label] += message.data[first : first + dimension.size]
            first += dimension.size

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/simulated_ur":
                self.controller = {item.key: item.value for item in status.values}

    def _on_planner(self, message: DiagnosticStatus) -> None:
        self._state = {item.key: item.value for item in message.values}.get("state", "")
        self._driven += self._state == "driving"

    def _on_preview(self, data: bytes) -> None:
        self._arm_commanded = time.monotonic()
        self._previews += 1

    def _on_joints(self, message: JointState) -> None:
        angles = dict(zip(message.name, message.position, strict=True))
        self._home = self._home or [angles[name] for name in UR_JOINTS]

    def begin(self) -> None:
        """Wait until all nodes are ready, and until the platform and the arm move."""
        self.until(self._is_ready, DISCOVERY_TIMEOUT, "nodes that miss a part of the robot")
        self._session.node.destroy_subscription(self._home_input)
        moving = lambda: self._driven > 0 and self._previews > 0  # noqa: E731
        self.until(moving, DISCOVERY_TIMEOUT, "no drive to a goal, or no previews of the arm")

    def _is_ready(self) -> bool:
        publishers = (self._goals, self._obstacles, self._joints)
        playing = self.controller.get("program_state") == "PLAYING"
        known = self._state and self._home and self.timing["intervals"] and playing
        return bool(known) and all(p.get_subscription_count() > 0 for p in publishers)

    def until(self, done: Callable[[], bool], timeout: float, failure: str) -> None:
        """Run the load until a condition holds; raise CommandError after `timeout` [s]."""
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                raise CommandError(f"{failure} within {timeout:g} s")
            self.run(FEED_PERIOD)

    def run(self, seconds: float) -> None:
        """Keep the platform, the planner and the arm moving for a given time [s]."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            if self._is_ready():
                self._feed(time.monotonic())
            self._session.spin(min(left, FEED_PERIOD))
            self.check()

    def check(self) -> None:
        """Check that no node is stopped and all processes run; see :meth:`run`."""
        self._children.check()
        if self._stopped:
            # A stop is published at once, the controller's diagnostics only once a second.
            self._session.wait(lambda: self.controller.get("program_state") != "PLAYING", 1.5)
            name, reason = next(iter(self._stopped.items()))
            keys = ("program_state", "program_end_reason")
            state = " ".join(self.controller.get(key, "unknown") for key in keys)
            raise CommandError(
                f"the robot stopped: {name} is {reason}; program on the controller: {state}"
            )

    def _feed(self, now: float) -> None:
        """Publish observations of the obstacles, and a new command for what is at rest."""
        stamp = self._session.node.get_clock().now().to_msg()
        markers = [obstacle.marker(0.0, stamp) for obstacle in self._surroundings]
        self._obstacles.publish(MarkerArray(markers=markers))
        since = now - self._goal_sent
        if since > GOAL_TIMEOUT or (since > GOAL_PERIOD and self._state != "driving"):
            self._goal_sent = now
            pose = pose_message(np.array(GOALS[self._goals_sent % len(GOALS)]))
            goal = PoseStamped(pose=pose)
            goal.header.frame_id = "odom"
            self._goals_sent += 1
            self._goals.publish(goal)
        if now - self._arm_commanded > PREVIEW_TIMEOUT:
            self._arm_commanded = now + GOAL_PERIOD  # wait longer for the first preview
            angles = (np.array(self._home) + JOINT_OFFSETS).tolist()
            points = [JointTrajectoryPoint(positions=each) for each in angles] * ROUNDS
            self._joints.publish(JointTrajectory(joint_names=list(UR_JOINTS), points=points))


def robot(args: argparse.Namespace) -> list[ProcessSpec]:
    """Return the processes of the robot's nodes; its simulated UR controller uses free ports."""
    ports = dict(zip(UR_PORTS, find_free_ports(len(UR_PORTS)), strict=True))
    params = [*LENIENT, READ_TIMEOUT, *(f"ports.{name}:={port}" for name, port in ports.items())]
    for name, port in (("dashboard", "dashboard"), ("script", "secondary"), ("rtde", "rtde")):
        params.append(f"ur.{name}_port:={ports[port]}")
    params += ["ur.reverse_port:=0", "ur.host:=127.0.0.1", f"ur.priority:={args.priority}"]
    setup = RobotSetup(robot=args.robot, params=[*params, *args.param], arm="simulated")
    tasks = [task for task in robot_processes(setup) if task.name not in UNNEEDED_NODES]
    if not any(task.name == "mpc_planner" for task in tasks):
        raise CommandError("mpc_planner cannot run on this machine, as casadi is not installed")
    return tasks


def bare_block(load: ArmBenchmarkLoad, seconds: float, priority: int) -> tuple[list[float], str]:
    """Run the bare loop under the load; return its intervals [s] and its scheduling class."""
    command = node_command("omniman_ros.lab.bench.arm_bare", (f"{seconds}", f"{priority}"))
    # Like each node, it leads a session, by which the kernel may group processes.
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            late = "the bare loop did not end"
            load.until(lambda: process.poll() is not None, seconds + BARE_TIMEOUT, late)
        finally:
            process.kill()
        assert process.stdout is not None
        said = json.loads(process.stdout.read())
    return said["intervals"], said["scheduling"]


def measure(
    nodes: RunningNodes, load: ArmBenchmarkLoad, priority: int, pairs: int, seconds: float
) -> dict[str, Any]:
    """Measure the streaming process and the bare loop in alternating blocks of a duration [s].

    Raises:
        CommandError: The robot stopped, or the two loops differ in their scheduling class.
    """
    load.begin()
    for name in HARDWARE_NODES:
        set_niceness(nodes.children.pid(name), HARDWARE_NICENESS)
    node = nodes.children.pid("arm_streamer")
    pids = {"streaming": next(children(node)), "node": node}
    ours = scheduling(pids["streaming"])
    before, started = load.controller, time.monotonic()
    used = {name: cpu_time(pid) for name, pid in pids.items()}
    sides: dict[str, list[list[float]]] = {"streamer": [], "bare": []}
    ages: list[float] = []

    def measure_streamer() -> None:
        load.timing = {"intervals": [], "ages": []}
        load.run(seconds)
        if len(load.timing["intervals"]) < MIN_REPORTED_FRACTION * seconds / PERIOD:
            raise CommandError(f"too few send intervals in {seconds:g} s")
        sides["streamer"].append(list(load.timing["intervals"]))
        ages.extend(load.timing["ages"])

    def measure_bare() -> None:
        intervals, theirs = bare_block(load, seconds, priority)
        if theirs != ours:
            raise CommandError(f"the loops differ in their scheduling class: {ours}, {theirs}")
        sides["bare"].append(intervals)

    for k in range(pairs):
        for block in (measure_streamer, measure_bare)[:: -1 if k % 2 else 1]:
            load.run(PAUSE)
            block()
    wall, last = time.monotonic() - started, load.controller
    fractions = {name: (cpu_time(pid) - used[name]) / wall for name, pid in pids.items()}
    load.until(lambda: load.controller is not last, 5.0, "no diagnostics of simulated_ur")
    return {
        "scheduling": ours,
        **figures(sides, ages),
        "cpu_share": fractions,
        "read_timeouts": ended_programs(load.controller) - ended_programs(before),
    }


def ended_programs(values: Mapping[str, str]) -> int:
    """Return the number of programs that have ended, from the diagnostics of `simulated_ur`.

    The streamer's program on the controller ends by itself only if no setpoint arrives within the
    read time-out, or if the connection is lost.
    """
    return int(values["programs"]) - (values["program_state"] == "PLAYING")


def figures(
    sides: Mapping[str, Sequence[Sequence[float]]], ages: Sequence[float]
) -> dict[str, Any]:
    """Return the figures of all blocks of both sides [s], and of the setpoints' ages [s]."""
    p99 = [[spread_ms(block)["p99_ms"] for block in sides[side]] for side in ("streamer", "bare")]
    ratios = [ours / theirs for ours, theirs in zip(*p99, strict=True)]
    result: dict[str, Any] = {"pair_ratios": ratios, "ratio": statistics.median(ratios)}
    for side, blocks in sides.items():
        values = [value for block in blocks for value in block]
        late = [sum(value > bound for value in values) for bound in LATE]
        result[side] = {**spread_ms(values), "count": len(values), "late": late}
    return {**result, "age": spread_ms(ages)}


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench arm`; return 0, the exit code of a successful measurement."""
    pairs, seconds = (2, 2.0) if args.quick else (5, 8.0)
    if not 0 <= args.priority <= 99:
        raise CommandError(f"--priority {args.priority}: must be from 0 to 99", 2)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must not reach another robot
    isolate_ros_domain(os.environ)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "pairs": pairs}
    result |= {"block_s": seconds, "priority": args.priority}
    with running_nodes(robot(args)) as nodes:
        say(f"{pairs} pairs of blocks of {seconds:g} s ...")
        result |= measure(nodes, ArmBenchmarkLoad(nodes), args.priority, pairs, seconds)
    return conclude("arm", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    both = result["streamer"], result["bare"]
    rows = []
    for key in ("median", "p99", "max"):
        times = [f"{side[f'{key}_ms']:.2f} ms" for side in both]
        rows.append(Figure(f"send interval, {key}", times))
    for k, bound in enumerate(LATE):
        counts = [f"{side['late'][k]} of {side['count']}" for side in both]
        rows.append(Figure(f"  above {1e3 * bound:g} ms", counts))
    ratios, fraction, age = result["pair_ratios"], result["cpu_share"], result["age"]
    about = f"ratio of the p99 intervals, median of {len(ratios)} pairs"
    ratio = at_most(about, result["ratio"], AIM_RATIO)
    spread = f"({min(ratios):.2f} to {max(ratios):.2f})"
    rows.append(ratio._replace(values=(*ratio.values, spread)))
    for key in ("median", "p99", "max"):
        value = f"{age[f'{key}_ms']:.2f} ms"
        rows.append(Figure(f"setpoint age at the feedback, {key}", (value,)))
    for name, about in (("streaming", "streaming process"), ("node", "node")):
        rows.append(Figure(f"share of a core, {about}", (f"{fraction[name]:.1%}",)))
    rows.append(at_most("read time-outs on the UR controller", result["read_timeouts"], 0))
    return [BenchmarkTable((f"arm_streamer, {result['scheduling']}", "bare loop"), rows)]
