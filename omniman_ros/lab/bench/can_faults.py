"""Faults of `omniman bench can`: how soon all drives get a stop command, and come to rest.

Bridge and simulated drives run as they do on a robot, each in a process of its own, with the
time-outs of the installations in config/can/. Faults are injected at a steady speed; the kernel
stamps the arrival of each frame.
"""

import random
import re
import signal
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import GREEN, RED, paint, say, table
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.lab.bench.can_rig import BusFrame, Kind, Rig
from omniman_ros.lab.bench.harness import Rows
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import redirect_signals

MARGIN = 2e-3
"""Time that a reaction may take in addition to the periods that it may wait for [s]."""
FIRMWARE = 1e-3
"""Period of the drives' own watchdogs [s]."""
MODE_TIMEOUT = 0.1
"""Longest time for which a drive may display another mode than the commanded one [s]."""
REST_TIME = 0.1
"""Time for which the platform must be at rest to count as resting [s]."""
RECORDED_BEFORE = 0.05
"""Time before a fault in which frames are recorded: it contains the last frame of a drive that
falls silent [s]."""
RUNS = 5
"""Number of runs of each fault."""
SLOW_RUNS = 2
"""Number of runs of a fault that takes seconds."""
ATTEMPTS = 4
"""Largest number of attempts at one run: a busy machine may stop the drives by itself."""
FOREIGN = (0x201, b"\x0f" + bytes(5) + b"\x07")
"""Frame (id, data) of a second host, which the bridge never sends: operation enabled, at a
standstill, to node 1."""


def reaction(
    frames: Sequence[BusFrame], after: float, nodes: Sequence[int], is_reaction: Kind
) -> float | None:
    """Find the time at which the last drive got the reaction to a fault.

    Args:
        frames: Frames on the bus.
        after: Time before which frames do not count [s].
        nodes: Node ids of the drives.
        is_reaction: Kind of frame that is the reaction; of each drive, the first one counts.

    Returns:
        The time [s]; None if a drive got none.
    """
    first: dict[int, float] = {}
    for frame in frames:
        if frame.at < after:
            continue
        for node in nodes:
            if node not in first and is_reaction(frame, node):
                first[node] = frame.at
    return max(first.values()) if len(first) == len(nodes) else None


def evidence(
    frames: Sequence[BusFrame],
    kind: Kind,
    nodes: Sequence[int],
    first: bool,
    span: tuple[float, float],
) -> float | None:
    """Find the time at which a fault became visible on the bus.

    Args:
        frames: Frames on the bus.
        kind: Kind of frame that shows the fault.
        nodes: Node ids of the faulty drives.
        first: Whether the first such frame shows it, instead of the last.
        span: Begin and end of the time in which frames count [s].

    Returns:
        The time [s]; None if there is no such frame.
    """
    times = [f.at for f in frames if span[0] <= f.at <= span[1] and any(kind(f, n) for n in nodes)]
    if not times:
        return None
    return times[0] if first else times[-1]


def rest(truth: Sequence[tuple[float, float]], after: float) -> float | None:
    """Find the time at which the platform came to rest and stayed at rest.

    Args:
        truth: Times [s] and speeds of the platform, as multiples of the threshold of rest.
        after: Time of the evidence [s].

    Returns:
        The time [s]; None if the platform has not been at rest for `REST_TIME` yet.
    """
    stood: float | None = None
    for at, speed in truth:
        if at >= after:
            stood = None if speed > 1.0 else at if stood is None else stood
    return stood if stood is not None and truth[-1][0] - stood >= REST_TIME else None


@dataclass(frozen=True)
class Fault:
    """A fault that is injected, and the reaction that must follow.

    Attributes:
        name: Name in the table.
        begin: Injects the fault into wheels; returns the time of the evidence where that is not
            on the bus [s].
        bound: Longest time from the evidence to the reaction [s].
        reason: Pattern of the reason that the bridge must give, `{}` being the wheel; empty: the
            bridge does not latch a stop.
        evidence: Kind of frame that shows the fault.
        first: Whether the first such frame shows it, instead of the last before a silence.
        all_wheels: Whether all wheels have the fault.
        reaction: Kind of frame that is the reaction: "stop", "change", or a kind of the protocol;
            where the protocol lacks that kind, only the time until rest is measured.
        end: Removes the fault.
        latches: Whether nothing may move afterwards until a reset.
        slow: Whether a run takes seconds, so that there are fewer runs.
    """

    name: str
    begin: Callable[[Rig, Sequence[str]], float | None]
    bound: Callable[[CanParameters], float]
    reason: str
    evidence: str = ""
    first: bool = True
    all_wheels: bool = False
    reaction: str = "stop"
    end: Callable[[Rig], object] = lambda rig: None
    latches: bool = True
    slow: bool = False


