"""Faults of `omniman bench can`: how soon all drives are told to stop, and stand.

Bridge and simulated drives run as they do on a robot, each in its process, with the time-outs of
the installations in config/can/. Faults are switched on at a steady speed; the kernel says when
each frame came.
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

from omniman_ros.cli.bench_can_rig import Heard, Kind, Rig
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.session import Session
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.core.can_parameters import CanParameters

MARGIN = 2e-3
"""What a reaction may take besides the periods it may wait for [s]."""
FIRMWARE = 1e-3
"""Period of the drives' own watchdogs [s]."""
MODE_PATIENCE = 0.1
"""How long a drive may show another mode than it was told [s]."""
HOLD = 0.1
"""How long the platform must be at rest to count [s]."""
BEFORE = 0.05
"""How long frames are recorded before a fault: what falls silent has said its last then [s]."""
RUNS, SLOW_RUNS = 5, 2
ATTEMPTS = 4
"""Of one run: a machine that is busy may stop the drives by itself."""
FOREIGN = (0x201, b"\x0f" + bytes(5) + b"\x07")
"""A frame of a second host: operation enabled, at a standstill, to node 1; it is not our own."""


def reaction(
    frames: Sequence[Heard], after: float, nodes: Sequence[int], is_told: Kind
) -> float | None:
    """When the last drive was told: of each the first frame of a kind since a time; or None."""
    first: dict[int, float] = {}
    for frame in frames:
        if frame.at < after:
            continue
        for node in nodes:
            if node not in first and is_told(frame, node):
                first[node] = frame.at
    return max(first.values()) if len(first) == len(nodes) else None


def evidence(
    frames: Sequence[Heard],
    kind: Kind,
    nodes: Sequence[int],
    first: bool,
    span: tuple[float, float],
) -> float | None:
    """When the first, or the last, frame of a kind came within a span of time; or None."""
    times = [f.at for f in frames if span[0] <= f.at <= span[1] and any(kind(f, n) for n in nodes)]
    if not times:
        return None
    return times[0] if first else times[-1]


def rest(truth: Sequence[tuple[float, float]], after: float) -> float | None:
    """When the platform came to rest for good; None if it does not stand for long enough yet.

    Args:
        truth: Times [s] and speeds, as shares of what counts as rest.
        after: Time of the evidence.
    """
    stood: float | None = None
    for at, speed in truth:
        if at >= after:
            stood = None if speed > 1.0 else at if stood is None else stood
    return stood if stood is not None and truth[-1][0] - stood >= HOLD else None


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong, and what must follow.

    Attributes:
        name: For people.
        begin: Makes it so; returns the time of the evidence, where it is not on the bus.
        bound: Longest time from the evidence to the reaction [s].
        reason: What the bridge must say, for the wheel; nothing: it does not stop for good.
        evidence: Kind of the frame that shows it.
        first: Whether the first such frame shows it, or the last: where something falls silent.
        all_wheels: Whether all wheels have it.
        reaction: Kind of the frames that are the reaction: a stop, a change, or another kind of
            the protocol; where it has none such, only the rest is measured.
        end: Makes it undone.
        stays: Whether nothing may move then until a reset.
        slow: Whether it takes seconds: it is provoked less often.
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
    stays: bool = True
    slow: bool = False


def _at_reception(p: CanParameters) -> float:
    return p.period + MARGIN


def _at_silence(p: CanParameters) -> float:
    return p.feedback_timeout + p.period + MARGIN


def _at_lost_heartbeat(p: CanParameters) -> float:
    return 3 * p.drive_heartbeat + 2 * p.period + MARGIN


def _at_other_mode(p: CanParameters) -> float:
    return MODE_PATIENCE + 2 * p.period + MARGIN


def _at_stale_command(p: CanParameters) -> float:
    return p.command_timeout + p.period + MARGIN


def _at_watchdog(p: CanParameters) -> float:
    told = p.drive_heartbeat if p.protocol == "odrive" else 0.0  # in its next heartbeat
    return p.heartbeat_timeout + told + FIRMWARE + MARGIN


def _switched(
    name: str, flag: str, bound: Callable[[CanParameters], float], reason: str, evidence: str,
    **options: bool,
) -> Fault:  # fmt: skip
    """A fault of the simulated drives."""

    def begin(rig: Rig, wheels: Sequence[str]) -> None:
        rig.switch(flag, wheels)

    def end(rig: Rig) -> None:
        rig.switch(flag, ())

    return Fault(name, begin, bound, reason, evidence, end=end, **options)  # type: ignore[arg-type]


def _silenced(name: str, flag: str, **options: bool) -> Fault:
    """A fault after which nothing is reported any more."""
    reason = "no feedback" if "all_wheels" in options else "{}: no feedback"
    return _switched(name, flag, _at_silence, reason, "report", first=False, **options)


