"""Reaction to faults in `omniman bench can`: times until all drives get a stop command, and rest.

Bridge and simulated drives run in processes of their own, with the time-outs of the installations
in config/can/. Faults are injected at a steady speed, and the kernel stamps the arrival of each
frame. Times are measured from the evidence, the moment at which the fault becomes visible to the
bridge or, where the bridge itself fails, to the drives.
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
from omniman_ros.lab.bench.can_rig import BusFrame, FrameKind, Rig
from omniman_ros.lab.bench.harness import Rows
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import redirect_signals

MARGIN = 2e-3
"""Permitted time of a reaction beyond the time-outs and periods that it waits for [s]."""
WATCHDOG_PERIOD = 1e-3
"""Period at which the drives check their watchdogs [s]."""
MODE_TIMEOUT = 0.1
"""Time for which a drive may display another mode than the commanded one [s]."""
REST_TIME = 0.1
"""Time without motion after which the platform counts as having come to rest [s]."""
RECORDED_BEFORE = 0.05
"""Time before a fault from which on frames are recorded [s].

It contains the last frame of a drive that falls silent.
"""
RUNS = 5
"""Number of runs of each fault."""
SLOW_RUNS = 2
"""Number of runs of each fault whose runs take seconds."""
ATTEMPTS = 4
"""Largest number of attempts at one run.

A run is repeated if the drives stop for another reason, such as delays on a busy machine.
"""
FOREIGN_FRAME = (0x201, b"\x0f" + bytes(5) + b"\x07")
"""Identifier and data of a frame to node 1 that the bridge never sends, as if from a second host.