def _at_reception(p: CanParameters) -> float:
    return p.period + MARGIN


def _at_silence(p: CanParameters) -> float:
    return p.feedback_timeout + p.period + MARGIN


def _at_lost_heartbeat(p: CanParameters) -> float:
    return 3 * p.drive_heartbeat + 2 * p.period + MARGIN


def _at_other_mode(p: CanParameters) -> float:
    return MODE_TIMEOUT + 2 * p.period + MARGIN


def _at_stale_command(p: CanParameters) -> float:
    return p.command_timeout + p.period + MARGIN


def _at_watchdog(p: CanParameters) -> float:
    # An ODrive reports it in its next heartbeat.
    reported = p.drive_heartbeat if p.protocol == "odrive" else 0.0
    return p.heartbeat_timeout + reported + FIRMWARE + MARGIN


def _switched(
    name: str,
    flag: str,
    bound: Callable[[CanParameters], float],
    reason: str,
    evidence: str,
    **options: bool,
) -> Fault:
    """Make a fault that is a parameter of the simulated drives."""

    def begin(rig: Rig, wheels: Sequence[str]) -> None:
        rig.switch(flag, wheels)

    def end(rig: Rig) -> None:
        rig.switch(flag, ())

    return Fault(name, begin, bound, reason, evidence, end=end, **options)  # type: ignore[arg-type]


def _silenced(name: str, flag: str, **options: bool) -> Fault:
    """Make a fault after which drives report nothing any more."""
    reason = "no feedback" if "all_wheels" in options else "{}: no feedback"
    return _switched(name, flag, _at_silence, reason, "report", first=False, **options)


def _signalled(number: int) -> Callable[[Rig, Sequence[str]], None]:
    return lambda rig, wheels: rig.signal(number)


def _boot_up(rig: Rig, wheels: Sequence[str]) -> None:
    # A drive that really restarts is silent first.
    rig.recorder.send(0x700 + rig.nodes[0], b"\x00")


def _command_too(rig: Rig, wheels: Sequence[str]) -> None:
    rig.recorder.send(*FOREIGN)


def _end_commands(rig: Rig, wheels: Sequence[str]) -> float:
    rig.commanding = False
    return rig.published


EMERGENCY = Fault(
    "emergency_stop",
    lambda rig, wheels: rig.emergency(True),
    _at_reception,
    "emergency",
    end=lambda rig: rig.emergency(False),
)
STALE = Fault(
    "commands end", _end_commands, _at_stale_command, "", reaction="change", latches=False
)
STOPPED = Fault(
    "bridge SIGSTOP",
    _signalled(signal.SIGSTOP),
    _at_watchdog,
    "held up|EMCY|error|closed loop",
    "setpoint",
    first=False,
    reaction="watchdog",
    end=lambda rig: rig.signal(signal.SIGCONT),
)
KILLED = Fault(
    "bridge SIGKILL",
    _signalled(signal.SIGKILL),
    _at_watchdog,
    "",
    "setpoint",
    first=False,
    reaction="watchdog",
    end=lambda rig: rig.restart(),
    latches=False,
    slow=True,
)

