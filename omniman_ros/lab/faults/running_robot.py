"""The running robot of the faults: its processes, its ground truth, and what it reports."""

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.arrays import Array
from omniman_ros.lab.faults.injections import (
    ARM,
    BRIDGE,
    CONTROLLER,
    DRIVES,
    STREAMER,
    STREAMING_PROCESS,
)
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes

YAW_ARM = 0.5
"""Distance from its centre at which a turn of the platform counts as speed [m]."""
HARDWARE = (DRIVES, ARM)
"""Processes that simulate hardware, which on a real robot has processors of its own."""
HARDWARE_NICENESS, NICENESS = -15, -10
"""Niceness of these and of the other processes, where the system permits it."""
MOVERS = (CONTROLLER, BRIDGE, STREAMER)
"""Nodes whose stop states tell whether the robot can be driven."""
DASHBOARD_PORT = "ports.dashboard:="
"""Beginning of the argument that gives the port of the dashboard."""
SERVICE_TIMEOUT = 10.0
"""Longest time for the answer of a service [s]."""
CALLS = 3
"""Number of calls of a service that does not answer."""


class GroundTruth:
    """Records where the simulated robot really is.

    Speeds are those of the platform, where a turn counts by `YAW_ARM`, and of the fastest joint.

    Args:
        session: ROS session that receives it.
    """

    def __init__(self, session: Session) -> None:
        self._platform: list[tuple[float, ...]] = []
        self._arm: list[tuple[float, ...]] = []
        node, depth = session.node, 1000
        node.create_subscription(Odometry, "ground_truth/odom", self._on_odom, depth)
        node.create_subscription(
            JointState, "ground_truth/arm_joint_states", self._on_joints, depth
        )

    def _on_odom(self, message: Odometry) -> None:
        twist, position = message.twist.twist, message.pose.pose.position
        speed = np.hypot(twist.linear.x, twist.linear.y) + YAW_ARM * abs(twist.angular.z)
        at = time_seconds(message.header.stamp)
        yaw = yaw_from_quaternion(message.pose.pose.orientation)
        self._platform.append((at, float(speed), position.x, position.y, yaw))

    def _on_joints(self, message: JointState) -> None:
        speed = max(map(abs, message.velocity))
        self._arm.append((time_seconds(message.header.stamp), speed, *message.position))

    def clear(self) -> None:
        """Forget what was recorded, but for the last report."""
        del self._platform[:-1]
        del self._arm[:-1]

    @property
    def platform(self) -> Array:
        """Times [s], speeds [m/s] and poses x, y [m], theta [rad] of the platform, (m, 5)."""
        return np.array(self._platform).reshape(-1, 5)

    @property
    def arm(self) -> Array:
        """Times [s], speeds [rad/s] and angles [rad] of the arm, (m, 8)."""
        return np.array(self._arm).reshape(-1, 8)

    @property
    def longest_gap(self) -> float:
        """Longest time between two reports on the platform or on the arm [s]."""
        gaps = [np.diff(samples[:, 0]).max(initial=0.0) for samples in (self.platform, self.arm)]
        return float(max(gaps))

    @property
    def speeds(self) -> tuple[float, float]:
        """Last speeds of platform [m/s] and arm [rad/s]; 0 before the first."""
        platform = self._platform[-1][1] if self._platform else 0.0
        return platform, self._arm[-1][1] if self._arm else 0.0

    @property
    def pose(self) -> Array | None:
        """Last pose x, y, theta (3,) of the platform [m, m, rad]; None before the first."""
        return np.array(self._platform[-1][2:]) if self._platform else None

    @property
    def angles(self) -> Array | None:
        """Last angles of the arm (6,) [rad]; None before the first."""
        return np.array(self._arm[-1][2:]) if self._arm else None


