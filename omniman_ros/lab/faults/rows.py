"""A row of the table of faults: what fails, and what must happen then."""

from dataclasses import dataclass
from enum import Enum

from omniman_ros.lab.faults.injections import Injection, Publication, Restart, Second


class Subject(Enum):
    """Kind of thing that fails."""

    SOURCE = "source"
    PROCESS = "process"
    LINK = "link"
    SENSOR = "sensor"
    DRIVE = "drive"
    ARM = "arm"
    PERSON = "person"


class MotionKind(Enum):
    """What the robot does when the fault begins."""

    TWIST = "twist"  #: the platform follows `cmd_vel`, the arm a trajectory
    TRAJECTORY = "trajectory"  #: platform and arm follow one trajectory


class RequiredOutcome(Enum):
    """What must become of the motion."""

    #: Platform and arm come to rest, and nothing moves again before a reset
    LATCHED = "stops until a reset"
    PAUSED = "stops, goes on"  #: the platform comes to rest, and goes on when the fault has gone
    #: All come to rest; the motion is over, and the next command moves again without a reset
    ENDED = "stops for this motion"
    #: Neither speed nor acceleration exceed the limits, whatever is asked for
    LIMITED = "stays within the limits"
    UNHARMED = "drives on"  #: the motion goes on as if nothing had happened


class GoingOn(Enum):
    """What a user does to drive on."""

    NOTHING = "nothing"
    COMMAND = "send the next command"
    RESET = "`omniman reset`"
    PENDANT = "switch the arm on at its pendant, then `omniman reset`"
    RESTART = "start the node again, then `omniman reset`"


@dataclass(frozen=True)
class Row:
    """A row of the table of faults."""

    name: str  #: name of the row, for `--row`
    subject: Subject  #: what fails
    fault: str  #: fault, in words for the documentation
    injection: Injection  #: how it is injected
    outcome: RequiredOutcome  #: what must become of the motion
    going_on: GoingOn  #: what a user does to drive on
    motion: MotionKind = MotionKind.TWIST  #: motion of the robot when the fault begins
    #: Time from the injection within which nobody can know of the fault: the time-out by which it
    #: becomes evident [s].
    unnoticed: float = 0.0
    timeout: str = ""  #: what sets this time, mostly a parameter; empty if there is none
    #: Longest permitted time from then until platform and arm begin to brake [s]
    reaction: float = 0.12
    #: Time by which the stop may last longer than the hardest one, as platform and arm stay on
    #: their path [s].
    slowly: float = 0.0
    leftover: float = 2e-3  #: largest motion once the fault has gone, before a reset [m or rad]
    platform: bool = True  #: whether the platform has to react
    arm: bool = True  #: whether the arm has to react
    stopped: tuple[str, ...] = ()  #: names of the nodes whose `stop_state` must be `stopped`
    source: str = ""  #: required value of `active_source`; empty if any will do

    def __post_init__(self) -> None:
        if self.outcome is RequiredOutcome.LATCHED and not self.stopped:
            raise ValueError(f"row '{self.name}': nobody is named who is stopped")
        if (self.unnoticed > 0.0) != bool(self.timeout):
            raise ValueError(f"row '{self.name}': a time-out needs its name, and a name its time")

    @property
    def short_name(self) -> str:
        """Name for `omniman fault`: one word, in lower case."""
        return self.name.lower().replace(" ", "-").replace("/", "-")

    @property
    def needs_laboratory(self) -> bool:
        """Whether a process has to be started, which only the laboratory can do."""
        return isinstance(self.injection, (Restart, Second))

    @property
    def told(self) -> str:
        """What tells a user of it, as Markdown; empty if nothing does."""
        if self.stopped:
            nodes = ", ".join(f"`{name}`" for name in self.stopped)
            return f"`stop_state` of {nodes}: `stopped`"
        if self.source:
            return f"`active_source`: `{self.source}`"
        return "a warning in the log" if isinstance(self.injection, Publication) else ""