FAULTS: dict[str, list[Fault]] = {
    "cia402": [
        _switched("drive fault (EMCY)", "fault", _at_reception, "{}: EMCY", "EMCY"),
        Fault(
            "boot-up, as of a drive",
            _boot_up,
            _at_reception,
            "boot-up",
            "boot-up",
            all_wheels=True,
        ),
        Fault(
            "supply gone (EMCY)",
            lambda rig, wheels: rig.switch("supply", 5.0),
            _at_reception,
            "EMCY",
            "EMCY",
            all_wheels=True,
            end=lambda rig: rig.switch("supply", 0.0),
        ),
        Fault("second host (RPDO)", _command_too, _at_reception, "another host", "foreign"),
        _switched(
            "other mode shown", "wrong_mode", _at_other_mode, "{}: .*shows mode", "other mode"
        ),
        _silenced("drive silent", "silent"),
        _silenced("drive starts anew", "reboot", slow=True),
        _silenced("all drives silent", "silent", all_wheels=True, slow=True),
        _silenced("drive deaf", "deaf"),
        _silenced("reports frozen, heartbeat alive", "frozen_reports"),
        _switched(
            "reports too short",
            "short_reports",
            _at_silence,
            "{}: no feedback",
            "whole report",
            first=False,
        ),
        _switched(
            "heartbeat lost",
            "no_heartbeat",
            _at_lost_heartbeat,
            "{}: .*heartbeat lost",
            "heartbeat",
            first=False,
        ),
        EMERGENCY,
        Fault("~/stop", lambda rig, wheels: rig.stop(), _at_reception, "~/stop"),
        STALE,
        STOPPED,
        KILLED,
    ],
    "vesc": [_silenced("drive silent", "silent"), EMERGENCY, STALE, STOPPED],
    "odrive": [
        _switched("drive fault (error)", "fault", _at_reception, "{}: axis error", "error"),
        _silenced("drive silent", "silent"),
        EMERGENCY,
        STALE,
        replace(STOPPED, slow=True),  # its drives let the wheels coast
    ],
}


@dataclass
class Record:
    """The measurements of one fault.

    Attributes:
        reactions: Times from the evidence to the reaction [s].
        rests: Times from the evidence until rest [s].
        repeated: Number of runs in which something else stopped the platform.
        moved: Number of runs in which the platform moved again before a reset.
    """

    reactions: list[float] = field(default_factory=list)
    rests: list[float] = field(default_factory=list)
    repeated: int = 0
    moved: int = 0

    def summary(self, fault: Fault, bound: float, reacts: bool) -> dict[str, Any]:
        """Return the figures of the fault; figures of times are left out where there are none.

        Args:
            fault: The fault.
            bound: Longest time from the evidence to the reaction [s].
            reacts: Whether the protocol shows the reaction.
        """
        figures: dict[str, Any] = {"fault": fault.name, "runs": len(self.rests)}
        if reacts and self.reactions:
            figures |= {
                "reaction_median_ms": 1e3 * statistics.median(self.reactions),
                "reaction_max_ms": 1e3 * max(self.reactions),
                "bound_ms": 1e3 * bound,
                "late": sum(reaction > bound for reaction in self.reactions),
            }
        if self.rests:
            figures["rest_median_ms"] = 1e3 * statistics.median(self.rests)
            figures["rest_max_ms"] = 1e3 * max(self.rests)
        return figures | {"repeated": self.repeated, "moved_before_reset": self.moved}


def measure(quick: bool, port: int) -> dict[str, list[dict[str, Any]]]:
    """Measure all faults of all protocols.

    Args:
        quick: Whether there is one run of each fault, no slow fault, and only one fault of each
            protocol but the first.
        port: UDP port of the bus.

    Returns:
        Figures of each fault by protocol; see `Record.summary`.
    """
    result: dict[str, Any] = {}
    for protocol, known in FAULTS.items():
        faults = [fault for fault in known if not (quick and fault.slow)]
        if quick and result:
            faults = faults[:1]
        say(f"{protocol}: {len(faults)} faults ...")
        log = NodeOutputLog()
        try:
            with Session("omniman_bench_can") as session:
                rig = Rig(session, protocol, port, log)
                with redirect_signals(rig.interrupt), rig:
                    result[protocol] = [inject(rig, fault, quick) for fault in faults]
        except CommandError:
            log.show()
            raise
    return result


def inject(rig: Rig, fault: Fault, quick: bool) -> dict[str, Any]:
    """Inject a fault several times, into one wheel after the other; return its figures."""
    record = Record()
    reacts = fault.reaction != "watchdog" or "watchdog" in rig.dialect.kinds
    bound = fault.bound(rig.parameters)
    for k in range(1 if quick else SLOW_RUNS if fault.slow else RUNS):
        wheel = k % len(rig.names)
        for _ in range(ATTEMPTS):
            rig.settle()
            if run_once(rig, fault, wheel, record, reacts):
                break
            record.repeated += 1
    return record.summary(fault, bound, reacts)


