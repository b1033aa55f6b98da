"""Base of the codecs of drive protocols, as the policy of the bridge sees them.

An axis is one drive as the policy sees it: it converts demands into frames and frames into
feedback, in units of the motor's shaft. It knows its protocol and the state machine of its drive;
it knows no other wheel, no clock and no bus. Times are seconds of any steady clock, given by the
caller.
"""

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import ClassVar

from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import InputError, ParameterError

#: Ratio of a speed that a shaft certainly cannot reach to its largest speed
IMPOSSIBLE_SPEED = 3.0

#: Uses the data of a report received at a time [s]; returns False if they are not valid
ReportHandler = Callable[[bytes, float], bool | None]


class AxisState(Enum):
    """State of a drive, as far as the drive has reported it."""

    OFFLINE = "offline"  #: The drive is not configured yet, or has restarted since
    CONFIGURING = "configuring"  #: The axis is configuring the drive
    READY = "ready"  #: The drive is configured, without power on the motor
    ENABLED = "enabled"  #: The drive follows setpoints
    STOPPING = "stopping"  #: The drive ramps to rest, or holds, on its own
    FAULT = "fault"  #: The drive reports a fault


class Demand(Enum):
    """What the policy demands of a drive."""

    IDLE = "idle"  #: Take the power off the motor
    DRIVE = "drive"  #: Enable the drive and follow the setpoint
    #: Perform a quick stop: by the drive's own ramp, or by a setpoint that ramps to rest
    STOP = "stop"


class Receipt(Enum):
    """Result of the reception of a frame by an axis."""

    FOREIGN = "foreign"  #: The frame is not from the drive of this axis
    #: The id is of this drive, but the frame is too short, of the wrong kind or invalid
    MALFORMED = "malformed"
    ACCEPTED = "accepted"  #: The frame was used


@dataclass(frozen=True, slots=True)
class DriveSetpoint:
    """Setpoint of a drive, at the motor's shaft."""

    mode: DriveMode  #: Velocity, torque or voltage; voltage only where the axis supports it
    value: float  #: Velocity [rad/s], torque [N m] or voltage [V]
    feedforward: float = 0.0  #: Feed-forward torque that goes with a velocity [N m]


REST = DriveSetpoint(DriveMode.VELOCITY, 0.0)  #: Setpoint of zero velocity


@dataclass(slots=True)
class Feedback:
    """Latest measurements of a drive, at the motor's shaft; NaN before they are received."""

    position: float = math.nan  #: Unwrapped angle [rad]
    velocity: float = math.nan  #: Angular velocity [rad/s]
    torque: float = math.nan  #: Torque [N m]
    current: float = math.nan  #: Motor current [A]
    #: Voltage at the motor's terminals [V]; NaN if the drive does not report it
    voltage: float = math.nan
    bus_voltage: float = math.nan  #: Supply voltage [V]
    at: float = -math.inf  #: Time at which position and velocity were last received [s]
    count: int = 0  #: Number of times that position and velocity were received
    #: Number of times that the drive has restarted, as reported or as inferred: the position
    #: continues from where it was, whatever the shaft has done meanwhile.
    restarts: int = 0

    def measure(self, position: float, velocity: float, now: float) -> None:
        """Set position [rad] and velocity [rad/s], received at a time [s]."""
        self.position, self.velocity = position, velocity
        self.at, self.count = now, self.count + 1


@dataclass(frozen=True)
class AxisSettings:
    """Installation of one drive; speeds and torques at the motor's shaft."""

    name: str  #: Name of the wheel
    node: int  #: Id of the drive on the bus
    period: float  #: Time between two setpoints [s]
    counts: float  #: Position units per revolution
    velocity_scale: float  #: Velocity units per revolution per second
    pole_pairs: int  #: Pole pairs of the motor
    torque_constant: float  #: Torque constant of the motor [N m/A]
    rated_torque: float  #: Rated torque of the motor [N m]; 0 if it is read from the drive
    mode: DriveMode  #: Mode of setpoints that the drive must support besides velocity
    feed_forward: bool  #: Whether feed-forward torque is sent
    max_speed: float  #: Largest speed [rad/s]
    max_torque: float  #: Largest torque [N m]
    quick_stop_deceleration: float  #: Deceleration of a quick stop [rad/s^2]
    #: Time without a heartbeat of the host after which the drive stops [s]
    heartbeat_timeout: float
    drive_heartbeat: float  #: Period of the drive's heartbeat [s]
    feedback_timeout: float  #: Age of the feedback at which the drive counts as lost [s]

    def require_positive(self, *names: str) -> None:
        """Raise ParameterError unless settings by which a codec divides are finite and above 0."""
        for name in names:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ParameterError(f"{self.name}.{name}", value, "must be finite and above zero")

    def clip(self, setpoint: DriveSetpoint) -> DriveSetpoint:
        """Clip speed and torque, not voltage; raise InputError if the setpoint is not finite."""
        value, torque = setpoint.value, setpoint.feedforward
        if not (math.isfinite(value) and math.isfinite(torque)):
            raise InputError(f"setpoint of {self.name} must be finite: {value}, {torque}")
        limits = {DriveMode.VELOCITY: self.max_speed, DriveMode.TORQUE: self.max_torque}
        limit = limits.get(setpoint.mode, math.inf)
        return replace(
            setpoint,
            value=min(max(value, -limit), limit),
            feedforward=min(max(torque, -self.max_torque), self.max_torque),
        )

    def is_reachable(self, step: float, elapsed: float) -> bool:
        """Return whether the shaft can rotate by a step [rad] between reports `elapsed` [s] apart.

        Reports may be late: each may be as old as the feedback timeout, on top of the time that
        elapsed between the receptions. After a long silence nearly any step is reachable.
        """
        longest_time = max(elapsed, 0.0) + self.feedback_timeout
        return abs(step) <= IMPOSSIBLE_SPEED * self.max_speed * longest_time + 0.5 * math.pi


