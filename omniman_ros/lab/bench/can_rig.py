"""Test rig of the faults in `omniman bench can`: bridge and drives in processes, on one bus.

The simulated robot stands on the floor, as its platform would always be at rest if the wheels were
lifted.
"""

import contextlib
import math
import os
import signal
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import can
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.can_peer import open_bus
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.processes.drive_options import MULTICAST_GROUP, find_installation_file
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec
from omniman_ros.processes.robot_setup import node_command
from omniman_ros.robots import load_robot
from omniman_ros.yaml_files import read_parameters

ROBOT = "omniman"
"""Name of the simulated robot."""
WHEEL_SPEED = 2.0
"""Commanded speed of all wheels [rad/s]."""
PERIOD = 0.01
"""Period of `wheel_commands` [s]."""
STEADY_TIME = 0.05
"""Time for which all setpoints must have been constant before a fault is injected [s]."""
REST_SPEED = 0.01
"""Speed up to which the platform counts as at rest [m/s]."""
REST_YAW_RATE = 0.03
"""Yaw rate up to which the platform counts as at rest [rad/s]."""
TIMEOUT = 20.0
"""Longest time to wait for a condition or a service [s]."""
RETRY_PERIOD = 0.1
"""Time between two resets while they are refused [s]."""


class BusFrame(NamedTuple):
    """A frame on the bus.

    Attributes:
        at: Time of arrival by the system clock [s].
        id: Identifier.
        data: Data, at most 8 bytes.
    """

    at: float
    id: int
    data: bytes


