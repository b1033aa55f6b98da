"""Instructions of the stack machine that programs are compiled to.

Each takes its thread and one argument, and returns true if the thread cannot go on now: it waits,
it has ended, or the program has. A thread keeps its frames itself, not on Python's stack, so that
it can stop in the middle of an expression and go on in a later cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from omniman_ros.simulated_ur.urscript.errors import Fault
from omniman_ros.simulated_ur.urscript.values import (
    Operator,
    Value,
    element,
    make_list,
    make_pose,
    negative,
    to_str,
    truth,
    with_element,
)

if TYPE_CHECKING:
    from omniman_ros.simulated_ur.urscript.machine import Machine

DEEPEST = 200  # calls within calls

PENDING = object()


class Wait:
    """What a thread waits for.

    Attributes:
        poll: Gives the value of the call that waits, or PENDING; asked once a cycle.
        takes_time: Whether the wait uses up the thread's time slice; a join does not.
    """

    __slots__ = ("poll", "takes_time")

    def __init__(self, poll: Callable[[], object], takes_time: bool = True) -> None:
        self.poll = poll
        self.takes_time = takes_time


class Function:
    """A function, thread or program.

    Attributes:
        name: Its name.
        parameters: Names, in order.
        defaults: Those that have a default, set by the first instructions of the code.
        is_thread: Whether it is run rather than called.
        code: Its instructions.
        lines: The line of each.
    """

    def __init__(self, name: str, is_thread: bool = False) -> None:
        self.name = name
        self.parameters: list[str] = []
        self.defaults: set[str] = set()
        self.is_thread = is_thread
        self.code: list[Instruction] = []
        self.lines: list[int] = []


class Frame:
    """A call that is under way."""

    __slots__ = ("function", "code", "next", "variables")

    def __init__(self, function: Function, variables: dict[str, Value]) -> None:
        self.function = function
        self.code = function.code
        self.next = 0
        self.variables = variables


class Thread:
    """A thread of a program.

    Attributes:
        machine: What runs it.
        handle: What `run` returned; the main thread has 0.
        frame: The call that is executed; None once the thread has ended.
        frames: Those that wait for it.
        stack: Operands.
        wait: What it waits for.
        left: Instructions that it may still execute in this cycle.
    """

    __slots__ = ("machine", "handle", "frame", "frames", "stack", "wait", "left")

    def __init__(self, machine: Machine, handle: int, frame: Frame) -> None:
        self.machine = machine
        self.handle = handle
        self.frame: Frame | None = frame
        self.frames: list[Frame] = []
        self.stack: list[Any] = []
        self.wait: Wait | None = None
        self.left = 0

    @property
    def line(self) -> int:
        """The line that it executes, or executed last."""
        frame = self.frame
        return frame.function.lines[max(frame.next - 1, 0)] if frame else 0


Operation: TypeAlias = Callable[[Any, Any], bool | None]
Instruction: TypeAlias = tuple[Operation, Any]


def constant(thread: Thread, value: Value) -> None:
    """Push a value."""
    thread.stack.append(value)


def drop(thread: Thread, _: None) -> None:
    """Drop the value of a call that is a statement."""
    thread.stack.pop()


def load(thread: Thread, name: str) -> None:
    """Push a variable: the function's own first, then the global one."""
    variables = thread.frame.variables  # type: ignore[union-attr]
    if name not in variables:
        variables = thread.machine.variables
        if name not in variables:
            raise Fault(f"name '{name}' is not defined")
    thread.stack.append(variables[name])


def scope(thread: Thread, name: str) -> dict[str, Value]:
    """Where an assignment without `local` or `global` goes.

    To the function's own variable if there is one, else to the global one if there is one, else
    to a new one of the function's own (URScript manual, "Scoping rules").
    """
    own = thread.frame.variables  # type: ignore[union-attr]
    if name not in own and name in thread.machine.variables:
        return thread.machine.variables
    return own


def store(thread: Thread, name: str) -> None:
    """Assign to whichever variable is in scope."""
    scope(thread, name)[name] = thread.stack.pop()


def store_local(thread: Thread, name: str) -> None:
    """Assign to the function's own variable."""
    thread.frame.variables[name] = thread.stack.pop()  # type: ignore[union-attr]


def store_global(thread: Thread, name: str) -> None:
    """Assign to the global variable."""
    thread.machine.variables[name] = thread.stack.pop()


def store_element(thread: Thread, name: str) -> None:
    """Assign to an element: its index and the value are on the stack."""
    value, index = thread.stack.pop(), thread.stack.pop()
    variables = scope(thread, name)
    if name not in variables:
        raise Fault(f"name '{name}' is not defined")
    variables[name] = with_element(variables[name], index, value)


def binary(thread: Thread, function: Operator) -> None:
    """Two operands to one result."""
    stack = thread.stack
    right = stack.pop()
    stack[-1] = function(stack[-1], right)


