"""Power state machine of CiA 402-2 (IEC 61800-7-201), 6.3: states, commands, transitions."""

from enum import Enum


class State(Enum):
    """States of the drive; the values are their bits of the statusword (CiA 402-2, 8.4.2)."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


class Command(Enum):
    """Commands; the values are mask and value of the controlword (CiA 402-2, 8.4.1)."""

    DISABLE_VOLTAGE = (0x02, 0x00)
    QUICK_STOP = (0x06, 0x02)
    SHUTDOWN = (0x07, 0x06)
    SWITCH_ON = (0x0F, 0x07)
    ENABLE = (0x0F, 0x0F)


FAULT_RESET = 0x80  #: Bit of the controlword whose rising edge resets a fault
HALT = 0x100  #: Bit of the controlword that halts the motor in profile modes

#: State by previous state and command; 0, 1, 13 to 15, and 12 after a ramp, have other causes
TRANSITIONS = {
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): State.READY,  # 2
    (State.READY, Command.SWITCH_ON): State.SWITCHED_ON,  # 3
    (State.READY, Command.ENABLE): State.SWITCHED_ON,  # 3, then 4
    (State.SWITCHED_ON, Command.ENABLE): State.ENABLED,  # 4
    (State.ENABLED, Command.SWITCH_ON): State.SWITCHED_ON,  # 5
    (State.SWITCHED_ON, Command.SHUTDOWN): State.READY,  # 6
    (State.READY, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 7
    (State.READY, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 7
    (State.ENABLED, Command.SHUTDOWN): State.READY,  # 8
    (State.ENABLED, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 9
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 10
    (State.ENABLED, Command.QUICK_STOP): State.QUICK_STOP,  # 11
    (State.QUICK_STOP, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 12
    (State.QUICK_STOP, Command.ENABLE): State.ENABLED,  # 16, if the quick stop option (605A) stays
}

POWERED = (State.ENABLED, State.QUICK_STOP, State.FAULT_REACTION)  #: States with power


BY_BITS = tuple(
    next(command for command in Command if bits & command.value[0] == command.value[1])
    for bits in range(16)
)  #: Command by the low four bits of a controlword: exactly one matches


def command(controlword: int) -> Command:
    """Return the command in a controlword."""
    return BY_BITS[controlword & 0x0F]
