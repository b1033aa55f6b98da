"""Common parts of all benchmarks: nodes that run during a measurement, and the final results.

A benchmark measures, judges its figures by its aims, prints a table and publishes its JSON. Its
exit code states whether it could measure, whatever the figures.
"""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say, table
from omniman_ros.lab.bench.measurement import cpu_shares
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec, redirect_signals

POLL_PERIOD = 0.05
"""Time for which callbacks are served between two checks of the processes [s]."""
Rows = list[tuple[str, ...]]
"""Rows of a table, of which the first is its head."""


class RunningNodes:
    """The nodes under measurement as processes, and a ROS session beside them.

    Attributes:
        session: The session.
        children: The processes.
    """

    def __init__(self, session: Session, children: ProcessGroup) -> None:
        self.session, self.children = session, children

    def pids(self, names: Sequence[str]) -> dict[str, int]:
        """Return the process ids of nodes, by name."""
        return {name: self.children.pid(name) for name in names}

    def wait(self, condition: Callable[[], bool], timeout: float, missing: str) -> None:
        """Serve callbacks until a condition holds.

        Args:
            condition: The condition.
            timeout: Longest time to wait [s].
            missing: What is missing if it does not hold, for the error.

        Raises:
            CommandError: The condition does not hold in time, or a process has ended.
        """

        def checked() -> bool:
            self.children.check()
            return condition()

        if not self.session.wait(checked, timeout):
            raise CommandError(f"{missing} within {timeout:g} s")

    def serve(self, seconds: float, feed: Callable[[float], None] | None = None) -> None:
        """Serve callbacks for a time.

        Args:
            seconds: The time [s].
            feed: Called every `POLL_PERIOD` with the time since the begin [s].

        Raises:
            CommandError: A process has ended.
        """
        start = time.monotonic()
        while (now := time.monotonic() - start) < seconds:
            self.children.check()
            if feed is not None:
                feed(now)
            self.session.spin(POLL_PERIOD)

    def cpu_shares(
        self,
        names: Sequence[str],
        seconds: float,
        feed: Callable[[float], None] | None = None,
    ) -> dict[str, float]:
        """Measure the share of one core that nodes use; see :meth:`serve`."""
        return cpu_shares(self.pids(names), lambda: self.serve(seconds, feed))


@contextlib.contextmanager
def running_nodes(tasks: Sequence[ProcessSpec]) -> Iterator[RunningNodes]:
    """Run processes and a ROS session; show the processes' last output if the measurement fails.

    Args:
        tasks: The processes.

    Raises:
        CommandError: A process has ended, or the measurement raised it.
    """
    log = NodeOutputLog()
    children = ProcessGroup(tasks, on_line=log)
    with redirect_signals(children.interrupt):
        try:
            with children, Session("omniman_bench") as session:
                yield RunningNodes(session, children)
        except CommandError:
            log.show()
            raise


def free_ports(count: int, kind: socket.SocketKind = socket.SOCK_STREAM) -> list[int]:
    """Return ports of this machine that nobody uses.

    Args:
        count: Number of ports.
        kind: SOCK_STREAM for TCP, SOCK_DGRAM for UDP.
    """
    host = "127.0.0.1" if kind == socket.SOCK_STREAM else ""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(type=kind)) for _ in range(count)]
        for item in sockets:
            item.bind((host, 0))
        return [item.getsockname()[1] for item in sockets]


def cpu_share_rows(share: Mapping[str, Any], at_rest: str) -> Rows:
    """Return rows of a table with the share of a core of each node.

    Args:
        share: Shares by node under `driving` and `idle`.
        at_rest: What the second share is called.
    """
    return [
        (
            f"share of a core, {name}",
            f"{100 * driving:.1f} %",
            f"{100 * share['idle'][name]:.1f} % {at_rest}",
        )
        for name, driving in share["driving"].items()
    ]


def tables(*each: Rows) -> list[str]:
    """Return the lines of a report: tables with a blank line around each."""
    lines = [""]
    for rows in each:
        lines += [*table(rows), ""]
    return lines


def conclude(
    name: str,
    result: dict[str, Any],
    report: Callable[[dict[str, Any]], list[str]],
    folder: str,
    aims: Callable[[dict[str, Any]], Mapping[str, bool | None]] | None = None,
) -> int:
    """Judge a result by the aims, print its report, and publish it as JSON.

    Args:
        name: Name of the benchmark.
        result: What was measured; `aims` is added where there are aims.
        report: Makes the lines of the report from the result.
        folder: Folder of the results.
        aims: Judges the result: which aims were met, None where too little was measured.

    Returns:
        0, the exit code of a benchmark that could measure.

    Raises:
        OSError: The folder cannot be written.
    """
    if aims is not None:
        result["aims"] = dict(aims(result))
    say("\n".join(report(result)))
    results.publish(f"bench_{name}", result, folder)
    return 0
