"""State that compiled code uses, and requests that it makes to the machine.

A compiled part of a program is either `plain`, a Python function of the frame, or `suspending`,
a generator function of the frame. A generator yields requests to the machine (call a function,
wait for a motion, start a thread) and receives the answer as the value of its `yield`. A thread
can thus stop in the middle of an expression and continue in a later cycle of the controller.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Generic, TypeAlias, TypeVar

from omniman_ros.simulation.ur.urscript.context import Context, Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.values import Value

T = TypeVar("T")  #: Type of the value of compiled code


@dataclass(frozen=True)
class Call:
    """Request to call a function of the program; answered by its value."""

    function: "Function"
    arguments: dict[str, Value]


@dataclass(frozen=True)
class Start:
    """Request to start a thread; answered by its handle."""

    function: "Function"


@dataclass(frozen=True)
class Kill:
    """Request to end a thread; it has no effect if the thread has ended."""

    handle: int


@dataclass(frozen=True)
class Join:
    """Request to wait until a thread has ended."""

    handle: int


@dataclass(frozen=True)
class Halt:
    """Request to end the program."""


#: Request of compiled code to the machine
Request: TypeAlias = Call | Start | Kill | Join | Halt | Wait
#: Generator that yields requests, receives their answers, and returns a value
Suspending: TypeAlias = Generator[Request, Any, T]


class LoopControl(Enum):
    """How a statement leaves the round of its loop."""

    BREAK = "break"
    CONTINUE = "continue"


@dataclass(frozen=True)
class Return:
    """How a statement leaves its function: with a value."""

    value: Value


#: Result of a statement; None if the next statement is to be executed
Outcome: TypeAlias = LoopControl | Return | None


@dataclass(slots=True)
class Thread:
    """A thread of a program."""

    handle: int  #: What `run` returned; 0 for the main thread
    #: Generators of the calls that are under way, the innermost last
    calls: list[Suspending[Value]] = field(default_factory=list)
    wait: Wait | None = None  #: What it waits for
    answer: Any = None  #: Answer to its last request
    line: int = 0  #: Line of the last request or error
    budget: int = 0  #: Statements and calls that it may still execute in this cycle


@dataclass(slots=True)
class StackFrame:
    """Variables of a call, and its surroundings."""

    variables: dict[str, Value]  #: The function's own variables
    globals: dict[str, Value]  #: Variables of the program
    thread: Thread  #: Thread that executes the call
    context: Context  #: What the functions of the controller work on

    def charge(self, line: int) -> None:
        """Count a statement or call; beyond the budget, this raises a ScriptRuntimeError."""
        thread = self.thread
        thread.budget -= 1
        if thread.budget < 0:
            thread.line = line
            raise ScriptRuntimeError("infinite loop")


@dataclass(frozen=True, slots=True)
class Code(Generic[T]):
    """A compiled part of a program, in one of its two forms."""

    #: Function of the frame, or None where the part may suspend its thread
    plain: Callable[[StackFrame], T] | None = None
    #: Generator function of the frame otherwise
    suspending: Callable[[StackFrame], Suspending[T]] | None = None

    def execute(self, frame: StackFrame) -> Suspending[T]:
        """Execute the part as a generator, whatever its form."""
        if self.plain is not None:
            return self.plain(frame)
        assert self.suspending is not None
        return (yield from self.suspending(frame))


Expression: TypeAlias = Code[Value]  #: Code of an expression
Statement: TypeAlias = Code[Outcome]  #: Code of a statement, or of several that follow each other


@dataclass
class Function:
    """A function, thread or program."""

    name: str
    is_thread: bool = False  #: Whether it is run rather than called
    parameters: tuple[str, ...] = ()  #: Names of its parameters, in order
    optional: frozenset[str] = frozenset()  #: Names of those that have a default
    #: Code of the defaults by name; evaluated in the frame of the call
    defaults: dict[str, Code[Value]] = field(default_factory=dict)
    #: Its statements
    body: Code[Outcome] = field(default_factory=lambda: Code(lambda frame: None))

    def execute(self, frame: StackFrame) -> Suspending[Value]:
        """Evaluate the defaults of what was not given, then run the body; return the value.

        The call itself is charged, too: calls can follow each other without end, or multiply, in
        defaults and expressions alone.

        Raises:
            ScriptRuntimeError: A part cannot be executed, or the budget is used up.
        """
        frame.charge(frame.thread.line)
        for name, default in self.defaults.items():
            if name not in frame.variables:
                frame.variables[name] = yield from default.execute(frame)
        outcome = yield from self.body.execute(frame)
        return outcome.value if isinstance(outcome, Return) else None
