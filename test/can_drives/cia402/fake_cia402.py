"""A small CiA 402 drive for tests of the axis: it obeys unless a test alters its behaviour.

Written from CiA 301 and the state table of CiA 402, without watchdog and ramp.
"""

import struct

from omniman_ros.can_drives.axis import REST, AxisState, Demand, Receipt
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.cia402.network import CanopenNetwork
from omniman_ros.can_drives.frame import CanFrame
from test.can_drives.fuzz import settings

SIGNED = {
    0x605A,
    0x605E,
    0x6007,
    0x6060,
    0x6061,
    0x6064,
    0x606C,
    0x6071,
    0x6077,
    0x60B1,
    0x60B2,
    0x60FF,
}
SIZES = {0x6060: 1, 0x6061: 1, 0x60C2: 1, 0x6064: 4, 0x606C: 4, 0x60FF: 4, 0x60B1: 4, 0x6085: 4}
SIZES |= {0x6079: 4, 0x6076: 4, 0x6502: 4, 0x1000: 4, 0x1016: 4, 0x1029: 1}

# (state, command bits) -> state; CiA 402 "PDS FSA", transitions 2 to 12
SHUTDOWN, SWITCH_ON, ENABLE, QUICK, DISABLE = 6, 7, 15, 2, 0
MOVES = {
    ("disabled", SHUTDOWN): "ready",
    ("ready", SWITCH_ON): "on",
    ("ready", DISABLE): "disabled",
    ("ready", QUICK): "disabled",
    ("on", ENABLE): "enabled",
    ("on", SHUTDOWN): "ready",
    ("on", DISABLE): "disabled",
    ("on", QUICK): "disabled",
    ("enabled", SWITCH_ON): "on",
    ("enabled", SHUTDOWN): "ready",
    ("enabled", DISABLE): "disabled",
    ("enabled", QUICK): "quick",
    ("quick", DISABLE): "disabled",
}
WORDS = {
    "boot": 0x0200,
    "disabled": 0x0250,
    "ready": 0x0231,
    "on": 0x0233,
    "enabled": 0x0237,
    "quick": 0x0217,
    "reaction": 0x021F,
    "fault": 0x0218,
}


class FakeDrive:
    def __init__(self, node=5, begins_anew=False):
        self.begins_anew = begins_anew  # and may receive PDOs before they are mapped
        self.node, self.nmt, self.state, self.word = node, 0x7F, "disabled", 0
        self.objects = {
            (0x1000, 0): 0x00020192,
            (0x1016, 1): 0,
            (0x1017, 0): 0,
            (0x6007, 0): 0,
            (0x603F, 0): 0,
            (0x6040, 0): 0,
            (0x6041, 0): 0,
            (0x605A, 0): 2,
            (0x6060, 0): 0,
            (0x605E, 0): 0,
            (0x1029, 1): 0,
            (0x6061, 0): 0,
            (0x6064, 0): 0,
            (0x606C, 0): 0,
            (0x6071, 0): 100,
            (0x6076, 0): 1000,
            (0x6077, 0): 0,
            (0x6079, 0): 24000,
            (0x6085, 0): 1,
            (0x60B1, 0): 7,
            (0x60B2, 0): 7,
            (0x60C2, 1): 1,
            (0x60C2, 2): -3,
            (0x60FF, 0): 4096,
            (0x6502, 0): 0x3AF,
        }
        for n in range(4):
            self.objects |= {(0x1400 + n, 1): 0x200 + 0x100 * n + node, (0x1400 + n, 2): 255}
            self.objects |= {(0x1800 + n, 1): 0x40000180 + 0x100 * n + node, (0x1800 + n, 2): 255}
            self.objects |= {(b + n, s): 0 for b in (0x1600, 0x1A00) for s in range(9)}
        self.written, self.aborts, self.ignored, self.mute = [], {}, set(), set()
        self.latched, self.syncs, self.fixes = {}, 0, True
        self.resets = 0
        self.frozen_word = self.shown_mode = None
        self.silent = set()  # of "heartbeat", "status", "motion", "sdo"

    def size(self, index, sub):
        if 0x1400 <= index < 0x1C00:
            return 4 if sub and (index & 0x200 or sub == 1) else 1
        return SIZES.get(index, 2)

    def bytes_of(self, index, sub):
        size = self.size(index, sub)
        return (self.objects[index, sub] & (1 << 8 * size) - 1).to_bytes(size, "little")

    def statusword(self):
        return WORDS[self.state] if self.frozen_word is None else self.frozen_word

    def receive(self, frame):
        """Return the frames sent in response."""
        if frame.id == 0 and frame.data[1] in (0, self.node):
            self.nmt = {1: 5, 2: 4, 0x80: 0x7F}.get(frame.data[0], 0)
            return []
        if frame.id == 0x600 + self.node and self.nmt != 4 and "sdo" not in self.silent:
            return self.serve(frame.data)
        if frame.id == 0x080 and self.nmt == 5:
            return self.sync()
        for n in range(4):
            if self.objects.get((0x1400 + n, 1)) == frame.id and self.nmt == 5:
                assert self.objects[0x1400 + n, 2] == 1 or self.begins_anew
                self.latched[n] = frame.data
        return []

    def serve(self, data):
        command, index, sub = struct.unpack_from("<BHB", data)
        key = index, sub
        answer = 0x580 + self.node
        if key in self.mute:
            return []
        write = command >> 5 == 1
        abort = self.aborts.get((*key, "w" if write else "r"), 0)
        if key not in self.objects:
            abort = abort or 0x06020000
        if abort:
            return [CanFrame(answer, struct.pack("<BHBI", 0x80, index, sub, abort))]
        if write:
            size = 4 - (command >> 2 & 3)
            assert size == self.size(*key), f"{index:04X}: {size} bytes"
            value = int.from_bytes(data[4 : 4 + size], "little", signed=index in SIGNED)
            self.written.append((index, sub, value))
            if key not in self.ignored:
                self.objects[key] = value
            if index == 0x6040:
                self.control(value)
            return [CanFrame(answer, struct.pack("<BHBI", 0x60, index, sub, 0))]
        self.objects[0x6041, 0] = self.statusword()
        raw = self.bytes_of(*key)
        return [
            CanFrame(
                answer,
                struct.pack("<BHB", 0x43 | (4 - len(raw)) << 2, index, sub) + raw.ljust(4, b"\0"),
            )
        ]

    def control(self, word):
        edge = word & 0x80 and not self.word & 0x80
        self.word = word
        if self.state == "fault" and edge:
            self.resets += 1
            if self.fixes:
                self.state = "disabled"
        self.state = MOVES.get((self.state, word & 0x0F), self.state)

    def sync(self):
        for n, data in self.latched.items():
            for i in range(self.objects[0x1600 + n, 0]):
                mapping = self.objects[0x1600 + n, i + 1]
                index, size = mapping >> 16, (mapping & 0xFF) // 8
                value, data = data[:size], data[size:]
                assert len(value) == size
                self.objects[index, 0] = int.from_bytes(value, "little", signed=index in SIGNED)
                if index == 0x6040:
                    self.control(self.objects[index, 0])
        self.latched = {}
        self.objects[0x6061, 0] = (
            self.objects[0x6060, 0] if self.shown_mode is None else self.shown_mode
        )
        self.objects[0x6041, 0] = self.statusword()
        moves = self.state == "enabled" and self.objects[0x6060, 0] in (3, 9)
        self.objects[0x606C, 0] = speed = self.objects[0x60FF, 0] if moves else 0
        self.objects[0x6064, 0] += round(0.005 * speed)
        self.syncs += 1
        frames = []
        for n, name in enumerate(("status", "motion", "supply", "")):
            cob_id = self.objects.get((0x1800 + n, 1), 1 << 31)
            if cob_id >> 31 or name in self.silent or self.syncs % self.objects[0x1800 + n, 2]:
                continue
            data = b""
            for i in range(self.objects[0x1A00 + n, 0]):
                mapping = self.objects[0x1A00 + n, i + 1]
                data += self.bytes_of(mapping >> 16, mapping >> 8 & 0xFF)
            frames.append(CanFrame(cob_id & 0x7FF, data))
        return frames

    def heartbeat(self):
        return (
            [] if "heartbeat" in self.silent else [CanFrame(0x700 + self.node, bytes((self.nmt,)))]
        )


