"""CANopen node of a simulated CiA 402 drive: NMT, SDO server, PDOs, heartbeats, emergencies.

Written from CiA 301 and CiA 402-2. The SDO server, the object dictionary and the emergency
producer are those of the `canopen` library. Its `LocalNode` lacks NMT gating, PDOs by SYNC and the
consumer of heartbeats, and sends its own heartbeat from a thread: these parts are written here.
"""

import math
import struct
from collections.abc import Sequence
from typing import Any

import can
import canopen
from canopen import SdoAbortedError
from canopen import objectdictionary as od

from omniman_ros.simulation.can_drives.cia402 import indices
from omniman_ros.simulation.can_drives.cia402.axis import Cia402Settings, PowerDrive
from omniman_ros.simulation.can_drives.cia402.errors import PDO_LONG, PDO_SHORT, Errors
from omniman_ros.simulation.can_drives.cia402.objects import ALL, Key, Value, dictionary
from omniman_ros.simulation.can_drives.cia402.pdo import EVENT, INVALID_VALUE, Pdo, all_pdos
from omniman_ros.simulation.can_drives.firmware import ReportFaults
from omniman_ros.simulation.can_drives.motor import DriveFaults, DriveMotor

__all__ = ["Cia402Drive", "Cia402Settings"]

# States of the node, as in its heartbeat (CiA 301, 7.2.8.3.2)
BOOTING = 0  #: State of the node: booting
STOPPED = 4  #: State of the node: stopped
OPERATIONAL = 5  #: State of the node: operational
PRE_OPERATIONAL = 127  #: State of the node: pre-operational

START = 1  #: NMT command: start
STOP = 2  #: NMT command: stop
ENTER_PRE_OPERATIONAL = 128  #: NMT command: enter pre-operational
RESET_NODE = 129  #: NMT command: reset the node
RESET_COMMUNICATION = 130  #: NMT command: reset the communication
#: State of the node after an NMT command (CiA 301, 7.2.8.2.1)
STATE_BY_COMMAND = {START: OPERATIONAL, STOP: STOPPED, ENTER_PRE_OPERATIONAL: PRE_OPERATIONAL}
#: State of an operational node after a loss of its host, by error behaviour (object 1029:01)
STATE_ON_ERROR = {0: PRE_OPERATIONAL, 2: STOPPED}

NMT = 0x000  #: CAN id of NMT commands
RESPONSE = 0x580  #: CAN id of SDO answers, without the node
REQUEST = 0x600  #: CAN id of SDO requests, without the node
MONITOR = 0x700  #: CAN id of heartbeats, without the node
GENERAL_ERROR = 0x0800_0000  #: Abort code: general error
NO_DATA = 0x0800_0024  #: Abort code: no data
INCOMPATIBLE = 0x0604_0043  #: Abort code: incompatible parameter
REFUSED = 0x0800_0022  #: Abort code: the value cannot be stored in the present state
ABORT = struct.Struct("<BHBL")  #: Layout of an SDO abort
MOTION = (indices.POSITION, indices.VELOCITY)  #: Indices of the objects with position and velocity
MAX_STEP = 0.002  #: Longest time between runs of the timers that detects a late heartbeat [s]
TIMER_TOLERANCE = 1e-6  #: How early a timer may expire, as sums of periods are not exact [s]
COMMUNICATION_OBJECTS = range(0x1000, 0x2000)  #: Indices of the communication objects


class _NoTask:
    """Placeholder for a periodic message of the library: the drive sends by its own timers."""

    def update(self, data: Any) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing."""


class _Outbox(canopen.Network):
    """Network without a bus and threads, which collects the frames to send."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[tuple[can.Message, Pdo | None]] = []

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        self.put(can_id, bytes(data))

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:
        """Send nothing, because the drive has its own timers."""
        return _NoTask()

    def put(self, can_id: int, data: bytes, pdo: Pdo | None = None) -> None:
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        self.frames.append((message, pdo))


