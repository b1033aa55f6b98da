"""A protocol whose drives are scripted by the test, to test the policy alone."""

import math

from omniman_ros.can_drives.axis import AxisState, Demand, Feedback, Receipt
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.protocols import ProtocolEntry
from omniman_ros.control.wheel_cascade import DriveMode

COMMAND, REPORT, SYNC = 0x200, 0x180, 0x80


class ScriptedAxis:
    """Axis that obeys at once and follows exactly, unless the test changes it."""

    def __init__(self, settings):
        self.settings = settings
        self.state = AxisState.OFFLINE
        self.fault_reason = ""
        self.feedback = Feedback()
        self.modes = {DriveMode.VELOCITY, DriveMode.TORQUE}
        self.command_ids = [(COMMAND + settings.node, False)]
        self.obedient = True
        self.asked = []
        self.resets = 0

    def configure(self, now):
        self.state, self.fault_reason = AxisState.CONFIGURING, ""

    def reset(self, now):
        self.fault_reason, self.resets = "", self.resets + 1
        if self.state is AxisState.FAULT:
            self.state = AxisState.READY
        if self.state is AxisState.OFFLINE:
            self.state = AxisState.CONFIGURING

    def receive(self, frame, now):
        if frame.extended or frame.id != REPORT + self.settings.node:
            return Receipt.FOREIGN
        if len(frame.data) != 8:
            return Receipt.MALFORMED
        self.feedback.position = int.from_bytes(frame.data[:4], "little", signed=True) * 1e-3
        self.feedback.velocity = int.from_bytes(frame.data[4:], "little", signed=True) * 1e-3
        self.feedback.at, self.feedback.count = now, self.feedback.count + 1
        return Receipt.ACCEPTED

    def tick(self, demand, setpoint, now):
        assert math.isfinite(setpoint.value)
        self.asked.append((demand, setpoint))
        if self.obedient:
            self._obey(demand)
        moves = demand is not Demand.IDLE and self.state is not AxisState.READY
        milli = round(1e3 * setpoint.value) if moves else 0
        data = demand.value[0].encode() + milli.to_bytes(4, "little", signed=True)
        return [CanFrame(COMMAND + self.settings.node, data)]

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


class ScriptedNetwork:
    command_ids = ((SYNC, False),)
    samples_at_sync = True

    def __init__(self, settings):
        pass

    def before(self, now):
        return []

    def after(self, now):
        return [CanFrame(SYNC, b"")]


ENTRY = ProtocolEntry(ScriptedAxis, ScriptedNetwork)


def report(node, position, velocity):
    """Return a report of a motor's position [rad] and velocity [rad/s]."""
    position, velocity = (
        round(1e3 * value).to_bytes(4, "little", signed=True) for value in (position, velocity)
    )
    return CanFrame(REPORT + node, position + velocity)
