"""The CiA 402 axis with a drive on an independent CANopen stack: npm's `canopen`.

The drive is a process of its own; its time, like the axis', is injected. To install the stack:
`npm ci --ignore-scripts` in test/can_drives/npm, or in another directory that OMNIMAN_NPM names.
"""

import math
import os
import shutil
import subprocess
import threading
from pathlib import Path

import pytest

from omniman_ros.can_drives.axis import REST, AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.cia402.network import CanopenNetwork
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from test.can_drives.fuzz import settings

HERE = Path(__file__).parents[1] / "npm"
PLACES = [Path(p) / "node_modules" for p in (HERE, os.environ.get("OMNIMAN_NPM")) if p]
MISSING = f"npm's canopen is not in {' or '.join(map(str, PLACES))}"
MODULES = [place for place in PLACES if (place / "canopen").is_dir()]
NODE = shutil.which("node")
PATIENCE = 60.0  #: Time after which a drive that hangs is ended, s

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(NODE is None, reason="node is not installed"),
    pytest.mark.skipif(not MODULES, reason=MISSING),
]


class NpmBench:
    """The axis and the process of the drive, connected by lines of text; 5 ms per step."""

    def __init__(self, **changes):
        given = settings(**({"rated_torque": 0.0} | changes))
        self.axis, self.network = Cia402Axis(given), CanopenNetwork((given,))
        self.process = subprocess.Popen(
            [NODE, HERE / "drive.js", str(given.node)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"NODE_PATH": str(MODULES[0])},
        )
        self.watchdog = threading.Timer(PATIENCE, self.process.kill)
        self.watchdog.start()
        self.now, self.demand, self.setpoint = 0.0, Demand.IDLE, REST
        self.receipts, self.heard, self.host_lives = [], [], True

    def close(self):
        self.watchdog.cancel()
        self.process.stdin.close()
        self.process.wait(10.0)
        self.process.stdout.close()

    def say(self, line):
        self.process.stdin.write(line + "\n")

    def step(self, count=1):
        for _ in range(count):
            self.now += 0.005
            frames = self.network.before(self.now) if self.host_lives else []
            frames += self.axis.tick(self.demand, self.setpoint, self.now)
            for frame in [*frames, *self.network.after(self.now)]:
                self.say(str(frame))
            self.say(f"@{self.now:.6f}")
            self.process.stdin.flush()
            while (line := self.process.stdout.readline().strip()) != ".":
                assert line, "the drive's process has ended"
                id, data = line.split("#")
                self.heard.append(line)
                frame = CanFrame(int(id, 16), bytes.fromhex(data))
                self.receipts.append(self.axis.receive(frame, self.now))

    def until(self, state, seconds=3.0):
        begin = self.now
        while self.axis.state is not state:
            assert self.now - begin < seconds, (self.axis.state, self.axis.fault_reason)
            self.step()


@pytest.fixture
def bench():
    bench = NpmBench()
    yield bench
    bench.close()


@pytest.fixture
def driving(bench):
    bench.axis.configure(0.0)
    bench.until(AxisState.READY)
    bench.demand, bench.setpoint = Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, 20.0)
    bench.until(AxisState.ENABLED)
    bench.step(20)
    assert bench.axis.fault_reason == ""
    return bench


def test_drive_is_configured_enabled_and_follows_a_velocity(bench):
    bench.axis.configure(0.0)
    bench.until(AxisState.READY)
    assert bench.heard[0] == "705#00"
    assert bench.axis.fault_reason == ""
    bench.demand, bench.setpoint = Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, 20.0)
    bench.until(AxisState.ENABLED)
    feedback = bench.axis.feedback
    assert feedback.velocity == 0.0  # the stale target did not move it
    bench.step(5)
    begin = feedback.position
    bench.step(100)
    assert feedback.velocity == pytest.approx(20.0, abs=0.01)
    # 0.5 s; the counter begins 647 short of its end, and is not noticed to wrap
    assert feedback.position - begin == pytest.approx(10.0, abs=0.02)
    assert any(line.startswith("285#") and line[10] in "89ABCDEF" for line in bench.heard)
    assert feedback.torque == pytest.approx(0.15)  # 100 / 1000 of 6076
    assert feedback.bus_voltage == pytest.approx(24.5)
    assert set(bench.receipts) == {Receipt.ACCEPTED}
    assert bench.axis.fault_reason == ""


def test_drive_stops_quickly_on_its_own_ramp_and_drives_again(driving):
    bench, feedback = driving, driving.axis.feedback
    bench.demand = Demand.STOP
    bench.until(AxisState.STOPPING, 0.015)
    speed = feedback.velocity
    bench.step()
    assert speed - feedback.velocity == pytest.approx(200.0 * 0.005, abs=0.01)  # 6085
    bench.step(40)
    assert (feedback.velocity, bench.axis.state) == (0.0, AxisState.STOPPING)
    bench.demand = Demand.DRIVE
    bench.until(AxisState.ENABLED)
    bench.step(3)
    assert feedback.velocity == pytest.approx(20.0, abs=0.01)
    assert bench.axis.fault_reason == ""


def test_emergency_is_detected(driving):
    driving.say("!emcy 3210")
    driving.step()
    assert driving.axis.fault_reason.startswith("EMCY 3210 (Voltage)")
    driving.until(AxisState.STOPPING, 0.015)


def test_fault_is_detected_and_reset(driving):
    driving.say("!fault")
    driving.until(AxisState.FAULT, 0.015)
    assert "EMCY 2310 (Current)" in driving.axis.fault_reason
    assert "fault, statusword 0218" in driving.axis.fault_reason
    driving.demand = Demand.IDLE
    driving.axis.reset(driving.now)
    driving.until(AxisState.READY, 0.2)
    driving.step(10)
    assert (driving.axis.fault_reason, driving.axis.state) == ("", AxisState.READY)
    assert math.isclose(driving.axis.feedback.velocity, 0.0)


def test_restart_is_detected_and_configured_by_a_reset(driving):
    driving.say("!reboot")
    driving.step()
    assert driving.axis.fault_reason.startswith("restarted (boot-up)")
    assert driving.axis.state is AxisState.OFFLINE
    driving.demand = Demand.IDLE
    driving.axis.reset(driving.now)
    driving.until(AxisState.READY)
    assert driving.axis.fault_reason == ""


def test_drive_stops_by_itself_without_the_heartbeat_of_the_host(driving):
    begin = driving.now
    driving.host_lives = False
    while not driving.axis.fault_reason:
        driving.step()
        assert driving.now - begin < 0.5
    assert "EMCY 8130 (Monitoring)" in driving.axis.fault_reason
    assert 0.07 < driving.now - begin <= 0.1 + 0.005 + 1e-9  # 1016:01 is 0.1 s
    driving.step(40)
    assert driving.axis.feedback.velocity == 0.0