class Bench:
    """An axis, its fake drive and the bus between them, on injected time, 5 ms a step."""

    def __init__(self, drive=None, **changes):
        given = settings(**changes)
        self.axis, self.network = Cia402Axis(given), CanopenNetwork((given,))
        self.drive = drive or FakeDrive(given.node)
        self.now, self.sent, self.receipts = 0.0, [], []
        self.demand, self.setpoint = Demand.IDLE, REST
        self.lost = lambda frame: False
        self.steps = 0

    def step(self, count=1):
        for _ in range(count):
            self.now += 0.005
            self.steps += 1
            if self.steps % 6 == 0:
                self.deliver(self.drive.heartbeat())
            frames = self.network.before(self.now)
            frames += self.axis.tick(self.demand, self.setpoint, self.now)
            frames += self.network.after(self.now)
            self.last = frames
            for frame in frames:
                self.sent.append(frame)
                self.deliver(self.drive.receive(frame))

    def deliver(self, frames):
        for frame in frames:
            if not self.lost(frame):
                self.receipts.append(self.axis.receive(frame, self.now))

    def until(self, state, seconds=3.0):
        """Step until a state is reached; return the time that it took."""
        begin = self.now
        while self.axis.state is not state:
            assert self.now - begin < seconds, (self.axis.state, self.axis.fault_reason)
            self.step()
        return self.now - begin

    def configured(self):
        self.axis.configure(self.now)
        assert self.axis.state is AxisState.CONFIGURING
        self.until(AxisState.READY)
        assert self.axis.fault_reason == ""
        return self

    def driving(self, setpoint=None):
        self.configured()
        self.demand, self.setpoint = Demand.DRIVE, setpoint or REST
        self.until(AxisState.ENABLED)
        self.step(10)
        assert self.axis.fault_reason == ""
        return self

    def tell(self, cob_id, data):
        """Deliver a frame from the drive."""
        frame = CanFrame(cob_id + self.drive.node, bytes.fromhex(data))
        receipt = self.axis.receive(frame, self.now)
        assert receipt in Receipt
        return receipt

    def rpdos(self):
        """Return the data of the RPDOs of the last step by number."""
        node = self.drive.node
        ids = {0x200 + 0x100 * n + node: n + 1 for n in range(4)}
        return {ids[f.id]: f.data for f in self.last if f.id in ids}
