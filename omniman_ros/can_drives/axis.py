"""Interface between the policy of the bridge and the codec of a drive protocol.

An axis is one drive as the policy sees it: it converts demands into frames and frames into
feedback, in units of the motor's shaft. It knows its protocol and the state machine of its drive;
it knows no other wheel, no clock and no bus. Times are seconds of any steady clock, given by the
caller.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from omniman_ros.can_drives.frame import Frame
from omniman_ros.control.wheel_cascade import DriveMode


class AxisState(Enum):
    """State of a drive, as far as the drive has reported it."""

    OFFLINE = "offline"
    """The drive is not configured yet, or has restarted since."""
    CONFIGURING = "configuring"
    """The axis is configuring the drive."""
    READY = "ready"
    """The drive is configured, without power on the motor."""
    ENABLED = "enabled"
    """The drive follows setpoints."""
    STOPPING = "stopping"
    """The drive ramps to rest, or holds, on its own."""
    FAULT = "fault"
    """The drive reports a fault."""


class Demand(Enum):
    """What the policy demands of a drive."""

    IDLE = "idle"
    """Take the power off the motor."""
    DRIVE = "drive"
    """Enable the drive and follow the setpoint."""
    STOP = "stop"
    """Perform a quick stop: by the drive's own ramp, or by a setpoint that ramps to rest."""


class Receipt(Enum):
    """Result of the reception of a frame by an axis."""

    FOREIGN = "foreign"
    """The frame is not from the drive of this axis."""
    MALFORMED = "malformed"
    """The id is of this drive, but the frame is too short, of the wrong kind or invalid."""
    ACCEPTED = "accepted"
    """The frame was used."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Setpoint of a drive, at the motor's shaft.

    Attributes:
        mode: Velocity, torque or voltage; voltage only where the axis supports it.
        value: Velocity [rad/s], torque [N m] or voltage [V].
        feedforward: Feed-forward torque that goes with a velocity [N m].
    """

    mode: DriveMode
    value: float
    feedforward: float = 0.0


REST = Setpoint(DriveMode.VELOCITY, 0.0)
"""Setpoint of zero velocity."""


@dataclass(slots=True)
class Feedback:
    """Latest measurements of a drive, at the motor's shaft; NaN before they are received.

    Attributes:
        position: Unwrapped angle [rad].
        velocity: Angular velocity [rad/s].
        torque: Torque [N m].
        current: Motor current [A].
        voltage: Voltage at the motor's terminals [V]; NaN if the drive does not report it.
        bus_voltage: Supply voltage [V].
        at: Time at which position and velocity were last received [s].
        count: Number of times that position and velocity were received.
        restarts: Number of times that the drive has restarted, as reported or as inferred: the
            position continues from where it was, whatever the shaft has done meanwhile.
    """

    position: float = math.nan
    velocity: float = math.nan
    torque: float = math.nan
    current: float = math.nan
    voltage: float = math.nan
    bus_voltage: float = math.nan
    at: float = -math.inf
    count: int = 0
    restarts: int = 0


@dataclass(frozen=True)
class AxisSettings:
    """Installation of one drive; speeds and torques at the motor's shaft.

    Attributes:
        name: Name of the wheel.
        node: Id of the drive on the bus.
        period: Time between two setpoints [s].
        counts: Position units per revolution.
        velocity_scale: Velocity units per revolution per second.
        pole_pairs: Pole pairs of the motor.
        torque_constant: Torque constant of the motor [N m/A].
        rated_torque: Rated torque of the motor [N m]; 0 if it is read from the drive.
        mode: Mode of setpoints that the drive must support besides velocity.
        feed_forward: Whether feed-forward torque is sent.
        max_speed: Largest speed [rad/s].
        max_torque: Largest torque [N m].
        quick_stop_deceleration: Deceleration of a quick stop [rad/s^2].
        heartbeat_timeout: Time without a heartbeat of the host after which the drive stops [s].
        drive_heartbeat: Period of the drive's heartbeat [s].
        feedback_timeout: Age of the feedback at which the drive counts as lost [s].
    """

    name: str
    node: int
    period: float
    counts: float
    velocity_scale: float
    pole_pairs: int
    torque_constant: float
    rated_torque: float
    mode: DriveMode
    feed_forward: bool
    max_speed: float
    max_torque: float
    quick_stop_deceleration: float
    heartbeat_timeout: float
    drive_heartbeat: float
    feedback_timeout: float


class Axis(Protocol):
    """One drive.

    Attributes:
        settings: Installation of the drive.
        state: State that the drive reported last.
        fault_reason: Why the drive cannot be driven, or an empty string: a fault, an emergency
            message, a restart, a missing heartbeat, a mode that the drive lacks, a refused
            configuration. It is set at reception or in `tick` and stays until `reset` (or
            `configure`).
        feedback: Latest measurements.
        modes: Modes of setpoints that the drive can follow, known once it is configured.
        command_ids: Ids, and whether they are extended, of the frames that only the host of this
            drive sends, to command it. If one is received, there is a second host.
    """

    settings: AxisSettings
    state: AxisState
    fault_reason: str
    feedback: Feedback
    modes: Collection[DriveMode]
    command_ids: Collection[tuple[int, bool]]

    def configure(self, now: float) -> None:
        """Begin to configure the drive, from any state; `tick` continues until it is READY.

        The state becomes CONFIGURING at once and the fault reason is cleared. Configuring does not
        put power on the motor, and first switches it off if it may be on.
        """

    def reset(self, now: float) -> None:
        """Clear the fault reason; the next ticks reset a drive in FAULT.

        A drive that has restarted (OFFLINE) is configured again. Nothing moves.
        """

    def receive(self, frame: Frame, now: float) -> Receipt:
        """Process a frame from the bus; never raise an error, whatever the frame contains."""

    def tick(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        """Return the frames for this drive: once per period, and once more when a stop begins.

        Unless the drive is ENABLED the frames carry no motion (velocity zero), whatever the
        setpoint. With Demand.STOP a drive with a quick stop of its own is commanded to perform
        it; others follow the setpoint.

        Raises:
            ValueError: The setpoint is not finite.
        """


class WrappingCounter:
    """Unwraps the readings of an integer counter that overflows in both directions.

    Args:
        bits: Width of the counter.

    Attributes:
        value: Unwrapped value of the latest reading.
    """

    def __init__(self, bits: int = 32) -> None:
        self._span = 1 << bits
        self._reading: int | None = None
        self._has_origin = False
        self.value = 0

    def update(self, reading: int) -> int:
        """Return the unwrapped value of a reading; the first reading is its own value."""
        if self._reading is not None:
            half = self._span >> 1
            self.value += (reading - self._reading + half) % self._span - half
        elif not self._has_origin:
            self.value = reading
        self._reading, self._has_origin = reading, True
        return self.value

    def restart(self) -> None:
        """Keep `value` at the next reading: the counter restarted, but the shaft did not move."""
        self._reading = None
