"""`omniman bench can`: round trips of the bridge over a bus, compared with bare python-can.

A round trip begins with the frames of a period and ends when all drives have answered. In every
other block, python-can alone sends the bridge's own frames to the same drives.
"""

import argparse
import os
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import can
import numpy as np

from omniman_ros.can_drives.drives import CanDrivesPhase
from omniman_ros.can_drives.frame import CanFrame, bus_load
from omniman_ros.can_drives.link import CanLink
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.lab.bench.can_drives import COUNTS, open_bus
from omniman_ros.lab.bench.harness import BenchmarkTable, at_most, conclude
from omniman_ros.lab.measurement import cpu_time, spread_ms
from omniman_ros.processes.drive_options import MULTICAST_GROUP
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec, redirect_signals
from omniman_ros.processes.robot_setup import node_command
from omniman_ros.robots import robot_parameters

AIM_RATIO = 2.0  #: largest ratio of the bridge's median round-trip time to that of python-can
RATES = (100.0, 250.0, 500.0)  #: [Hz]
WHEELS = 4
BITRATES = (500_000, 1_000_000)  #: for which the bus load is computed [bit/s]
TRIP_TIMEOUT = 0.05  #: duration after which a round trip counts as lost [s]
START_TIMEOUT = 20.0  #: longest time until the drives are ready [s]
ANSWERS = (0x180, 0x280)  #: function codes of the transmit PDOs 1 and 2


@dataclass
class Side:
    """The measurements of the bridge or of python-can in all its blocks."""

    trips: list[float] = field(default_factory=list)  #: completed round trips [s]
    lost: int = 0  #: periods whose round trip was not completed in time
    periods: int = 0
    cpu: float = 0.0  #: CPU time of this process [s]
    wall: float = 0.0  #: duration [s]

    def summary(self) -> dict[str, float]:
        """Return the figures of the side; times are NaN if no round trip was completed."""
        return {
            **spread_ms(self.trips),
            "lost_share": self.lost / max(self.periods, 1),
            "cpu_share": self.cpu / max(self.wall, 1e-9),
        }


class Bridge:
    """The bridge without ROS, in this process; its drives are ready after construction.

    Raises:
        CommandError: The drives are not ready in time, or have ended.
    """

    def __init__(self, rate: float, port: int, check: Callable[[], None]) -> None:
        robot = build(Platform, robot_parameters("omniman"))
        values = {
            "can.interface": "udp_multicast",
            "can.channel": MULTICAST_GROUP,
            "can.port": port,
            "can.nodes": tuple(range(1, WHEELS + 1)),
            "can.rate": rate,
            "can.counts": COUNTS,
            "can.missed_periods": 1000,
            "can.heartbeat_timeout": 5.0,
            "can.drive_heartbeat": 1.0,
            "can.configure_timeout": 2.0,
        }
        parameters = build(CanParameters, values, "can.")
        self._period, self._check = 1.0 / rate, check
        self._link = CanLink(robot, parameters, time.monotonic)
        self._drives = self._link.drives
        self.frames: list[CanFrame] = []  #: frames of a period: commands and answers
        self._command = WheelCommand(DriveMode.VELOCITY, np.zeros(WHEELS), np.ones(WHEELS))
        self._bare = open_bus(port)
        self._bring_up()

    def _bring_up(self) -> None:
        drives, end = self._drives, time.monotonic() + START_TIMEOUT
        while drives.phase is not CanDrivesPhase.DRIVING:
            self._check()
            if time.monotonic() > end:
                raise CommandError(f"the drives are not ready: {drives.stop_reason}")
            if drives.phase is CanDrivesPhase.UNCONFIGURED:
                drives.configure(time.monotonic())
                self._link.run_until(
                    lambda: drives.phase is not CanDrivesPhase.CONFIGURING, START_TIMEOUT
                )
            elif drives.phase is CanDrivesPhase.IDLE:
                drives.enable(time.monotonic())
            self._link.run_until(lambda: drives.phase is not CanDrivesPhase.ENABLING, 1.0)

    def block(self, periods: int, measured: Side) -> None:
        """Run periods of the bridge: one command each, until all drives have answered."""
        self._link.run_until(lambda: False, 0.1)  # frames that arrived during the other block
        self._periods(periods, measured, self._discard_states, self._bridge_trip)
        if self._drives.stop_reason:
            raise CommandError(f"the drives stopped: {self._drives.stop_reason}")

    def bare_block(self, periods: int, measured: Side) -> None:
        """Run periods of python-can alone: the bridge's frames to the same drives."""
        frames = self._drives.tick(time.monotonic())
        trip = lambda due: self._bare_trip(frames, due)  # noqa: E731
        self._periods(periods, measured, self._discard_frames, trip)
        while any(True for _ in self._link.bus.take()):
            pass  # discarded: the bridge would stop, as the frames seem to be of a second host

    def _periods(
        self,
        periods: int,
        measured: Side,
        discard: Callable[[], None],
        trip: Callable[[float], bool],
    ) -> None:
        """Run periods, each of which discards late answers, and makes a round trip until due."""
        cpu, begin = cpu_time(os.getpid()), time.monotonic()
        due = begin + self._period
        for _ in range(periods):
            time.sleep(max(due - time.monotonic(), 0.0))
            discard()
            start, due = time.monotonic(), due + self._period
            if trip(min(due, start + TRIP_TIMEOUT)):
                measured.trips.append(time.monotonic() - start)
            else:
                measured.lost += 1
        measured.periods += periods
        measured.cpu += cpu_time(os.getpid()) - cpu
        measured.wall += time.monotonic() - begin
        self._check()

    def _discard_states(self) -> None:
        self._link.receive()
        self._drives.take_states()

    def _bridge_trip(self, due: float) -> bool:
        self._drives.set_command(self._command, time.monotonic())
        self._link.tick()
        while self._drives.take_states() is None:
            left = due - time.monotonic()
            if left <= 0.0:
                return False
            self._link.bus.wait(left)
            self._link.receive()
        return True

    def _discard_frames(self) -> None:
        while self._bare.recv(0.0) is not None:
            pass

    def _bare_trip(self, frames: list[CanFrame], due: float) -> bool:
        for frame in frames:
            self._bare.send(can.Message(0.0, frame.id, False, data=frame.data))
        answers: list[CanFrame] = []
        while len(answers) < len(ANSWERS) * WHEELS:
            message = self._bare.recv(max(due - time.monotonic(), 0.0))
            if message is None:
                return False
            if message.arbitration_id & 0x780 in ANSWERS:
                answers.append(CanFrame(message.arbitration_id, bytes(message.data)))
        self.frames = [*frames, *answers]
        return True

    def close(self) -> None:
        """Close both connections to the bus."""
        self._bare.shutdown()
        self._link.close()


