"""A simulated drive with CiA 402 over CANopen: what it hears, says and watches on the bus.

Written from CiA 301 and CiA 402-2. The SDO server, the object dictionary and the emergency
producer are those of the `canopen` library; its `LocalNode` lacks NMT gating, PDOs by SYNC, the
consumer of heartbeats, and produces its own with a thread: all these are here.
"""

import math
import struct
from collections.abc import Sequence
from typing import Any

import can
import canopen
from canopen import SdoAbortedError
from canopen import objectdictionary as od

from omniman_ros.drive.can.cia402_axis import Cia402Settings, PowerDrive
from omniman_ros.drive.can.cia402_errors import PDO_LONG, PDO_SHORT, Errors
from omniman_ros.drive.can.cia402_objects import ALL, Key, Value, dictionary
from omniman_ros.drive.can.cia402_pdo import EVENT, INVALID_VALUE, Pdo, all_pdos
from omniman_ros.drive.can.motor import DriveFaults, Motor

__all__ = ["Cia402Drive", "Cia402Settings"]

BOOTING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
"""States of the node, as its heartbeat tells them (CiA 301, 7.2.8.3.2)."""
START, STOP, ENTER_PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
NEXT = {START: OPERATIONAL, STOP: STOPPED, ENTER_PRE_OPERATIONAL: PRE_OPERATIONAL}
"""NMT command to state (CiA 301, 7.2.8.2.1)."""
ON_ERROR = {0: PRE_OPERATIONAL, 2: STOPPED}
"""Value of 1029:01 to where an operational node goes when its host is lost."""

NMT, RESPONSE, REQUEST, MONITOR = 0x000, 0x580, 0x600, 0x700
GENERAL_ERROR = 0x0800_0000
NO_DATA = 0x0800_0024
INCOMPATIBLE = 0x0604_0043
REFUSED = 0x0800_0022
ABORT = struct.Struct("<BHBL")
MOTION = (0x6064, 0x606C)
PATIENCE = 0.002
"""Longest time between two runs of its timers that does not let a late heartbeat pass, s."""
SLACK = 1e-6
"""By so much a timer may run out early: sums of periods are not exact, s."""
COMMUNICATION_OBJECTS = range(0x1000, 0x2000)


class _NoTask:
    """Stands for a periodic message that is not sent: the drive keeps its own time."""

    def update(self, data: Any) -> None:
        """Change nothing."""

    def stop(self) -> None:
        """Stop nothing."""


class _Outbox(canopen.Network):
    """A network without a bus: it collects what is sent, and starts no thread."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[tuple[can.Message, Pdo | None]] = []

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Keep a frame."""
        self.put(can_id, bytes(data))

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:
        """Send nothing."""
        return _NoTask()

    def put(self, can_id: int, data: bytes, pdo: Pdo | None = None) -> None:
        """Keep a frame, and the PDO that it is."""
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        self.frames.append((message, pdo))


