"""The far end of the bus in `omniman bench can`: CiA 402 drives without a plant.

Usage: `can_drives PORT WHEELS RATE`. The motors reach their setpoints at once: only bus and bridge
are measured.
"""

import time
from collections.abc import Iterable

import can

from omniman_ros.can_drives.reception import enlarge_receive_buffer
from omniman_ros.processes.drive_options import MULTICAST_GROUP
from omniman_ros.simulation.can_drives.cia402.drive import Cia402Drive, Cia402Settings
from omniman_ros.simulation.can_drives.network import EchoFilter

COUNTS = 4096.0  #: encoder counts per revolution of a wheel
TORQUE_CONSTANT = 0.05  #: of the motors [N m/A]


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
    bus = can.Bus(interface="udp_multicast", channel=MULTICAST_GROUP, port=port, hop_limit=0)
    enlarge_receive_buffer(bus)
    return bus


def main(args: list[str] | None = None) -> int:
    """Run the drives, with the node ids 1, 2 and so on, until SIGINT."""
    port, wheels, rate = (args or [])[1:]
    motors = [FreeMotor() for _ in range(int(wheels))]
    settings = Cia402Settings(
        counts=COUNTS, velocity_scale=COUNTS, rated_torque=1.0, rated_current=1.0 / TORQUE_CONSTANT
    )
    drives = [Cia402Drive(motor, k + 1, settings) for k, motor in enumerate(motors)]
    own, last = EchoFilter(), time.monotonic()
    with open_bus(int(port)) as bus:

        def send(frames: Iterable[can.Message], now: float) -> None:
            for frame in frames:
                own.record_sent(frame, now)
                bus.send(frame)

        try:
            while True:
                message, now = bus.recv(1.0 / float(rate)), time.monotonic()
                if message is not None and not own.is_echo(message, now):
                    for node in drives:
                        send(node.receive(message, now), now)
                if now - last >= 1e-3:
                    for motor in motors:
                        motor.turn(now - last)
                    for node in drives:
                        send(node.advance(now), now)
                    last = now
        except KeyboardInterrupt:
            return 0
