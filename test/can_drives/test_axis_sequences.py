"""Random sequences of plausible frames, demands, times, resets and configurations, per protocol.

A mostly obedient drive answers; its frames are occasionally lost, repeated, old or
somebody else's. What must hold after each step is in `Walk.tick` and `Walk.look`.
"""

import math
import random
import struct
from collections import Counter

import pytest

from omniman_ros.can_drives.axis import AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.odrive import OdriveAxis
from omniman_ros.can_drives.vesc import VescAxis
from omniman_ros.control.wheel_cascade import DriveMode
from test.can_drives.cia402.fake_cia402 import WORDS, FakeDrive
from test.can_drives.fuzz import settings

STEPS = 20_000
NODE = 5
#: Steps of time; a steady clock makes none back, but nothing may move if it did
TIMES = [0.005] * 1500 + [0.0, 0.001, 0.02] * 30 + [0.2, 5.0, 1e6, -0.01, -3.0, -1e6]
VALUES = [0.0, 3.0, -40.0, 1e9]


class Walk:
    """One axis with its drive and bus.

    Attributes:
        follows_stops: Whether STOP follows its setpoint.
    """

    follows_stops, steps = True, STEPS
    modes = (DriveMode.VELOCITY, DriveMode.TORQUE)

    def __init__(self, seed, axis):
        self.chance, self.axis = random.Random(seed), axis
        self.now, self.demand, self.configured = 0.0, Demand.IDLE, False
        self.seen, self.moved, self.receipts = Counter(), 0, set()
        self.last = []

    def run(self):
        for _ in range(self.steps):
            before, call = self.axis.fault_reason, self.chance.random()
            self.now += self.chance.choice(TIMES)
            if call < 0.001:
                self.axis.configure(self.now)
                assert self.axis.state is AxisState.CONFIGURING and not self.axis.fault_reason
                self.configured, before = True, ""
            elif call < 0.005 or (before and call < 0.1):
                was = self.axis.state
                self.axis.reset(self.now)
                assert self.axis.state in (was, AxisState.CONFIGURING)
                assert not self.axis.fault_reason
                before = ""
            elif call < 0.55:
                self.tick()
            else:
                for frame in self.reports():
                    self.hear(frame)
            self.look(before)
        assert self.receipts == set(Receipt)

    def tick(self):
        axis = self.axis
        if self.chance.random() < 0.04:
            self.demand = self.chance.choice(
                [Demand.DRIVE, Demand.DRIVE, Demand.STOP, Demand.IDLE]
            )
        mode = self.chance.choice(self.modes)
        setpoint = DriveSetpoint(mode, self.chance.choice(VALUES), self.chance.choice(VALUES))
        state = axis.state
        frames = axis.tick(self.demand, setpoint, self.now)
        moved = any(map(self.moves, frames))
        may = self.demand is Demand.DRIVE or (self.demand is Demand.STOP and self.follows_stops)
        assert not moved or (state is AxisState.ENABLED and may), (state, self.demand, frames)
        assert len({frame.id for frame in frames if not frame.remote}) <= 5
        assert all((f.id, f.extended) in axis.command_ids or f.remote or f.id == 0 for f in frames)
        self.moved += moved
        self.check(state, frames)
        self.obey(frames)
        if self.chance.random() < 0.8:
            for frame in self.reports():
                self.hear(frame)

    def hear(self, frame):
        chance = self.chance.random()
        if chance < 0.01:
            return
        if chance < 0.015:
            frame = frame._replace(data=frame.data[: self.chance.randrange(8)])
        elif chance < 0.03 and self.last:
            frame = self.chance.choice(self.last)
        elif chance < 0.033:
            frame = frame._replace(id=frame.id ^ 1 << self.chance.randrange(11))
        elif chance < 0.035:
            frame = frame._replace(data=self.chance.randbytes(len(frame.data)))
        self.last = [*self.last[-20:], frame]
        self.receipts.add(self.axis.receive(frame, self.now))

    def look(self, before):
        axis = self.axis
        assert axis.state in AxisState and isinstance(axis.fault_reason, str)
        assert axis.fault_reason.startswith(before)
        for value in (axis.feedback.position, axis.feedback.velocity, axis.feedback.torque):
            assert not math.isinf(value)
        self.seen[axis.state] += 1