class Cia402Drive:
    """Firmware of one drive; it implements `BusDrive`.

    A controlword that becomes valid with a SYNC acts after the drive has sampled its reports at
    that SYNC. Event-driven TPDOs are sent on change, on entering operational, and by their event
    timer.
    """

    def __init__(
        self, motor: DriveMotor, node: int, settings: Cia402Settings | None = None
    ) -> None:
        self._settings = settings or Cia402Settings()
        self.node, self.faults = node, DriveFaults()
        self._faults = self.faults
        self._network = _Outbox()
        local = canopen.LocalNode(node, dictionary())
        local.associate_network(self._network)
        local.add_read_callback(self._on_read)
        local.add_write_callback(self._on_write)
        self._values: dict[Key, Value] = {}
        #: Objects by index and by name, as the drive's EDS would tell them to a master
        self.object_dictionary: od.ObjectDictionary = local.object_dictionary
        self._variables = _variables(self.object_dictionary)
        for key, entry in ALL.items():
            self._values[key] = entry.default
        self._errors = Errors(self._values, local.emcy)
        #: Power stage and motion of the drive
        self.axis = PowerDrive(motor, self._settings, self._values, self._errors)
        self._received, self._transmitted = all_pdos(node, self._values, self._variables)
        self._report_faults = ReportFaults()
        self._now = -math.inf
        self.nmt = BOOTING  #: State of the node, as in its heartbeat
        self._boot_due: float | None = None
        self._restore(communication_only=False)

    # ---- start --------------------------------------------------------------------------------

    def _restore(self, communication_only: bool) -> None:
        for key, entry in ALL.items():
            if key[0] in COMMUNICATION_OBJECTS or not communication_only:
                self._values[key] = entry.default
        self._values[indices.EMCY_COB_ID, 0] = 0x80 + self.node
        self._values[indices.IDENTITY, 4] = self._settings.serial
        for pdo in (*self._received, *self._transmitted):
            pdo.restore()
        self._supervised: tuple[int, float] | None = None
        self._host_received_at: float | None = None
        self._heartbeat_due = math.inf
        self._errors.restart()
        if not communication_only:
            self.axis.restart()

    def _reboot(self, now: float) -> None:
        """Restart at a time [s]: the motor's power is switched off, the configuration is lost."""
        self._restore(communication_only=False)
        self.axis.restart_count()
        self._network.frames.clear()
        self._report_faults = ReportFaults()
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

    # ---- reception ----------------------------------------------------------------------------

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Process a frame; return the answers and other frames that are due."""
        if now - self._now >= MAX_STEP or self.faults is not self._faults:
            self._run(now)
        is_data = not (message.is_error_frame or message.is_remote_frame or message.is_extended_id)
        if is_data and not self.faults.deaf and self.nmt != BOOTING:
            self._now = max(now, self._now)
            if self._dispatch(message.arbitration_id, bytes(message.data)):
                self._run(now)
        return self._flush()

    def _dispatch(self, can_id: int, data: bytes) -> bool:
        """Dispatch a frame; return whether it was for this drive."""
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
        elif can_id == int(self._values[indices.SYNC_COB_ID, 0]) & 0x7FF:
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
        if data[0] in STATE_BY_COMMAND:
            self._enter(STATE_BY_COMMAND[data[0]])
        elif data[0] == RESET_NODE:
            self._reboot(self._now)
        elif data[0] == RESET_COMMUNICATION:
            self.axis.abort_connection()
            self._restore(communication_only=True)
            self.axis.connection_lost = False
            self._boot_up()

    def _on_heartbeat(self, node: int, data: bytes) -> None:
        """Record a heartbeat; the first one starts the supervision (CiA 301, 7.2.8.2.2.2)."""
        if self._supervised and node == self._supervised[0] and len(data) == 1:
            self._host_received_at = self._now
            if self.axis.connection_lost:
                self.axis.connection_back()

    def _on_sdo(self, data: bytes) -> None:
        """Serve an SDO request, which has 8 bytes (CiA 301, 7.2.4.3)."""
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
        except struct.error:  # the library fails if the first request is malformed
            abort = ABORT.pack(0x80, index, sub, GENERAL_ERROR)
            self._network.put(RESPONSE + self.node, abort)

    def _on_pdo(self, pdo: Pdo, data: bytes) -> None:
        if len(data) < pdo.length:
            self._errors.add(PDO_SHORT)
            return
        self._errors.remove(PDO_SHORT)
        (self._errors.add if len(data) > pdo.length else self._errors.remove)(PDO_LONG)
        if pdo.transmission in EVENT:
            self._apply(pdo, data)
        else:
            pdo.received = data

    def _apply(self, pdo: Pdo, data: bytes) -> None:
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
                self._apply(pdo, data)

    # ---- object dictionary, as the SDO server sees it ------------------------------------------

    def _on_read(self, index: int, subindex: int, od: od.ODVariable) -> Value:
        if index == indices.ERROR_HISTORY and subindex > int(
            self._values[indices.ERROR_HISTORY, 0]
        ):
            raise SdoAbortedError(NO_DATA)
        return self._values[index, subindex]

    def _on_write(self, index: int, subindex: int, od: od.ODVariable, data: bytes) -> None:
        key = (index, subindex)
        value = int(od.decode_raw(bytes(data)))
        allowed = ALL[key].allowed
        if allowed and value not in allowed:
            raise SdoAbortedError(INVALID_VALUE)
        if index == indices.MODE and value and value not in self._settings.modes:
            raise SdoAbortedError(INVALID_VALUE)
        pdo = self._pdo_of(index)
        if pdo is not None:
            pdo.check(key, value)
        if index == indices.CONSUMER_HEARTBEAT:
            self._set_supervision(value)
        self._values[key] = value
        if pdo is not None:
            pdo.refresh()
        elif index == indices.PRODUCER_HEARTBEAT:
            self._heartbeat_due = self._now if value else math.inf
        elif index == indices.ERROR_HISTORY:
            for sub in range(1, 9):
                self._values[indices.ERROR_HISTORY, sub] = 0
        elif index >= 0x6000:
            self.axis.write(index, value)

    def _pdo_of(self, index: int) -> Pdo | None:
        for pdo in (*self._received, *self._transmitted):
            if index in (pdo.parameters, pdo.mapping):
                return pdo
        return None

    def _set_supervision(self, value: int) -> None:
        """Apply a consumer heartbeat time (CiA 301, 7.5.2.15)."""
        node, milliseconds = value >> 16 & 0xFF, value & 0xFFFF
        if value >> 24:
            raise SdoAbortedError(INCOMPATIBLE)
        self._supervised = (
            (node, 1e-3 * milliseconds) if 1 <= node <= 127 and milliseconds else None
        )
        self._host_received_at = None

    # ---- time ---------------------------------------------------------------------------------

    def advance(self, now: float) -> list[can.Message]:
        """Run timers, watchdogs and the motor up to a time [s]; return the frames that are due."""
        self._run(now)
        return self._flush()

    def _run(self, now: float) -> None:
        self._now = now = max(now, self._now)
        if self.faults is not self._faults:
            previous, self._faults = self._faults, self.faults
            self.axis.faults = self.faults
            if self.faults.reboots > previous.reboots:
                self._reboot(now)
        if self.nmt == BOOTING:
            if self._boot_due is None:
                self._boot_due = now + self._settings.boot_time
            if now < self._boot_due:
                return
            self._boot_up()
        self._supervise_host(now)
        self.axis.run(now)
        if self.nmt != STOPPED:
            self._errors.send()
        self._send_heartbeat(now)
        if self.nmt == OPERATIONAL:
            self._send_events(now)

    def _supervise_host(self, now: float) -> None:
        if self._supervised is None or self._host_received_at is None:
            return
        if now - self._host_received_at >= self._supervised[1]:
            self._host_received_at = None
            self.axis.connection_failed()
            self._errors.send()
            state = STATE_ON_ERROR.get(int(self._values[indices.ERROR_BEHAVIOUR, 1]))
            if state is not None and self.nmt == OPERATIONAL:
                self.nmt, self.axis.remote = state, False

    def _send_heartbeat(self, now: float) -> None:
        if now < self._heartbeat_due - TIMER_TOLERANCE:
            return
        period = 1e-3 * int(self._values[indices.PRODUCER_HEARTBEAT, 0])
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
            age = now - pdo.sent_at + TIMER_TOLERANCE
            data = pdo.pack()
            has_expired = pdo.event_timer and age >= pdo.event_timer
            if has_expired or (data != pdo.sent and age >= pdo.inhibit):
                self._transmit(pdo, data)

    # ---- sending ------------------------------------------------------------------------------

    def _transmit(self, pdo: Pdo, data: bytes) -> None:
        pdo.syncs, pdo.sent, pdo.sent_at = 0, data, self._now
        if not (self.faults.frozen_reports and pdo.carries(*MOTION)):
            self._network.put(pdo.id, data, pdo)

    def _flush(self) -> list[can.Message]:
        frames, self._network.frames = self._network.frames, []
        result: list[can.Message] = []
        for message, pdo in frames:
            result += [message] if pdo is None else self._report_faults.apply(message, self.faults)
        return [] if self.faults.silent else result


def _variables(objects: od.ObjectDictionary) -> dict[Key, od.ODVariable]:
    result: dict[Key, od.ODVariable] = {}
    for index, entry in objects.indices.items():
        members: Sequence[od.ODVariable] = (
            [entry] if isinstance(entry, od.ODVariable) else list(entry.subindices.values())
        )
        for variable in members:
            result[index, variable.subindex] = variable
    return result
