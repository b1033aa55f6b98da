"""Groups of child processes that are started together and stopped in a fixed order.

Each process runs in a session of its own, so that the terminal's Ctrl-C reaches only the parent,
which passes it on stage by stage. Nothing is polled: exits and signals arrive in one queue.
"""

import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Self

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say

STOP_TIMEOUT = 20.0  #: Time after a process's signal at which it is killed if it has not ended [s]
#: Time for reading the rest of a process's output after its end [s].
#: A process that it has started itself may hold the pipe open for longer.
OUTPUT_TIMEOUT = 1.0


@dataclass(frozen=True)
class ProcessSpec:
    """A process to run."""

    name: str  #: Name of the process in messages
    command: Sequence[str]  #: Command line
    #: Order in which processes are stopped: stage 0 gets its signal first, and each later stage
    #: when all processes of the earlier ones have ended. They start in reverse order.
    stage: int = 0
    #: Whether the end of the process is an event of the group. The end of a process that is not
    #: essential is only reported.
    essential: bool = True


@dataclass(frozen=True)
class ProcessExit:
    """The end of a process in a group.

    A node that was asked to end and has come to rest, but whose middleware does not shut down, is
    ended by SIGALRM; nodes ignore that signal before they are at rest (see `nodes.runtime.run`).
    """

    name: str  #: Name of the process
    code: int  #: Exit code, or minus the number of the signal that killed the process
    asked: bool = False  #: Whether the group had asked the process to end

    @property
    def is_success(self) -> bool:
        """Whether the process ended by itself after it had done all that it was to do."""
        return self.code == 0 or self._was_at_rest or self.had_not_begun

    @property
    def _was_at_rest(self) -> bool:
        return self.asked and self.code == -signal.SIGALRM

    @property
    def had_not_begun(self) -> bool:
        """Whether the process was asked to end before it handled signals: nothing moves then."""
        return self.asked and self.code == -signal.SIGINT

    def __str__(self) -> str:
        if self._was_at_rest:
            return f"{self.name} came to rest, but its middleware did not shut down (SIGALRM)"
        if self.code >= 0:
            return f"{self.name} ended with exit code {self.code}"
        return f"{self.name} was killed by {signal.Signals(-self.code).name}"


@dataclass(frozen=True)
class ReceivedSignal:
    """A signal that the parent has received."""

    number: int  #: Number of the signal