class Cia402Walk(Walk):
    follows_stops, steps = False, 3 * STEPS  # most of them configure it

    def __init__(self, seed):
        super().__init__(seed, Cia402Axis(settings(mode=DriveMode.TORQUE, feed_forward=True)))
        self.drive, self.answers, self.driven, self.ran = FakeDrive(NODE), [], 0, False

    def moves(self, frame):
        if frame.id == 0x205:
            return any(frame.data[2:6])
        return frame.id in (0x305, 0x405) and any(frame.data[-3:-1] or frame.data)

    def check(self, state, frames):
        """Check that a stop or release is sent in every state except during configuration."""
        self.driven = self.driven + 1 if self.demand is Demand.DRIVE else 0
        words = [struct.unpack_from("<H", f.data)[0] for f in frames if f.id in (0x205, 0x305)]
        self.ran |= self.axis.state not in (AxisState.OFFLINE, AxisState.CONFIGURING)
        if state is AxisState.CONFIGURING or not self.ran:
            assert not words or self.axis.state is AxisState.OFFLINE
            return
        (word,) = words
        if self.demand is Demand.STOP:
            assert word in (0x02, 0x00, 0x80)
        elif self.demand is Demand.IDLE:
            assert word in (0x06, 0x00, 0x80)
        if self.axis.fault_reason:
            assert word & 0x0F != 0x0F
        if self.driven <= 3:
            assert not any(map(self.moves, frames))

    def obey(self, frames):
        for frame in [*frames, CanFrame(0x080, b"")]:
            if self.chance.random() < 0.99:
                self.answers += self.drive.receive(frame)

    def reports(self):
        answers, self.answers = self.answers, []
        chance = self.chance.random()
        if chance < 0.002:
            self.drive = FakeDrive(NODE, begins_anew=True)
            return [CanFrame(0x705, b"\x00")]
        if chance < 0.005:
            self.drive.state = self.chance.choice(list(WORDS))
        elif chance < 0.007:
            return [*answers, CanFrame(0x085, self.chance.randbytes(8))]
        elif chance < 0.009:
            self.drive.nmt = 0x7F
        return [*answers, *self.drive.heartbeat()]


class VescWalk(Walk):
    modes = tuple(DriveMode)

    def __init__(self, seed):
        super().__init__(seed, VescAxis(settings()))
        self.tachometer = self.released = 0

    def moves(self, frame):
        return any(frame.data)

    def check(self, state, frames):
        (frame,) = frames
        if self.demand is Demand.IDLE or (state is AxisState.CONFIGURING):
            assert frame == CanFrame(0x0105, bytes(4), True)
        elif state is not AxisState.ENABLED and not any(frame.data):
            assert frame.id in (0x0105, 0x0305)

    def obey(self, frames):
        pass

    def reports(self):
        chance = self.chance.random()
        if chance < 0.003:
            self.tachometer = 0
            return [CanFrame(0x3905, b"\x05", True)] if chance < 0.001 else []
        self.tachometer += self.chance.randrange(-10, 30)
        supply = 0 if chance < 0.01 else 240
        status = struct.pack(">ihh", 1000, -20, self.chance.choice((-300, 0, 300)))
        status_5 = struct.pack(">ihh", self.tachometer, supply, 0)
        return [CanFrame(0x0905, status, True), CanFrame(0x1B05, status_5, True)]


class OdriveWalk(Walk):
    def __init__(self, seed):
        super().__init__(seed, OdriveAxis(settings(feed_forward=True)))
        self.state, self.error, self.turns = 1, 0, 0.0

    def moves(self, frame):
        return not frame.remote and frame.id & 31 in (0x0D, 0x0E) and any(frame.data)

    def check(self, state, frames):
        """Check that each tick sends a setpoint and that IDLE never requests closed loop."""
        assert any(f.id & 31 in (0x0D, 0x0E) and not f.remote for f in frames)
        asked = [f.data[0] for f in frames if f.id & 31 == 0x07]
        if self.demand is not Demand.DRIVE or self.axis.fault_reason:
            assert 8 not in asked

    def obey(self, frames):
        for frame in frames:
            if frame.remote or self.chance.random() < 0.02:
                continue
            if frame.id & 31 == 0x07:
                self.state = 1 if self.error else frame.data[0]
            elif frame.id & 31 == 0x18:
                self.error = 0

    def reports(self):
        chance = self.chance.random()
        if chance < 0.002:
            self.state, self.turns = 1, 0.0
        elif chance < 0.004:
            self.state, self.error = 1, 1 << self.chance.randrange(32)
        elif chance < 0.005:
            self.state = self.chance.randrange(256)
        self.turns += self.chance.uniform(-0.1, 0.3)
        return [
            CanFrame(NODE << 5 | 0x01, struct.pack("<IBxxx", self.error, self.state)),
            CanFrame(NODE << 5 | 0x09, struct.pack("<ff", self.turns, 1.0)),
            CanFrame(NODE << 5 | 0x17, struct.pack("<ff", 24.0, 1.0)),
        ]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", [Cia402Walk, VescWalk, OdriveWalk])
def test_no_sequence_moves_a_drive_that_is_not_enabled_and_commanded(kind, seed):
    walk = kind(seed)
    walk.run()
    assert walk.moved > STEPS // 100
    states = set(AxisState)
    if walk.follows_stops:
        states.discard(AxisState.STOPPING)
    if kind is VescWalk:
        states.discard(AxisState.FAULT)
    for state in states:
        assert walk.seen[state] > STEPS // 200, (state, walk.seen)
