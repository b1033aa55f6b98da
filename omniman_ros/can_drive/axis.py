"""What a protocol is to the policy: one axis a drive, and the bus they share.

An axis turns demands into frames and frames into feedback, in units of the motor's shaft. It
knows its protocol and its drive's state machine; it knows no other wheel, no clock and no bus.
Times are seconds of any steady clock, given by the caller.

To add a protocol: write one file with an `Axis` and, where the bus carries more than the axes'
own frames, a `Network`; and one line in `protocols.PROTOCOLS`.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.wheel_cascade import DriveMode


class AxisState(Enum):
    """Where a drive is, as far as it has said."""

    OFFLINE = "offline"
    """Not configured yet, or it has begun anew since."""
    CONFIGURING = "configuring"
    READY = "ready"
    """Configured, without power on the motor."""
    ENABLED = "enabled"
    """It follows setpoints."""
    STOPPING = "stopping"
    """It ramps to rest, or holds, by itself."""
    FAULT = "fault"


class Demand(Enum):
    """What the policy wants of a drive."""

    IDLE = "idle"
    """No power on the motor."""
    DRIVE = "drive"
    """Get enabled, and follow the setpoint."""
    STOP = "stop"
    """Quick stop: the drive's own, or the setpoint, which then ramps to rest."""


class Receipt(Enum):
    """What an axis says of a frame."""

    FOREIGN = "foreign"
    """Not from this axis' drive."""
    MALFORMED = "malformed"
    """From this drive by its id, but too short, of the wrong kind or with nonsense in it."""
    TAKEN = "taken"


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a drive is asked to follow, at the motor's shaft.

    Attributes:
        mode: Velocity, torque or voltage; voltage only where the axis has it.
        value: rad/s, N m or V.
        feedforward: Torque in N m, with velocities.
    """

    mode: DriveMode
    value: float
    feedforward: float = 0.0


REST = Setpoint(DriveMode.VELOCITY, 0.0)


@dataclass(slots=True)
class Feedback:
    """What a drive measures, at the motor's shaft; NaN for what has not been heard.

    Attributes:
        position: Unwrapped, rad.
        velocity: rad/s.
        torque: N m.
        current: Of the motor, A.
        voltage: At the motor's terminals, V; NaN where the drive does not tell.
        bus_voltage: Of the supply, V.
        at: When position and velocity were last heard, s.
        count: How often they were.
    """

    position: float = math.nan
    velocity: float = math.nan
    torque: float = math.nan
    current: float = math.nan
    voltage: float = math.nan
    bus_voltage: float = math.nan
    at: float = -math.inf
    count: int = 0


@dataclass(frozen=True)
class AxisSettings:
    """What an axis is told of its drive; speeds and torques at the motor's shaft.

    Attributes:
        name: Of the wheel.
        node: Id of the drive.
        period: Time between two setpoints, s.
        counts: Position units per turn.
        velocity_scale: Velocity units per turn per second.
        pole_pairs: Of the motor.
        torque_constant: N m/A.
        rated_torque: N m; 0 if the drive is to be asked.
        mode: What is needed besides velocity.
        feed_forward: Whether feed-forward torque is sent.
        max_speed, max_torque: rad/s and N m.
        quick_stop_deceleration: rad/s^2.
        heartbeat_timeout: Silence of the host after which the drive stops, s.
        drive_heartbeat: Period of the drive's heartbeat, s.
        feedback_timeout: Age of the feedback at which the drive is lost, s.
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
        settings: As given.
        state: As the drive has said last.
        trouble: Why it cannot drive, in words, or empty: a fault, an emergency message, a restart,
            a heartbeat that is missing, a mode that it does not take, a refused configuration.
            It is set at reception or in `tick` and stays until `reset` (or `configure`).
        feedback: Latest measurements.
        modes: What it can follow, known once it is configured.
        command_ids: Ids of frames that only the host of this drive sends (what it is commanded
            with): heard from somewhere else, they betray a second host.
    """

    settings: AxisSettings
    state: AxisState
    trouble: str
    feedback: Feedback
    modes: Collection[DriveMode]
    command_ids: Collection[tuple[int, bool]]

    def configure(self, now: float) -> None:
        """Begin, from whatever state; `tick` then sends what is needed until it is READY.

        It goes to CONFIGURING at once, and forgets trouble. It does not put power on the motor,
        and takes it off first where the drive may have it on.
        """

    def reset(self, now: float) -> None:
        """Forget trouble and have a drive in FAULT reset by the next ticks; configured or not.

        A drive that began anew (OFFLINE) is configured again. It moves nothing.
        """

    def receive(self, frame: Frame, now: float) -> Receipt:
        """Take a frame from the bus; never raises, whatever is in it."""

    def tick(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        """Frames for this drive now: once a period, and once more at once where a stop begins.

        While it is not ENABLED the frames carry no motion (velocity zero), whatever the setpoint.
        With Demand.STOP a drive with a quick stop of its own is told to do it, others follow the
        setpoint. A setpoint that is not finite raises ValueError.
        """


class Network(Protocol):
    """What a bus carries besides the frames of the single axes.

    Attributes:
        command_ids: As those of an axis.
        samples: Whether the drives measure when they hear the last frame of a period (SYNC), and
            not when they report.
    """

    samples: bool
    command_ids: Collection[tuple[int, bool]]

    def before(self, now: float) -> list[Frame]:
        """Frames before those of the axes, once a period."""

    def after(self, now: float) -> list[Frame]:
        """Frames after those of the axes, once a period."""


@dataclass
class QuietNetwork:
    """A bus that carries the frames of the axes alone."""

    samples: bool = False
    command_ids: Collection[tuple[int, bool]] = field(default_factory=tuple)

    def before(self, now: float) -> list[Frame]:
        """Return nothing."""
        return []

    def after(self, now: float) -> list[Frame]:
        """Return nothing."""
        return []


class Counter:
    """Joins readings of an integer counter that wraps, both ways, into one number.

    Args:
        bits: Width of the counter.
    """

    def __init__(self, bits: int = 32) -> None:
        self._span = 1 << bits
        self._reading: int | None = None
        self._heard = False
        self.value = 0

    def update(self, reading: int) -> int:
        """Return the number for a reading; the very first is the origin."""
        if self._reading is not None:
            half = self._span >> 1
            self.value += (reading - self._reading + half) % self._span - half
        elif not self._heard:
            self.value = reading
        self._reading, self._heard = reading, True
        return self.value

    def restart(self) -> None:
        """The counter began anew, the wheel stays where it was: the next reading is `value`."""
        self._reading = None
