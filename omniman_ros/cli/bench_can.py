"""`omniman bench can`: round trips of the bridge over a bus, next to bare python-can.

Bare python-can does two things: it sends as many frames to an echo, and it sends the bridge's own
frames of the last period, again and again, to the very same drives. Then faults, see
`bench_can_faults`.
"""

import argparse
import os
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np

from omniman_ros.can_drive.drives import CanDrives
from omniman_ros.can_drive.frame import Frame
from omniman_ros.can_drive.link import CanLink
from omniman_ros.can_drive.load import load
from omniman_ros.can_drive.phase import Phase
from omniman_ros.cli import bench_can_faults, results
from omniman_ros.cli.bench_can_peer import COUNTS, SYNC
from omniman_ros.cli.bench_cpu import cpu_time
from omniman_ros.cli.children import Children, Task, signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import node_command
from omniman_ros.cli.installation import MULTICAST
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.terminal import GREEN, RED, paint, say, table
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.core.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.robots import load_robot

AIM_RATIO = 2.0
"""Median round trip over that of the bare echo."""
RATES = (100.0, 250.0, 500.0)
WHEELS = (4, 8)
BITRATES = (500_000, 1_000_000)
PATIENCE = 0.05
"""A round trip that takes longer is lost [s]."""
STARTED = 20.0
"""How long the far end may take to be there [s]."""


@dataclass(frozen=True)
class Effort:
    """Blocks of each kind, by turns, and periods in a block."""

    blocks: int
    periods: int


FULL = Effort(blocks=10, periods=100)
QUICK = Effort(blocks=2, periods=20)