class Network:
    """Frames of the host that belong to no single axis; of most protocols there are none."""

    #: Whether the drives measure when they receive the last frame of a period (SYNC), rather than
    #: when they report
    samples_at_sync = False
    #: Ids, and whether they are extended, of frames that only a host sends
    command_ids: Collection[tuple[int, bool]] = ()

    def __init__(self, settings: tuple[AxisSettings, ...]) -> None:
        pass

    def before(self, now: float) -> list[CanFrame]:
        """Return the frames to send before those of the axes, once per period."""
        return []

    def after(self, now: float) -> list[CanFrame]:
        """Return the frames to send after those of the axes, once per period."""
        return []


class DriveAxis(ABC):
    """Codec of one drive, the base of all protocols: demands to frames, reports to feedback.

    A protocol passes its ids and handlers on, writes `frames`, and sets `state` to what the drive
    reports. `configure` makes the state CONFIGURING; the first reports make it READY, and those
    after `Demand.DRIVE` ENABLED. What a stop then does, and when, is the policy's.

    Args:
        command_ids: Ids of the frames that only the host of this drive sends, to command it. If
            one is received that was not sent, there is a second host.
        reports: Handlers of the drive's frames by id. Data too short to unpack (`struct.error`)
            are invalid, and must have had no effect.
        extended: Whether all these ids have 29 bits.
    """

    network: ClassVar[type[Network]] = Network  #: Frames of the host to all drives of the bus
    #: Modes of setpoints that the drive can follow, known once it is configured
    modes: Collection[DriveMode] = (DriveMode.VELOCITY,)

    def __init__(
        self,
        settings: AxisSettings,
        command_ids: Iterable[int],
        reports: Mapping[int, ReportHandler],
        *,
        extended: bool = False,
    ) -> None:
        self.settings = settings  #: Installation of the drive
        self.state = AxisState.OFFLINE  #: State that the drive reported last
        #: Why the drive cannot be driven, or an empty string: a fault, an emergency message, a
        #: restart, a missing heartbeat, a mode that the drive lacks, a refused configuration. It
        #: is set at reception or in `tick` and stays until `reset` (or `configure`).
        self.fault_reason = ""
        self.feedback = Feedback()  #: Latest measurements
        #: Ids of commands, and whether they are extended
        self.command_ids = frozenset((number, extended) for number in command_ids)
        self._reports = {(number, extended): handler for number, handler in reports.items()}

    def configure(self, now: float) -> None:
        """Begin to configure the drive, from any state; `tick` continues until it is READY.

        The state becomes CONFIGURING at once and the fault reason is cleared. Configuring does not
        put power on the motor, and first switches it off if it may be on.
        """
        self.state, self.fault_reason = AxisState.CONFIGURING, ""

    def reset(self, now: float) -> None:
        """Clear the fault reason; the next ticks reset a drive in FAULT.

        A drive that has restarted (OFFLINE) is configured again. Nothing moves.
        """
        if self.fault_reason or self.state in (AxisState.OFFLINE, AxisState.FAULT):
            self.configure(now)

    def receive(self, frame: CanFrame, now: float) -> Receipt:
        """Process a frame from the bus; never raise an error, whatever the frame contains.

        Remote frames are requests of a host, and thus foreign.
        """
        handler = self._reports.get((frame.id, frame.extended))
        if handler is None or frame.remote:
            return Receipt.FOREIGN
        try:
            return Receipt.MALFORMED if handler(frame.data, now) is False else Receipt.ACCEPTED
        except struct.error:
            return Receipt.MALFORMED

    def tick(self, demand: Demand, setpoint: DriveSetpoint, now: float) -> list[CanFrame]:
        """Return the frames for this drive: once per period, and once more when a stop begins.

        Unless the drive is ENABLED the frames carry no motion (velocity zero), whatever the
        setpoint. With Demand.STOP a drive with a quick stop of its own is commanded to perform
        it; others follow the setpoint.

        Raises:
            InputError: The setpoint is not finite.
        """
        setpoint = self.settings.clip(setpoint)
        follows = self.state is AxisState.ENABLED and demand is not Demand.IDLE
        return self.frames(demand, setpoint if follows else REST, now)

    @abstractmethod
    def frames(self, demand: Demand, setpoint: DriveSetpoint, now: float) -> list[CanFrame]:
        """Return the frames of `tick`; the setpoint is within the limits, and REST unless ENABLED.

        A setpoint has one of `modes`.
        """

    def wants_power(self, demand: Demand) -> bool:
        """Whether the motor shall have power: to drive without a fault reason, or as it stops."""
        if demand is Demand.STOP:
            return self.state in (AxisState.ENABLED, AxisState.STOPPING)
        return demand is Demand.DRIVE and not self.fault_reason

    def fail(self, state: AxisState, reason: str) -> None:
        """Set the state, and why the drive cannot be driven unless there is a reason already."""
        self.state = state
        self.fault_reason = self.fault_reason or reason


class WrappingCounter:
    """Unwraps the readings of an integer counter that overflows in both directions."""

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
