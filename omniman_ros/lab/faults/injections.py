"""Ways to inject a fault into the running robot, as data; `player` carries them out."""

import signal
from dataclasses import dataclass
from enum import Enum

CONTROLLER = "platform_controller"  #: node that computes the wheel commands
BRIDGE = "can_bridge"  #: node between the wheel commands and the bus
DRIVES = "simulated_can_drives"  #: node that simulates the drives and the plant
STREAMER = "arm_streamer"  #: node that streams the arm's setpoints
ARM = "simulated_ur"  #: node that simulates the arm's controller
INTERPOLATOR = "path_interpolator"  #: node that sends paths and trajectories as previews
MONITOR = "collision_monitor"  #: node that limits the speed before contact
STREAMING_PROCESS = "streaming process"  #: child process of the streamer that sends the setpoints


@dataclass(frozen=True)
class Signal:
    """A signal to a process."""

    process: str  #: name of the process
    #: Number of the signal. A process that was killed is started again before the next row.
    number: signal.Signals
    #: Time after which a suspended process goes on [s]; None until the judgement
    resume: float | None = None


@dataclass(frozen=True)
class Restart:
    """A process is killed and at once started again."""

    process: str


@dataclass(frozen=True)
class Second:
    """A second copy of a process is started."""

    process: str


@dataclass(frozen=True)
class Setting:
    """A fault that a simulated device simulates itself."""

    node: str  #: node of the simulated device
    parameter: str  #: name of the parameter
    value: bool | float | tuple[str, ...]  #: value with the fault
    cleared: bool | float | tuple[str, ...]  #: value without it
    #: Commands to the dashboard of the arm's controller once it is cleared
    afterwards: tuple[str, ...] = ()


class TwistFault(Enum):
    """What becomes of the stream of twists on `cmd_vel`."""

    SILENT = "silent"
    NAN = "NaN"
    INFINITE = "infinite"
    JUMP = "a hundred times too fast"
    OPPOSED = "a second publisher sends the opposite"
    FLOOD = "a thousand times a second"


class InvalidContent(Enum):
    """Messages on a topic beside those of its own publisher."""

    NAN = "NaN"
    INFINITE = "infinite"
    EMPTY = "empty"
    WRONG_NAMES = "wrong names"
    WRONG_FRAME = "wrong frame"
    HUGE = "1e300"


@dataclass(frozen=True)
class Publication:
    """A second publisher of a topic sends invalid messages 100 times a second."""

    topic: str  #: name of the topic, a key of `invalid_messages.TOPICS`
    content: InvalidContent  #: what it sends


@dataclass(frozen=True)
class EmergencyStop:
    """The emergency stop is pressed."""

    others_release: bool = False  #: whether a second publisher sends false all the while


@dataclass(frozen=True)
class ServiceStop:
    """A node's `~/stop` is called."""

    node: str


Injection = (
    Signal | Restart | Second | Setting | TwistFault | Publication | EmergencyStop | ServiceStop
)  #: Any way to inject a fault
