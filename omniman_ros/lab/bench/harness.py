"""Common parts of all benchmarks: nodes that run during a measurement, and the final report.

A benchmark measures, compares its figures with its aims, prints a table and publishes its JSON.
Its exit code states whether the measurement succeeded, independent of the figures.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say, table
from omniman_ros.lab.measurement import cpu_shares
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec, redirect_signals

POLL_PERIOD = 0.05  # period at which the processes are checked while callbacks are served [s]
LENIENT = (
    "timeouts.wheel_states:=2.0",
    "firmware.watchdog:=2.0",
    "safety.deadline:=0.05",
    "odom_timeout:=1.0",
    "odom_pause:=1.0",
    "joint_trajectory.states_timeout:=1.0",
    "joint_trajectory.following_error:=1.0",
    "scaling_timeout:=2.0",
    "ur.feedback_timeout:=1.0",
    "ur.following_error:=1.0",
    "ur.read_timeout:=0.2",
    "drive.dead_wheel:=drive_on",
)
"""Parameters with long time-outs and wide tolerances: simulated hardware shares the CPU with the
nodes, and must not stop the robot when it is late."""
Rows = list[tuple[str, ...]]
"""Rows of a table as tuples of cells; the first row of a table is its header."""


class RunningNodes:
    """The measured nodes, each in a process of its own, and a ROS session in this process."""

    def __init__(self, session: Session, children: ProcessGroup) -> None:
        self.session, self.children = session, children

    def pids(self, names: Sequence[str]) -> dict[str, int]:
        """Return the process ids of the named nodes, by name."""
        return {name: self.children.pid(name) for name in names}

    def wait(self, condition: Callable[[], bool], timeout: float, missing: str) -> None:
        """Serve callbacks until a condition holds."""

        def checked() -> bool:
            self.children.check()
            return condition()

        if not self.session.wait(checked, timeout):
            raise CommandError(f"{missing} within {timeout:g} s")

    def serve(self, seconds: float, feed: Callable[[float], None] | None = None) -> None:
        """Serve callbacks for a given time."""
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
        """Measure the share of one core that each node uses while callbacks are served.

        Returns:
            CPU time over elapsed time, by node.
        """
        return cpu_shares(self.pids(names), lambda: self.serve(seconds, feed))


@contextlib.contextmanager
def running_nodes(tasks: Sequence[ProcessSpec]) -> Iterator[RunningNodes]:
    """Run nodes and a ROS session as a context; print the nodes' last output on failure."""
    log = NodeOutputLog()
    children = ProcessGroup(tasks, on_line=log)
    with redirect_signals(children.interrupt):
        try:
            with children, Session("omniman_bench") as session:
                yield RunningNodes(session, children)
        except CommandError:
            log.show()
            raise


def cpu_share_rows(share: Mapping[str, Any], idle_label: str) -> Rows:
    """Return one table row per node, with the share of a core that it uses."""
    return [
        (
            f"share of a core, {name}",
            f"{100 * driving:.1f} %",
            f"{100 * share['idle'][name]:.1f} % {idle_label}",
        )
        for name, driving in share["driving"].items()
    ]


def tables(*each: Rows) -> list[str]:
    """Return the lines of a report that contains tables, with blank lines around each table."""
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
    """Compare a result with its aims, print its report, and publish it as JSON.

    Returns:
        0, the exit code of a benchmark whose measurement succeeded.
    """
    if aims is not None:
        result["aims"] = dict(aims(result))
    say("\n".join(report(result)))
    results.publish(f"bench_{name}", result, folder)
    return 0