@dataclass
class Side:
    """What is measured of one side.

    Attributes:
        trips: Round trips [s].
        lost: Periods without all answers before the next.
        periods: All periods.
        cpu, wall: CPU time of this process and time, in its blocks [s].
    """

    trips: list[float] = field(default_factory=list)
    lost: int = 0
    periods: int = 0
    cpu: float = 0.0
    wall: float = 0.0

    def summary(self) -> dict[str, float]:
        """Figures; milliseconds."""
        trips = 1e3 * np.array(self.trips or [np.nan])
        return {
            "median_ms": float(np.median(trips)),
            "p99_ms": float(np.percentile(trips, 99)),
            "lost_share": self.lost / max(self.periods, 1),
            "cpu_share": self.cpu / max(self.wall, 1e-9),
        }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench can`; returns 0 if it could be measured, whatever the figures."""
    effort = QUICK if args.quick else FULL
    cases = [measure(wheels, rate, effort) for wheels in WHEELS for rate in RATES]
    result: dict[str, Any] = {"quick": args.quick, "cases": cases}
    os.environ.pop("ROS_DOMAIN_ID", None)  # wheel_commands must reach no other robot
    isolate(os.environ)
    result["faults"] = bench_can_faults.measure(args.quick, _free_ports()[0], signals_to)
    result["aims"] = aims(result)
    say("\n".join(report(result)))
    results.publish("bench_can", result, args.results)
    return 0


def aims(result: dict[str, Any]) -> dict[str, bool]:
    """Which aims were met."""
    return {
        "latency_ratio": all(case["ratio"] <= AIM_RATIO for case in result["cases"]),
        "reactions": bench_can_faults.aim(result["faults"]),
    }


def robot_of(wheels: int) -> Robot:
    """A robot of the package with so many wheels: those of omniman, in rows."""
    values = dict(load_robot("omniman"))
    rows = wheels // 4
    for name in ("wheels.y", "wheels.heading", "wheels.roller_angle"):
        values[name] = list(values[name]) * rows
    values["wheels.x"] = [x * (1.0 + row) for row in range(rows) for x in values["wheels.x"]]
    names = values["wheels.names"]
    values["wheels.names"] = [f"{name}{row or ''}" for row in range(rows) for name in names]
    return build(Robot, values)


def measure(wheels: int, rate: float, effort: Effort) -> dict[str, Any]:
    """All sides by turns."""
    say(f"{wheels} drives at {rate:g} Hz ...")
    ports = _free_ports()
    peers = [
        Task(kind, node_command("omniman_ros.cli.bench_can_peer",
                                (kind, str(port), str(wheels), str(rate))))
        for kind, port in zip(("drives", "echo"), ports, strict=True)
    ]  # fmt: skip
    children = Children(peers)
    ours, same, bare = Side(), Side(), Side()
    with signals_to(children.interrupt), children:
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
        "load": {str(bits): load(bridge.frames, span, bits) for bits in BITRATES},
    }


def _free_ports() -> list[int]:
    """Two UDP ports that nobody has."""
    with (
        socket.socket(type=socket.SOCK_DGRAM) as one,
        socket.socket(type=socket.SOCK_DGRAM) as two,
    ):
        one.bind(("", 0))
        two.bind(("", 0))
        return [one.getsockname()[1], two.getsockname()[1]]


def _sleep_until(due: float) -> None:
    time.sleep(max(due - time.monotonic(), 0.0))


class _Tap(CanDrives):
    """The policy, with all frames noted while it is asked for."""

    def __init__(self, robot: Robot, parameters: CanParameters, frames: list[Frame]) -> None:
        super().__init__(robot, parameters)
        self._frames = frames
        self.noting = False

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.noting and not self.lookout.is_host(frame):
            self._frames.append(frame)
        return super().receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        frames = super().tick(now)
        if self.noting:
            self._frames += frames
        return frames


class Bridge:
    """The bridge without ROS: link, policy and codec, in this process."""

    def __init__(self, wheels: int, rate: float, port: int, check: Callable[[], None]) -> None:
        robot = robot_of(wheels)
        values = {
            "can.interface": "udp_multicast", "can.channel": MULTICAST, "can.port": port,
            "can.nodes": tuple(range(1, wheels + 1)), "can.rate": rate, "can.counts": COUNTS,
            "can.missed_periods": 1000, "can.heartbeat_timeout": 5.0, "can.drive_heartbeat": 1.0,
            "can.configure_timeout": 2.0,
        }  # fmt: skip
        parameters = build(CanParameters, values, "can.")
        self.frames: list[Frame] = []
        self._period = 1.0 / rate
        self._link = CanLink(robot, parameters, time.monotonic)
        self._link.drives = self._tap = _Tap(robot, parameters, self.frames)
        self._command = WheelCommand(DriveMode.VELOCITY, np.zeros(wheels), np.full(wheels, 1.0))
        options = {"interface": "udp_multicast", "channel": MULTICAST, "port": port}
        self._bare = can.Bus(**options, hop_limit=0)
        self._wheels = wheels
        self._bring_up(check)

    def _bring_up(self, check: Callable[[], None]) -> None:
        drives, end = self._link.drives, time.monotonic() + STARTED
        while drives.phase is not Phase.DRIVING:
            check()
            if time.monotonic() > end:
                raise CommandError(f"the drives are not there: {drives.stop_reason}")
            if drives.phase is Phase.UNCONFIGURED:
                drives.configure(time.monotonic())
                self._link.run_until(lambda: drives.phase is not Phase.CONFIGURING, STARTED)
            elif drives.phase is Phase.IDLE:
                drives.enable(time.monotonic())
            self._link.run_until(lambda: drives.phase is not Phase.ENABLING, 1.0)

    def block(self, periods: int, measured: Side) -> None:
        """Do periods: one command each, until all drives have answered."""
        link = self._link
        link.run_until(lambda: False, 0.1)  # what came while the other side had its turn
        due = time.monotonic() + self._period
        self._tap.noting = True
        for _ in range(periods):
            _sleep_until(due)
            link.hear()
            link.drives.take_states()
            start, due = time.monotonic(), due + self._period
            link.drives.command(self._command, start)
            link.tick()
            measured.periods += 1
            while link.drives.take_states() is None:
                now = time.monotonic()
                if now >= min(due, start + PATIENCE):
                    measured.lost += 1
                    break
                link.bus.wait(min(due, start + PATIENCE) - now)
                link.hear()
            else:
                measured.trips.append(time.monotonic() - start)
        self._tap.noting = False
        if link.drives.stop_reason:
            raise CommandError(f"the drives stopped: {link.drives.stop_reason}")

    def repeat(self, periods: int, measured: Side) -> None:
        """Send the frames of one period by python-can alone; all is as the drives expect it."""
        frames = [
            can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)
            for frame in self._link.drives.tick(time.monotonic())
        ]
        _bare_block(self._bare, frames, 2 * self._wheels, self._period, periods, measured)
        while any(True for _ in self._link.bus.take()):
            pass  # to the bridge this was a second host, and it would stop

    def close(self) -> None:
        """Close the bus."""
        self._bare.shutdown()
        self._link.close()


def _bare_trip(
    bus: can.BusABC, frames: list[can.Message], answers: int, due: float
) -> float | None:
    """Send frames and wait for as many reports; their round trip, None if it is too long [s]."""
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
    bus: can.BusABC, frames: list[can.Message], answers: int, period: float, periods: int,
    measured: Side,
) -> None:  # fmt: skip
    """Do periods by python-can alone."""
    due = time.monotonic() + period
    for _ in range(periods):
        _sleep_until(due)
        while bus.recv(0.0) is not None:
            pass  # what came late
        due += period
        trip = _bare_trip(bus, frames, answers, min(due, time.monotonic() + PATIENCE))
        measured.periods += 1
        if trip is None:
            measured.lost += 1
        else:
            measured.trips.append(trip)


class Echo:
    """As many frames to and fro by python-can alone."""

    def __init__(self, wheels: int, rate: float, port: int, check: Callable[[], None]) -> None:
        options = {"interface": "udp_multicast", "channel": MULTICAST, "port": port}
        self._bus = can.Bus(**options, hop_limit=0)
        self._period = 1.0 / rate
        self._answers = 2 * wheels
        self._frames = [
            can.Message(arbitration_id=0x200 + node, data=bytes(7), is_extended_id=False)
            for node in range(1, wheels + 1)
        ]
        self._frames.append(can.Message(arbitration_id=SYNC, is_extended_id=False))
        end = time.monotonic() + STARTED
        while self._trip(time.monotonic() + 0.2) is None:
            check()
            if time.monotonic() > end:
                raise CommandError("the echo is not there")

    def _trip(self, due: float) -> float | None:
        return _bare_trip(self._bus, self._frames, self._answers, due)

    def block(self, periods: int, measured: Side) -> None:
        """Do periods."""
        _bare_block(self._bus, self._frames, self._answers, self._period, periods, measured)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


def report(result: dict[str, Any]) -> list[str]:
    """The table at the end."""
    rows: list[tuple[str, ...]] = [
        ("drives, rate", "bridge p50 / p99", "bare, same drives", "echo", "ratios", "lost",
         "CPU (echo)", "load 500k / 1M")
    ]  # fmt: skip
    for case in result["cases"]:
        ours, same, bare = case["bridge"], case["same_drives"], case["echo"]
        loads = [f"{100 * case['load'][str(bits)]:.0f} %" for bits in BITRATES]
        good = case["ratio"] <= AIM_RATIO
        ratio = paint(f"{case['ratio']:.2f}", GREEN if good else RED, sys.stdout)
        rows.append(
            (f"{case['wheels']} at {case['rate_hz']:g} Hz",
             f"{ours['median_ms']:.2f} / {ours['p99_ms']:.2f} ms",
             f"{same['median_ms']:.2f} / {same['p99_ms']:.2f} ms",
             f"{bare['median_ms']:.2f} / {bare['p99_ms']:.2f} ms",
             f"{case['ratio_same_drives']:.2f}, {ratio}",
             f"{100 * ours['lost_share']:.1f} %",
             f"{100 * ours['cpu_share']:.0f} % ({100 * bare['cpu_share']:.0f} %)",
             " / ".join(loads))
        )  # fmt: skip
    aim = f"  aim: median at most {AIM_RATIO:g} times the echo's"
    return ["", *table(rows), aim, *bench_can_faults.report(result["faults"])]
