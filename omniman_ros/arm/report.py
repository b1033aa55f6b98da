"""What the streaming process says to its node."""

from dataclasses import dataclass
from enum import Enum

from omniman_ros.arm.feedback import ArmSample


class Phase(Enum):
    """What is done with the arm."""

    IDLE = "idle"
    """No program of ours runs."""
    STARTING = "starting"
    """A program was sent, and has to call."""
    STREAMING = "streaming"
    """Setpoints go to the program."""
    ENDING = "ending"
    """The arm is brought to rest, then the program ends."""


@dataclass(frozen=True)
class Timing:
    """How punctual the setpoints were since the last of these.

    Attributes:
        intervals: Between two sends, s.
        ages: Of the newest setpoint that the program had read, at the arrival of each sample, s.
    """

    intervals: tuple[float, ...]
    ages: tuple[float, ...]


@dataclass(frozen=True)
class ArmReport:
    """State of the streaming.

    Attributes:
        samples: Real-time data that are new, oldest first.
        phase: See there.
        connected: Whether real-time data flow.
        trouble: Why the arm cannot be moved now, whatever was latched; or empty.
        stop_reason: Why it was stopped for good, or empty.
        failure: Why it did not come up, or empty.
        resets: How many resets had been heard: an older report does not know of the last.
        at_rest: Whether the setpoints stand.
        refusals: What was refused since the last report, in words.
        texts: What the controller said since.
        counts: Bad data and calls so far, by kind.
        timing: See there; now and then.
    """

    samples: tuple[ArmSample, ...] = ()
    phase: Phase = Phase.IDLE
    connected: bool = False
    trouble: str = "no data yet"
    stop_reason: str = ""
    failure: str = ""
    resets: int = 0
    at_rest: bool = True
    refusals: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    timing: Timing | None = None
