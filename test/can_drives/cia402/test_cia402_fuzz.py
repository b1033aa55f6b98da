"""Arbitrary frames received by a CiA 402 axis in each of its states."""

import random

import pytest

from omniman_ros.can_drives.axis import AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from test.can_drives.cia402.fake_cia402 import Bench
from test.can_drives.fuzz import COUNT, frames

IDS = [0x000, 0x080, 0x085, 0x185, 0x285, 0x385, 0x485, 0x585, 0x605, 0x205, 0x705]


def offline(bench):
    bench.driving()
    bench.tell(0x700, "00")


def configuring(bench):
    bench.axis.configure(0.0)
    bench.step(10)


def stopping(bench):
    bench.driving()
    bench.demand = Demand.STOP
    bench.step(3)


def fault(bench):
    bench.driving()
    bench.drive.state = "fault"
    bench.step(3)


BEGINNINGS = {
    AxisState.OFFLINE: offline,
    AxisState.CONFIGURING: configuring,
    AxisState.READY: Bench.configured,
    AxisState.ENABLED: Bench.driving,
    AxisState.STOPPING: stopping,
    AxisState.FAULT: fault,
}
ENABLED = CanFrame(0x185, bytes.fromhex("3702090000"))
SETPOINTS = [
    DriveSetpoint(DriveMode.VELOCITY, 40.0, 0.3),
    DriveSetpoint(DriveMode.VELOCITY, -40.0, -0.3),
]


def quiet(axis, frame):
    """Return whether a frame requests no motion."""
    if frame.id == 0x205:
        return frame.data[2:6] == bytes(4)
    if frame.id == 0x305:
        return frame.data[2:4] == bytes(2)
    return frame.id != 0x405 or frame.data == bytes(2)


@pytest.mark.parametrize("begin", list(AxisState))
def test_no_frame_raises_or_moves_a_drive_that_is_not_enabled(begin):
    bench = Bench(feed_forward=True, mode=DriveMode.TORQUE)
    BEGINNINGS[begin](bench)
    axis, chance = bench.axis, random.Random(begin.value)
    assert axis.state is begin
    receipts, moved, states = set(), 0, set()
    demand = Demand.DRIVE
    for k, frame in enumerate(frames(begin.value, COUNT, IDS)):
        bench.now += 0.005 * (chance.random() < 0.04)
        receipts.add(axis.receive(frame, bench.now))
        states.add(axis.state)
        if k % 3 == 0:
            before = axis.state
            enabled = before is AxisState.ENABLED and not axis.fault_reason
            if chance.random() < 0.1:
                demand = chance.choice(list(Demand))
            sent = axis.tick(demand, chance.choice(SETPOINTS), bench.now)
            still = all(quiet(axis, frame) for frame in sent)
            assert still or (enabled and demand is Demand.DRIVE)
            moved += not still
            assert all(
                (frame.id, frame.extended) in axis.command_ids | {(0, False)} for frame in sent
            )
        if chance.random() < 0.05:
            axis.reset(bench.now)
            axis.receive(ENABLED, bench.now)
        if chance.random() < 0.002:
            # a whole configuration in between: random answers do not make one
            bench.drive.state = chance.choice(("fault", "disabled"))
            bench.demand = Demand.IDLE
            axis.configure(bench.now)
            for _ in range(200):
                bench.step()
                if axis.state in (AxisState.READY, AxisState.FAULT):
                    break
            bench.demand = Demand.DRIVE
            bench.step(8)
            bench.sent.clear()
            bench.receipts.clear()
    assert receipts == set(Receipt)
    assert moved > COUNT / 200
    assert {AxisState.OFFLINE, AxisState.ENABLED} <= states
