"""Replay of a recorded platform controller: its commands, compared bit for bit.

What a recording does not contain is counted as not judged, never as equal.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.control.journal import Chunk, ReplayedTick, read_chunk, replay, restore
from omniman_ros.control.platform import PlatformController
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.errors import InputError

JOURNAL = "controller_journal"  #: Topic of the controller's journal
COMMANDS, VOLTAGES = "wheel_commands", "wheel_voltages"
OUTPUTS = (COMMANDS, VOLTAGES)  #: Topics of the commands
#: Reasons why a recorded or a repeated command is not judged
NO_JOURNAL, NOT_RECORDED = "outside of the journal", "not in the recording"


@dataclass(frozen=True)
class Difference:
    """A value that is not repeated."""

    stamp: int  #: Stamp of the command [ns]
    topic: str
    name: str  #: Field of the message
    recorded: object
    replayed: object


@dataclass
class ReplayReport:
    """What a replay has found."""

    ticks: int = 0  #: Number of ticks that were repeated
    equal: Counter[str] = field(default_factory=Counter)  #: Number of equal commands, by topic
    different: Counter[str] = field(default_factory=Counter)
    not_judged: Counter[tuple[str, str]] = field(default_factory=Counter)  #: By topic and reason
    first: Difference | None = None  #: First difference
    gaps: int = 0  #: Number of places where parts of the journal are missing

    @property
    def judged(self) -> int:
        """Number of commands that were compared."""
        return self.equal.total() + self.different.total()


class Recorded:
    """The controller's part of a recording: its commands by stamp, and its journal."""

    def __init__(self, messages: Iterable[tuple[str, Any]]) -> None:
        self.commands: dict[int, tuple[str, Any]] = {}
        self.chunks: list[Chunk] = []
        for topic, message in messages:
            if topic == JOURNAL:
                self.chunks.append(read_chunk(bytes(message.data)))
            else:
                stamp = message.header.stamp
                self.commands[stamp.sec * 10**9 + stamp.nanosec] = topic, message


def compare(recorded: Recorded) -> ReplayReport:
    """Repeat a recorded controller, and compare its commands with the recorded ones.

    Raises:
        InputError: The journal is missing, or this version cannot read or repeat it.
    """
    if not recorded.chunks:
        raise InputError(f"there is no {JOURNAL} in the recording: nobody knows what was asked")
    report, unmatched = ReplayReport(), dict(recorded.commands)
    for tick, names in _ticks(recorded.chunks, report):
        report.ticks += 1
        _compare_tick(tick, names, unmatched, report)
    for topic, _ in unmatched.values():
        report.not_judged[topic, NO_JOURNAL] += 1
    return report


def _ticks(
    chunks: Iterable[Chunk], report: ReplayReport
) -> Iterator[tuple[ReplayedTick, tuple[str, ...]]]:
    """Yield the ticks of a journal as far as it is complete, each with the wheels' names."""
    core: PlatformController | None = None
    due: tuple[int, int] | None = None
    for chunk in chunks:
        if chunk.state:
            core = restore(chunk)
        elif core is None or (chunk.segment, chunk.number) != due:
            report.gaps += due is not None
            due = None
            continue
        due = chunk.segment, chunk.number + 1
        for tick in replay(core, chunk.entries):
            yield tick, core.parameters.robot.wheels.names


def _compare_tick(
    tick: ReplayedTick,
    names: tuple[str, ...],
    unmatched: dict[int, tuple[str, Any]],
    report: ReplayReport,
) -> None:
    command, stamp = tick.command, tick.stamp
    topic = VOLTAGES if command is not None and command.mode is DriveMode.VOLTAGE else COMMANDS
    if stamp is None and command is None:
        return
    if stamp is None:
        _differ(report, Difference(round(tick.now * 1e9), topic, "command", None, "a command"))
        return
    if stamp not in unmatched:
        report.not_judged[topic, NOT_RECORDED] += 1
        return
    recorded_topic, message = unmatched.pop(stamp)
    differences = _differences(stamp, recorded_topic, message, topic, command, names)
    first = next(differences, None)
    if first is None:
        report.equal[topic] += 1
    else:
        _differ(report, first)


def _differ(report: ReplayReport, difference: Difference) -> None:
    report.different[difference.topic] += 1
    report.first = report.first or difference


def _differences(
    stamp: int,
    recorded_topic: str,
    message: Any,
    topic: str,
    command: WheelCommand | None,
    names: tuple[str, ...],
) -> Iterator[Difference]:
    """Yield how a command differs from a recorded one; NaN and -0.0 count by their bits."""
    if command is None:
        yield Difference(stamp, recorded_topic, "command", "a command", None)
        return
    if topic != recorded_topic:
        yield Difference(stamp, recorded_topic, "topic", recorded_topic, topic)
        return
    if tuple(message.name) != names:
        yield Difference(stamp, topic, "name", tuple(message.name), names)
    velocity = () if command.velocity is None else command.velocity
    for label, values in (("velocity", velocity), ("effort", command.effort)):
        old, new = (np.asarray(array, float) for array in (getattr(message, label), values))
        if len(old) != len(new):
            yield Difference(stamp, topic, f"number of {label}", len(old), len(new))
            continue
        for name, before, after in zip(names, old, new, strict=True):
            if before.tobytes() != after.tobytes():
                yield Difference(stamp, topic, f"{label}[{name}]", float(before), float(after))