def _signalled(number: int) -> Callable[[Rig, Sequence[str]], None]:
    return lambda rig, wheels: rig.signal(number)


def _boot_up(rig: Rig, wheels: Sequence[str]) -> None:
    rig.listener.send(0x700 + rig.nodes[0], b"\x00")  # a drive that is really gone is silent first


def _command_too(rig: Rig, wheels: Sequence[str]) -> None:
    rig.listener.send(*FOREIGN)


def _end_commands(rig: Rig, wheels: Sequence[str]) -> float:
    rig.commanding = False
    return rig.published


EMERGENCY = Fault(
    "emergency_stop", lambda rig, wheels: rig.emergency(True), _at_reception, "emergency",
    end=lambda rig: rig.emergency(False),
)  # fmt: skip
STALE = Fault("commands end", _end_commands, _at_stale_command, "", reaction="change", stays=False)
STOPPED = Fault(
    "bridge SIGSTOP", _signalled(signal.SIGSTOP), _at_watchdog, "held up|EMCY|error|closed loop",
    "setpoint", first=False, reaction="watchdog", end=lambda rig: rig.signal(signal.SIGCONT),
)  # fmt: skip
KILLED = Fault(
    "bridge SIGKILL", _signalled(signal.SIGKILL), _at_watchdog, "", "setpoint", first=False,
    reaction="watchdog", end=lambda rig: rig.restart(), stays=False, slow=True,
)  # fmt: skip

FAULTS: dict[str, list[Fault]] = {
    "cia402": [
        _switched("drive fault (EMCY)", "fault", _at_reception, "{}: EMCY", "EMCY"),
        Fault("boot-up, as of a drive", _boot_up, _at_reception, "boot-up", "boot-up",
              all_wheels=True),
        Fault("supply gone (EMCY)", lambda rig, wheels: rig.switch("supply", 5.0), _at_reception,
              "EMCY", "EMCY", all_wheels=True, end=lambda rig: rig.switch("supply", 0.0)),
        Fault("second host (RPDO)", _command_too, _at_reception, "another host", "foreign"),
        _switched("other mode shown", "wrong_mode", _at_other_mode, "{}: .*shows mode",
                  "other mode"),
        _silenced("drive silent", "silent"),
        _silenced("drive starts anew", "reboot", slow=True),
        _silenced("all drives silent", "silent", all_wheels=True, slow=True),
        _silenced("drive deaf", "deaf"),
        _silenced("reports frozen, heartbeat alive", "frozen_reports"),
        _switched("reports too short", "short_reports", _at_silence, "{}: no feedback",
                  "whole report", first=False),
        _switched("heartbeat lost", "no_heartbeat", _at_lost_heartbeat, "{}: .*heartbeat lost",
                  "heartbeat", first=False),
        EMERGENCY, Fault("~/stop", lambda rig, wheels: rig.stop(), _at_reception, "~/stop"),
        STALE, STOPPED, KILLED,
    ],
    "vesc": [_silenced("drive silent", "silent"), EMERGENCY, STALE, STOPPED],
    "odrive": [
        _switched("drive fault (error)", "fault", _at_reception, "{}: axis error", "error"),
        _silenced("drive silent", "silent"), EMERGENCY, STALE,
        replace(STOPPED, slow=True),  # it lets the wheels turn freely
    ],
}  # fmt: skip


@dataclass
class Record:
    """What came of a fault: times from its evidence [s]; runs in which something else stopped it.

    Attributes:
        moved: Runs in which the platform moved again before a reset.
    """

    reactions: list[float] = field(default_factory=list)
    rests: list[float] = field(default_factory=list)
    repeated: int = 0
    moved: int = 0

    def summary(self, fault: Fault, bound: float, reacts: bool) -> dict[str, Any]:
        """Figures; milliseconds. Those of times are left out where there are none."""
        figures: dict[str, Any] = {"fault": fault.name, "runs": len(self.rests)}
        if reacts and self.reactions:
            figures |= {
                "reaction_median_ms": 1e3 * statistics.median(self.reactions),
                "reaction_max_ms": 1e3 * max(self.reactions),
                "bound_ms": 1e3 * bound,
                "late": sum(one > bound for one in self.reactions),
            }
        if self.rests:
            figures["rest_median_ms"] = 1e3 * statistics.median(self.rests)
            figures["rest_max_ms"] = 1e3 * max(self.rests)
        return figures | {"repeated": self.repeated, "moved_before_reset": self.moved}


