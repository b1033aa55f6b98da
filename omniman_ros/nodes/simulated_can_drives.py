"""Node `simulated_can_drives`: drives on a CAN bus, and the robot that they move, simulated."""

import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

from omniman_ros import conversions
from omniman_ros.can_drive import availability
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.robot import Robot
from omniman_ros.drive.can.parameters import FLAGS, CanFaultParameters
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run

if TYPE_CHECKING:
    import can

TICK = 0.001
"""Period of the drives' firmware [s]."""
LISTEN = 0.1
"""How long the receiver waits for a frame, or after an error of the bus [s]."""
STALL = 1.0
"""Largest age of a frame that is believed [s]."""
ECHOES = ("udp_multicast",)
"""Interfaces that bring back one's own frames."""


@dataclass(frozen=True, kw_only=True)
class SimulatedCanDrivesParameters:
    """Parameters of the node: robot, simulation, installation and faults."""

    robot: Robot = inline()
    simulation: SimulationParameters = inline()
    can: CanParameters
    can_faults: CanFaultParameters
    truth_rate: float = parameter(
        100.0, "Rate of ground_truth/odom.", unit="Hz", low=1, high=1000, read_only=True
    )
    world_frame: str = parameter("map", "Frame of the ground truth.", read_only=True)
    base_frame: str = parameter("base_link", "Frame of its twist.", read_only=True)
    seed: int = parameter(0, "Seed of noise and losses.", low=0, high=2**31, read_only=True)


def open_bus(parameters: CanParameters) -> "can.BusABC":
    """Open the bus of an installation.

    Raises:
        ParameterError: It cannot be opened.
    """
    import can

    multicast = parameters.interface == "udp_multicast"
    more: dict[str, Any] = (
        {"port": parameters.port, "hop_limit": 0} if multicast else {"bitrate": parameters.bitrate}
    )
    try:
        return can.Bus(interface=parameters.interface, channel=parameters.channel, **more)
    except (can.CanError, OSError, ValueError, NotImplementedError, ImportError) as error:
        raise ParameterError("can.interface", parameters.interface, str(error)) from error


def _plain(message: "can.Message") -> "can.Message":
    """The same message, of the types that it should have; raises where that cannot be."""
    import can

    return can.Message(
        timestamp=float(message.timestamp),
        arbitration_id=int(message.arbitration_id),
        is_extended_id=bool(message.is_extended_id),
        is_remote_frame=bool(message.is_remote_frame),
        is_error_frame=bool(message.is_error_frame),
        data=bytes(message.data),
        check=True,
    )


def _is_nonsense(error: Exception) -> bool:
    """Whether what came was no frame; else the bus cannot be read."""
    import can

    if isinstance(error, can.CanError):
        return error.__cause__ is not None and not isinstance(error.__cause__, OSError)
    return not isinstance(error, OSError)


