"""Interface of a simulated drive to its motor's shaft, and its faults."""

from dataclasses import dataclass
from typing import Protocol


class DriveMotor(Protocol):
    """Motor of one drive, as its firmware sees it; quantities at the motor's shaft.

    A motor whose encoder is detected to be wrong brakes by itself until it is released.
    """

    @property
    def position(self) -> float:
        """Unwrapped angle, measured by the encoder [rad]."""

    @property
    def velocity(self) -> float:
        """Speed, measured by the encoder [rad/s]."""

    @property
    def torque(self) -> float:
        """Torque, derived from the current [N m]."""

    @property
    def current(self) -> float:
        """Current [A]."""

    @property
    def voltage(self) -> float:
        """Voltage at the motor [V]."""

    @property
    def supply(self) -> float:
        """Supply voltage of the drive [V]."""

    @property
    def lost(self) -> bool:
        """Whether the encoder is detected to be wrong."""

    def follow_velocity(self, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop at a speed [rad/s], with a feed-forward torque [N m]."""

    def follow_torque(self, torque: float) -> None:
        """Close the current loop at a torque [N m]."""

    def follow_voltage(self, voltage: float) -> None:
        """Apply a voltage [V]."""

    def halt(self, deceleration: float) -> None:
        """Ramp to rest at a deceleration [rad/s^2], and hold."""

    def release(self) -> None:
        """Switch the power off: the motor rotates freely."""


@dataclass(frozen=True)
class DriveFaults:
    """Simulated faults of one drive; a protocol ignores faults that it cannot have."""

    silent: bool = False  #: The drive sends nothing, but still receives commands
    deaf: bool = False  #: The drive receives nothing
    frozen_reports: bool = False  #: Reports of motion stop, the heartbeat continues
    frozen_encoder: bool = False  #: Reports continue with an unchanging position and velocity
    no_heartbeat: bool = False  #: The heartbeat stops, but reports continue
    fault: bool = False  #: The drive has an error until this ends and the host resets it
    refuse_enable: bool = False  #: The drive does not switch the motor on
    wrong_mode: bool = False  #: The drive reports another mode than the one that was set
    stuck_status: bool = False  #: The status no longer changes
    configuration_refused: bool = False  #: Each write of the configuration is refused
    configuration_unanswered: bool = False  #: The configuration's requests are not answered
    short_reports: bool = False  #: Reports lack their last byte
    duplicated_reports: bool = False  #: Each report is sent twice
    reordered_reports: bool = False  #: Of each pair of reports, the later one is sent first
    supply: float = 0.0  #: Supply voltage [V]; 0 selects that of the motor
    reboots: int = 0  #: Number of requested restarts: the drive restarts whenever it increases