It is receive PDO 1 with the controlword for an enabled operation, a zero setpoint and the mode of
operation 7 (interpolated position).
"""


def time_of_reaction(
    frames: Sequence[BusFrame], after: float, nodes: Sequence[int], is_reaction: FrameKind
) -> float | None:
    """Return the time at which the reaction to a fault is complete, for the last of all drives.

    Args:
        frames: Frames on the bus.
        after: Time before which frames do not count [s].
        nodes: Node ids of the drives.
        is_reaction: Kind of frame that is the reaction; the first such frame of each drive counts.

    Returns:
        The time by the system clock [s]; None if there is no such frame of some drive.
    """
    first: dict[int, float] = {}
    for frame in frames:
        if frame.at < after:
            continue
        for node in nodes:
            if node not in first and is_reaction(frame, node):
                first[node] = frame.at
    return max(first.values()) if len(first) == len(nodes) else None


def time_of_evidence(
    frames: Sequence[BusFrame],
    kind: FrameKind,
    nodes: Sequence[int],
    first: bool,
    span: tuple[float, float],
) -> float | None:
    """Return the time at which a fault became visible on the bus.

    Args:
        frames: Frames on the bus.
        kind: Kind of frame that shows the fault.
        nodes: Node ids of the faulty drives.
        first: Whether the first such frame shows the fault; otherwise the last one does.
        span: Start and end of the time in which frames count [s].

    Returns:
        The time by the system clock [s]; None if there is no such frame.
    """
    times = [f.at for f in frames if span[0] <= f.at <= span[1] and any(kind(f, n) for n in nodes)]
    if not times:
        return None
    return times[0] if first else times[-1]


def time_of_rest(truth: Sequence[tuple[float, float]], after: float) -> float | None:
    """Return the time at which the platform came to rest and since which it has been at rest.

    Args:
        truth: Times [s] and speeds of the platform, as multiples of the largest speed that counts
            as rest.
        after: Time before which rest does not count, such as that of the evidence [s].

    Returns:
        The time by the system clock [s]; None if the platform has not been at rest for
        `REST_TIME` yet.
    """
    since: float | None = None
    for at, speed in truth:
        if at >= after:
            since = None if speed > 1.0 else at if since is None else since
    return since if since is not None and truth[-1][0] - since >= REST_TIME else None


@dataclass(frozen=True)
class Fault:
    """A fault that is injected, and the reaction that must follow.

    Attributes:
        name: Name in the table.
        inject: Function that injects the fault into the named wheels; returns the time of the
            evidence by the system clock [s], or None if the evidence is a frame on the bus.
        bound: Function that returns the longest permitted time from the evidence to the reaction
            [s] from the parameters of the installation.
        reason: Regular expression of the reason for the stop that the bridge must publish, with
            `{}` in place of the wheel's name; empty if the bridge need not publish any.
        evidence: Name of the kind of frame that shows the fault.
        first: Whether the first such frame shows the fault; otherwise the last one before a
            silence does.
        all_wheels: Whether all wheels have the fault.
        reaction: Name of the kind of frame that is the reaction: "stop", "change" (of a setpoint)
            or "watchdog". If the protocol has no frame that shows a watchdog, only the time until
            rest is measured.
        remove: Function that removes the fault.
        latches: Whether nothing may move afterwards until a reset.
        slow: Whether a run takes seconds, so that there are fewer runs.
    """

    name: str
    inject: Callable[[Rig, Sequence[str]], float | None]
    bound: Callable[[CanParameters], float]
    reason: str
    evidence: str = ""
    first: bool = True
    all_wheels: bool = False
    reaction: str = "stop"
    remove: Callable[[Rig], object] = lambda rig: None
    latches: bool = True
    slow: bool = False


def _bound_after_frame(p: CanParameters) -> float:
    return p.period + MARGIN


def _bound_after_silence(p: CanParameters) -> float:
    return p.feedback_timeout + p.period + MARGIN


def _bound_after_lost_heartbeat(p: CanParameters) -> float:
    return 3 * p.drive_heartbeat + 2 * p.period + MARGIN


def _bound_after_other_mode(p: CanParameters) -> float:
    return MODE_TIMEOUT + 2 * p.period + MARGIN


def _bound_after_last_command(p: CanParameters) -> float:
    return p.command_timeout + p.period + MARGIN


def _bound_of_watchdog(p: CanParameters) -> float:
    # An ODrive reports the stop in its next heartbeat.
    report_delay = p.drive_heartbeat if p.protocol == "odrive" else 0.0
    return p.heartbeat_timeout + report_delay + WATCHDOG_PERIOD + MARGIN


def _parameter_fault(
    name: str,
    flag: str,
    bound: Callable[[CanParameters], float],
    reason: str,
    evidence: str,
    **options: bool,
) -> Fault:
    """Make a fault of the simulated drives that a parameter `can_faults.*` sets.

    Args:
        name: Name in the table.
        flag: Last part of the parameter's name; its value is the names of the faulty wheels.
        bound: See `Fault`.
        reason: See `Fault`.
        evidence: See `Fault`.
        options: Further attributes of the fault.
    """

    def inject(rig: Rig, wheels: Sequence[str]) -> None:
        rig.set_fault(flag, wheels)

    def remove(rig: Rig) -> None:
        rig.set_fault(flag, ())

    what = (name, inject, bound, reason, evidence)
    return Fault(*what, remove=remove, **options)  # type: ignore[arg-type]


def _silent_fault(name: str, flag: str, **options: bool) -> Fault:
    """Make a fault after which the bridge receives no more reports; see `_parameter_fault`."""
    reason = "no feedback" if "all_wheels" in options else "{}: no feedback"
    return _parameter_fault(
        name, flag, _bound_after_silence, reason, "report", first=False, **options
    )


def _bridge_signal(number: int) -> Callable[[Rig, Sequence[str]], None]:
    return lambda rig, wheels: rig.signal_bridge(number)


def _send_boot_up(rig: Rig, wheels: Sequence[str]) -> None:
    # The message is forged, as a drive that restarts is silent before it sends one.
    rig.recorder.send(0x700 + rig.nodes[0], b"\x00")


def _send_foreign_frame(rig: Rig, wheels: Sequence[str]) -> None:
    rig.recorder.send(*FOREIGN_FRAME)


def _end_commands(rig: Rig, wheels: Sequence[str]) -> float:
    rig.commanding = False
    return rig.published


EMERGENCY_STOP = Fault(
    "emergency_stop",
    lambda rig, wheels: rig.set_emergency_stop(True),
    _bound_after_frame,
    "emergency",
    remove=lambda rig: rig.set_emergency_stop(False),
)
"""The emergency stop is pressed."""
COMMANDS_END = Fault(
    "commands end", _end_commands, _bound_after_last_command, "", reaction="change", latches=False
)
"""The publisher of `wheel_commands` falls silent."""
BRIDGE_SUSPENDED = Fault(
    "bridge SIGSTOP",
    _bridge_signal(signal.SIGSTOP),
    _bound_of_watchdog,
    "held up|EMCY|error|closed loop",
    "setpoint",
    first=False,
    reaction="watchdog",
    remove=lambda rig: rig.signal_bridge(signal.SIGCONT),
)
"""The process of the bridge is suspended."""
BRIDGE_KILLED = Fault(
    "bridge SIGKILL",
    _bridge_signal(signal.SIGKILL),
    _bound_of_watchdog,
    "",
    "setpoint",
    first=False,
    reaction="watchdog",
    remove=lambda rig: rig.restart_bridge(),
    latches=False,
    slow=True,
)
"""The process of the bridge is killed."""

FAULTS: dict[str, list[Fault]] = {
    "cia402": [
        _parameter_fault("drive fault (EMCY)", "fault", _bound_after_frame, "{}: EMCY", "EMCY"),
        Fault(
            "boot-up message of a drive",
            _send_boot_up,
            _bound_after_frame,
            "boot-up",
            "boot-up",
            all_wheels=True,
        ),
        Fault(
            "supply voltage fails (EMCY)",
            lambda rig, wheels: rig.set_fault("supply", 5.0),
            _bound_after_frame,
            "EMCY",
            "EMCY",
            all_wheels=True,
            remove=lambda rig: rig.set_fault("supply", 0.0),
        ),
        Fault(
            "second host (RPDO)",
            _send_foreign_frame,
            _bound_after_frame,
            "another host",
            "foreign",
        ),
        _parameter_fault(
            "other mode displayed",
            "wrong_mode",
            _bound_after_other_mode,
            "{}: .*shows mode",
            "other mode",
        ),
        _silent_fault("drive silent", "silent"),
        _silent_fault("drive restarts", "reboot", slow=True),
        _silent_fault("all drives silent", "silent", all_wheels=True, slow=True),
        _silent_fault("drive deaf", "deaf"),
        _silent_fault("reports stop, heartbeat continues", "frozen_reports"),
        _parameter_fault(
            "reports too short",
            "short_reports",
            _bound_after_silence,
            "{}: no feedback",
            "whole report",
            first=False,
        ),
        _parameter_fault(
            "heartbeat lost",
            "no_heartbeat",
            _bound_after_lost_heartbeat,
            "{}: .*heartbeat lost",
            "heartbeat",
            first=False,
        ),
        EMERGENCY_STOP,
        Fault("~/stop", lambda rig, wheels: rig.call_stop(), _bound_after_frame, "~/stop"),
        COMMANDS_END,
        BRIDGE_SUSPENDED,
        BRIDGE_KILLED,
    ],
    "vesc": [
        _silent_fault("drive silent", "silent"),
        EMERGENCY_STOP,
        COMMANDS_END,
        BRIDGE_SUSPENDED,
    ],
    "odrive": [
        _parameter_fault(
            "drive fault (error)", "fault", _bound_after_frame, "{}: axis error", "error"
        ),
        _silent_fault("drive silent", "silent"),
        EMERGENCY_STOP,
        COMMANDS_END,
        replace(BRIDGE_SUSPENDED, slow=True),  # ODrives let the wheels coast
    ],
}
"""Faults that are injected, by protocol; the name of each fault is unique in its protocol."""


@dataclass
class Record:
    """The measurements of one fault.

    Attributes:
        reactions: Times from the evidence to the reaction, one per valid run [s].
        rests: Times from the evidence until rest, one per valid run [s].
        repeated: Number of runs that do not count, as something else stopped the platform.
        moved: Number of valid runs in which the platform moved again before a reset.
    """

    reactions: list[float] = field(default_factory=list)
    rests: list[float] = field(default_factory=list)
    repeated: int = 0
    moved: int = 0

    def summary(self, fault: Fault, bound: float, reacts: bool) -> dict[str, Any]:
        """Return the figures of the fault; those of times that were not measured are left out.

        Args:
            fault: Fault that was injected.
            bound: Longest permitted time from the evidence to the reaction [s].
            reacts: Whether a frame of the protocol shows the reaction.
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
        quick: Whether to measure one run of each fault, no slow faults, and only one fault of each
            protocol other than the first.
        port: UDP port of the bus.

    Returns:
        Figures of each fault by protocol; see `Record.summary`.

    Raises:
        CommandError: The robot does not reach a steady speed, does not come to rest after a
            fault, or the drives have ended.
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
                    result[protocol] = [measure_fault(rig, fault, quick) for fault in faults]
        except CommandError:
            log.show()
            raise
    return result


