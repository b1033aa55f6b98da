"""`omniman bench can`: round trips of the bridge over a bus, compared with bare python-can.

A round trip begins with the frames of a period and ends when all drives have answered. There are
two baselines with python-can alone: it exchanges as many frames with an echo, and it sends the
bridge's own frames to the same drives.
"""

import argparse
import contextlib
import os
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np

from omniman_ros.can_drives.drives import CanDrives, Phase
from omniman_ros.can_drives.frame import Frame, bus_load
from omniman_ros.can_drives.link import CanLink
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say, table
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.bench.can_peer import COUNTS, SYNC, open_bus
from omniman_ros.lab.bench.harness import Rows, conclude
from omniman_ros.lab.measurement import cpu_time
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.drive_options import MULTICAST_GROUP
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec, redirect_signals
from omniman_ros.processes.robot_setup import node_command
from omniman_ros.robots import load_robot

AIM_RATIO = 2.0  # aim: largest ratio of the bridge's median round-trip time to that with the echo
RATES = (100.0, 250.0, 500.0)  # rates at which the bridge is measured [Hz]
WHEELS = (4, 8)  # numbers of drives with which the bridge is measured
BITRATES = (500_000, 1_000_000)  # bit rates for which the bus load is computed [bit/s]
TRIP_TIMEOUT = 0.05  # longest duration of a round trip, after which it counts as lost [s]
START_TIMEOUT = 20.0  # longest time until the drives or the echo are ready [s]


@dataclass(frozen=True)
class Effort:
    """Extent of the measurement."""

    blocks: int  # number of blocks of each side; the sides alternate
    periods: int  # number of periods in a block


FULL = Effort(blocks=10, periods=100)  # extent without options
QUICK = Effort(blocks=2, periods=20)  # extent with `--quick`


