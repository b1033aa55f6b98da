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
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.demo.moving_obstacles import MovingObstacles
from omniman_ros.lab.bench.harness import (
    LENIENT,
    Rows,
    RunningNodes,
    conclude,
    running_nodes,
    tables,
)
from omniman_ros.lab.measurement import cpu_time, percentiles_ms
from omniman_ros.lab.priority import scheduling, set_niceness
from omniman_ros.lab.verdicts import verdict
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.processes.free_ports import find_free_ports
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, node_command, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.ur.parameters import PERIOD

AIM_RATIO = 1.5  # largest median of all pairs' ratios of the p99 send intervals
LATE, VERY_LATE = 0.012, 0.020  # intervals that count as late [s]
PAUSE = 0.5  # between two blocks, in which the last reports on the previous one arrive [s]
MIN_REPORTED_SHARE = 0.5  # of a block's intervals, within the block
REPORT_TIMEOUT = 5.0  # longest time until the reports on a block arrive [s]
BARE_TIMEOUT = 20.0  # longest time that starting and ending the bare loop take [s]
BLOCK_RANGE = (1.0, 600.0)  # of the duration of a block [s]
UNNEEDED_NODES = ("joint_states_merger", "viewer")
HARDWARE_NODES = ("simulated_drive", "simulated_ur")  # real hardware has CPUs of its own
HARDWARE_NICENESS = -10
STREAMING_MODULE = "omniman_ros.ur.streaming_loop"
READ_TIMEOUT = "ur.read_timeout:=0.04"  # as its expiry is what the benchmark counts
OBSTACLES = ((1.3, 0.15), (1.3, -1.6), (3.5, 1.0), (-1.2, -0.3))  # one is between the goals [m]
OBSTACLE_RADIUS = 0.25  # [m]
GOALS = ((2.6, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0))  # in odom [m, m, rad]
JOINT_OFFSETS = (
    (0.3, -0.2, 0.3, -0.2, 0.2, 0.3),
    (-0.2, -0.1, 0.2, -0.3, -0.3, -0.2),
    (0.0,) * 6,
)
"""Points of a round of the arm, as offsets from the initial joint angles [rad]. They are small, so
that a short delay of the simulated controller does not look like a fault of the setpoints."""
ROUNDS = 30  # of the arm in a trajectory
FEED_PERIOD = 0.05  # of the observations of the obstacles [s]
GOAL_PERIOD, GOAL_TIMEOUT = 1.0, 20.0  # shortest and longest time between two goals [s]
PREVIEW_TIMEOUT = 0.3  # without a preview, after which the arm's trajectory has ended [s]


