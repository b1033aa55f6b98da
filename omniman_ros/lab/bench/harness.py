"""Common parts of all benchmarks: nodes and processes that run, the report and its aims.

A benchmark measures, prints tables of figures with their aims, and publishes its JSON. Its exit
code states whether the measurement succeeded, independent of the figures.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say, table
from omniman_ros.lab.measurement import cpu_fractions, spread_ms
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec, redirect_signals

POLL_PERIOD = 0.05  #: period at which the processes are checked while callbacks are served [s]
#: Parameters with long time-outs and wide tolerances: simulated hardware shares the CPU with the
#: nodes, and must not stop the robot when it is late.
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
#: Rows of a table as tuples of cells; the first row of a table is its header
Rows = list[tuple[str, ...]]


class Figure(NamedTuple):
    """A row of a report: a quantity, its values, and its aim if it has one."""

    about: str
    values: Sequence[str]
    aim: str = ""
    met: bool | None = None  #: whether the aim is met; None where nothing decides


def at_most(about: str, value: float | None, aim: float, text: str = "{:.3g}") -> Figure:
    """Return a figure whose aim is an upper bound; None was not measured."""
    shown = "-" if value is None else text.format(value)
    return Figure(
        about, (shown,), f"<= {text.format(aim)}", None if value is None else value <= aim
    )


def at_least(about: str, value: float | None, aim: float, text: str = "{:.3g}") -> Figure:
    """Return a figure whose aim is a lower bound; None was not measured."""
    shown = "-" if value is None else text.format(value)
    return Figure(
        about, (shown,), f">= {text.format(aim)}", None if value is None else value >= aim
    )


class BenchmarkTable(NamedTuple):
    """A table of a report, with the titles of the columns of values."""

    titles: Sequence[str]
    figures: Sequence[Figure]


class RunningNodes:
    """The measured nodes, each in a process of its own, and a ROS session in this process."""

    def __init__(self, session: Session, children: ProcessGroup) -> None:
        self.session, self.children = session, children

    def wait(self, condition: Callable[[], bool], timeout: float, missing: str) -> None:
        """Serve callbacks until a condition holds.

        Raises:
            CommandError: It does not hold within `timeout` [s], or a node has ended.
        """

        def checked() -> bool:
            self.children.check()
            return condition()

        if not self.session.wait(checked, timeout):
            raise CommandError(f"{missing} within {timeout:g} s")

    def received(self, kind: type[Any], topic: str, depth: int = 10) -> list[Any]:
        """Subscribe to a topic; return the list to which its messages will be added."""
        messages: list[Any] = []
        self.session.node.create_subscription(kind, topic, messages.append, depth)
        return messages

    def serve(self, seconds: float, feed: Callable[[float], None] | None = None) -> None:
        """Serve callbacks for a time, and call a function with the time since the begin [s]."""
        start = time.monotonic()
        while (now := time.monotonic() - start) < seconds:
            self.children.check()
            if feed is not None:
                feed(now)
            self.session.spin(POLL_PERIOD)

    def cpu_fractions(
        self,
        names: Sequence[str],
        seconds: float,
        feed: Callable[[float], None] | None = None,
    ) -> dict[str, float]:
        """Return the load of a core by each node while callbacks are served, by node."""
        pids = {name: self.children.pid(name) for name in names}
        return cpu_fractions(pids, lambda: self.serve(seconds, feed))


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


def cpu_share_figures(fraction: Mapping[str, Any], idle: str) -> list[Figure]:
    """Return a row for each node: the fraction of a core that it uses driving, and idle."""
    return [
        Figure(f"share of a core, {name}", (f"{driving:.1%}", f"{other:.1%} {idle}"))
        for (name, driving), other in zip(
            fraction["driving"].items(), fraction["idle"].values(), strict=True
        )
    ]


def cycle_figures(times: Sequence[Sequence[float]]) -> dict[str, float]:
    """Return the CPU time of the cycles of all drives, and the worst drive's percentile [ms]."""
    worst = max(spread_ms(drive)["p99_ms"] for drive in times)
    return {**spread_ms([taken for drive in times for taken in drive]), "worst_p99_ms": worst}


def spread_text(spread: Mapping[str, float], digits: int = 0) -> str:
    """Return the median, the 99th percentile and the maximum of `spread_ms` as text."""
    return (
        ", ".join(f"{spread[f'{key}_ms']:.{digits}f}" for key in ("median", "p99", "max")) + " ms"
    )


def tables(*each: Rows) -> list[str]:
    """Return the lines of a report that contains tables, with blank lines around each table."""
    lines = [""]
    for rows in each:
        lines += [*table(rows), ""]
    return lines


def aims(report: Sequence[BenchmarkTable]) -> dict[str, bool | None]:
    """Return whether the aims of a report are met, by quantity."""
    return {row.about: row.met for part in report for row in part.figures if row.aim}


def lines(report: Sequence[BenchmarkTable]) -> list[str]:
    """Return the lines of a report."""
    parts = []
    for titles, figures in report:
        rows: Rows = [("", *titles)]
        if any(figure.aim for figure in figures):
            rows[0] += ("aim", "")
        for about, values, aim, met in figures:
            filled = [*values, *[""] * (len(titles) - len(values))]
            rows.append((about, *filled, *((aim, verdict(met)) if aim else ())))
        parts.append(rows)
    return tables(*parts)


def conclude(
    name: str, result: dict[str, Any], report: Sequence[BenchmarkTable], folder: str
) -> int:
    """Print a report, and publish its result as JSON; return 0, the exit code."""
    result["aims"] = aims(report)
    say("\n".join(lines(report)))
    results.publish(f"bench_{name}", result, folder)
    return 0
