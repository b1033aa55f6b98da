"""The far end of the bus in `omniman bench can`: CiA 402 drives without a plant, or an echo.

Usage: `can_peer KIND PORT WHEELS RATE`, where KIND is `drives` or `echo`. The motors of the drives
reach their setpoints at once, so that only the bus and the bridge are measured. The echo answers
each SYNC frame with as many frames as the drives would send.
"""

import time
from collections.abc import Iterable
from typing import Any

import can

from omniman_ros.can_drives.reception import enlarge_receive_buffer
from omniman_ros.processes.drive_options import MULTICAST_GROUP
from omniman_ros.simulation.can_drives.cia402.drive import Cia402Drive, Cia402Settings
from omniman_ros.simulation.can_drives.network import EchoFilter

COUNTS = 4096.0  # encoder counts per revolution of a wheel
SYNC = 0x080  # identifier of the SYNC frame (CiA 301)
TORQUE_CONSTANT = 0.05  # torque constant of the motors [N m/A]


class FreeMotor:
    """A motor without inertia and load, which reaches its setpoint at once."""

    torque = current = voltage = 0.0
    supply, lost = 48.0, False

    def __init__(self) -> None:
        self.position = self.velocity = 0.0

    def turn(self, dt: float) -> None:
        """Advance by a time step [s] at the present velocity."""
        self.position += self.velocity * dt

    def follow_velocity(self, velocity: float, torque: float = 0.0) -> None:
        """Set the velocity [rad/s]; the feed-forward torque has no effect."""
        self.velocity = velocity

    def follow_torque(self, torque: float) -> None:
        """Stand still, as a torque determines no velocity of a motor without inertia."""
        self.velocity = 0.0

    follow_voltage = halt = follow_torque

    def release(self) -> None:
        """Stand still, as no torque acts."""
        self.velocity = 0.0


def open_bus(port: int) -> can.BusABC:
    """Open a CAN bus of UDP that does not leave this machine."""
    options: dict[str, Any] = {"channel": MULTICAST_GROUP, "port": port, "hop_limit": 0}
    bus = can.Bus(interface="udp_multicast", **options)
    enlarge_receive_buffer(bus)
    return bus


def main(args: list[str] | None = None) -> int:
    """Run the drives or the echo until SIGINT."""
    _, kind, port, wheels, rate = args or []
    with open_bus(int(port)) as bus:
        try:
            if kind == "echo":
                echo(bus, int(wheels))
            else:
                drive(bus, int(wheels), float(rate))
        except KeyboardInterrupt:
            return 0
    return 0


def echo(bus: can.BusABC, wheels: int) -> None:
    """Answer each SYNC frame with two frames of eight bytes per wheel."""
    answers = [
        can.Message(arbitration_id=base + node, data=bytes(8), is_extended_id=False)
        for node in range(1, wheels + 1)
        for base in (0x180, 0x280)
    ]
    while True:
        message = bus.recv()
        if message is not None and message.arbitration_id == SYNC:
            for answer in answers:
                bus.send(answer)


def drive(bus: can.BusABC, wheels: int, rate: float) -> None:
    """Simulate one CiA 402 drive per wheel, with the node ids 1, 2 and so on."""
    motors = [FreeMotor() for _ in range(wheels)]
    settings = Cia402Settings(
        counts=COUNTS, velocity_scale=COUNTS, rated_torque=1.0, rated_current=1.0 / TORQUE_CONSTANT
    )
    drives = [Cia402Drive(motor, k + 1, settings) for k, motor in enumerate(motors)]
    own, last = EchoFilter(), time.monotonic()

    def send(frames: Iterable[can.Message], now: float) -> None:
        for frame in frames:
            own.record_sent(frame, now)
            bus.send(frame)

    while True:
        message, now = bus.recv(1.0 / rate), time.monotonic()
        if message is not None and not own.is_echo(message, now):
            for node in drives:
                send(node.receive(message, now), now)
        if now - last >= 1e-3:
            for motor in motors:
                motor.turn(now - last)
            for node in drives:
                send(node.advance(now), now)
            last = now
