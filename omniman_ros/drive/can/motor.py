"""What a simulated drive has to do with: the shaft of its motor, and faults to play."""

from dataclasses import dataclass
from typing import Protocol


class Motor(Protocol):
    """The motor of one drive, as its firmware sees it; SI units at the motor's shaft.

    Attributes:
        position, velocity: From the encoder: rad, not wrapped, and rad/s.
        torque, current, voltage: N m, A and V at the motor.
        supply: Voltage of the drive's supply, V.
        lost: Whether the encoder is found to mislead; it then brakes by itself until released.
    """

    @property
    def position(self) -> float:
        """Angle, rad."""

    @property
    def velocity(self) -> float:
        """Speed, rad/s."""

    @property
    def torque(self) -> float:
        """Torque, N m."""

    @property
    def current(self) -> float:
        """Current, A."""

    @property
    def voltage(self) -> float:
        """Voltage at the motor, V."""

    @property
    def supply(self) -> float:
        """Voltage of the supply, V."""

    @property
    def lost(self) -> bool:
        """Whether the encoder is found to mislead."""

    def follow_velocity(self, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop: rad/s, with a feed-forward torque in N m."""

    def follow_torque(self, torque: float) -> None:
        """Close the current loop: N m."""

    def follow_voltage(self, voltage: float) -> None:
        """Give a voltage: V."""

    def halt(self, deceleration: float) -> None:
        """Ramp to rest, rad/s^2, and hold."""

    def release(self) -> None:
        """Take the power off: the motor turns freely."""


@dataclass(frozen=True)
class DriveFaults:
    """Faults of one drive, switched on and off by hand; what a protocol lacks it leaves alone.

    Attributes:
        silent: Nothing is sent, commands are still heard.
        deaf: Nothing is heard.
        frozen_reports: Position and velocity reports stop, the heartbeat goes on.
        frozen_encoder: Reports go on with the same position and velocity for ever.
        no_heartbeat: The heartbeat stops, reports go on.
        fault: An error of the drive: it stops, says so, and stays until it is switched off and
            the drive's fault is reset by its host.
        refuse_enable: It does not switch the motor on.
        wrong_mode: It shows another mode than the one it was given.
        stuck_status: Its status stays as it was.
        configuration_refused: Each write of its configuration is answered by an error.
        configuration_unanswered: No answer to reads and writes of its configuration.
        short_reports: Reports lack their last byte.
        duplicated_reports: Each report is sent twice.
        reordered_reports: Of each two reports the later one comes first.
        supply: Voltage of its supply, V; 0 for the motor's own.
        reboots: How often it was made to start anew: when the number rises it does.
    """

    silent: bool = False
    deaf: bool = False
    frozen_reports: bool = False
    frozen_encoder: bool = False
    no_heartbeat: bool = False
    fault: bool = False
    refuse_enable: bool = False
    wrong_mode: bool = False
    stuck_status: bool = False
    configuration_refused: bool = False
    configuration_unanswered: bool = False
    short_reports: bool = False
    duplicated_reports: bool = False
    reordered_reports: bool = False
    supply: float = 0.0
    reboots: int = 0
