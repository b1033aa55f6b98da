"""State of a running program that the controller's functions use."""

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from omniman_ros.simulation.ur.urscript.host import Host

PENDING = object()  #: Result of a poll: the wait is not over


@dataclass(frozen=True, slots=True)
class Wait:
    """Wait of a thread for a condition."""

    poll: Callable[[], object]  #: Returns the value of the call, or PENDING; once per cycle
    takes_time: bool = True  #: Whether the wait uses up the thread's time slice; a join does not


@dataclass
class Context:
    """State of a running program beyond its variables."""

    host: Host  #: The controller that the program queries and commands
    random: Random  #: Generator of the function `random`
    sockets: set[str] = field(default_factory=set)  #: Names of the sockets that the program opened
    #: Bytes, by socket, of a message that has not arrived in full; the next read uses them
    kept: dict[str, bytearray] = field(default_factory=dict)
    popups_closed: int = 0  #: Number of times that the person at the pendant closed the messages