def measure_fault(rig: Rig, fault: Fault, quick: bool) -> dict[str, Any]:
    """Inject a fault several times, into one wheel after the other.

    Args:
        rig: Running bridge and drives.
        fault: Fault to inject.
        quick: Whether to measure one run only.

    Returns:
        Figures of the fault; see `Record.summary`.

    Raises:
        CommandError: See `measure`.
    """
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
        fault: Fault to inject.
        wheel: Index of the faulty wheel, ignored if the fault is one of all wheels.
        record: Record to which the measured times are added.
        reacts: Whether a frame of the protocol shows the reaction.

    Returns:
        Whether the run is valid; if not, something else stopped the wheels, and nothing is
        recorded.

    Raises:
        CommandError: See `measure`.
    """
    faulty = range(len(rig.names)) if fault.all_wheels else (wheel,)
    rig.recorder.clear()
    rig.truth.clear()
    # The fault begins at a random phase of the bridge's period.
    rig.session.spin(RECORDED_BEFORE + random.uniform(0.0, rig.parameters.period))
    kinds = _kinds(rig)
    start = time.time()
    shown = fault.inject(rig, [rig.names[i] for i in faulty])
    rig.wait(lambda: time_of_rest(rig.truth, start) is not None, f"rest after '{fault.name}'")
    frames, end = list(rig.recorder.frames), time.time()
    reacted = None
    if reacts:
        after = start if shown is None else shown
        reacted = time_of_reaction(frames, after, rig.nodes, kinds[fault.reaction])
    if shown is None:
        span = (start - RECORDED_BEFORE, end if reacted is None else reacted)
        nodes = [rig.nodes[i] for i in faulty]
        shown = time_of_evidence(frames, kinds[fault.evidence], nodes, fault.first, span)
    removed = time.time()
    fault.remove(rig)
    if fault.latches:
        rig.session.spin(REST_TIME)
        rig.wait(lambda: rig.state == DiagnosticStatus.ERROR, "latched stop of the bridge")
    before = [(t, v) for t, v in rig.truth if t <= removed]
    rested = None if shown is None else time_of_rest(before, shown)
    if shown is None or rested is None or not _is_expected_reason(rig, fault, wheel):
        return False
    if reacts and (reacted is None or reacted < shown):
        return False
    if reacted is not None:
        record.reactions.append(reacted - shown)
    record.rests.append(rested - shown)
    record.moved += fault.latches and any(v > 1.0 for t, v in rig.truth if t > removed)
    return True


def _kinds(rig: Rig) -> dict[str, FrameKind]:
    """Return all kinds of frames by name; "change" is relative to the present setpoints."""
    dialect, stop, changed = rig.dialect, rig.dialect.stop, rig.changed_setpoint()

    def is_stop(frame: BusFrame, node: int) -> bool:
        return frame.id in dialect.setpoint(node) and frame.data[:2] == stop

    return {
        **dialect.kinds,
        "foreign": lambda frame, node: (frame.id, frame.data) == FOREIGN_FRAME,
        "change": changed,
        "stop": changed if stop is None else is_stop,
    }


def _is_expected_reason(rig: Rig, fault: Fault, wheel: int) -> bool:
    """Return whether the bridge has published the reason that a fault must cause."""
    return not fault.reason or bool(re.search(fault.reason.format(rig.names[wheel]), rig.reason))


def aim(result: Mapping[str, Any]) -> bool:
    """Return whether the aim was met.

    All faults must have been measured, no reaction may be late, and no platform may move again
    before a reset.

    Args:
        result: Figures of each fault by protocol; see `measure`.
    """
    rows = [row for rows in result.values() for row in rows]
    return all(
        row["runs"] > 0 and row.get("late", 0) == 0 and row["moved_before_reset"] == 0
        for row in rows
    )


def report(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report on the figures that `measure` returns."""
    rows: Rows = [
        ("fault, while driving", "reaction p50", "max", "bound", "rest p50", "max", "runs")
    ]
    for protocol, faults in result.items():
        rows += [(f"{protocol}: {row['fault']}", *_cells(row)) for row in faults]
    return [
        "",
        *table(rows),
        "  reaction: from the first sign of the fault to the stop frame of the last drive; where "
        "the bridge is suspended or killed, to the last drive's report of its own stop",
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