def negate(thread: Thread, _: None) -> None:
    """Unary minus."""
    thread.stack[-1] = negative(thread.stack[-1])


def invert(thread: Thread, _: None) -> None:
    """Logical not."""
    thread.stack[-1] = not truth(thread.stack[-1])


def to_bool(thread: Thread, _: None) -> None:
    """The right operand of `and` and `or`, which is their result."""
    thread.stack[-1] = truth(thread.stack[-1])


def index(thread: Thread, _: None) -> None:
    """A list and an index to an element."""
    where = thread.stack.pop()
    thread.stack[-1] = element(thread.stack[-1], where)


def take(thread: Thread, count: int) -> tuple[Any, ...]:
    """Pop operands, in the order in which they were pushed."""
    if count == 0:
        return ()
    values = tuple(thread.stack[-count:])
    del thread.stack[-count:]
    return values


def build_list(thread: Thread, count: int) -> None:
    """Elements to a list."""
    thread.stack.append(make_list(take(thread, count)))


def build_pose(thread: Thread, count: int) -> None:
    """Elements to a pose."""
    thread.stack.append(make_pose(take(thread, count)))


def jump(thread: Thread, target: int) -> None:
    """Go on elsewhere."""
    thread.frame.next = target  # type: ignore[union-attr]


def jump_unless(thread: Thread, target: int) -> None:
    """Go on elsewhere if the condition on the stack is false."""
    value = thread.stack.pop()
    if value is True:
        return
    if not truth(value):
        thread.frame.next = target  # type: ignore[union-attr]


def skip_and(thread: Thread, target: int) -> None:
    """Left operand of `and`: the result if it is false, else dropped."""
    if truth(thread.stack[-1]):
        thread.stack.pop()
    else:
        thread.stack[-1] = False
        thread.frame.next = target  # type: ignore[union-attr]


def skip_or(thread: Thread, target: int) -> None:
    """Left operand of `or`: the result if it is true, else dropped."""
    if truth(thread.stack[-1]):
        thread.stack[-1] = True
        thread.frame.next = target  # type: ignore[union-attr]
    else:
        thread.stack.pop()


def jump_given(thread: Thread, name_target: tuple[str, int]) -> None:
    """Step over the default of a parameter that was given."""
    name, target = name_target
    if name in thread.frame.variables:  # type: ignore[union-attr]
        thread.frame.next = target  # type: ignore[union-attr]


def call(thread: Thread, function_names: tuple[Function, tuple[str, ...]]) -> None:
    """Call a function of the program; its arguments are on the stack, by these names."""
    function, names = function_names
    if len(thread.frames) >= DEEPEST:
        raise Fault(f"calls are nested more than {DEEPEST} deep at '{function.name}'")
    thread.frames.append(thread.frame)  # type: ignore[arg-type]
    variables = dict(zip(names, take(thread, len(names)), strict=True))
    thread.frame = Frame(function, variables)


def give_back(thread: Thread, _: None) -> bool:
    """Return from a call, its value on the stack; at the outermost one the thread ends."""
    if thread.frames:
        thread.frame = thread.frames.pop()
        return False
    thread.frame = None
    return True


def builtin(
    thread: Thread, how: tuple[Callable[..., object], int, tuple[str, ...]]
) -> bool | None:
    """Call a function of the controller: positional arguments first, then those by name."""
    function, positional, names = how
    values = take(thread, positional + len(names))
    if names:
        named = dict(zip(names, values[positional:], strict=True))
        result = function(thread, *values[:positional], **named)
    else:
        result = function(thread, *values)
    if isinstance(result, Wait):
        thread.wait = result
        return True
    thread.stack.append(result)
    return None


def fail(_: Thread, message: str) -> None:
    """A call that can only go wrong."""
    raise Fault(message)


def run(thread: Thread, function: Function) -> None:
    """Start a thread; its handle is the value."""
    thread.stack.append(thread.machine.start(function))


def handle_of(value: Value) -> int:
    """A thread's handle; those of no thread, as 0, are handles too."""
    if type(value) is not int:
        raise Fault(f"{to_str(value)} is no thread")
    return value


def kill(thread: Thread, _: None) -> bool:
    """End a thread; nothing if it has ended."""
    thread.machine.kill(handle_of(thread.stack.pop()))
    return thread.frame is None


def join(thread: Thread, _: None) -> bool:
    """Wait until a thread has ended; this leaves a value, as calls do."""
    handle = handle_of(thread.stack.pop())
    machine = thread.machine
    if not machine.is_alive(handle):
        thread.stack.append(None)
        return False
    thread.wait = Wait(lambda: PENDING if machine.is_alive(handle) else None, takes_time=False)
    return True


def halt(thread: Thread, _: None) -> bool:
    """End the program."""
    thread.machine.stop("halt")
    return True
