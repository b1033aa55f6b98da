"""Execution of a program, one cycle of the controller at a time."""

from collections.abc import Callable
from random import Random
from typing import Any

from omniman_ros.core.errors import OmnimanError
from omniman_ros.simulation.ur.urscript.compiler import Program
from omniman_ros.simulation.ur.urscript.context import PENDING, Context, Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.execution import (
    Call,
    Function,
    Halt,
    Join,
    Kill,
    Request,
    StackFrame,
    Start,
    Thread,
)
from omniman_ros.simulation.ur.urscript.host import Host
from omniman_ros.simulation.ur.urscript.values import Value

#: Largest number of statements and calls of a thread in a cycle; above it, its loop is endless.
#:
#: Drivers need some 120 in a cycle, and some 50 for each setpoint that they read late. The largest
#: number lasts some 30 ms, in which the controller reports nothing; hosts wait 80 ms for feedback.
MAX_STATEMENTS = 10_000
MAX_CALL_DEPTH = 200  #: Largest depth of calls within calls
MAX_THREADS = 64  #: Largest number of threads at once, and of those started in a cycle


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
        max_statements: int = MAX_STATEMENTS,
        seed: int = 0,
    ) -> None:
        self.end_reason = ""
        self.variables: dict[str, Value] = {}  #: Global variables
        self._context = Context(host, Random(seed))
        self._max_statements = max_statements
        self._takes_no_time = program.secondary
        self._threads: dict[int, Thread] = {}  # in the order in which they started
        self._last_handle = 0
        self._started = 0  # in this cycle
        self._main = Thread(0)
        self._threads[0] = self._main
        self._push(self._main, program.main, self.variables)

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
        for thread in self._threads.values():
            thread.budget = self._max_statements
        ready = list(self._threads.values())
        while ready and self.running:
            known_handles = set(self._threads)
            # Threads that gave up their time slice are out; a join may be over in a later round.
            again = [thread for thread in ready if not self._advance(thread)]
            started = [
                thread for thread in self._threads.values() if thread.handle not in known_handles
            ]
            if len(again) == len(ready) and not started:
                break
            ready = [thread for thread in again if thread.calls] + started

    def close_popups(self) -> None:
        """Close all messages, as the person at the pendant does; calls that wait then return."""
        self._context.popups_closed += 1

    def stop(self, reason: str) -> None:
        """End the program and its threads, and close its sockets, unless it has ended."""
        if not self.running:
            return
        self.end_reason = reason
        for thread in self._threads.values():
            thread.calls = []
        self._threads.clear()
        for name in sorted(self._context.sockets):
            self._context.host.socket_close(name)
        self._context.sockets.clear()

    def _push(self, thread: Thread, function: Function, variables: dict[str, Value]) -> None:
        frame = StackFrame(variables, self.variables, thread, self._context)
        thread.calls.append(function.execute(frame))

    def _advance(self, thread: Thread) -> bool:
        """Let a thread run, and return whether it gave up its time slice or ended."""
        if not thread.calls:
            return True
        try:
            if not self._has_waited(thread):
                return thread.wait is not None and thread.wait.takes_time
            self._execute(thread)
        except OmnimanError as error:
            self.stop(f"runtime error line {thread.line}: {error}")
            return True
        if not thread.calls:
            self._threads.pop(thread.handle, None)
            if thread is self._main:
                self.stop("completed")
            return True
        return thread.wait is None or thread.wait.takes_time

    def _has_waited(self, thread: Thread) -> bool:
        if thread.wait is not None:
            value = thread.wait.poll()
            if value is PENDING:
                return False
            thread.wait = None
            thread.answer = value
        return True

    def _execute(self, thread: Thread) -> None:
        """Execute a thread until it waits or ends."""
        while thread.calls and thread.wait is None:
            answer, thread.answer = thread.answer, None
            try:
                request = thread.calls[-1].send(answer)
            except StopIteration as end:
                if thread.calls:
                    thread.calls.pop()
                thread.answer = end.value
            else:
                self._serve(thread, request)

    def _serve(self, thread: Thread, request: Request) -> None:
        if isinstance(request, Wait):
            if self._takes_no_time and request.takes_time:
                raise ScriptRuntimeError("a secondary program cannot take time")
            thread.wait = request
        else:
            SERVED[type(request)](self, thread, request)

    def _call(self, thread: Thread, request: Call) -> None:
        if len(thread.calls) > MAX_CALL_DEPTH:
            name = request.function.name
            raise ScriptRuntimeError(
                f"calls are nested more than {MAX_CALL_DEPTH} deep at '{name}'"
            )
        self._push(thread, request.function, request.arguments)

    def _start(self, thread: Thread, request: Start) -> None:
        self._started += 1
        if max(len(self._threads), self._started) >= MAX_THREADS:
            raise ScriptRuntimeError(
                f"more than {MAX_THREADS} threads at once, or started in one cycle"
            )
        self._last_handle += 1
        started = Thread(self._last_handle, budget=self._max_statements)
        self._push(started, request.function, {})
        self._threads[started.handle] = started
        thread.answer = started.handle

    def _kill(self, thread: Thread, request: Kill) -> None:
        if self._is_alive(request.handle):
            self._threads.pop(request.handle).calls = []

    def _join(self, thread: Thread, request: Join) -> None:
        handle = request.handle
        if self._is_alive(handle):
            thread.wait = Wait(
                lambda: PENDING if self._is_alive(handle) else None, takes_time=False
            )

    def _halt(self, thread: Thread, request: Halt) -> None:
        self.stop("halt")

    def _is_alive(self, handle: int) -> bool:
        """Return whether there is a thread of that handle other than the main one, 0."""
        return handle in self._threads and handle != 0


SERVED: dict[type, Callable[[Machine, Thread, Any], None]] = {
    Call: Machine._call,
    Start: Machine._start,
    Kill: Machine._kill,
    Join: Machine._join,
    Halt: Machine._halt,
}