class Cia402Drive:
    """Firmware of one drive; a `BusDrive`.

    A controlword that comes with a SYNC acts after the drive has sampled what it reports at that
    SYNC. Event-driven TPDOs are sent on change, on entering operational, and by their event timer.

    Args:
        motor: The motor.
        node: Id, 1 to 127.
        settings: Of the drive.

    Attributes:
        faults: Faults to play, changed from outside at any time.
        nmt: State of the node, as in its heartbeat.
        axis: What it does with the motor.
    """

    def __init__(self, motor: Motor, node: int, settings: Cia402Settings | None = None) -> None:
        self._settings = settings or Cia402Settings()
        self.node, self.faults = node, DriveFaults()
        self._faults = self.faults
        self._network = _Outbox()
        local = canopen.LocalNode(node, dictionary())
        local.associate_network(self._network)
        local.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]
        local.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]
        self._values: dict[Key, Value] = {}
        self._variables = _variables(local.object_dictionary)
        for key, entry in ALL.items():
            self._values[key] = entry.default
        self._errors = Errors(self._values, local.emcy)
        self.axis = PowerDrive(motor, self._settings, self._values, self._errors)
        self._received, self._transmitted = all_pdos(node, self._values, self._variables)
        self._held: dict[int, can.Message] = {}
        self._now = -math.inf
        self.nmt = BOOTING
        self._boot_due: float | None = None
        self._restore(communication_only=False)

    # life of the node

    def _restore(self, communication_only: bool) -> None:
        """Set objects to their values after a start."""
        for key, entry in ALL.items():
            if key[0] in COMMUNICATION_OBJECTS or not communication_only:
                self._values[key] = entry.default
        self._values[0x1014, 0] = 0x80 + self.node
        self._values[0x1018, 4] = self._settings.serial
        for pdo in (*self._received, *self._transmitted):
            pdo.restore()
        self._watched: tuple[int, float] | None = None
        self._host_heard: float | None = None
        self._heartbeat_due = math.inf
        self._errors.restart()
        if not communication_only:
            self.axis.restart()

    def _reboot(self, now: float) -> None:
        """Begin anew: the motor has no power, and all configuration is lost."""
        self._restore(communication_only=False)
        self.axis.restart_count()
        self._network.frames.clear()
        self._held.clear()
        self.nmt, self._boot_due = BOOTING, now + self._settings.boot_time

    def _boot_up(self) -> None:
        self._network.put(MONITOR + self.node, bytes([BOOTING]))
        self._boot_due = None
        self._enter(PRE_OPERATIONAL)

    def _enter(self, state: int) -> None:
        if state == OPERATIONAL and self.nmt != OPERATIONAL:
            for pdo in (*self._received, *self._transmitted):
                pdo.begin()
        stopping = state == STOPPED and self.nmt != STOPPED
        self.nmt, self.axis.remote = state, state == OPERATIONAL
        if stopping:
            self.axis.abort_connection()

    # what the bus brings

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Hear a frame, and answer."""
        if now - self._now >= PATIENCE or self.faults is not self._faults:
            self._run(now)
        plain = not (message.is_error_frame or message.is_remote_frame or message.is_extended_id)
        if plain and not self.faults.deaf and self.nmt != BOOTING:
            self._now = max(now, self._now)
            if self._hear(message.arbitration_id, bytes(message.data)):
                self._run(now)
        return self._flush()

    def _hear(self, can_id: int, data: bytes) -> bool:
        """Take a frame; tell whether it was for this drive."""
        if can_id == NMT:
            self._on_nmt(data)
        elif MONITOR < can_id < MONITOR + 128:
            self._on_heartbeat(can_id - MONITOR, data)
        elif self.nmt == STOPPED:
            return False
        elif can_id == REQUEST + self.node:
            self._on_sdo(data)
        elif self.nmt != OPERATIONAL:
            return False
        elif can_id == int(self._values[0x1005, 0]) & 0x7FF:
            self._on_sync()
        else:
            pdo = next((p for p in self._received if p.enabled and p.id == can_id), None)
            if pdo is None:
                return False
            self._on_pdo(pdo, data)
        return True

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node):
            return
        if data[0] in NEXT:
            self._enter(NEXT[data[0]])
        elif data[0] == RESET_NODE:
            self._reboot(self._now)
        elif data[0] == RESET_COMMUNICATION:
            self.axis.abort_connection()
            self._restore(communication_only=True)
            self.axis.connection_lost = False
            self._boot_up()

    def _on_heartbeat(self, node: int, data: bytes) -> None:
        """The first one starts the watch (CiA 301, 7.2.8.2.2.2)."""
        if self._watched and node == self._watched[0] and len(data) == 1:
            self._host_heard = self._now
            if self.axis.connection_lost:
                self.axis.connection_back()

    def _on_sdo(self, data: bytes) -> None:
        """Only requests of 8 bytes are any (CiA 301, 7.2.4.3)."""
        if len(data) != 8 or self.faults.configuration_unanswered:
            return
        index, sub = struct.unpack_from("<HB", data, 1)
        self.axis.measure()
        try:
            if self.faults.configuration_refused and data[0] & 0xE0 == 0x20:
                raise SdoAbortedError(REFUSED)
            self._network.notify(REQUEST + self.node, bytearray(data), self._now)
        except SdoAbortedError as error:
            self._network.put(RESPONSE + self.node, ABORT.pack(0x80, index, sub, error.code))
        except struct.error:  # the library names no object when it refuses a first odd request
            abort = ABORT.pack(0x80, index, sub, GENERAL_ERROR)
            self._network.put(RESPONSE + self.node, abort)

    def _on_pdo(self, pdo: Pdo, data: bytes) -> None:
        if len(data) < pdo.length:
            self._errors.add(PDO_SHORT)
            return
        self._errors.remove(PDO_SHORT)
        (self._errors.add if len(data) > pdo.length else self._errors.remove)(PDO_LONG)
        if pdo.transmission in EVENT:
            self._take(pdo, data)
        else:
            pdo.received = data

    def _take(self, pdo: Pdo, data: bytes) -> None:
        """Let what a PDO brought become active, all of it before any of it acts."""
        written = pdo.unpack(data)
        for key, value in written:
            self._values[key] = value
        for (index, _), value in written:
            self.axis.write(index, value)

    def _on_sync(self) -> None:
        self.axis.measure()
        for pdo in self._transmitted:
            if not pdo.enabled or pdo.transmission in EVENT:
                continue
            pdo.syncs += 1
            data = pdo.pack()
            due = pdo.syncs >= pdo.transmission if pdo.transmission else data != pdo.sent
            if due:
                self._transmit(pdo, data)
        for pdo in self._received:
            if pdo.enabled and pdo.received is not None:
                data, pdo.received = pdo.received, None
                self._take(pdo, data)

    # object dictionary, as the SDO server sees it

    def _on_read(self, index: int, subindex: int, od: od.ODVariable) -> Value:
        if index == 0x1003 and subindex > int(self._values[0x1003, 0]):
            raise SdoAbortedError(NO_DATA)
        return self._values[index, subindex]

    def _on_write(self, index: int, subindex: int, od: od.ODVariable, data: bytes) -> None:
        key = (index, subindex)
        value = int(od.decode_raw(bytes(data)))
        allowed = ALL[key].allowed
        if allowed and value not in allowed:
            raise SdoAbortedError(INVALID_VALUE)
        if index == 0x6060 and value and value not in self._settings.modes:
            raise SdoAbortedError(INVALID_VALUE)
        pdo = self._pdo_of(index)
        if pdo is not None:
            pdo.check(key, value)
        if index == 0x1016:
            self._watch(value)
        self._values[key] = value
        if pdo is not None:
            pdo.refresh()
        elif index == 0x1017:
            self._heartbeat_due = self._now if value else math.inf
        elif index == 0x1003:
            for sub in range(1, 9):
                self._values[0x1003, sub] = 0
        elif index >= 0x6000:
            self.axis.write(index, value)

    def _pdo_of(self, index: int) -> Pdo | None:
        for pdo in (*self._received, *self._transmitted):
            if index in (pdo.parameters, pdo.mapping):
                return pdo
        return None

    def _watch(self, value: int) -> None:
        """Take a consumer heartbeat time (CiA 301, 7.5.2.15)."""
        node, milliseconds = value >> 16 & 0xFF, value & 0xFFFF
        if value >> 24:
            raise SdoAbortedError(INCOMPATIBLE)
        self._watched = (node, 1e-3 * milliseconds) if 1 <= node <= 127 and milliseconds else None
        self._host_heard = None

    # time

    def advance(self, now: float) -> list[can.Message]:
        """Run timers, watchdogs and the motor up to a time; return what is due."""
        self._run(now)
        return self._flush()

    def _run(self, now: float) -> None:
        self._now = now = max(now, self._now)
        if self.faults is not self._faults:
            before, self._faults = self._faults, self.faults
            self.axis.faults = self.faults
            if self.faults.reboots > before.reboots:
                self._reboot(now)
        if self.nmt == BOOTING:
            if self._boot_due is None:
                self._boot_due = now + self._settings.boot_time
            if now < self._boot_due:
                return
            self._boot_up()
        self._watch_host(now)
        self.axis.run(now)
        if self.nmt != STOPPED:
            self._errors.send()
        self._send_heartbeat(now)
        if self.nmt == OPERATIONAL:
            self._send_events(now)

    def _watch_host(self, now: float) -> None:
        if self._watched is None or self._host_heard is None:
            return
        if now - self._host_heard >= self._watched[1]:
            self._host_heard = None
            self.axis.connection_failed()
            self._errors.send()
            where = ON_ERROR.get(int(self._values[0x1029, 1]))
            if where is not None and self.nmt == OPERATIONAL:
                self.nmt, self.axis.remote = where, False

    def _send_heartbeat(self, now: float) -> None:
        if now < self._heartbeat_due - SLACK:
            return
        period = 1e-3 * int(self._values[0x1017, 0])
        self._heartbeat_due += period
        if self._heartbeat_due <= now:
            self._heartbeat_due = now + period
        if not self.faults.no_heartbeat:
            self._network.put(MONITOR + self.node, bytes([self.nmt]))

    def _send_events(self, now: float) -> None:
        due = [pdo for pdo in self._transmitted if pdo.enabled and pdo.transmission in EVENT]
        if due:
            self.axis.measure()
        for pdo in due:
            age = now - pdo.sent_at + SLACK
            data = pdo.pack()
            timer = pdo.event_timer and age >= pdo.event_timer
            if timer or (data != pdo.sent and age >= pdo.inhibit):
                self._transmit(pdo, data)

    # what goes to the bus

    def _transmit(self, pdo: Pdo, data: bytes) -> None:
        pdo.syncs, pdo.sent, pdo.sent_at = 0, data, self._now
        if not (self.faults.frozen_reports and pdo.carries(*MOTION)):
            self._network.put(pdo.id, data, pdo)

    def _flush(self) -> list[can.Message]:
        frames, self._network.frames = self._network.frames, []
        result: list[can.Message] = []
        for message, pdo in frames:
            result += [message] if pdo is None else self._distorted(message)
        return [] if self.faults.silent else result

    def _distorted(self, message: can.Message) -> list[can.Message]:
        """Play the faults of reports."""
        faults, number = self.faults, message.arbitration_id
        if faults.short_reports:
            message = can.Message(
                arbitration_id=number, data=message.data[:-1], is_extended_id=False
            )
        result = [message] * (2 if faults.duplicated_reports else 1)
        if not faults.reordered_reports:
            held = self._held.pop(number, None)
            return result if held is None else [held, *result]
        if number not in self._held:
            self._held[number] = message
            return result[1:]
        return [*result, self._held.pop(number)]


def _variables(objects: od.ObjectDictionary) -> dict[Key, od.ODVariable]:
    """Return all variables of an object dictionary by index and sub-index."""
    result: dict[Key, od.ODVariable] = {}
    for index, entry in objects.indices.items():
        members: Sequence[od.ODVariable] = (
            [entry] if isinstance(entry, od.ODVariable) else list(entry.subindices.values())
        )
        for variable in members:
            result[index, variable.subindex] = variable
    return result