class Load:
    """Keeps platform, planner and arm moving, and collects the timing of the arm's setpoints."""

    def __init__(self, nodes: RunningNodes) -> None:
        self._session, self._children = nodes.session, nodes.children
        self.controller: dict[str, str] = {}
        self.reports = 0  # diagnostics of the simulated UR controller
        self.intervals: list[float] = []
        self.ages: list[float] = []
        self._goals_sent = self._previews = self._driven = 0
        self._stopped: dict[str, str] = {}
        self._home: list[float] = []
        self._state = ""
        self._arm_commanded = self._goal_sent = -math.inf
        count = len(OBSTACLES)
        places, radii = np.array(OBSTACLES), np.full(count, OBSTACLE_RADIUS)
        self._surroundings = MovingObstacles(0.0, places, np.zeros((count, 2)), radii)
        node = self._session.node
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        self._obstacles = node.create_publisher(MarkerArray, "obstacles", 50)
        self._joints = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        subscribe = node.create_subscription
        subscribe(DiagnosticStatus, "stop_state", self.on_stop_state, ALL_LATCHED)
        subscribe(DiagnosticStatus, "mpc/status", self._on_planner, 10)
        subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        subscribe(Float64MultiArray, "arm/timing", self.on_timing, 50)
        # Raw messages are not deserialised: mostly, only their arrival matters.
        subscribe(JointTrajectory, "arm/joint_reference", self._on_preview, 10, raw=True)
        subscribe(JointState, "arm/joint_states", self._on_joints, 10, raw=True)

    def on_stop_state(self, message: DiagnosticStatus) -> None:
        """Record whether the node that sent a stop state is stopped."""
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    def on_timing(self, message: Float64MultiArray) -> None:
        """Collect the send intervals and setpoint ages, distinguished by their labels."""
        first = 0
        for dimension in message.layout.dim:
            values = message.data[first : first + dimension.size]
            {"intervals": self.intervals, "ages": self.ages}[dimension.label].extend(values)
            first += dimension.size

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/simulated_ur":
                self.controller = {item.key: item.value for item in status.values}
                self.reports += 1

    def _on_planner(self, message: DiagnosticStatus) -> None:
        self._state = {item.key: item.value for item in message.values}.get("state", "")
        self._driven += self._state == "driving"

    def _on_preview(self, data: bytes) -> None:
        self._arm_commanded = time.monotonic()
        self._previews += 1

    def _on_joints(self, data: bytes) -> None:
        if not self._home:
            message = deserialize_message(data, JointState)
            angles = dict(zip(message.name, message.position, strict=True))
            self._home = [angles[name] for name in UR_JOINTS]

    def begin(self) -> None:
        """Wait until all nodes are ready, and until the platform and the arm move."""
        self.until(self._is_ready, DISCOVERY_TIMEOUT, "nodes that miss a part of the robot")
        moving = lambda: self._driven > 0 and self._previews > 0  # noqa: E731
        self.until(moving, DISCOVERY_TIMEOUT, "no drive to a goal, or no previews of the arm")

    def _is_ready(self) -> bool:
        publishers = (self._goals, self._obstacles, self._joints)
        playing = self.controller.get("program_state") == "PLAYING"
        known = self._state and self._home and self.intervals and playing
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
                self._feed()
            self._session.spin(min(left, FEED_PERIOD))
            self.check()

    def check(self) -> None:
        """Check that no node is stopped and all processes run; see :meth:`run`."""
        self._children.check()
        if self._stopped:
            # A stop is published at once, the controller's diagnostics only once a second.
            self._session.wait(lambda: self.controller.get("program_state") != "PLAYING", 1.5)
            name, reason = next(iter(self._stopped.items()))
            state = self.controller.get("program_state", "unknown")
            end = self.controller.get("program_end_reason", "")
            raise CommandError(
                f"the robot stopped: {name} is {reason}; the program on the controller: {state}"
                + (f" ({end})" if end else "")
            )

    def _feed(self) -> None:
        """Publish observations of the obstacles, and a new command for what is at rest."""
        now, stamp = time.monotonic(), self._session.node.get_clock().now().to_msg()
        self._obstacles.publish(self._surroundings.message(0.0, stamp))
        since = now - self._goal_sent
        if since > GOAL_TIMEOUT or (since > GOAL_PERIOD and self._state != "driving"):
            self._goal_sent = now
            goal = PoseStamped()
            goal.header.frame_id = "odom"
            x, y, heading = GOALS[self._goals_sent % len(GOALS)]
            goal.pose.position.x, goal.pose.position.y = x, y
            goal.pose.orientation = quaternion_from_yaw(heading)
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