class _Child:
    """A running process of a group."""

    def __init__(
        self,
        spec: ProcessSpec,
        environment: Mapping[str, str],
        events: "queue.SimpleQueue[ProcessExit | ReceivedSignal]",
        on_line: Callable[[str, str], None],
    ) -> None:
        self.spec = spec
        self.code: int | None = None
        self._asked = False
        self.process = subprocess.Popen(
            list(spec.command),
            env=dict(environment),
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            bufsize=1,
        )
        self._events = events
        self._on_line = on_line
        reader = threading.Thread(target=self._read_output, daemon=True)
        reader.start()
        threading.Thread(target=self._wait_for_end, args=(reader,), daemon=True).start()

    def _read_output(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._on_line(self.spec.name, line.rstrip("\n"))

    def _wait_for_end(self, reader: threading.Thread) -> None:
        code = self.process.wait()
        reader.join(timeout=OUTPUT_TIMEOUT)
        self._events.put(ProcessExit(self.spec.name, code, self._asked))

    def send(self, number: int) -> None:
        """Send the process a signal; SIGKILL also goes to every process that it has started."""
        if self.code is not None:
            return
        self._asked = True
        try:
            if number == signal.SIGKILL:
                os.killpg(self.process.pid, number)
            else:
                self.process.send_signal(number)
        except ProcessLookupError:
            pass


class ProcessGroup:
    """Runs child processes; as a context manager it starts them, and leaves none behind.

    Args:
        environment: Environment variables of the processes; those of this process if None.
        on_line: Called with name and line for each line of output, from threads.
        stop_timeout: Time after a process's signal at which it is killed if it has not ended [s].
    """

    def __init__(
        self,
        specs: Sequence[ProcessSpec],
        *,
        environment: Mapping[str, str] | None = None,
        on_line: Callable[[str, str], None] = lambda name, line: say(f"[{name}] {line}"),
        report: Callable[[str], None] = say,
        stop_timeout: float = STOP_TIMEOUT,
    ) -> None:
        self._specs = specs
        self._environment = {**(environment or os.environ), "PYTHONUNBUFFERED": "1"}
        self._on_line = on_line
        self._report = report
        self._stop_timeout = stop_timeout
        self._events: queue.SimpleQueue[ProcessExit | ReceivedSignal] = queue.SimpleQueue()
        self._children: dict[str, _Child] = {}

    def __enter__(self) -> Self:
        try:
            for spec in sorted(self._specs, key=lambda spec: -spec.stage):
                self._children[spec.name] = _Child(
                    spec, self._environment, self._events, self._on_line
                )
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.stop()
        finally:
            self._kill(list(self._children.values()))

    def pid(self, name: str) -> int:
        """Return the process id of a process."""
        return self._children[name].process.pid

    def interrupt(self, number: int) -> None:
        """Add a signal to the events of the group; safe to call from a signal handler."""
        self._events.put(ReceivedSignal(number))

    def next_event(self, timeout: float | None = None) -> ProcessExit | ReceivedSignal | None:
        """Wait for an essential process's end or a signal, up to `timeout` [s] or for ever."""
        while True:
            event = self._next_event(timeout)
            if not isinstance(event, ProcessExit) or self._children[event.name].spec.essential:
                return event
            self._report(f"{event}: continuing without it")

    def _next_event(self, timeout: float | None = None) -> ProcessExit | ReceivedSignal | None:
        """Wait for the end of any process, or for a signal, and note the exit code."""
        try:
            if timeout is not None and timeout <= 0.0:
                event = self._events.get_nowait()
            else:
                event = self._events.get(timeout=timeout)
        except queue.Empty:
            return None
        if isinstance(event, ProcessExit):
            self._children[event.name].code = event.code
        return event

    def check(self) -> None:
        """Raise CommandError if an essential process ended, KeyboardInterrupt after a signal."""
        event = self.next_event(0.0)
        if isinstance(event, ProcessExit):
            raise CommandError(str(event))
        if isinstance(event, ReceivedSignal):
            raise KeyboardInterrupt

    def stop(self, number: int = signal.SIGINT) -> bool:
        """Signal each stage once the previous one has ended; return whether all ended well.

        A signal that is received meanwhile kills the processes that still run.
        """
        all_succeeded = True
        for stage in sorted({child.spec.stage for child in self._children.values()}):
            members = self._running(stage)
            for child in members:
                child.send(number)
            all_succeeded &= self._wait_for(members)
        return all_succeeded

    def _running(self, stage: int | None = None) -> list[_Child]:
        """Return the processes that run, of one stage or of all."""
        return [
            child
            for child in self._children.values()
            if child.code is None and stage in (None, child.spec.stage)
        ]

    def _wait_for(self, members: list[_Child]) -> bool:
        """Wait for processes, kill them after the timeout; return whether all ended well."""
        all_succeeded = True
        deadline = time.monotonic() + self._stop_timeout
        while any(child.code is None for child in members):
            event = self._next_event(max(deadline - time.monotonic(), 0.0))
            if isinstance(event, ProcessExit):
                if event.code != 0 and not event.had_not_begun:
                    self._report(str(event))
                all_succeeded &= event.is_success
                continue
            running = [child.spec.name for child in members if child.code is None]
            if event is None:
                self._report(
                    f"killing {', '.join(running)}: still running {self._stop_timeout:g} s after "
                    "the signal"
                )
                self._kill(members)
            else:
                self._report("second signal: killing all nodes")
                self._kill(self._running())
            all_succeeded = False
        return all_succeeded

    def _kill(self, members: list[_Child]) -> None:
        for child in members:
            child.send(signal.SIGKILL)
        while any(child.code is None for child in members):
            self._next_event()


@contextmanager
def redirect_signals(
    receive: Callable[[int], None],
    numbers: Sequence[int] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
) -> Iterator[None]:
    """Pass signals to a function instead of to their handlers, in the main thread."""

    def handler(number: int, frame: FrameType | None) -> None:
        receive(number)

    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous_handler in previous.items():
            signal.signal(number, previous_handler)


def interrupt_on_signals() -> AbstractContextManager[None]:
    """Raise KeyboardInterrupt in the main thread on SIGINT, SIGTERM and SIGHUP alike.

    The main thread must run no callbacks of rclpy meanwhile, where an exception may get lost.
    """

    def interrupt(number: int) -> None:
        raise KeyboardInterrupt

    return redirect_signals(interrupt)
