"""The processes of the running robot, each of which can be killed and started again by itself."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from omniman_ros.console.errors import CommandError
from omniman_ros.lab.faults.injections import ARM, DRIVES, STREAMER, STREAMING_PROCESS
from omniman_ros.lab.priority import set_niceness
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec

#: Processes that simulate hardware, which on a real robot has processors of its own
HARDWARE = (DRIVES, ARM)
HARDWARE_NICENESS, NICENESS = -15, -10
"""Niceness of these and of the other processes, where the system permits it."""


class RobotProcesses:
    """Processes that run while this is entered as a context."""

    def __init__(
        self,
        specs: Iterable[ProcessSpec],
        on_start: Callable[[str], None],
        on_line: Callable[[str, str], None],
    ) -> None:
        self._specs = {spec.name: spec for spec in specs}
        self._on_start, self._on_line = on_start, on_line
        self._groups: dict[str, ProcessGroup] = {}

    def __enter__(self) -> Self:
        try:
            for spec in sorted(self._specs.values(), key=lambda spec: -spec.stage):
                self.start(spec.name)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def _end(self) -> None:
        for name in list(self._groups):
            self.kill(name)

    @property
    def names(self) -> list[str]:
        """Names of the processes."""
        return list(self._specs)

    @property
    def ended(self) -> list[str]:
        """Names of the processes that do not run."""
        return [name for name in self._specs if not self.is_alive(name)]

    def start(self, name: str, copy: str = "") -> None:
        """Start a process."""
        spec = self._specs[name]
        label = copy or name
        group = ProcessGroup(
            [ProcessSpec(label, spec.command, essential=False)],
            on_line=self._on_line,
            report=lambda text: None,
        )
        self._groups[label] = group.__enter__()
        if not copy:
            self._on_start(name)
        niceness = HARDWARE_NICENESS if name in HARDWARE else NICENESS
        set_niceness(group.pid(label), niceness)

    def pid(self, name: str) -> int:
        """Return the process id of a process, which may be the streamer's streaming process."""
        if name != STREAMING_PROCESS:
            return self._groups[name].pid(name)
        for child in children(self._groups[STREAMER].pid(STREAMER)):
            return child
        raise CommandError("arm_streamer has no streaming process")

    def signal(self, name: str, number: int) -> None:
        """Send a process a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid(name), number)

    def kill(self, name: str) -> None:
        """Kill a process, with those that it has started, and forget it."""
        group = self._groups.pop(name, None)
        if group is None:
            return
        with contextlib.suppress(ProcessLookupError):
            descendants = list(children(group.pid(name)))
            for pid in (group.pid(name), *descendants):
                os.kill(pid, signal.SIGKILL)
        group.__exit__(None, None, None)

    def is_alive(self, name: str) -> bool:
        """Return whether a process runs."""
        group = self._groups.get(name)
        if group is None:
            return False
        with contextlib.suppress(CommandError):
            group.check()
        stat = Path(f"/proc/{group.pid(name)}/stat")
        with contextlib.suppress(OSError):
            return stat.read_text().rpartition(")")[2].split()[0] != "Z"
        return False

    def restart(self) -> None:
        """Kill all processes, and start them anew."""
        self._end()
        self.__enter__()

    def argument(self, name: str, beginning: str) -> str:
        """Return what follows a beginning in the one argument of a process that has it."""
        found = next(text for text in self._specs[name].command if text.startswith(beginning))
        return found.removeprefix(beginning)


def children(pid: int) -> Iterator[int]:
    """Yield the process ids of the children of a process."""
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            yield from map(int, path.read_text().split())
