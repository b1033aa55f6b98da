"""What `omniman bench can` provokes faults on: bridge and drives as processes, and their bus.

The simulated robot stands on the floor: on blocks its platform would always be at rest.
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
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from omniman_ros.cli.children import Children, Task
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import node_command
from omniman_ros.cli.installation import MULTICAST, installation_file
from omniman_ros.cli.session import Session
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.nodes.stopping import ALL_LATCHED, LATCHED
from omniman_ros.robots import load_robot

ROBOT = "omniman"
SPEED = 2.0
"""Of the wheels [rad/s]."""
PERIOD = 0.01
"""Of wheel_commands [s]."""
STEADY = 0.05
"""How long all setpoints must have been the same before a fault [s]."""
REST_SPEED, REST_TURN = 0.01, 0.03
"""Platform at rest: m/s, rad/s."""
PATIENCE = 20.0
"""For what has to come [s]."""
RETRY = 0.1
"""Time between two resets, while one is refused [s]."""


class Heard(NamedTuple):
    """A frame: time of arrival [s, of the system's clock], id, data."""

    at: float
    id: int
    data: bytes


class Listener:
    """Hears all frames on the bus, in a thread."""

    def __init__(self, port: int) -> None:
        self._bus = can.Bus(interface="udp_multicast", channel=MULTICAST, port=port, hop_limit=0)
        self.frames: list[Heard] = []
        self.last: dict[int, bytes] = {}
        self.since: dict[int, float] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(0.1)
            except can.CanError:
                continue
            if message is None or message.is_remote_frame:
                continue
            frame = Heard(message.timestamp, message.arbitration_id, bytes(message.data))
            self.frames.append(frame)
            if self.last.get(frame.id) != frame.data:
                self.last[frame.id], self.since[frame.id] = frame.data, frame.at

    def forget(self) -> None:
        """Begin a new record."""
        self.frames = []

    def send(self, id: int, data: bytes) -> None:
        """Speak on the bus."""
        self._bus.send(can.Message(arbitration_id=id, data=data, is_extended_id=False))

    def close(self) -> None:
        """Close the bus."""
        self._closing.set()
        self._thread.join()
        self._bus.shutdown()


Kind = Callable[[Heard, int], bool]
"""Whether a frame is of a kind, by the node id of the drive."""


@dataclass(frozen=True)
class Dialect:
    """Frames of a protocol, as this benchmark needs to know them.

    Attributes:
        setpoint: Ids of the frames that may hold a drive's setpoint, by its node id.
        stop: What a stop is told a drive by; None: any frame but the setpoint of before.
        kinds: Frames that faults show by.
    """

    setpoint: Callable[[int], tuple[int, ...]]
    stop: bytes | None
    kinds: Mapping[str, Kind]


def _emergency(frame: Heard, node: int, code: int = 0) -> bool:
    told = struct.unpack_from("<H", frame.data)[0] if len(frame.data) >= 2 else 0
    return frame.id == 0x080 + node and bool(told) and code in (0, told)


DIALECTS = {
    # Controlword 0x0002: quick stop, little-endian (IEC 61800-7-201).
    "cia402": Dialect(
        lambda node: (0x200 + node,),
        b"\x02\x00",
        {
            "EMCY": _emergency,
            "boot-up": lambda f, node: f.id == 0x700 + node and f.data == b"\x00",
            "report": lambda f, node: f.id == 0x280 + node,
            "whole report": lambda f, node: f.id == 0x280 + node and len(f.data) == 8,
            "heartbeat": lambda f, node: f.id == 0x700 + node,
            "other mode": lambda f, node: f.id == 0x180 + node and f.data[2:3] != b"\x09",
            "setpoint": lambda f, node: f.id == 0x080,
            "watchdog": lambda f, node: _emergency(f, node, 0x8130),
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


def installation(name: str) -> CanParameters:
    """The installation of a protocol, as it is in config/can/."""
    tree = yaml.safe_load(Path(installation_file(name)).read_text(encoding="utf-8"))
    return build(CanParameters, flatten_mapping(tree["/**"]["ros__parameters"]), "can.")


class Rig:
    """Bridge and drives as processes, a bus, and this process, which drives.

    Attributes:
        commanding: Whether wheel_commands are published.
        published: When the last one was [s, of the system's clock].
        truth: Times and speeds of the platform, as shares of what counts as rest.
        state, reason: What the bridge says of stops.
    """

    def __init__(
        self, session: Session, protocol: str, port: int, log: Callable[[str, str], None]
    ) -> None:  # fmt: skip
        self.session, self.protocol, self.log = session, protocol, log
        self.parameters, self.dialect = installation(protocol), DIALECTS[protocol]
        self.names = list(load_robot(ROBOT)["wheels.names"])
        self.nodes = self.parameters.nodes
        self._arguments = (
            "--ros-args", "-p", f"robot:={ROBOT}", "--params-file", installation_file(protocol),
            "-p", "can.interface:=udp_multicast", "-p", f"can.channel:='{MULTICAST}'",
            "-p", f"can.port:={port}",
        )  # fmt: skip
        self._top = SPEED * load_robot(ROBOT)["wheels.radius"][0]
        self.commanding, self.published = True, 0.0
        self.truth: list[tuple[float, float]] = []
        self._forward, self.state, self.reason = 0.0, b"", ""
        self._drives = self._children("simulated_can_drives")
        self._bridge = self._children("can_bridge")
        self.listener = Listener(port)
        self._make_topics()

    def _children(self, node: str) -> Children:
        task = Task(node, node_command(node, self._arguments))
        return Children([task], on_line=self.log, report=lambda text: None)

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
        self._message = JointState(name=self.names, velocity=[SPEED] * len(self.names))

    def _command(self) -> None:
        if self.commanding:
            self.published = time.time()
            self._commands.publish(self._message)

    def _on_truth(self, message: Odometry) -> None:
        stamp, twist = message.header.stamp, message.twist.twist
        self._forward = twist.linear.x
        speed = math.hypot(twist.linear.x, twist.linear.y) / REST_SPEED
        turn = abs(twist.angular.z) / REST_TURN
        self.truth.append((stamp.sec + 1e-9 * stamp.nanosec, max(speed, turn)))

    def _on_state(self, message: DiagnosticStatus) -> None:
        self.state, self.reason = message.level, message.message

    # ---- life ---------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        self._drives.__enter__()
        self._bridge.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        node = self.session.node
        node.destroy_timer(self._timer)
        with contextlib.suppress(ProcessLookupError):
            self.signal(signal.SIGCONT)
        for children in (self._bridge, self._drives):
            children.__exit__(None, None, None)
        self.listener.close()

    def interrupt(self, number: int) -> None:
        """Pass a signal in; safe in a signal handler."""
        self._drives.interrupt(number)

    def signal(self, number: int) -> None:
        """Send the bridge a signal."""
        os.kill(self._bridge.pid("can_bridge"), number)

    def restart(self) -> None:
        """Start another bridge in the place of one that was killed."""
        self._bridge.__exit__(None, None, None)
        self._bridge = self._children("can_bridge")
        self._bridge.__enter__()

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Serve callbacks until a condition holds.

        Raises:
            CommandError: It does not; or the drives ended.
        """

        def done() -> bool:
            self._drives.check()
            return condition()

        if not self.session.wait(done, PATIENCE):
            raise CommandError(f"{self.protocol}: waited for {what} ({self.reason})")

    def call(self, client: Any, request: Any) -> Any:
        """Call a service."""
        self.wait(client.service_is_ready, client.srv_name)
        future = client.call_async(request)
        self.wait(future.done, client.srv_name)
        return future.result()

    # ---- what is done to it -------------------------------------------------------------------

    def switch(self, fault: str, value: Sequence[str] | float) -> None:
        """Set a fault of the drives."""
        if isinstance(value, float):
            given = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        else:
            kind = ParameterType.PARAMETER_STRING_ARRAY
            given = ParameterValue(type=kind, string_array_value=list(value))
        parameter = Parameter(name=f"can_faults.{fault}", value=given)
        answer = self.call(self._set, SetParameters.Request(parameters=[parameter]))
        if not answer.results[0].successful:
            raise CommandError(f"can_faults.{fault}: {answer.results[0].reason}")

    def emergency(self, pressed: bool) -> float:
        """Publish emergency_stop; returns when."""
        at = time.time()
        self._emergency.publish(Bool(data=pressed))
        return at

    def stop(self) -> float:
        """Call ~/stop of the bridge; returns when."""
        at = time.time()
        self.call(self._services["stop"], Trigger.Request())
        return at

    def settle(self) -> None:
        """Drive on, after resets where it is stopped, until all is steady."""
        self.commanding, asked = True, 0.0

        def steady() -> bool:
            nonlocal asked
            now = time.time()
            if self.state == DiagnosticStatus.ERROR and now - asked > RETRY:
                reset = self._services["reset"]
                if reset.service_is_ready():
                    asked = now
                    reset.call_async(Trigger.Request())
            return self._is_steady(now)

        self.wait(steady, "a steady speed")

    def _is_steady(self, now: float) -> bool:
        since = self.listener.since
        told = [max(since.get(i, 0.0) for i in self.dialect.setpoint(n)) for n in self.nodes]
        return (
            self.state == DiagnosticStatus.OK
            and self._forward > 0.95 * self._top
            and all(0.0 < at < now - STEADY for at in told)
        )

    def told(self) -> Kind:
        """A kind of frames: those that tell a drive something else than now."""
        driving = dict(self.listener.last)

        def is_told(frame: Heard, node: int) -> bool:
            return frame.id in self.dialect.setpoint(node) and frame.data != driving.get(frame.id)

        return is_told