def measure(quick: bool, port: int, on_signal: Callable[[Callable[[int], None]], Any]) -> Any:
    """Measure all faults of all protocols.

    Args:
        quick: One run each, without what takes long, and little of all protocols but the first.
        port: Of the bus.
        on_signal: Gives signals to a function, as a context manager.

    Returns:
        Lists of figures by protocol; see `Record.summary`.
    """
    result: dict[str, Any] = {}
    for protocol, known in FAULTS.items():
        faults = [fault for fault in known if not (quick and fault.slow)]
        if quick and result:
            faults = faults[:1]
        say(f"{protocol}: {len(faults)} faults ...")
        log = NodeLog()
        try:
            with Session("omniman_bench_can") as session:
                rig = Rig(session, protocol, port, log)
                with on_signal(rig.interrupt), rig:
                    result[protocol] = [provoke(rig, fault, quick) for fault in faults]
        except CommandError:
            log.show()
            raise
    return result


def provoke(rig: Rig, fault: Fault, quick: bool) -> dict[str, Any]:
    """Provoke a fault some times, on one wheel after the other."""
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
    """Provoke a fault once; False if something else stopped the wheels."""
    everything = range(len(rig.names)) if fault.all_wheels else (wheel,)
    nodes = [rig.nodes[i] for i in everything]
    rig.listener.forget()
    rig.truth.clear()
    rig.session.spin(BEFORE + random.uniform(0.0, rig.parameters.period))  # at any phase
    told, kinds = rig.told(), dict(rig.dialect.kinds)
    kinds["foreign"] = lambda f, node: (f.id, f.data) == FOREIGN
    start = time.time()
    at = fault.begin(rig, [rig.names[i] for i in everything])
    rig.wait(lambda: rest(rig.truth, start) is not None, f"rest after '{fault.name}'")
    frames, end = list(rig.listener.frames), time.time()
    reacted = None
    if reacts:
        stop = rig.dialect.stop
        kinds["change"] = told
        kinds["stop"] = told if stop is None else (
            lambda f, node: f.id in rig.dialect.setpoint(node) and f.data[:2] == stop
        )  # fmt: skip
        reacted = reaction(frames, start if at is None else at, rig.nodes, kinds[fault.reaction])
    if at is None:
        until = end if reacted is None else reacted
        at = evidence(frames, kinds[fault.evidence], nodes, fault.first, (start - BEFORE, until))
    still = time.time()
    fault.end(rig)
    if fault.stays:
        rig.session.spin(HOLD)
        rig.wait(lambda: rig.state == DiagnosticStatus.ERROR, "the reason of the stop")
    moved = fault.stays and any(speed > 1.0 for seen, speed in rig.truth if seen > still)
    stood = None if at is None else rest([(t, v) for t, v in rig.truth if t <= still], at)
    reason = fault.reason.format(rig.names[wheel])
    named = not reason or re.search(reason, rig.reason)
    if at is None or stood is None or not named or (reacts and (reacted is None or reacted < at)):
        return False
    if reacted is not None:
        record.reactions.append(reacted - at)
    record.rests.append(stood - at)
    record.moved += moved
    return True


def aim(result: Mapping[str, Any]) -> bool:
    """Whether all faults could be measured, each reaction was in time, and nothing moved again."""
    rows = [row for rows in result.values() for row in rows]
    return all(
        row["runs"] > 0 and row.get("late", 0) == 0 and row["moved_before_reset"] == 0
        for row in rows
    )


def report(result: Mapping[str, Any]) -> list[str]:
    """The table at the end."""
    rows: list[tuple[str, ...]] = [
        ("fault, while driving", "reaction p50", "max", "bound", "rest p50", "max", "runs")
    ]
    for protocol, faults in result.items():
        rows += [(f"{protocol}: {row['fault']}", *_cells(row)) for row in faults]
    return ["", *table(rows),
            "  reaction: from the evidence to the last drive's stop frame; at a bridge that is "
            "stopped or killed to the last drive's own report", ""]  # fmt: skip


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    repeated = f" (+{row['repeated']} stopped by something else)" if row["repeated"] else ""
    runs = f"{row['runs']}{repeated}"
    if row["moved_before_reset"]:
        runs = paint(f"{runs} MOVED AGAIN", RED, sys.stdout)
    told, stands = ("", "", ""), ("", "")
    if "bound_ms" in row:
        longest = f"{row['reaction_max_ms']:.1f} ms"
        told = (
            f"{row['reaction_median_ms']:.1f} ms",
            paint(longest, RED if row["late"] else GREEN, sys.stdout),
            f"{row['bound_ms']:.0f} ms",
        )
    if row["runs"]:
        stands = (f"{row['rest_median_ms']:.0f} ms", f"{row['rest_max_ms']:.0f} ms")
    return (*told, *stands, runs)
