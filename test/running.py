"""The command `omniman` as a process, in a ROS domain of the test's own."""

import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.processes.free_ports import find_free_ports
from omniman_ros.processes.ros_domain import free_domain

PATIENCE = 60.0  #: Time after which a test gives up waiting [s]
#: Options of a robot on a machine that may stand still for a moment, as virtual ones do
PATIENT = ("-p", "timeouts.wheel_states:=2.0")


def environment(domain: int | None = None) -> dict[str, str]:
    """Return this environment, isolated from other robots; without a domain, in a free one."""
    return os.environ | {
        "ROS_DOMAIN_ID": str(free_domain() if domain is None else domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONUNBUFFERED": "1",
    }


def command(*arguments: str) -> list[str]:
    """Return the command line of `omniman` with these arguments."""
    return [sys.executable, "-m", "omniman_ros.cli.main", *arguments]


def arm_on_free_ports() -> list[str]:
    """Return options of `omniman up` that give a simulated arm ports of the test's own.

    Two robots that are started at the same time would both find the ports of a UR controller free.
    """
    ports = dict(zip(UR_PORTS, find_free_ports(len(UR_PORTS)), strict=True))
    parameters = {f"ports.{name}": port for name, port in ports.items()}
    parameters["ur.dashboard_port"] = ports["dashboard"]
    parameters["ur.script_port"] = ports["secondary"]
    parameters["ur.rtde_port"] = ports["rtde"]
    return [word for item in parameters.items() for word in ("-p", "{}:={}".format(*item))]


class Running:
    """A process whose lines of output can be waited for; killed at the end of the `with` block."""

    def __init__(self, arguments: list[str], env: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            arguments,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines: list[str] = []
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._queue.put(line.rstrip("\n"))
        self._queue.put(None)

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def wait_for(self, text: str) -> str:
        """Wait for the next line that contains a text, and return it."""
        end = time.monotonic() + PATIENCE
        while True:
            line = self._queue.get(timeout=max(end - time.monotonic(), 0.01))
            assert line is not None, f"ended without '{text}':\n{self.output}"
            self.lines.append(line)
            if text in line:
                return line

    def skip_output(self) -> None:
        """Skip the lines so far, so that `wait_for` finds only later ones."""
        while not self._queue.empty():
            line = self._queue.get()
            assert line is not None, f"the process has ended:\n{self.output}"
            self.lines.append(line)

    def finish(self) -> int:
        """Wait for the end, read the rest of the output, and return the exit code."""
        code = self.process.wait(timeout=PATIENCE)
        while (line := self._queue.get(timeout=PATIENCE)) is not None:
            self.lines.append(line)
        return code

    @property
    def output(self) -> str:
        """The lines that were read so far."""
        return "\n".join(self.lines)


def children_of(pid: int) -> dict[int, str]:
    """Return the command lines of a process's children, by process id."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            line = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
        if int(parent) == pid:
            found[int(folder.name)] = line
    return found


def is_alive(pid: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Poll a condition for which there is no event to wait for."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"waited {PATIENCE} s for: {what}"
        time.sleep(0.01)
