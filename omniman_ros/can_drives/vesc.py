"""VESC on CAN: single-frame commands and status frames.

Source: documentation/comm_can.md and comm/comm_can.c of the firmware, github.com/vedderb/bldc.
Ids have 29 bits, command << 8 | node; data are big-endian. These settings of the drive must be
made beforehand, with VESC Tool (App Settings, General):

* its id, CAN mode VESC, and status messages 1 and 5 at the rate of `can.feedback_period`;
* a timeout with a brake current: when the host falls silent, a VESC follows its last command until
  the timeout, and without a brake current it then lets the motor turn freely;
* a lowest speed of the speed controller (s_pid_min_erpm) of 0: below it, 900 by default, the motor
  is shorted (FOC) or released, not controlled, so that it does not follow a ramp to its end and
  does not hold at rest.

A VESC has no state machine on the bus: no enabling, no acknowledgement, no heartbeat, and none of
its status frames carries a fault code. A fault shows as a current of zero, and clears by itself.
"""

import math
import struct
from enum import IntEnum

from omniman_ros.can_drives.axis import (
    AxisSettings,
    AxisState,
    Demand,
    DriveAxis,
    DriveSetpoint,
    ReportHandler,
    WrappingCounter,
)
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode


class PacketId(IntEnum):
    """Commands of frames (CAN_PACKET_ID) that are sent or received."""

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


#: Scale of a command's integer: counts per duty cycle of 1, per A, and per electrical rpm.
#: The table of comm_can.md says 1000 for SET_RPM; its C code and comm_can.c do not scale it.
SCALES = {PacketId.SET_DUTY: 1e5, PacketId.SET_CURRENT: 1e3, PacketId.SET_RPM: 1.0}

#: Commands that only a host sends
HOST_COMMANDS = tuple(p for p in PacketId if p.name.startswith("SET_"))
#: Reports that are received but not used here
UNUSED_REPORTS = (PacketId.STATUS_2, PacketId.STATUS_3, PacketId.STATUS_4, PacketId.STATUS_6)
#: Layout of status 1: speed [electrical rpm], total motor current [0.1 A], duty cycle [1/1000]
STATUS_LAYOUT = struct.Struct(">ihh")
#: Layout of status 5: tachometer [1/6 electrical revolution], input voltage [0.1 V], reserved
STATUS_5_LAYOUT = struct.Struct(">ihh")

MAX_DUTY = 0.95  #: Largest commanded duty cycle: the firmware's default limit (l_max_duty)
MIN_BUS_VOLTAGE = 5.0  #: Lowest plausible measurement of the supply voltage [V]; a VESC needs 8 V
RPM = 60.0 / math.tau  #: Revolutions per minute of 1 rad/s
MAX_INTEGER = 2**31 - 1  #: Largest integer of a command


