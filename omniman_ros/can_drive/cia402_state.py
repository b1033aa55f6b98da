"""State machine of a CiA 402 drive: what it shows, and the controlword for what is demanded.

IEC 61800-7-201, "PDS FSA"; masks and commands are the tables of `canopen.profiles.p402`.
"""

import math
from enum import Enum

from canopen.profiles.p402 import State402

from omniman_ros.can_drive.axis import AxisState, Demand


class PdsState(Enum):
    """State of the power drive system; values are the names in the table of masks."""

    NOT_READY = "NOT READY TO SWITCH ON"
    SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
    READY = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    ENABLED = "OPERATION ENABLED"
    QUICK_STOP = "QUICK STOP ACTIVE"
    FAULT_REACTION = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"

    def __str__(self) -> str:
        return self.value.lower()


MASKS = tuple((*State402.SW_MASK[state.value], state) for state in PdsState)
"""Mask and value of the statusword, and the state that they stand for."""

POWERED = (PdsState.ENABLED, PdsState.QUICK_STOP, PdsState.FAULT_REACTION)
"""States with power on the motor."""
FAULTS = (PdsState.FAULT_REACTION, PdsState.FAULT)

AXIS_STATES = {
    PdsState.NOT_READY: AxisState.READY,
    PdsState.SWITCH_ON_DISABLED: AxisState.READY,
    PdsState.READY: AxisState.READY,
    PdsState.SWITCHED_ON: AxisState.READY,
    PdsState.ENABLED: AxisState.ENABLED,
    PdsState.QUICK_STOP: AxisState.STOPPING,
    PdsState.FAULT_REACTION: AxisState.FAULT,
    PdsState.FAULT: AxisState.FAULT,
}

SHUTDOWN = State402.CW_SHUTDOWN
SWITCH_ON = State402.CW_SWITCH_ON
ENABLE = State402.CW_OPERATION_ENABLED
QUICK_STOP = State402.CW_QUICK_STOP
DISABLE_VOLTAGE = State402.CW_DISABLE_VOLTAGE
FAULT_RESET = State402.CW_SWITCH_ON_DISABLED
"""Bit 7: its edge resets a fault."""

# Quick stop active is left by "disable voltage" (transition 12), which every drive has. With
# quick stop option 6 a drive may also take "enable operation" (transition 16), but the profile
# advises against it and few have it; and by way of switch on disabled no old setpoint survives.
CONTROLWORDS = {
    Demand.IDLE: {
        PdsState.NOT_READY: DISABLE_VOLTAGE,
        PdsState.SWITCH_ON_DISABLED: SHUTDOWN,
        PdsState.READY: SHUTDOWN,
        PdsState.SWITCHED_ON: SHUTDOWN,
        PdsState.ENABLED: SHUTDOWN,
        PdsState.QUICK_STOP: DISABLE_VOLTAGE,
        PdsState.FAULT_REACTION: DISABLE_VOLTAGE,
        PdsState.FAULT: DISABLE_VOLTAGE,
    },
    Demand.DRIVE: {
        PdsState.NOT_READY: DISABLE_VOLTAGE,
        PdsState.SWITCH_ON_DISABLED: SHUTDOWN,
        PdsState.READY: SWITCH_ON,
        PdsState.SWITCHED_ON: ENABLE,
        PdsState.ENABLED: ENABLE,
        PdsState.QUICK_STOP: DISABLE_VOLTAGE,
        PdsState.FAULT_REACTION: DISABLE_VOLTAGE,
        PdsState.FAULT: DISABLE_VOLTAGE,
    },
    Demand.STOP: dict.fromkeys(PdsState, QUICK_STOP),
}
"""Controlword by demand and by the state that the drive shows."""


def pds_state(statusword: int) -> PdsState | None:
    """State that a statusword shows, or None if it is none of the profile's."""
    for mask, value, state in MASKS:
        if statusword & mask == value:
            return state
    return None


class FaultReset:
    """Edges of bit 7, one after the other, until the fault is gone or time is up.

    Args:
        now: When it began, s.
        period: Time between two controlwords, s.
    """

    HOLD = 0.02
    """Shortest time between two edges, s: drives read the controlword as seldom as that."""
    PATIENCE = 1.0
    """How long it is tried, s."""

    def __init__(self, now: float, period: float) -> None:
        self._deadline = now + self.PATIENCE
        self._hold = max(2, math.ceil(self.HOLD / period))
        self._ticks = 0

    def expired(self, now: float) -> bool:
        """Whether it has been tried for long enough."""
        return now > self._deadline

    def controlword(self) -> int:
        """Next controlword: low first, so that there is an edge whatever was sent before."""
        high = self._ticks // self._hold % 2
        self._ticks += 1
        return FAULT_RESET if high else DISABLE_VOLTAGE