def measure(rate: float, blocks: int, periods: int) -> dict[str, Any]:
    """Measure the bridge and python-can in alternating blocks, at a rate [Hz]."""
    say(f"{WHEELS} drives at {rate:g} Hz ...")
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = int(free.getsockname()[1])
    given = (str(port), str(WHEELS), str(rate))
    drives = ProcessSpec("drives", node_command("omniman_ros.lab.bench.can_drives", given))
    children, ours, bare = ProcessGroup([drives]), Side(), Side()
    with redirect_signals(children.interrupt), children:
        bridge = Bridge(rate, port, children.check)
        try:
            for _ in range(blocks):
                bridge.block(periods, ours)
                bridge.bare_block(periods, bare)
        finally:
            bridge.close()
    load = {str(bits): bus_load(bridge.frames, 1.0 / rate, bits) for bits in BITRATES}
    both = ours.summary(), bare.summary()
    return {
        "rate_hz": rate,
        "bridge": both[0],
        "python_can": both[1],
        "ratio": both[0]["median_ms"] / both[1]["median_ms"],
        "frames_per_period": len(bridge.frames),
        "load": load,
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench can`; return 0, the exit code of a successful measurement."""
    blocks, periods = (2, 20) if args.quick else (10, 100)
    cases = [measure(rate, blocks, periods) for rate in RATES]
    result: dict[str, Any] = {"quick": args.quick, "cases": cases}
    return conclude("can", result, report(result), args.results)


def report(result: dict[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = []
    for case in result["cases"]:
        both = case["bridge"], case["python_can"]
        times = [f"{side['median_ms']:.2f} / {side['p99_ms']:.2f} ms" for side in both]
        cpu = " / ".join(f"{side['cpu_share']:.0%}" for side in both)
        load = " / ".join(f"{case['load'][str(bits)]:.0%}" for bits in BITRATES)
        about = f"{WHEELS} drives at {case['rate_hz']:g} Hz"
        ratio = at_most(about, case["ratio"], AIM_RATIO, "{:.2f}")
        values = (*times, *ratio.values, f"{both[0]['lost_share']:.1%}", cpu, load)
        rows.append(ratio._replace(values=values))
    titles = ("bridge p50 / p99", "python-can", "ratio", "lost", "CPU of both", "load 500k / 1M")
    return [BenchmarkTable(titles, rows)]