def child_of(pid: int, word: str) -> int:
    """Return the process id of a child whose command line has a word."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            words = (folder / "cmdline").read_text().split("\0")
        except OSError:  # the process has ended meanwhile
            continue
        if int(parent) == pid and word in words:
            return int(folder.name)
    raise CommandError(f"process {pid} has no child {word} (the search needs Linux)")


def bare_block(load: Load, seconds: float, priority: int) -> tuple[list[float], str]:
    """Run the bare loop under the load; return its intervals [s] and its scheduling class."""
    given = (f"{seconds}", f"{priority}")
    command = node_command("omniman_ros.lab.bench.arm_bare", given)
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
    nodes: RunningNodes, load: Load, priority: int, pairs: int, seconds: float
) -> dict[str, Any]:
    """Measure the streaming process and the bare loop in alternating blocks of a duration [s].

    Raises:
        CommandError: The robot stopped, or the two loops differ in their scheduling class.
    """
    load.begin()
    for name in HARDWARE_NODES:
        set_niceness(nodes.children.pid(name), HARDWARE_NICENESS)
    node = nodes.children.pid("arm_streamer")
    pids = {"streaming": child_of(node, STREAMING_MODULE), "node": node}
    ours = scheduling(pids["streaming"])
    before, started = load.controller, time.monotonic()
    used = {name: cpu_time(pid) for name, pid in pids.items()}
    sides: dict[str, list[list[float]]] = {"streamer": [], "bare": []}
    ages: list[float] = []

    def measure_streamer() -> None:
        load.intervals.clear()
        load.ages.clear()
        load.run(seconds)
        if len(load.intervals) < MIN_REPORTED_SHARE * seconds / PERIOD:
            raise CommandError(f"only {len(load.intervals)} send intervals in {seconds:g} s")
        sides["streamer"].append(list(load.intervals))
        ages.extend(load.ages)

    def measure_bare() -> None:
        intervals, theirs = bare_block(load, seconds, priority)
        if theirs != ours:
            raise CommandError(f"the loops differ in their scheduling class: {ours}, {theirs}")
        sides["bare"].append(intervals)

    for k in range(pairs):
        for block in (measure_streamer, measure_bare)[:: -1 if k % 2 else 1]:
            load.run(PAUSE)
            block()
        say(f"  pair {k + 1}: p99 ratio {pair_ratios(sides)[-1]:.3f}")
    reports, wall = load.reports, time.monotonic() - started
    shares = {name: (cpu_time(pid) - used[name]) / wall for name, pid in pids.items()}
    load.until(lambda: load.reports > reports, REPORT_TIMEOUT, "no diagnostics of simulated_ur")
    return {
        "scheduling": ours,
        **figures(sides, ages),
        "cpu_share": shares,
        "read_timeouts": ended_programs(load.controller) - ended_programs(before),
    }


def ended_programs(values: Mapping[str, str]) -> int:
    """Return the number of programs that have ended, from the diagnostics of `simulated_ur`.

    The streamer's program on the controller ends by itself only if no setpoint arrives within the
    read time-out, or if the connection is lost.
    """
    return int(values["programs"]) - (values["program_state"] == "PLAYING")


def pair_ratios(sides: Mapping[str, Sequence[Sequence[float]]]) -> list[float]:
    """Return the ratios of the streamer's p99 interval to the bare loop's, by pair of blocks."""
    each = zip(sides["streamer"], sides["bare"], strict=False)
    return [percentiles_ms(ours)[1] / percentiles_ms(theirs)[1] for ours, theirs in each]


def figures(
    sides: Mapping[str, Sequence[Sequence[float]]], ages: Sequence[float]
) -> dict[str, Any]:
    """Return the figures of all blocks of both sides [s], and of the setpoints' ages [s]."""
    names, ratios = ("p50_ms", "p99_ms", "max_ms"), pair_ratios(sides)
    result: dict[str, Any] = {"pair_ratios": ratios, "ratio": statistics.median(ratios)}
    for side, blocks in sides.items():
        values = [value for block in blocks for value in block]
        result[side] = {
            **dict(zip(names, percentiles_ms(values), strict=True)),
            "count": len(values),
            "above_12_ms": sum(value > LATE for value in values),
            "above_20_ms": sum(value > VERY_LATE for value in values),
        }
    result["age"] = dict(zip(names, percentiles_ms(ages), strict=True)) if ages else {}
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench arm`; return 0, the exit code of a successful measurement."""
    pairs = args.pairs if args.pairs is not None else 2 if args.quick else 5
    seconds = args.seconds if args.seconds is not None else 2.0 if args.quick else 8.0
    if pairs < 1:
        raise CommandError(f"--pairs {pairs}: must be at least 1", 2)
    if not BLOCK_RANGE[0] <= seconds <= BLOCK_RANGE[1]:
        low, high = BLOCK_RANGE
        raise CommandError(f"--seconds {seconds:g}: must be from {low:g} to {high:g} s", 2)
    if not 0 <= args.priority <= 99:
        raise CommandError(f"--priority {args.priority}: must be from 0 to 99", 2)
    os.environ.pop("ROS_DOMAIN_ID", None)  # the commands must not reach another robot
    isolate_ros_domain(os.environ)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "pairs": pairs}
    result |= {"block_s": seconds, "priority": args.priority}
    with running_nodes(robot(args)) as nodes:
        say(f"{pairs} pairs of blocks of {seconds:g} s ...")
        result |= measure(nodes, Load(nodes), args.priority, pairs, seconds)
    return conclude("arm", result, report, args.results, aims)


def aims(result: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    return {
        "p99_ratio": result["ratio"] <= AIM_RATIO,
        "read_timeouts": result["read_timeouts"] == 0,
    }


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    met = {key: verdict(good) for key, good in result["aims"].items()}
    ours, bare, share = result["streamer"], result["bare"], result["cpu_share"]
    rows: Rows = [(result["scheduling"], "arm_streamer", "bare loop", "aim", "")]
    for key in ("p50_ms", "p99_ms", "max_ms"):
        shown = (f"{side[key]:.2f} ms" for side in (ours, bare))
        rows.append((f"send interval, {key.removesuffix('_ms')}", *shown, "", ""))
    for bound in (12, 20):
        shown = (f"{side[f'above_{bound}_ms']} of {side['count']}" for side in (ours, bare))
        rows.append((f"  above {bound} ms", *shown, "", ""))
    low, high = min(result["pair_ratios"]), max(result["pair_ratios"])
    ratio, spread = f"{result['ratio']:.3f}", f"({low:.2f} to {high:.2f})"
    about = f"ratio of the p99 intervals, median of {len(result['pair_ratios'])} pairs"
    rows.append((about, ratio, spread, f"<= {AIM_RATIO:g}", met["p99_ratio"]))
    for key, value in result["age"].items():
        about = f"setpoint age at the feedback, {key.removesuffix('_ms')}"
        rows.append((about, f"{value:.2f} ms", "", "", ""))
    for name in ("streaming", "node"):
        about = f"share of a core, {name.replace('streaming', 'streaming process')}"
        rows.append((about, f"{100 * share[name]:.1f} %", "", "", ""))
    timeouts = str(result["read_timeouts"])
    rows.append(("read time-outs on the UR controller", timeouts, "", "0", met["read_timeouts"]))
    return tables(rows)