@dataclass
class Side:
    """The measurements of one of the sides that are compared, the bridge or a baseline."""

    trips: list[float] = field(default_factory=list)  # times of the completed round trips [s]
    lost: int = 0  # number of periods whose round trip was not completed in time
    periods: int = 0  # number of all periods
    cpu: float = 0.0  # CPU time of this process in the side's blocks [s]
    wall: float = 0.0  # total duration of the side's blocks [s]

    def summary(self) -> dict[str, float]:
        """Return the figures of the side; times are NaN if no round trip was completed."""
        trips = 1e3 * np.array(self.trips or [np.nan])
        return {
            "median_ms": float(np.median(trips)),
            "p99_ms": float(np.percentile(trips, 99)),
            "lost_share": self.lost / max(self.periods, 1),
            "cpu_share": self.cpu / max(self.wall, 1e-9),
        }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench can`; return 0, the exit code of a successful measurement."""
    effort = QUICK if args.quick else FULL
    cases = [measure(wheels, rate, effort) for wheels in WHEELS for rate in RATES]
    result: dict[str, Any] = {"quick": args.quick, "cases": cases}
    return conclude("can", result, report, args.results, aims)


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Return whether each aim was met."""
    return {
        "latency_ratio": all(case["ratio"] <= AIM_RATIO for case in result["cases"]),
    }


def robot_of(wheels: int) -> Robot:
    """Make a robot that repeats the four wheels of `omniman` at growing distances."""
    values = dict(load_robot("omniman"))
    rows = wheels // 4
    for name in ("wheels.y", "wheels.heading", "wheels.roller_angle"):
        values[name] = list(values[name]) * rows
    values["wheels.x"] = [x * (1.0 + row) for row in range(rows) for x in values["wheels.x"]]
    names = values["wheels.names"]
    values["wheels.names"] = [f"{name}{row or ''}" for row in range(rows) for name in names]
    return build(Robot, values)


def measure(wheels: int, rate: float, effort: Effort) -> dict[str, Any]:
    """Measure the bridge and both baselines in alternating blocks.

    Returns:
        Figures of the case.
    """
    say(f"{wheels} drives at {rate:g} Hz ...")
    ports = free_udp_ports(2)
    peers = [
        ProcessSpec(
            kind,
            node_command(
                "omniman_ros.lab.bench.can_peer", (kind, str(port), str(wheels), str(rate))
            ),
        )
        for kind, port in zip(("drives", "echo"), ports, strict=True)
    ]
    children = ProcessGroup(peers)
    ours, same, bare = Side(), Side(), Side()
    with redirect_signals(children.interrupt), children:
        bridge = Bridge(wheels, rate, ports[0], children.check)
        echo = Echo(wheels, rate, ports[1], children.check)
        sides = ((bridge.block, ours), (bridge.repeat, same), (echo.block, bare))
        try:
            for _ in range(effort.blocks):
                for block, measured in sides:
                    before, start = cpu_time(os.getpid()), time.monotonic()
                    block(effort.periods, measured)
                    measured.cpu += cpu_time(os.getpid()) - before
                    measured.wall += time.monotonic() - start
                    children.check()
        finally:
            bridge.close()
            echo.close()
    span = effort.blocks * effort.periods / rate
    return {
        "wheels": wheels,
        "rate_hz": rate,
        "bridge": ours.summary(),
        "same_drives": same.summary(),
        "echo": bare.summary(),
        "ratio_same_drives": ours.summary()["median_ms"] / same.summary()["median_ms"],
        "ratio": ours.summary()["median_ms"] / bare.summary()["median_ms"],
        "frames_per_period": len(bridge.frames) / (effort.blocks * effort.periods),
        "load": {str(bits): bus_load(bridge.frames, span, bits) for bits in BITRATES},
    }


def free_udp_ports(count: int) -> list[int]:
    """Return UDP ports that are free on this machine."""
    with contextlib.ExitStack() as stack:
        sockets = [
            stack.enter_context(socket.socket(type=socket.SOCK_DGRAM)) for _ in range(count)
        ]
        for each in sockets:
            each.bind(("", 0))
        return [int(each.getsockname()[1]) for each in sockets]


def _sleep_until(due: float) -> None:
    time.sleep(max(due - time.monotonic(), 0.0))


class _RecordingDrives(CanDrives):
    """The policy over the drives, which also records the frames that it sends and receives."""

    def __init__(self, robot: Robot, parameters: CanParameters, frames: list[Frame]) -> None:
        super().__init__(robot, parameters)
        self._frames = frames
        self.recording = False

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.recording and not self.host_detector.is_host_frame(frame):
            self._frames.append(frame)
        return super().receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        frames = super().tick(now)
        if self.recording:
            self._frames += frames
        return frames


class Bridge:
    """The bridge without ROS, in this process; its drives are ready after construction."""

    def __init__(self, wheels: int, rate: float, port: int, check: Callable[[], None]) -> None:
        robot = robot_of(wheels)
        values = {
            "can.interface": "udp_multicast",
            "can.channel": MULTICAST_GROUP,
            "can.port": port,
            "can.nodes": tuple(range(1, wheels + 1)),
            "can.rate": rate,
            "can.counts": COUNTS,
            "can.missed_periods": 1000,
            "can.heartbeat_timeout": 5.0,
            "can.drive_heartbeat": 1.0,
            "can.configure_timeout": 2.0,
        }
        parameters = build(CanParameters, values, "can.")
        self.frames: list[Frame] = []
        self._period = 1.0 / rate
        self._link = CanLink(robot, parameters, time.monotonic)
        self._recorder = _RecordingDrives(robot, parameters, self.frames)
        self._link.drives = self._recorder
        self._command = WheelCommand(DriveMode.VELOCITY, np.zeros(wheels), np.full(wheels, 1.0))
        self._bare = open_bus(port)
        self._wheels = wheels
        self._bring_up(check)

    def _bring_up(self, check: Callable[[], None]) -> None:
        drives, end = self._link.drives, time.monotonic() + START_TIMEOUT
        while drives.phase is not Phase.DRIVING:
            check()
            if time.monotonic() > end:
                raise CommandError(f"the drives are not ready: {drives.stop_reason}")
            if drives.phase is Phase.UNCONFIGURED:
                drives.configure(time.monotonic())
                self._link.run_until(lambda: drives.phase is not Phase.CONFIGURING, START_TIMEOUT)
            elif drives.phase is Phase.IDLE:
                drives.enable(time.monotonic())
            self._link.run_until(lambda: drives.phase is not Phase.ENABLING, 1.0)

    def block(self, periods: int, measured: Side) -> None:
        """Run a block of periods of the bridge: one command each.

        Until all drives have answered.
        """
        link = self._link
        link.run_until(lambda: False, 0.1)  # process frames that arrived during other blocks
        due = time.monotonic() + self._period
        self._recorder.recording = True
        for _ in range(periods):
            _sleep_until(due)
            link.receive()
            link.drives.take_states()
            start, due = time.monotonic(), due + self._period
            link.drives.set_command(self._command, start)
            link.tick()
            measured.periods += 1
            while link.drives.take_states() is None:
                now = time.monotonic()
                if now >= min(due, start + TRIP_TIMEOUT):
                    measured.lost += 1
                    break
                link.bus.wait(min(due, start + TRIP_TIMEOUT) - now)
                link.receive()
            else:
                measured.trips.append(time.monotonic() - start)
        self._recorder.recording = False
        if link.drives.stop_reason:
            raise CommandError(f"the drives stopped: {link.drives.stop_reason}")

    def repeat(self, periods: int, measured: Side) -> None:
        """Run a block with python-can alone: the bridge's frames to the same drives."""
        frames = [
            can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)
            for frame in self._link.drives.tick(time.monotonic())
        ]
        _bare_block(self._bare, frames, 2 * self._wheels, self._period, periods, measured)
        while any(True for _ in self._link.bus.take()):
            pass  # discarded: the bridge would stop, as the frames seem to be of a second host

    def close(self) -> None:
        """Close both connections to the bus."""
        self._bare.shutdown()
        self._link.close()


def _bare_trip(
    bus: can.BusABC, frames: list[can.Message], answers: int, due: float
) -> float | None:
    """Send frames and wait for the answers, the transmit PDOs 1 and 2 of the drives.

    Returns:
        The round-trip time [s]; None if not all answers have arrived by the deadline.
    """
    start = time.monotonic()
    for frame in frames:
        bus.send(frame)
    while answers:
        message = bus.recv(max(due - time.monotonic(), 0.0))
        if message is None:
            return None
        answers -= message.arbitration_id & 0x780 in (0x180, 0x280)
    return time.monotonic() - start


def _bare_block(
    bus: can.BusABC,
    frames: list[can.Message],
    answers: int,
    period: float,
    periods: int,
    measured: Side,
) -> None:
    """Run a block of periods with python-can alone."""
    due = time.monotonic() + period
    for _ in range(periods):
        _sleep_until(due)
        while bus.recv(0.0) is not None:
            pass  # late answers to the previous period are discarded
        due += period
        trip = _bare_trip(bus, frames, answers, min(due, time.monotonic() + TRIP_TIMEOUT))
        measured.periods += 1
        if trip is None:
            measured.lost += 1
        else:
            measured.trips.append(trip)


class Echo:
    """Exchanges as many frames as the bridge, but with an echo and by python-can alone."""

    def __init__(self, wheels: int, rate: float, port: int, check: Callable[[], None]) -> None:
        self._bus = open_bus(port)
        self._period = 1.0 / rate
        self._answers = 2 * wheels
        self._frames = [
            can.Message(arbitration_id=0x200 + node, data=bytes(7), is_extended_id=False)
            for node in range(1, wheels + 1)
        ]
        self._frames.append(can.Message(arbitration_id=SYNC, is_extended_id=False))
        end = time.monotonic() + START_TIMEOUT
        while self._trip(time.monotonic() + 0.2) is None:
            check()
            if time.monotonic() > end:
                raise CommandError("the echo is not ready")

    def _trip(self, due: float) -> float | None:
        return _bare_trip(self._bus, self._frames, self._answers, due)

    def block(self, periods: int, measured: Side) -> None:
        """Run a block of periods."""
        _bare_block(self._bus, self._frames, self._answers, self._period, periods, measured)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [
        (
            "drives, rate",
            "bridge p50 / p99",
            "python-can, same drives",
            "python-can, echo",
            "ratios",
            "lost",
            "CPU (echo)",
            "load 500k / 1M",
        )
    ]
    for case in result["cases"]:
        ours, same, bare = case["bridge"], case["same_drives"], case["echo"]
        loads = [f"{100 * case['load'][str(bits)]:.0f} %" for bits in BITRATES]
        good = case["ratio"] <= AIM_RATIO
        ratio = verdict(good, *2 * (f"{case['ratio']:.2f}",))
        rows.append(
            (
                f"{case['wheels']} at {case['rate_hz']:g} Hz",
                f"{ours['median_ms']:.2f} / {ours['p99_ms']:.2f} ms",
                f"{same['median_ms']:.2f} / {same['p99_ms']:.2f} ms",
                f"{bare['median_ms']:.2f} / {bare['p99_ms']:.2f} ms",
                f"{case['ratio_same_drives']:.2f}, {ratio}",
                f"{100 * ours['lost_share']:.1f} %",
                f"{100 * ours['cpu_share']:.0f} % ({100 * bare['cpu_share']:.0f} %)",
                " / ".join(loads),
            )
        )
    aim = f"  aim: median round trip at most {AIM_RATIO:g} times that with the echo"
    return ["", *table(rows), aim]
