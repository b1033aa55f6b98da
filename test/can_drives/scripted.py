"""A protocol whose drives are scripted by the test, to test the policy alone."""

import math

from omniman_ros.can_drives.axis import AxisState, Demand, DriveAxis, Network
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode

COMMAND, REPORT, SYNC = 0x200, 0x180, 0x80
PROTOCOL = f"{__name__}:ScriptedAxis"  #: Value of can.protocol


class ScriptedNetwork(Network):
    command_ids = ((SYNC, False),)
    samples_at_sync = True

    def after(self, now):
        return [CanFrame(SYNC, b"")]


class ScriptedAxis(DriveAxis):
    """Axis that obeys at once and follows exactly, unless the test changes it."""

    network = ScriptedNetwork
    modes = (DriveMode.VELOCITY, DriveMode.TORQUE)

    def __init__(self, settings):
        node = settings.node
        super().__init__(settings, [COMMAND + node], {REPORT + node: self._on_report})
        self.obedient = True
        self.asked = []
        self.resets = 0

    def reset(self, now):
        self.fault_reason, self.resets = "", self.resets + 1
        if self.state is AxisState.FAULT:
            self.state = AxisState.READY
        if self.state is AxisState.OFFLINE:
            self.state = AxisState.CONFIGURING

    def _on_report(self, data, now):
        if len(data) != 8:
            return False
        position, velocity = (
            int.from_bytes(part, "little", signed=True) * 1e-3 for part in (data[:4], data[4:])
        )
        self.feedback.measure(position, velocity, now)
        return True

    def frames(self, demand, setpoint, now):
        assert math.isfinite(setpoint.value)
        self.asked.append((demand, setpoint))
        if self.obedient:
            self._obey(demand)
        moves = demand is not Demand.IDLE and self.state is not AxisState.READY
        milli = round(1e3 * setpoint.value) if moves else 0
        data = demand.value[0].encode() + milli.to_bytes(4, "little", signed=True)
        return [CanFrame(COMMAND + self.settings.node, data)]

    tick = frames  # records every setpoint, also that of a drive that stops

    def _obey(self, demand):
        if self.state is AxisState.CONFIGURING:
            self.state = AxisState.READY
        elif self.state in (AxisState.READY, AxisState.ENABLED, AxisState.STOPPING):
            powered = self.state is not AxisState.READY
            self.state = {
                Demand.IDLE: AxisState.READY,
                Demand.DRIVE: AxisState.ENABLED,
                Demand.STOP: AxisState.STOPPING if powered else AxisState.READY,
            }[demand]


def report(node, position, velocity):
    """Return a report of a motor's position [rad] and velocity [rad/s]."""
    position, velocity = (
        round(1e3 * value).to_bytes(4, "little", signed=True) for value in (position, velocity)
    )
    return CanFrame(REPORT + node, position + velocity)