def run_once(rig: Rig, fault: Fault, wheel: int, record: Record, reacts: bool) -> bool:
    """Inject a fault once and record the reaction.

    Args:
        rig: Bridge and drives, driving at a steady speed.
        fault: The fault.
        wheel: Index of the wheel that has it, unless all have.
        record: Record that the reaction is added to.
        reacts: Whether the protocol shows the reaction.

    Returns:
        False if something else stopped the wheels; nothing is recorded then.
    """
    everything = range(len(rig.names)) if fault.all_wheels else (wheel,)
    rig.recorder.clear()
    rig.truth.clear()
    rig.session.spin(RECORDED_BEFORE + random.uniform(0.0, rig.parameters.period))  # any phase
    kinds = _kinds(rig)
    start = time.time()
    at = fault.begin(rig, [rig.names[i] for i in everything])
    rig.wait(lambda: rest(rig.truth, start) is not None, f"rest after '{fault.name}'")
    frames, end = list(rig.recorder.frames), time.time()
    reacted = None
    if reacts:
        reacted = reaction(frames, start if at is None else at, rig.nodes, kinds[fault.reaction])
    if at is None:
        span = (start - RECORDED_BEFORE, end if reacted is None else reacted)
        nodes = [rig.nodes[i] for i in everything]
        at = evidence(frames, kinds[fault.evidence], nodes, fault.first, span)
    at_rest = time.time()
    fault.end(rig)
    if fault.latches:
        rig.session.spin(REST_TIME)
        rig.wait(lambda: rig.state == DiagnosticStatus.ERROR, "the reason of the stop")
    stood = None if at is None else rest([(t, v) for t, v in rig.truth if t <= at_rest], at)
    if at is None or stood is None or not _is_reason(rig, fault, wheel):
        return False
    if reacts and (reacted is None or reacted < at):
        return False
    if reacted is not None:
        record.reactions.append(reacted - at)
    record.rests.append(stood - at)
    record.moved += fault.latches and any(v > 1.0 for t, v in rig.truth if t > at_rest)
    return True


def _kinds(rig: Rig) -> dict[str, Kind]:
    """Return the kinds of frames of the protocol, with those relative to the present setpoints."""
    dialect, stop, changed = rig.dialect, rig.dialect.stop, rig.changed_setpoint()

    def is_stop(frame: BusFrame, node: int) -> bool:
        return frame.id in dialect.setpoint(node) and frame.data[:2] == stop

    return {
        **dialect.kinds,
        "foreign": lambda frame, node: (frame.id, frame.data) == FOREIGN,
        "change": changed,
        "stop": changed if stop is None else is_stop,
    }


def _is_reason(rig: Rig, fault: Fault, wheel: int) -> bool:
    """Return whether the bridge gives the reason that a fault must have."""
    return not fault.reason or bool(re.search(fault.reason.format(rig.names[wheel]), rig.reason))


def aim(result: Mapping[str, Any]) -> bool:
    """Return whether all faults were measured, all reactions in time, and nothing moved again."""
    rows = [row for rows in result.values() for row in rows]
    return all(
        row["runs"] > 0 and row.get("late", 0) == 0 and row["moved_before_reset"] == 0
        for row in rows
    )


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the table."""
    rows: Rows = [
        ("fault, while driving", "reaction p50", "max", "bound", "rest p50", "max", "runs")
    ]
    for protocol, faults in result.items():
        rows += [(f"{protocol}: {row['fault']}", *_cells(row)) for row in faults]
    return [
        "",
        *table(rows),
        "  reaction: from the evidence to the last drive's stop frame; where the bridge is "
        "stopped or killed, to the last drive's own report",
        "",
    ]


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    repeated = f" (+{row['repeated']} stopped by something else)" if row["repeated"] else ""
    runs = f"{row['runs']}{repeated}"
    if row["moved_before_reset"]:
        runs = paint(f"{runs} MOVED AGAIN", RED, sys.stdout)
    reaction_cells, rest_cells = ("", "", ""), ("", "")
    if "bound_ms" in row:
        longest = f"{row['reaction_max_ms']:.1f} ms"
        reaction_cells = (
            f"{row['reaction_median_ms']:.1f} ms",
            paint(longest, RED if row["late"] else GREEN, sys.stdout),
            f"{row['bound_ms']:.0f} ms",
        )
    if row["runs"]:
        rest_cells = (f"{row['rest_median_ms']:.0f} ms", f"{row['rest_max_ms']:.0f} ms")
    return (*reaction_cells, *rest_cells, runs)
