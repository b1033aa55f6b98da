"""Execution of a program, one cycle of the controller at a time."""

from collections.abc import Callable
from random import Random

from omniman_ros.core.errors import OmnimanError
from omniman_ros.simulation.ur.urscript.compiler import Program, Run, line_of_error
from omniman_ros.simulation.ur.urscript.context import PENDING, Context, Variables, Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.host import Host
from omniman_ros.simulation.ur.urscript.values import Value, size, to_str

#: Largest work of a thread in a cycle; above it, its loop is endless.
#:
#: It is the number of statements, of calls, of the nodes of their expressions, and of the scalars
#: that operators make in lists; a function of the controller counts as CALL_WORK. Drivers need
#: some 500 in a cycle, and some 320 for each setpoint that they read late. The largest work
#: lasts some 15 ms where numbers are added, and up to 100 ms where lists and texts are handled;
#: meanwhile the controller reports nothing, and hosts wait 80 ms for feedback.
MAX_WORK = 70_000
MAX_CALL_DEPTH = 200  #: Largest depth of calls within calls
MAX_THREADS = 64  #: Largest number of threads at once, and of those started in a cycle

ENDED = Wait(lambda: PENDING, takes_time=False)  #: Wait of a thread that has ended itself


class Thread:
    """A thread of a program, as its translated code sees it."""

    def __init__(self, machine: "Machine", handle: int, function: Callable[..., Run]) -> None:
        self.handle = handle  #: What `run` returned; 0 for the main thread
        self.context = machine.context  #: What the functions of the controller work on
        self.budget = machine.max_work  #: What it may still execute in this cycle
        self.wait = Wait(lambda: None)  #: What it waits for; at first, for its turn
        own = Variables({}, machine.variables) if handle else machine.variables
        self.run = function(self, own, 1)  #: Its execution
        self._machine = machine

    def charge(self, work: int) -> None:
        """Count work; beyond the budget, this raises a ScriptRuntimeError."""
        self.budget -= work
        if self.budget < 0:
            raise ScriptRuntimeError("infinite loop")

    def charge_list(self, values: tuple[Value, ...]) -> None:
        """Count the work of an operator that has made a list."""
        self.charge(size(values))

    def enter(self, depth: int, name: str) -> int:
        """Count a call of a function at a depth, and return the depth in the function.

        Calls are counted, too, since they can follow each other without end, or multiply, in
        defaults and expressions alone.
        """
        if depth > MAX_CALL_DEPTH:
            raise ScriptRuntimeError(
                f"calls are nested more than {MAX_CALL_DEPTH} deep at '{name}'"
            )
        self.charge(1)
        return depth + 1

    def start(self, function: Callable[..., Run]) -> int:
        """Start a thread, and return its handle."""
        return self._machine.start(function)

    def kill(self, handle: Value) -> Wait | None:
        """End a thread; this has no effect if it has ended."""
        threads = self._machine.threads
        threads.pop(_other(handle), None)
        return None if self.handle in threads else ENDED

    def join(self, handle: Value) -> Wait:
        """Wait until a thread has ended."""
        threads, other = self._machine.threads, _other(handle)
        return Wait(lambda: PENDING if other in threads else None, takes_time=False)

    def halt(self) -> Wait:
        """End the program."""
        self._machine.stop("halt")
        return ENDED


class Machine:
    """A program that is being executed.

    Attributes:
        end_reason: Why it ended: "completed", "halt", "runtime error line n: ...", or the reason
            given to `stop`; "" while it runs.
    """

    def __init__(
        self,
        program: Program,
        host: Host,
        max_work: int = MAX_WORK,
        seed: int = 0,
    ) -> None:
        self.end_reason = ""
        self.variables = Variables({})  #: Global variables
        self.context = Context(host, Random(seed))  #: What the controller's functions work on
        self.max_work = max_work  #: Budget of each thread in a cycle
        self.is_secondary = program.secondary  #: Whether it takes no time
        self._last_handle = 0
        self._started = 0  # in this cycle
        self._main = Thread(self, 0, program.main)
        #: Threads by handle, in the order in which they started
        self.threads: dict[int, Thread] = {0: self._main}

    @property
    def running(self) -> bool:
        """Whether the program has not ended."""
        return not self.end_reason

    def step(self) -> None:
        """Execute one cycle: each thread until it gives up its time slice, the main one first.

        Threads that are started run in the same cycle; those that wait for the end of another
        continue in the cycle in which the other one ends.
        """
        self._started = 0
        for thread in self.threads.values():
            thread.budget = self.max_work
        ready = list(self.threads.values())
        while ready and self.running:
            known_handles = set(self.threads)
            # Threads that gave up their time slice are out; a join may be over in a later round.
            again = [thread for thread in ready if not self._advance(thread)]
            started = [
                thread for thread in self.threads.values() if thread.handle not in known_handles
            ]
            if len(again) == len(ready) and not started:
                break
            ready = again + started

    def close_popups(self) -> None:
        """Close all messages, as the person at the pendant does; calls that wait then return."""
        self.context.popups_closed += 1

    def stop(self, reason: str) -> None:
        """End the program and its threads, and close its sockets, unless it has ended."""
        if not self.running:
            return
        self.end_reason = reason
        self.threads.clear()
        for name in sorted(self.context.sockets):
            self.context.host.socket_close(name)
        self.context.sockets.clear()

    def start(self, function: Callable[..., Run]) -> int:
        """Start a thread, and return its handle; too many raise a ScriptRuntimeError."""
        self._started += 1
        if max(len(self.threads), self._started) >= MAX_THREADS:
            raise ScriptRuntimeError(
                f"more than {MAX_THREADS} threads at once, or started in one cycle"
            )
        self._last_handle += 1
        self.threads[self._last_handle] = Thread(self, self._last_handle, function)
        return self._last_handle

    def _advance(self, thread: Thread) -> bool:
        """Let a thread run, and return whether it gave up its time slice or ended."""
        if thread.handle not in self.threads:
            return True
        try:
            answer = thread.wait.poll()
            while answer is not PENDING:
                thread.wait = thread.run.send(answer)
                if self.is_secondary and thread.wait.takes_time:
                    raise ScriptRuntimeError("a secondary program cannot take time")
                answer = PENDING if thread.wait.takes_time else thread.wait.poll()
        except StopIteration:
            self.threads.pop(thread.handle, None)
            if thread is self._main:
                self.stop("completed")
            return True
        except (OmnimanError, ArithmeticError, ValueError, TypeError) as error:
            self.stop(f"runtime error line {line_of_error(error, thread.run)}: {error}")
            return True
        return thread.handle not in self.threads or thread.wait.takes_time


def _other(handle: Value) -> int:
    """Return the handle of a thread other than the main one, or 0 as -1.

    Raises:
        ScriptRuntimeError: The value is no handle; those of no thread, as 0, are handles too.
    """
    if type(handle) is not int:
        raise ScriptRuntimeError(f"{to_str(handle)} is no thread")
    return handle or -1