class BusRecorder:
    """Records all data frames on a bus, in a thread of its own.

    Args:
        port: UDP port of the bus.

    Attributes:
        frames: Frames since the last :meth:`clear`.
        last: Data of the last frame, by identifier.
        since: Arrival of the first of the consecutive frames with that data, by identifier [s].
    """

    def __init__(self, port: int) -> None:
        self._bus = open_bus(port)
        self.frames: list[BusFrame] = []
        self.last: dict[int, bytes] = {}
        self.since: dict[int, float] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._record, daemon=True)
        self._thread.start()

    def _record(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(0.1)
            except can.CanError:
                continue
            if message is None or message.is_remote_frame:
                continue
            frame = BusFrame(message.timestamp, message.arbitration_id, bytes(message.data))
            self.frames.append(frame)
            if self.last.get(frame.id) != frame.data:
                self.last[frame.id], self.since[frame.id] = frame.data, frame.at

    def clear(self) -> None:
        """Discard the recorded frames."""
        self.frames = []

    def send(self, id: int, data: bytes) -> None:
        """Send a frame with an 11-bit identifier."""
        self._bus.send(can.Message(arbitration_id=id, data=data, is_extended_id=False))

    def close(self) -> None:
        """End the recording and close the bus."""
        self._closing.set()
        self._thread.join()
        self._bus.shutdown()


FrameKind = Callable[[BusFrame, int], bool]
"""A kind of frame: a function that returns whether a frame is of this kind and belongs to the
drive with the given node id."""


@dataclass(frozen=True)
class Dialect:
    """The frames of a drive protocol that this benchmark distinguishes.

    Attributes:
        setpoint: Function from a node id to the identifiers of the frames that can carry the
            setpoint of that drive.
        stop: First two bytes of a stop command; None if the protocol has none, so that any
            setpoint that differs from the previous one counts as a stop.
        kinds: Kinds of frames that show faults or the drives' reaction to them, by name.
    """

    setpoint: Callable[[int], tuple[int, ...]]
    stop: bytes | None
    kinds: Mapping[str, FrameKind]


def _is_emergency(frame: BusFrame, node: int, code: int = 0) -> bool:
    """Return whether a frame is an EMCY message of a node, with a given error code or with any."""
    error = struct.unpack_from("<H", frame.data)[0] if len(frame.data) >= 2 else 0
    return frame.id == 0x080 + node and bool(error) and code in (0, error)


DIALECTS = {
    # The stop command is the controlword 0x0002, quick stop, little-endian (IEC 61800-7-201).
    "cia402": Dialect(
        lambda node: (0x200 + node,),
        b"\x02\x00",
        {
            "EMCY": _is_emergency,
            "boot-up": lambda f, node: f.id == 0x700 + node and f.data == b"\x00",
            "report": lambda f, node: f.id == 0x280 + node,
            "whole report": lambda f, node: f.id == 0x280 + node and len(f.data) == 8,
            "heartbeat": lambda f, node: f.id == 0x700 + node,
            "other mode": lambda f, node: f.id == 0x180 + node and f.data[2:3] != b"\x09",
            "setpoint": lambda f, node: f.id == 0x080,
            "watchdog": lambda f, node: _is_emergency(f, node, 0x8130),
        },
    ),
    "vesc": Dialect(
        lambda node: tuple(packet << 8 | node for packet in range(4)),
        None,
        {
            "report": lambda f, node: f.id in (9 << 8 | node, 27 << 8 | node),
            "setpoint": lambda f, node: f.id == 3 << 8 | node,
        },
    ),
    "odrive": Dialect(
        lambda node: (node << 5 | 0x0D,),
        None,
        {
            "error": lambda f, node: f.id == node << 5 | 1 and f.data[:4] != bytes(4),
            "report": lambda f, node: f.id == node << 5 | 9,
            "heartbeat": lambda f, node: f.id == node << 5 | 1,
            "setpoint": lambda f, node: f.id == node << 5 | 0x0D,
            "watchdog": lambda f, node: f.id == node << 5 | 1 and f.data[3:4] == b"\x01",
        },
    ),
}
"""Frames of each drive protocol."""


def load_installation(protocol: str) -> CanParameters:
    """Return the parameters of a protocol's installation file in config/can/."""
    (section,) = read_parameters(Path(find_installation_file(protocol)))
    return build(CanParameters, section.values, "can.")


class Rig:
    """Bridge and simulated drives, which run in processes on one bus and are driven from here.

    The processes run while the rig is used as a context manager.

    Args:
        session: ROS session of this process.
        protocol: Protocol of the drives.
        port: UDP port of the bus.
        log: Function that is called with the name of a process and a line of its output.

    Attributes:
        session: ROS session of this process.
        protocol: Protocol of the drives.
        parameters: Parameters of the installation.
        dialect: Frames of the protocol.
        names: Names of the wheels.
        nodes: Node ids of the drives, in the order of the wheels.
        recorder: Recorder of the bus.
        commanding: Whether `wheel_commands` are published.
        published: Time of the last `wheel_commands` by the system clock [s].
        truth: Times by the system clock [s] and speeds of the platform (ground truth), as
            multiples of the largest speed that counts as rest.
        state: Level of the bridge's last `stop_state`.
        reason: Reason in the bridge's last `stop_state`.
    """

    def __init__(
        self, session: Session, protocol: str, port: int, log: Callable[[str, str], None]
    ) -> None:
        self.session, self.protocol, self.log = session, protocol, log
        self.parameters, self.dialect = load_installation(protocol), DIALECTS[protocol]
        self.names = list(load_robot(ROBOT)["wheels.names"])
        self.nodes = self.parameters.nodes
        self._arguments = (
            "--ros-args",
            "-p",
            f"robot:={ROBOT}",
            "--params-file",
            find_installation_file(protocol),
            "-p",
            "can.interface:=udp_multicast",
            "-p",
            f"can.channel:='{MULTICAST_GROUP}'",
            "-p",
            f"can.port:={port}",
        )
        self._top_speed = WHEEL_SPEED * load_robot(ROBOT)["wheels.radius"][0]
        self.commanding, self.published = True, 0.0
        self.truth: list[tuple[float, float]] = []
        self._forward, self.state, self.reason = 0.0, b"", ""
        self._drives = self._children("simulated_can_drives")
        self._bridge = self._children("can_bridge")
        self.recorder = BusRecorder(port)
        self._make_topics()

    def _children(self, node: str) -> ProcessGroup:
        task = ProcessSpec(node, node_command(node, self._arguments))
        return ProcessGroup([task], on_line=self.log, report=lambda text: None)

    def _make_topics(self) -> None:
        node = self.session.node
        self._commands = node.create_publisher(JointState, "wheel_commands", QoSProfile(depth=1))
        self._emergency = node.create_publisher(Bool, "emergency_stop", LATCHED)
        node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 100)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_state, ALL_LATCHED)
        self._timer = node.create_timer(PERIOD, self._command)
        self._set = node.create_client(SetParameters, "simulated_can_drives/set_parameters")
        self._services = {
            name: node.create_client(Trigger, f"can_bridge/{name}") for name in ("stop", "reset")
        }
        self._message = JointState(name=self.names, velocity=[WHEEL_SPEED] * len(self.names))

    def _command(self) -> None:
        if self.commanding:
            self.published = time.time()
            self._commands.publish(self._message)

    def _on_truth(self, message: Odometry) -> None:
        stamp, twist = message.header.stamp, message.twist.twist
        self._forward = twist.linear.x
        speed = math.hypot(twist.linear.x, twist.linear.y) / REST_SPEED
        turn = abs(twist.angular.z) / REST_YAW_RATE
        self.truth.append((stamp.sec + 1e-9 * stamp.nanosec, max(speed, turn)))

    def _on_state(self, message: DiagnosticStatus) -> None:
        self.state, self.reason = message.level, message.message

    # ---- processes ------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.callback(self.session.node.destroy_timer, self._timer)
            stack.callback(self.recorder.close)
            stack.enter_context(self._drives)
            self._bridge.__enter__()
            stack.callback(self._end_bridge)
            self._cleanup = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()

    def _end_bridge(self) -> None:
        """End the bridge that runs, even if it is suspended."""
        with contextlib.suppress(ProcessLookupError):
            self.signal_bridge(signal.SIGCONT)
        self._bridge.__exit__(None, None, None)

    def interrupt(self, number: int) -> None:
        """Interrupt the drives with a signal; this is safe in a signal handler."""
        self._drives.interrupt(number)

    def signal_bridge(self, number: int) -> None:
        """Send a signal to the process of the bridge."""
        os.kill(self._bridge.pid("can_bridge"), number)

    def restart_bridge(self) -> None:
        """Start a new bridge in place of one that was killed."""
        self._bridge.__exit__(None, None, None)
        self._bridge = self._children("can_bridge").__enter__()

    def wait(self, condition: Callable[[], bool], goal: str) -> None:
        """Serve callbacks until a condition holds.

        Args:
            condition: Function that returns whether the condition holds.
            goal: Name of the awaited event or state in the error message.

        Raises:
            CommandError: The condition does not hold within `TIMEOUT`, or the drives have ended.
        """

        def done() -> bool:
            self._drives.check()
            return condition()

        if not self.session.wait(done, TIMEOUT):
            raise CommandError(f"{self.protocol}: no {goal} within {TIMEOUT:g} s ({self.reason})")

    def call(self, client: Any, request: Any) -> Any:
        """Call a service and return its response.

        Args:
            client: Client of the service.
            request: Request.

        Raises:
            CommandError: The service does not respond in time, or the drives have ended.
        """
        self.wait(client.service_is_ready, client.srv_name)
        future = client.call_async(request)
        self.wait(future.done, client.srv_name)
        return future.result()

    # ---- faults and commands --------------------------------------------------------------------

    def set_fault(self, fault: str, value: Sequence[str] | float) -> None:
        """Set a parameter `can_faults.*` of the simulated drives.

        Args:
            fault: Last part of the parameter's name.
            value: Names of the faulty wheels, or a number.

        Raises:
            CommandError: The drives refuse the value or do not respond.
        """
        if isinstance(value, float):
            parameter_value = ParameterValue(
                type=ParameterType.PARAMETER_DOUBLE, double_value=value
            )
        else:
            kind = ParameterType.PARAMETER_STRING_ARRAY
            parameter_value = ParameterValue(type=kind, string_array_value=list(value))
        parameter = Parameter(name=f"can_faults.{fault}", value=parameter_value)
        answer = self.call(self._set, SetParameters.Request(parameters=[parameter]))
        if not answer.results[0].successful:
            raise CommandError(f"can_faults.{fault}: {answer.results[0].reason}")

    def set_emergency_stop(self, pressed: bool) -> float:
        """Publish `emergency_stop`; return the time of publication by the system clock [s]."""
        at = time.time()
        self._emergency.publish(Bool(data=pressed))
        return at

    def call_stop(self) -> float:
        """Call `~/stop` of the bridge; return the time of the call by the system clock [s]."""
        at = time.time()
        self.call(self._services["stop"], Trigger.Request())
        return at

    def settle(self) -> None:
        """Reset the bridge if it is stopped, and drive until the speed is steady.

        Raises:
            CommandError: The speed does not become steady in time, or the drives have ended.
        """
        self.commanding, reset_at = True, 0.0

        def is_steady() -> bool:
            nonlocal reset_at
            now = time.time()
            if self.state == DiagnosticStatus.ERROR and now - reset_at > RETRY_PERIOD:
                reset = self._services["reset"]
                if reset.service_is_ready():
                    reset_at = now
                    reset.call_async(Trigger.Request())
            return self._is_steady(now)

        self.wait(is_steady, "steady speed")

    def _is_steady(self, now: float) -> bool:
        since = self.recorder.since
        constant_since = [
            max(since.get(i, 0.0) for i in self.dialect.setpoint(n)) for n in self.nodes
        ]
        return (
            self.state == DiagnosticStatus.OK
            and self._forward > 0.95 * self._top_speed
            and all(0.0 < at < now - STEADY_TIME for at in constant_since)
        )

    def changed_setpoint(self) -> FrameKind:
        """Return the kind of frames whose setpoint differs from that at the time of this call."""
        driving = dict(self.recorder.last)

        def is_changed(frame: BusFrame, node: int) -> bool:
            return frame.id in self.dialect.setpoint(node) and frame.data != driving.get(frame.id)

        return is_changed