class VescAxis(DriveAxis):
    """One VESC.

    A velocity is sent as SET_RPM, a torque as SET_CURRENT by the torque constant, a voltage as
    SET_DUTY by the bus voltage of STATUS_5. There is no feed-forward: that of a velocity setpoint
    is not sent.

    READY means that STATUS and STATUS_5 have been received. The first tick with Demand.DRIVE
    commands zero speed and makes the axis ENABLED, if both are still fresh. With Demand.IDLE, and
    while the axis is configured, each tick sends a current of zero: silence would let the last
    command act until the drive's timeout, and then its brake current, which would not be "no
    power". With Demand.STOP the axis follows the setpoint. A drive that lost its configuration
    in motion is held at zero speed until Demand.IDLE; one that was not driven stays
    without power.

    The sign of the current in STATUS distinguishes motoring from generating (mc_interface_get_tot_
    current_filtered), not the direction: multiplied by the sign of the duty cycle it is that of
    the torque. At a duty cycle that rounds to zero the direction is unknown; positive is assumed.

    A restart shows in the tachometer, which begins at zero again: a step that no shaft can do
    counts as a restart. A restart within a few revolutions of zero is not detected, nor is one in
    a long silence, which is lost feedback anyway. Some firmware also announces it, by NOTIFY_BOOT.

    Raises:
        ParameterError: A setting that the codec divides by is not finite and above zero.
    """

    modes = tuple(DriveMode)

    def __init__(self, settings: AxisSettings) -> None:
        settings.require_positive("pole_pairs", "torque_constant", "period", "feedback_timeout")
        handlers: dict[PacketId, ReportHandler] = {
            PacketId.STATUS: self._on_status,
            PacketId.STATUS_5: self._on_status_5,
            PacketId.NOTIFY_BOOT: self._on_boot,
        } | dict.fromkeys(UNUSED_REPORTS, _is_complete)
        super().__init__(
            settings,
            [packet << 8 | settings.node for packet in HOST_COMMANDS],
            {packet << 8 | settings.node: handler for packet, handler in handlers.items()},
            extended=True,
        )
        self._radians_per_count = math.tau / (6 * settings.pole_pairs)
        self._tachometer = WrappingCounter()
        self._tachometer_at: float | None = None
        self._duty = math.nan
        self._fresh: set[PacketId] = set()
        self._received: set[PacketId] = set()
        self._is_driven = False

    def configure(self, now: float) -> None:
        """See `DriveAxis`: nothing is set; the axis waits for both reports, without power."""
        super().configure(now)
        self._received.clear()
        self._is_driven = False

    def frames(self, demand: Demand, setpoint: DriveSetpoint, now: float) -> list[CanFrame]:
        """See `DriveAxis`: return exactly one frame."""
        if demand is Demand.IDLE:
            self._is_driven = False
            if self.state is AxisState.ENABLED:
                self.state = AxisState.READY
        elif self.state is AxisState.ENABLED:
            return [self._setpoint_frame(setpoint)]
        elif demand is Demand.DRIVE and self._can_drive(now):
            self.state, self._is_driven = AxisState.ENABLED, True
        return [
            self._command_frame(PacketId.SET_RPM if self._is_driven else PacketId.SET_CURRENT, 0.0)
        ]

    def _can_drive(self, now: float) -> bool:
        is_fresh = now - self.feedback.at <= self.settings.feedback_timeout
        return self.state is AxisState.READY and not self.fault_reason and is_fresh

    def _setpoint_frame(self, setpoint: DriveSetpoint) -> CanFrame:
        settings, value = self.settings, setpoint.value
        if setpoint.mode is DriveMode.VELOCITY:
            return self._command_frame(PacketId.SET_RPM, value * RPM * settings.pole_pairs)
        if setpoint.mode is DriveMode.TORQUE:
            return self._command_frame(PacketId.SET_CURRENT, value / settings.torque_constant)
        supply = self.feedback.bus_voltage
        if not supply >= MIN_BUS_VOLTAGE:
            self.fail(self.state, f"no plausible bus voltage received: {supply:g} V")
            return self._command_frame(PacketId.SET_CURRENT, 0.0)
        return self._command_frame(
            PacketId.SET_DUTY, min(max(value / supply, -MAX_DUTY), MAX_DUTY)
        )

    def _command_frame(self, packet: PacketId, value: float) -> CanFrame:
        number = round(min(max(value * SCALES[packet], -MAX_INTEGER), MAX_INTEGER))
        return CanFrame(packet << 8 | self.settings.node, struct.pack(">i", number), extended=True)

    def _on_status(self, data: bytes, now: float) -> None:
        speed, current, duty = STATUS_LAYOUT.unpack_from(data)
        feedback, settings = self.feedback, self.settings
        feedback.velocity = speed / (RPM * settings.pole_pairs)
        self._duty = duty * 1e-3
        feedback.current = current * (-0.1 if duty < 0 else 0.1)
        feedback.torque = feedback.current * settings.torque_constant
        feedback.voltage = self._duty * feedback.bus_voltage
        self._count_report(PacketId.STATUS, now)

    def _on_status_5(self, data: bytes, now: float) -> None:
        reading, supply, _ = STATUS_5_LAYOUT.unpack_from(data)
        counter, previous = self._tachometer, self._tachometer.value
        step = (counter.update(reading) - previous) * self._radians_per_count
        before = self._tachometer_at
        if before is not None and not self.settings.is_reachable(step, now - before):
            counter.value = previous  # the position continues from there
            self.feedback.restarts += 1
            self._on_restart(f"its tachometer jumped by {step / math.tau:.1f} revolutions")
        self._tachometer_at = now
        self.feedback.position = counter.value * self._radians_per_count
        self.feedback.bus_voltage = supply * 0.1
        self.feedback.voltage = self._duty * self.feedback.bus_voltage
        self._count_report(PacketId.STATUS_5, now)

    def _count_report(self, packet: PacketId, now: float) -> None:
        self._fresh.add(packet)
        self._received.add(packet)
        if len(self._fresh) == 2:
            self._fresh.clear()
            self.feedback.measure(self.feedback.position, self.feedback.velocity, now)
        if self.state is AxisState.CONFIGURING and len(self._received) == 2:
            self.state = AxisState.READY

    def _on_boot(self, data: bytes, now: float) -> None:
        self._tachometer.restart()
        self.feedback.restarts += 1
        self._on_restart("it reports a boot")

    def _on_restart(self, evidence: str) -> None:
        if self.state in (AxisState.READY, AxisState.ENABLED):
            self.fail(AxisState.OFFLINE, f"it restarted: {evidence}")


def _is_complete(data: bytes, now: float) -> bool:
    return len(data) == 8
