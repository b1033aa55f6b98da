"""VESC on CAN: single-frame commands and status frames.

Source: documentation/comm_can.md and comm/comm_can.c of the firmware, github.com/vedderb/bldc.
29-bit ids, command << 8 | node; big-endian. What the drive has to be told beforehand, with VESC
Tool (App Settings, General): its id, CAN mode VESC, status messages 1 and 5 at the rate of
`can.feedback_period`; a time-out with a brake current: when the host falls silent a VESC goes on
with its last command until then, and without a brake current it lets the motor turn freely; and a
least speed of the speed controller (s_pid_min_erpm) of 0: below it, 900 by default, the motor is
shorted (FOC) or released, not controlled: the end of a ramp is not followed, rest is not held.

A VESC has no state machine on the bus: no enabling, no acknowledgement, no heartbeat, and none of
its status frames carries a fault code. A fault shows as a current of zero, and heals by itself.
"""

import math
import struct
from collections.abc import Callable, Collection
from enum import IntEnum

from omniman_ros.can_drive.axis import (
    AxisSettings,
    AxisState,
    Counter,
    Demand,
    Feedback,
    Receipt,
    Setpoint,
)
from omniman_ros.can_drive.checks import clipped, positive, reachable
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.wheel_cascade import DriveMode


class Packet(IntEnum):
    """Commands (CAN_PACKET_ID) that are sent or heard here."""

    SET_DUTY = 0
    SET_CURRENT = 1
    SET_CURRENT_BRAKE = 2
    SET_RPM = 3
    SET_POS = 4
    STATUS = 9
    SET_CURRENT_REL = 10
    SET_CURRENT_BRAKE_REL = 11
    SET_CURRENT_HANDBRAKE = 12
    SET_CURRENT_HANDBRAKE_REL = 13
    STATUS_2 = 14
    STATUS_3 = 15
    STATUS_4 = 16
    STATUS_5 = 27
    NOTIFY_BOOT = 57
    STATUS_6 = 58


SCALES = {Packet.SET_DUTY: 1e5, Packet.SET_CURRENT: 1e3, Packet.SET_RPM: 1.0}
"""i32 of a command per unit: duty of 1, A, electrical rpm.

The table of comm_can.md says 1000 for SET_RPM; its C code and comm_can.c do not scale it.
"""

COMMANDS = tuple(p for p in Packet if p.name.startswith("SET_"))
STATUS = struct.Struct(">ihh")
"""Electrical rpm; total motor current, 0.1 A; duty, 1/1000."""
STATUS_5 = struct.Struct(">ihh")
"""Tachometer, 6 a turn of the field; input voltage, 0.1 V; reserved."""

MAX_DUTY = 0.95
"""Largest duty that is asked for: the firmware's default limit (l_max_duty)."""
MIN_BUS_VOLTAGE = 5.0
"""Supply below which a measured voltage is not believed [V]; a VESC needs 8 V."""
RPM = 60.0 / math.tau
"""Turns per minute of 1 rad/s."""
LARGEST = 2**31 - 1


