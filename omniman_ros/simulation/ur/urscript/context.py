"""State of a running program that its code and the controller's functions use."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from random import Random

from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.host import Host
from omniman_ros.simulation.ur.urscript.values import Value, with_element

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


class Variables(dict[str, Value]):
    """A call's own variables; a name that is not among them is looked up in the global ones."""

    def __init__(self, own: Mapping[str, Value], shared: "Variables | None" = None) -> None:
        super().__init__(own)
        #: Global variables, which are the main thread's own
        self.shared = self if shared is None else shared

    def __missing__(self, name: str) -> Value:
        if name in self.shared:
            return self.shared[name]
        raise ScriptRuntimeError(f"name '{name}' is not defined")

    def of_call(self, arguments: Mapping[str, Value]) -> "Variables":
        """Return the variables with which a call of a function begins."""
        return Variables(arguments, self.shared)

    def assign(self, name: str, value: Value) -> None:
        """Assign to whichever variable is in scope (URScript manual, "Scoping rules").

        That is the function's own variable if there is one, else the global one if there is
        one, else a new one of the function's own.
        """
        own = name in self or name not in self.shared
        (self if own else self.shared)[name] = value

    def assign_element(self, name: str, index: Value, value: Value) -> None:
        """Replace one element of a list or pose, where the variable is."""
        self.assign(name, with_element(self[name], index, value))