class RunningRobot:
    """Robot of processes, each of which can be killed and started again by itself.

    Args:
        session: ROS session of this process.
        setup: Options of the robot.
        left_out: Names of the nodes that are not started.
        on_line: Called with name and line for each line of output, from threads.

    Attributes:
        session: ROS session of this process.
        truth: Ground truth.
        stop_states: Level of the last `stop_state` by node.
        reasons: Text of the last `stop_state` by node.
        source: Last `active_source`.
        on_check: Called again and again while this waits for something.
        unanswered: Names of services, once for each call that was not answered in time.
    """

    def __init__(
        self,
        session: Session,
        setup: RobotSetup,
        left_out: Sequence[str],
        on_line: Callable[[str, str], None],
    ) -> None:
        self.session, self.truth = session, GroundTruth(session)
        processes = [spec for spec in robot_processes(setup) if spec.name not in left_out]
        self._specs = {spec.name: spec for spec in processes}
        self._on_line = on_line
        self._groups: dict[str, ProcessGroup] = {}
        self._interrupted = False
        self.on_check: Callable[[], None] = lambda: None
        self.stop_states: dict[str, bytes] = {}
        self.reasons: dict[str, str] = {}
        self.source = ""
        self.unanswered: list[str] = []
        self._clients: dict[str, Any] = {}
        node = session.node
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        node.create_subscription(String, "active_source", self._on_source, LATCHED)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        name = message.name.rpartition("/")[2]
        self.stop_states[name], self.reasons[name] = message.level, message.message

    def _on_source(self, message: String) -> None:
        self.source = message.data

    # ---- processes ------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        try:
            for spec in sorted(self._specs.values(), key=lambda spec: -spec.stage):
                self.start(spec.name)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def _end(self) -> None:
        for name in list(self._groups):
            self.kill(name)

    @property
    def names(self) -> list[str]:
        """Names of the processes."""
        return list(self._specs)

    def start(self, name: str, copy: str = "") -> None:
        """Start a process.

        Args:
            name: Name of the process.
            copy: Name of a second copy of it; empty for the first one.
        """
        spec = self._specs[name]
        label = copy or name
        group = ProcessGroup(
            [ProcessSpec(label, spec.command, essential=False)],
            on_line=self._on_line,
            report=lambda text: None,
        )
        self._groups[label] = group.__enter__()
        if not copy:
            self.stop_states.pop(name, None)
        niceness = HARDWARE_NICENESS if name in HARDWARE else NICENESS
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, group.pid(label), niceness)

    def pid(self, name: str) -> int:
        """Return the process id of a process, which may be the streamer's streaming process.

        Raises:
            CommandError: There is no such process.
        """
        if name != STREAMING_PROCESS:
            return self._groups[name].pid(name)
        for child in children(self._groups[STREAMER].pid(STREAMER)):
            return child
        raise CommandError("arm_streamer has no streaming process")

    def signal(self, name: str, number: int) -> None:
        """Send a process a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid(name), number)

    def kill(self, name: str) -> None:
        """Kill a process, with those that it has started, and forget it."""
        group = self._groups.pop(name, None)
        if group is None:
            return
        with contextlib.suppress(ProcessLookupError):
            descendants = list(children(group.pid(name)))
            for pid in (group.pid(name), *descendants):
                os.kill(pid, signal.SIGKILL)
        group.__exit__(None, None, None)

    def is_alive(self, name: str) -> bool:
        """Return whether a process runs."""
        group = self._groups.get(name)
        if group is None:
            return False
        with contextlib.suppress(CommandError):
            group.check()
        stat = Path(f"/proc/{group.pid(name)}/stat")
        with contextlib.suppress(OSError):
            return stat.read_text().rpartition(")")[2].split()[0] != "Z"
        return False

    def restart(self) -> None:
        """Kill all processes, and start them anew."""
        self._end()
        self.__enter__()

    def interrupt(self, number: int) -> None:
        """Have the next :meth:`check` raise an error; safe to call from a signal handler."""
        self._interrupted = True

    def check(self) -> None:
        """Raise an error after a signal.

        Raises:
            KeyboardInterrupt: A signal was received.
        """
        if self._interrupted:
            raise KeyboardInterrupt
        self.on_check()

    # ---- waiting and services -------------------------------------------------------------------

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition holds; return whether it did within the timeout [s].

        Raises:
            KeyboardInterrupt: A signal was received.
        """

        def checked() -> bool:
            self.check()
            return condition()

        return self.session.wait(checked, timeout)

    def pause(self, seconds: float) -> None:
        """Serve callbacks for some time [s]."""
        self.wait(lambda: False, seconds)

    def trigger(self, node: str, action: str) -> None:
        """Call a Trigger service of a node if it is there, without waiting for the answer."""
        client = self._client(Trigger, f"{node}/{action}")
        if client.service_is_ready():
            client.call_async(Trigger.Request())

    def connect(self, node: str, action: str) -> None:
        """Wait until a Trigger service of a node can be called.

        Raises:
            CommandError: It is not there.
        """
        client = self._client(Trigger, f"{node}/{action}")
        if not self.wait(client.service_is_ready, SERVICE_TIMEOUT):
            raise CommandError(f"{node}/{action} is not there")

    def _client(self, kind: type, service: str) -> Any:
        """Return a client, which is kept."""
        if service not in self._clients:
            self._clients[service] = self.session.node.create_client(kind, service)
        return self._clients[service]

    def set_parameter(self, node: str, name: str, value: bool | float | tuple[str, ...]) -> None:
        """Set a parameter of a node.

        Raises:
            CommandError: The node refuses the value, or does not answer.
        """
        service = f"{node}/set_parameters"
        client = self._client(SetParameters, service)
        if not self.wait(client.service_is_ready, SERVICE_TIMEOUT):
            raise CommandError(f"{service} is not there")
        kind = Parameter.Type.STRING_ARRAY if isinstance(value, tuple) else None
        listed = list(value) if isinstance(value, tuple) else value
        parameter = (
            Parameter(name, kind, listed) if kind is not None else Parameter(name, value=listed)
        )
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
        for _ in range(CALLS):
            future = client.call_async(request)
            if self.wait(future.done, SERVICE_TIMEOUT):
                break
            self.unanswered.append(service)
        else:
            raise CommandError(f"{service} does not answer")
        answer = future.result().results[0]
        if not answer.successful:
            raise CommandError(f"{node}: {name} is refused: {answer.reason}")

    def send_to_dashboard(self, command: str) -> None:
        """Send a command to the dashboard of the simulated arm's controller.

        Raises:
            CommandError: The dashboard cannot be reached.
        """
        arguments = self._specs[ARM].command
        port = next(text for text in arguments if text.startswith(DASHBOARD_PORT))
        address = ("127.0.0.1", int(port.removeprefix(DASHBOARD_PORT)))
        try:
            with socket.create_connection(address, SERVICE_TIMEOUT) as connection:
                connection.recv(1024)  # its greeting
                connection.sendall(f"{command}\n".encode())
                connection.recv(1024)
        except OSError as error:
            raise CommandError(f"dashboard: {error}") from error

    @property
    def stopped(self) -> set[str]:
        """Names of the nodes that are stopped."""
        return {
            name for name, level in self.stop_states.items() if level == DiagnosticStatus.ERROR
        }

    @property
    def is_released(self) -> bool:
        """Whether all nodes that move something are running and not held."""
        return all(self.stop_states.get(name) == DiagnosticStatus.OK for name in MOVERS)

    def release(self, timeout: float) -> bool:
        """Reset all stopped nodes until all are running; return whether they are.

        Args:
            timeout: Longest time [s].
        """
        end = time.monotonic() + timeout
        while not self.is_released and time.monotonic() < end:
            for name in self.stopped:
                self.trigger(name, "reset")
            self.wait(lambda: self.is_released, 0.3)
        return self.is_released


def children(pid: int) -> Iterator[int]:
    """Yield the process ids of the children of a process."""
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            yield from map(int, path.read_text().split())
