"""Messages between a node and its streaming process: commands to it, and reports from it."""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from omniman_ros.ur.feedback import ArmSample


class StreamingCommand(Enum):
    """Command of a node to its streaming process."""

    #: Follow a preview: times, positions, velocities and accelerations of a `JointPreview`
    PREVIEW = auto()
    START = auto()  #: Start the program, and keep it supplied with setpoints
    KEEP_ALIVE = auto()  #: Do nothing: the message shows that the node runs
    #: Replace a process that has ended: remain stopped until a reset starts the program
    RESUME = auto()
    FINISH = auto()  #: Bring the arm to rest and end the program
    STOP = auto()  #: Latch a stop, with its reason
    #: Bring the arm to rest and refuse previews (True), or accept them again (False)
    HOLD = auto()
    LIMIT = auto()  #: Keep to a fraction of the joints' speed limits, 0 to 1
    RESET = auto()  #: Clear the stop, with the number of the reset
    TIME = auto()  #: Let simulated time pass, up to an instant of the node's clock [s]
    CONFIGURE = auto()  #: Replace the parameters: `ArmParameters` and `UrParameters`


@dataclass(frozen=True)
class CommandMessage:
    """A command with its arguments."""

    command: StreamingCommand
    arguments: tuple[Any, ...] = ()  #: Arguments of the command, see :class:`StreamingCommand`


class StreamingPhase(Enum):
    """Phase of the streaming."""

    IDLE = "idle"  #: No program of ours runs
    STARTING = "starting"  #: A program was sent; its connection is awaited
    STREAMING = "streaming"  #: Setpoints are sent to the program
    ENDING = "ending"  #: The arm is brought to rest; then the program ends


@dataclass(frozen=True)
class SendTiming:
    """Punctuality of the setpoints since the last timing."""

    intervals: tuple[float, ...]  #: Times between two sends [s]
    #: Age of the newest setpoint that the program had read, when each sample arrived [s]
    ages: tuple[float, ...]


@dataclass(frozen=True)
class StreamingReport:
    """State of the streaming, sent by its process."""

    samples: tuple[ArmSample, ...] = ()  #: New real-time data, oldest first
    phase: StreamingPhase = StreamingPhase.IDLE
    connected: bool = False  #: Whether real-time data flow
    #: Why the arm cannot be moved now, apart from a latched stop; or an empty string
    blocking_reason: str = "no data yet"
    stop_reason: str = ""  #: Reason of the latched stop, or an empty string
    failure: str = ""  #: Why the program did not start, or an empty string
    resets: int = 0  #: Number of the last reset that was received
    at_rest: bool = True  #: Whether the setpoints stand still
    refusals: tuple[str, ...] = ()  #: Refusals of previews since the last report
    texts: tuple[str, ...] = ()  #: Text messages of the controller since the last report
    #: Number of unusable data and refused connections so far, by kind
    counts: tuple[tuple[str, int], ...] = ()
    timing: SendTiming | None = None  #: Punctuality of the setpoints; None in most reports
    sent_until: float = 0.0  #: Instant before which all setpoints have been sent [s]