class SimulatedCanDrivesNode(OmnimanNode):
    """Plumbing around `drive.can.network.SimulatedBus`: real drives hear no topics."""

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_can_drives", **options)
        if self.get_parameter("use_sim_time").value:
            raise ParameterError("use_sim_time", True, "drives on a bus run on real time")
        self.settings = ParameterSet(self, SimulatedCanDrivesParameters)
        p = self.settings.value
        # Here, so that a machine without python-can can import this module for its parameters.
        from omniman_ros.drive.can.network import OwnFrames, SimulatedBus

        self.drives = SimulatedBus(p.robot, p.simulation, p.can, p.can_faults, p.seed)
        self.settings.on_change(self._configure)
        self._own = OwnFrames() if p.can.interface in ECHOES else None
        self._ending = False
        self._truth = self.create_publisher(Odometry, "ground_truth/odom", 10)
        self._truth_msg = Odometry(child_frame_id=p.base_frame)
        self._truth_msg.header.frame_id = p.world_frame
        handler = self.guarded("initialpose", self._on_initial_pose)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", handler, 10)
        self._arrived: deque[can.Message] = deque()
        self._trouble: deque[str] = deque(maxlen=1)
        self._closing = threading.Event()
        self._bus = open_bus(p.can)
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self.every(TICK, self.tick)
        self.every(1.0 / p.truth_rate, self._report_truth)

    # ---- bus ----------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Take frames from the bus, in a thread of its own, and have them served at once."""
        while not self._closing.is_set():
            try:
                message = self._bus.recv(LISTEN)
                plain = None if message is None else _plain(message)
            except Exception as error:  # UDP brings whatever somebody has packed
                self._trouble.append(str(error))
                if not _is_nonsense(error):
                    self._closing.wait(LISTEN)
                continue
            if plain is None:
                continue
            first, executor = not self._arrived, self.executor
            self._arrived.append(plain)
            if first and executor is not None and not self._closing.is_set():
                executor.create_task(self.tick)

    def tick(self) -> None:
        """Let the drives hear what has come, run them up to now, and send what they say."""
        while self._arrived:
            message = self._arrived.popleft()
            at = self._arrival(message)
            if self._own is None or not self._own.is_echo(message, at):
                self._send(self.drives.receive(message, at))
        self._send(self.drives.advance(self.now()))
        if self._ending and self.drives.at_rest:
            self.drives.release()
        while self._trouble:
            self.warn("bus", f"cannot receive: {self._trouble.popleft()}")

    def _arrival(self, message: "can.Message") -> float:
        """When a frame came, on the node's clock [s]; now where the bus does not tell.

        A machine that is busy lets this process wait, and its frames: drives that took them for
        late would stop, which real ones would not.
        """
        age = time.time() - message.timestamp
        return self.now() - (age if 0.0 <= age <= STALL else 0.0)

    def _send(self, messages: "list[can.Message]") -> None:
        import can

        for message in messages:
            if self._own is not None:
                self._own.add(message, self.now())
            try:
                self._bus.send(message)
            except (can.CanError, OSError, ValueError) as error:
                self.warn("send", f"cannot send: {error}")

    # ---- simulation ---------------------------------------------------------------------------

    def _configure(self, new: SimulatedCanDrivesParameters) -> None:
        self.drives.configure(new.robot, new.simulation, new.can_faults)

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frames = (self.settings.value.world_frame, "map", "odom")
        pose, _ = conversions.planar_pose(message, frames)
        self.drives.set_pose(pose)

    def _report_truth(self) -> None:
        pose, twist = self.drives.ground_truth()
        conversions.fill_odometry(
            self._truth_msg, pose.tolist(), twist, np.zeros((3, 3)), self.stamp()
        )
        self._truth.publish(self._truth_msg)

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        faults = self.settings.value.can_faults
        values: list[tuple[str, object]] = [
            ("protocol", self.settings.value.can.protocol),
            ("frames_heard", self.drives.heard),
            ("frames_sent", self.drives.sent),
            ("frames_lost_by_fault", self.drives.lost),
        ]
        played = {name: ", ".join(getattr(faults, name)) for name in (*FLAGS, "reboot")}
        played |= {
            "supply": f"{faults.supply or ''}",
            "lost_frames": f"{faults.lost_frames or ''}",
        }
        on = [f"{name} ({what})" for name, what in played.items() if what]
        if self._ending:
            return DiagnosticStatus.WARN, "shutting down", values
        if on:
            return DiagnosticStatus.WARN, f"faults: {'; '.join(on)}", values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Switch the drives off: each ramps its wheel to rest."""
        self._ending = True
        self.drives.halt()

    @property
    def finished(self) -> bool:
        """Whether the wheels stand."""
        return self.drives.at_rest

    @property
    def patience(self) -> float:
        """How long the ramp may take [s]."""
        firmware = self.settings.value.simulation.firmware
        return 1.0 + self.drives.fastest / firmware.quick_stop_deceleration

    def destroy_node(self) -> None:
        """Close the bus, too."""
        self._closing.set()
        self._listener.join(2.0 * LISTEN + 1.0)
        self._bus.shutdown()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_can_drives`."""
    if not availability.is_available():
        print(f"cannot start: {availability.HINT}", file=sys.stderr)
        return 1
    return run(SimulatedCanDrivesNode, args)