class VescAxis:
    """One VESC.

    Velocity is SET_RPM, torque SET_CURRENT by the torque constant, voltage SET_DUTY by the bus
    voltage of STATUS_5. There is no feed-forward: that of a velocity setpoint is not sent.

    READY means that STATUS and STATUS_5 have been heard. The first tick with Demand.DRIVE asks
    for zero speed and makes it ENABLED, if both are still fresh. With Demand.IDLE, and while it
    is configured, each tick sends a current of zero: silence would let the last command act until
    the drive's time-out, and then its brake current, which is not what "no power" means. With
    Demand.STOP it follows the setpoint; one that lost its configuration while it was driven is
    held at zero speed until it is released, one that was not driven stays without power.

    The sign of the current in STATUS tells drawing from generating (mc_interface_get_tot_current_
    filtered), not the direction: times the sign of the duty it is that of the torque. At a duty
    that rounds to zero the direction is not known; positive is assumed.

    A restart shows in the tachometer, which begins at zero again: a step that no shaft can do is
    taken for one. One within a few turns of zero is not seen, nor one in a long silence, which is
    lost feedback anyway. Some firmware announces it besides, by NOTIFY_BOOT.
    """

    def __init__(self, settings: AxisSettings) -> None:
        positive(settings, "pole_pairs", "torque_constant", "period", "feedback_timeout")
        self.settings = settings
        self.state = AxisState.OFFLINE
        self.trouble = ""
        self.feedback = Feedback()
        self.modes: Collection[DriveMode] = tuple(DriveMode)
        node = settings.node
        self.command_ids: Collection[tuple[int, bool]] = frozenset(
            (packet << 8 | node, True) for packet in COMMANDS
        )
        self._readers: dict[int, Callable[[bytes, float], None]] = {
            Packet.STATUS << 8 | node: self._take_status,
            Packet.STATUS_5 << 8 | node: self._take_status_5,
        }
        self._boot_id = Packet.NOTIFY_BOOT << 8 | node
        others = (Packet.STATUS_2, Packet.STATUS_3, Packet.STATUS_4, Packet.STATUS_6)
        self._others = frozenset(packet << 8 | node for packet in others)
        self._angle = math.tau / (6 * settings.pole_pairs)
        self._tachometer = Counter()
        self._counted_at: float | None = None
        self._duty = math.nan
        self._fresh: set[Packet] = set()
        self._heard: set[Packet] = set()
        self._driven = False

    def configure(self, now: float) -> None:
        """See `Axis`: there is nothing to set; it waits for both reports, without power."""
        self.state, self.trouble = AxisState.CONFIGURING, ""
        self._heard.clear()
        self._driven = False

    def reset(self, now: float) -> None:
        """See `Axis`: in trouble or OFFLINE it is configured again."""
        if self.trouble or self.state is AxisState.OFFLINE:
            self.configure(now)

    def receive(self, frame: Frame, now: float) -> Receipt:
        """See `Axis`: remote, 11-bit and short frames are malformed, a VESC sends none."""
        if frame.id == self._boot_id and frame.extended and not frame.remote:
            self._tachometer.restart()
            self._begin_anew("it says so")
            return Receipt.TAKEN
        read = self._readers.get(frame.id)
        if read is None and frame.id not in self._others:
            return Receipt.FOREIGN
        if not frame.extended or frame.remote or len(frame.data) < 8:
            return Receipt.MALFORMED
        if read is not None:
            read(frame.data, now)
        return Receipt.TAKEN

    def tick(self, demand: Demand, setpoint: Setpoint, now: float) -> list[Frame]:
        """See `Axis`: always one frame.

        Raises:
            ValueError: The setpoint is not finite.
        """
        setpoint = clipped(setpoint, self.settings)
        if demand is Demand.IDLE:
            self._driven = False
            if self.state is AxisState.ENABLED:
                self.state = AxisState.READY
        elif self.state is AxisState.ENABLED:
            return [self._follow(setpoint)]
        elif demand is Demand.DRIVE and self._can_drive(now):
            self.state, self._driven = AxisState.ENABLED, True
        return [self._command(Packet.SET_RPM if self._driven else Packet.SET_CURRENT, 0.0)]

    def _can_drive(self, now: float) -> bool:
        fresh = now - self.feedback.at <= self.settings.feedback_timeout
        return self.state is AxisState.READY and not self.trouble and fresh

    def _follow(self, setpoint: Setpoint) -> Frame:
        settings, value = self.settings, setpoint.value
        if setpoint.mode is DriveMode.VELOCITY:
            return self._command(Packet.SET_RPM, value * RPM * settings.pole_pairs)
        if setpoint.mode is DriveMode.TORQUE:
            return self._command(Packet.SET_CURRENT, value / settings.torque_constant)
        supply = self.feedback.bus_voltage
        if not supply >= MIN_BUS_VOLTAGE:
            self._fail(self.state, f"no bus voltage heard: {supply:g} V")
            return self._command(Packet.SET_CURRENT, 0.0)
        return self._command(Packet.SET_DUTY, min(max(value / supply, -MAX_DUTY), MAX_DUTY))

    def _command(self, packet: Packet, value: float) -> Frame:
        number = round(min(max(value * SCALES[packet], -LARGEST), LARGEST))
        return Frame(packet << 8 | self.settings.node, struct.pack(">i", number), extended=True)

    def _take_status(self, data: bytes, now: float) -> None:
        speed, current, duty = STATUS.unpack_from(data)
        feedback, settings = self.feedback, self.settings
        feedback.velocity = speed / (RPM * settings.pole_pairs)
        self._duty = duty * 1e-3
        feedback.current = current * (-0.1 if duty < 0 else 0.1)
        feedback.torque = feedback.current * settings.torque_constant
        feedback.voltage = self._duty * feedback.bus_voltage
        self._take(Packet.STATUS, now)

    def _take_status_5(self, data: bytes, now: float) -> None:
        reading, supply, _ = STATUS_5.unpack_from(data)
        counter, before = self._tachometer, self._tachometer.value
        step = (counter.update(reading) - before) * self._angle
        if self._counted_at is not None and not reachable(
            step, now - self._counted_at, self.settings
        ):
            counter.value = before  # it is continued from there
            self._begin_anew(f"its tachometer jumped by {step / math.tau:.1f} turns")
        self._counted_at = now
        self.feedback.position = counter.value * self._angle
        self.feedback.bus_voltage = supply * 0.1
        self.feedback.voltage = self._duty * self.feedback.bus_voltage
        self._take(Packet.STATUS_5, now)

    def _take(self, packet: Packet, now: float) -> None:
        self._fresh.add(packet)
        self._heard.add(packet)
        if len(self._fresh) == 2:
            self._fresh.clear()
            self.feedback.at = now
            self.feedback.count += 1
        if self.state is AxisState.CONFIGURING and len(self._heard) == 2:
            self.state = AxisState.READY

    def _begin_anew(self, sign: str) -> None:
        if self.state in (AxisState.READY, AxisState.ENABLED):
            self._fail(AxisState.OFFLINE, f"it began anew: {sign}")

    def _fail(self, state: AxisState, trouble: str) -> None:
        self.state = state
        self.trouble = self.trouble or trouble
