"""One simulated CiA 402 drive with a motor of its own, on injected time."""

import struct

import can

from omniman_ros.simulation.can_drives.cia402.drive import Cia402Drive, Cia402Settings

STATE = {
    0x40: "disabled",
    0x21: "ready",
    0x23: "on",
    0x27: "enabled",
    0x07: "quick stop",
    0x0F: "reaction",
    0x08: "fault",
}


class FakeMotor:
    """Follows at once; ramps where it is halted; coasts where it is released."""

    def __init__(self):
        self.position = self.velocity = self.torque = self.current = self.voltage = 0.0
        self.supply, self.lost = 48.0, False
        self.order = ("none",)
        self.halts = 0

    def follow_velocity(self, velocity, torque=0.0):
        self.order = ("velocity", velocity, torque)
        self.velocity = velocity

    def follow_torque(self, torque):
        self.order = ("torque", torque)
        self.torque = torque

    def follow_voltage(self, voltage):
        raise AssertionError("CiA 402 knows no voltage")

    def halt(self, deceleration):
        self.order = ("halt", deceleration)
        self.halts += 1

    def release(self):
        self.order, self.lost = ("release",), False

    def tick(self, step):
        if self.order[0] == "halt":
            change = min(abs(self.velocity), self.order[1] * step)
            self.velocity -= change if self.velocity > 0 else -change
        self.position += self.velocity * step


class Rig:
    """The drive, its motor and a clock; `log` records sent frames as (time, id, data)."""

    def __init__(self, node=5, boot=True, **settings):
        settings = {
            "counts": 4096,
            "velocity_scale": 4096,
            "rated_torque": 2.0,
            "rated_current": 10.0,
            "standstill": 0.5,
            "undervoltage": 24.0,
            "quick_stop_deceleration": 100.0,
            **settings,
        }
        self.motor = FakeMotor()
        self.drive = Cia402Drive(self.motor, node, Cia402Settings(**settings))
        self.node, self.now, self.log = node, 10.0, []
        if boot:
            self.run(0.05)

    def take(self, frames):
        frames = [(frame.arbitration_id, bytes(frame.data)) for frame in frames]
        self.log += [(self.now, *frame) for frame in frames]
        return frames

    def run(self, seconds, each=None, period=0.001):
        """Advance time; return the frames sent."""
        frames = []
        for _ in range(round(seconds / period)):
            self.now += period
            self.motor.tick(period)
            if each:
                each()
            frames += self.take(self.drive.advance(self.now))
        return frames

    def send(self, can_id, data, **kind):
        """Send a frame with data in hex or as bytes; return the answers."""
        data = bytes.fromhex(data) if isinstance(data, str) else data
        kind = {"is_extended_id": False, **kind}
        message = can.Message(arbitration_id=can_id, data=data, **kind)
        return self.take(self.drive.receive(message, self.now))

    def nmt(self, command, node=None):
        return self.send(0, bytes([command, self.node if node is None else node]))

    def sync(self):
        return self.send(0x80, b"")

    def beat(self, master=1, state=5):
        return self.send(0x700 + master, bytes([state]))

    def ask(self, request):
        """The one answer of the SDO server; other frames may come with it."""
        frames = self.send(0x600 + self.node, request)
        (answer,) = [data for can_id, data in frames if can_id == 0x580 + self.node]
        return answer

    def write(self, index, sub, value, size):
        """SDO download; 0, or the abort code."""
        signed = value < 0
        data = value.to_bytes(size, "little", signed=signed).ljust(4, b"\0")
        request = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + data
        answer = self.ask(request)
        assert struct.unpack_from("<HB", answer, 1) == (index, sub)
        if answer[0] == 0x80:
            return struct.unpack_from("<L", answer, 4)[0]
        assert answer[0] == 0x60
        return 0

    def read(self, index, sub=0, signed=True):
        """SDO upload; a negative number is an abort code."""
        request = struct.pack("<BHB4x", 0x40, index, sub)
        answer = self.ask(request)
        if answer[0] == 0x80:
            return -struct.unpack_from("<L", answer, 4)[0]
        size = 4 - (answer[0] >> 2 & 3)
        return int.from_bytes(answer[4 : 4 + size], "little", signed=signed)

    def control(self, *words):
        """Write controlwords by SDO, one after the other."""
        for word in words:
            assert self.write(0x6040, 0, word, 2) == 0

    @property
    def word(self):
        return self.read(0x6041, signed=False)

    @property
    def state(self):
        mask = 0x6F if self.word & 0x6F in (0x21, 0x23, 0x27, 0x07) else 0x4F
        return STATE[self.word & mask]

    def enable(self, mode=9):
        assert self.write(0x6060, 0, mode, 1) == 0
        self.control(0x06, 0x07, 0x0F)
        assert self.state == "enabled"

    def map(self, base, entries, kind=1, can_id=None):
        """Map a PDO by the procedure of CiA 301."""
        cob = self.read(base, 1, signed=False) & 0x7FF if can_id is None else can_id
        assert self.write(base, 1, 0x8000_0000 | cob, 4) == 0
        assert self.write(base + 0x200, 0, 0, 1) == 0
        for sub, entry in enumerate(entries, 1):
            assert self.write(base + 0x200, sub, entry, 4) == 0
        assert self.write(base + 0x200, 0, len(entries), 1) == 0
        assert self.write(base, 2, kind, 1) == 0
        assert self.write(base, 1, cob, 4) == 0

    def off(self, *pdos):
        for base in pdos:
            assert self.write(base, 1, 0x8000_0000 | self.read(base, 1, False) & 0x7FF, 4) == 0

    def cyclic(self, mode=9):
        """Map what a host of wheels would, start the node, enable the drive; PDOs by SYNC."""
        target = 0x60FF_0020 if mode in (3, 9) else 0x6071_0010
        self.map(0x1400, [0x6040_0010, target])
        self.map(0x1800, [0x6041_0010, 0x6061_0008, 0x6077_0010])
        self.map(0x1801, [0x6064_0020, 0x606C_0020])
        self.write(0x6060, 0, mode, 1)
        self.nmt(1)
        for word in (6, 7, 15):
            self.command(word, 0, mode)

    def command(self, word, target=0, mode=9):
        """Send one RPDO and one SYNC; return the answers."""
        layout = "<Hi" if mode in (3, 9) else "<Hh"
        self.send(0x200 + self.node, struct.pack(layout, word, target))
        return self.sync()
