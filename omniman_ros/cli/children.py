"""Child processes that belong together: started, listened to, and stopped in order.

Each runs in a session of its own: the terminal's Ctrl-C reaches only the parent, which passes it
on stage by stage. Nothing here polls: exits and signals come through one queue.
"""

import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Self

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.terminal import say

PATIENCE = 20.0
"""How long a child may take to come to rest after its signal before it is killed [s]."""


@dataclass(frozen=True)
class Task:
    """What to run: a name for people, a command line, and when it is stopped.

    Stage 0 gets its signal first; a later stage when all of the earlier ones have ended. They
    start the other way round. The death of what is not essential is reported, and no event.
    """

    name: str
    command: Sequence[str]
    stage: int = 0
    essential: bool = True


@dataclass(frozen=True)
class Exit:
    """A child has ended; a negative code is the signal that killed it."""

    name: str
    code: int

    def __str__(self) -> str:
        """`NAME ended with exit code CODE`, or by which signal."""
        if self.code >= 0:
            return f"{self.name} ended with exit code {self.code}"
        return f"{self.name} was killed by {signal.Signals(-self.code).name}"


@dataclass(frozen=True)
class Interrupt:
    """A signal for the parent."""

    number: int


class _Child:
    def __init__(
        self, task: Task, environment: Mapping[str, str],
        events: "queue.SimpleQueue[Exit | Interrupt]", on_line: Callable[[str, str], None],
    ) -> None:  # fmt: skip
        self.task = task
        self.code: int | None = None
        self.process = subprocess.Popen(
            list(task.command), env=dict(environment), start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", bufsize=1,
        )  # fmt: skip
        self._events = events
        self._on_line = on_line
        reader = threading.Thread(target=self._read, daemon=True)
        reader.start()
        threading.Thread(target=self._wait, args=(reader,), daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._on_line(self.task.name, line.rstrip("\n"))

    def _wait(self, reader: threading.Thread) -> None:
        code = self.process.wait()
        reader.join(timeout=1.0)  # its last words; a grandchild may hold the pipe open
        self._events.put(Exit(self.task.name, code))

    def send(self, number: int) -> None:
        """Signal the process and, to kill, all that it has started."""
        if self.code is not None:
            return
        try:
            if number == signal.SIGKILL:
                os.killpg(self.process.pid, number)
            else:
                self.process.send_signal(number)
        except ProcessLookupError:
            pass


class Children:
    """A set of child processes; as a context manager it starts them and leaves none behind.

    Args:
        tasks: What to run.
        environment: Of the children; this process's if None.
        on_line: Called with name and line for each line of output, from threads.
        report: Called with a sentence about each thing that goes wrong.
        patience: How long a child may take to end after its signal [s].
    """

    def __init__(
        self, tasks: Sequence[Task], *, environment: Mapping[str, str] | None = None,
        on_line: Callable[[str, str], None] = lambda name, line: say(f"[{name}] {line}"),
        report: Callable[[str], None] = say, patience: float = PATIENCE,
    ) -> None:  # fmt: skip
        self._tasks = tasks
        self._environment = {**(environment or os.environ), "PYTHONUNBUFFERED": "1"}
        self._on_line = on_line
        self._report = report
        self._patience = patience
        self._events: queue.SimpleQueue[Exit | Interrupt] = queue.SimpleQueue()
        self._children: dict[str, _Child] = {}

    def __enter__(self) -> Self:
        try:
            for task in sorted(self._tasks, key=lambda task: -task.stage):
                self._children[task.name] = _Child(
                    task, self._environment, self._events, self._on_line
                )
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        try:
            self.stop()
        finally:
            self._kill(list(self._children.values()))

    def pid(self, name: str) -> int:
        """Process id of a child."""
        return self._children[name].process.pid

    def interrupt(self, number: int) -> None:
        """Pass a signal in; safe in a signal handler."""
        self._events.put(Interrupt(number))

    def next_event(self, timeout: float | None = None) -> Exit | Interrupt | None:
        """Wait for the exit of what is essential, or a signal; None if none comes in time [s]."""
        while True:
            event = self._next_event(timeout)
            if not isinstance(event, Exit) or self._children[event.name].task.essential:
                return event
            self._report(f"{event}: going on without it")

    def _next_event(self, timeout: float | None = None) -> Exit | Interrupt | None:
        try:
            if timeout is not None and timeout <= 0.0:
                event = self._events.get_nowait()
            else:
                event = self._events.get(timeout=timeout)
        except queue.Empty:
            return None
        if isinstance(event, Exit):
            self._children[event.name].code = event.code
        return event

    def check(self) -> None:
        """Look for an exit or a signal, without waiting.

        Raises:
            CommandError: A child has ended.
            KeyboardInterrupt: A signal came.
        """
        event = self.next_event(0.0)
        if isinstance(event, Exit):
            raise CommandError(str(event))
        if isinstance(event, Interrupt):
            raise KeyboardInterrupt

    def stop(self, number: int = signal.SIGINT) -> bool:
        """Signal the stages in order, each when the one before has ended, and wait for all.

        A signal that arrives meanwhile kills what is left.

        Returns:
            Whether every child that ran until now ended by itself, with exit code 0.
        """
        good = True
        for stage in sorted({child.task.stage for child in self._children.values()}):
            members = self._running(stage)
            for child in members:
                child.send(number)
            good &= self._await(members)
        return good

    def _running(self, stage: int | None = None) -> list[_Child]:
        return [
            child
            for child in self._children.values()
            if child.code is None and stage in (None, child.task.stage)
        ]

    def _await(self, members: list[_Child]) -> bool:
        good = True
        deadline = time.monotonic() + self._patience
        while any(child.code is None for child in members):
            event = self._next_event(max(deadline - time.monotonic(), 0.0))
            if isinstance(event, Exit):
                if event.code != 0:
                    self._report(str(event))
                    good = False
                continue
            late = [child.task.name for child in members if child.code is None]
            if event is None:
                self._report(f"killing {', '.join(late)}: no end {self._patience:g} s after the "
                             "signal")  # fmt: skip
                self._kill(members)
            else:
                self._report("second signal: killing all nodes")
                self._kill(self._running())
            good = False
        return good

    def _kill(self, members: list[_Child]) -> None:
        for child in members:
            child.send(signal.SIGKILL)
        while any(child.code is None for child in members):
            self._next_event()


@contextmanager
def signals_to(
    receive: Callable[[int], None],
    numbers: Sequence[int] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
) -> Iterator[None]:
    """Give signals to a function instead of what they do by default."""

    def handler(number: int, frame: FrameType | None) -> None:
        receive(number)

    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)
