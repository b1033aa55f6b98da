"""State machine of a CiA 402 drive as tables: statusword to state, demand to controlword.

Source: IEC 61800-7-201, "PDS FSA"; masks and commands are those of `canopen.profiles.p402`.
"""

import math
from enum import Enum

from canopen.profiles.p402 import State402

from omniman_ros.can_drives.axis import AxisState, Demand


class PdsState(Enum):
    """State of the power drive system (PDS); the values are the keys of `State402.SW_MASK`."""

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


#: Mask of the statusword, value under the mask, and the state that it means
MASKS = tuple((*State402.SW_MASK[state.value], state) for state in PdsState)

#: States with power on the motor
POWERED = (PdsState.ENABLED, PdsState.QUICK_STOP, PdsState.FAULT_REACTION)
FAULTS = (PdsState.FAULT_REACTION, PdsState.FAULT)  #: States of a drive with a fault

AXIS_STATES = {
    PdsState.NOT_READY: AxisState.READY,
    PdsState.SWITCH_ON_DISABLED: AxisState.READY,
    PdsState.READY: AxisState.READY,
    PdsState.SWITCHED_ON: AxisState.READY,
    PdsState.ENABLED: AxisState.ENABLED,
    PdsState.QUICK_STOP: AxisState.STOPPING,
    PdsState.FAULT_REACTION: AxisState.FAULT,
    PdsState.FAULT: AxisState.FAULT,
}  #: State of the axis by the state that the drive reports

SHUTDOWN = State402.CW_SHUTDOWN  #: Controlword "shutdown"
SWITCH_ON = State402.CW_SWITCH_ON  #: Controlword "switch on"
ENABLE = State402.CW_OPERATION_ENABLED  #: Controlword "enable operation"
QUICK_STOP = State402.CW_QUICK_STOP  #: Controlword "quick stop"
DISABLE_VOLTAGE = State402.CW_DISABLE_VOLTAGE  #: Controlword "disable voltage"
#: Controlword with bit 7, whose rising edge resets a fault
FAULT_RESET = State402.CW_SWITCH_ON_DISABLED

# Quick stop active is left by "disable voltage" (transition 12), which every drive has. With
# quick stop option 6 a drive may also accept "enable operation" (transition 16), but the profile
# advises against it and few drives support it. After "switch on disabled", no old setpoint
# remains.
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
}  #: Controlword by demand and state of the drive


def pds_state(statusword: int) -> PdsState | None:
    """Return the state that a statusword reports, or None if the profile has no such state."""
    for mask, value, state in MASKS:
        if statusword & mask == value:
            return state
    return None


class FaultReset:
    """Repeats rising edges of the controlword's bit 7 every `period` [s], for a limited time."""

    #: Shortest time between two edges [s]: some drives do not read the controlword more often
    HOLD_TIME = 0.02
    TIMEOUT = 1.0  #: Time after which the reset is given up [s]

    def __init__(self, now: float, period: float) -> None:
        self._deadline = now + self.TIMEOUT
        self._hold_ticks = max(2, math.ceil(self.HOLD_TIME / period))
        self._ticks = 0

    def expired(self, now: float) -> bool:
        """Return whether the reset has timed out."""
        return now > self._deadline

    def controlword(self) -> int:
        """Return the next controlword; bit 7 is low at first, so that an edge follows."""
        high = self._ticks // self._hold_ticks % 2
        self._ticks += 1
        return FAULT_RESET if high else DISABLE_VOLTAGE
