"""Power state machine of CiA 402-2 (IEC 61800-7-201), 6.3: states, commands, transitions."""

from enum import Enum


class Cia402State(Enum):
    """States of the drive; the values are their bits of the statusword (CiA 402-2, 8.4.2)."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


class ControlwordCommand(Enum):
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
    (Cia402State.SWITCH_ON_DISABLED, ControlwordCommand.SHUTDOWN): Cia402State.READY,  # 2
    (Cia402State.READY, ControlwordCommand.SWITCH_ON): Cia402State.SWITCHED_ON,  # 3
    (Cia402State.READY, ControlwordCommand.ENABLE): Cia402State.SWITCHED_ON,  # 3, then 4
    (Cia402State.SWITCHED_ON, ControlwordCommand.ENABLE): Cia402State.ENABLED,  # 4
    (Cia402State.ENABLED, ControlwordCommand.SWITCH_ON): Cia402State.SWITCHED_ON,  # 5
    (Cia402State.SWITCHED_ON, ControlwordCommand.SHUTDOWN): Cia402State.READY,  # 6
    (Cia402State.READY, ControlwordCommand.QUICK_STOP): Cia402State.SWITCH_ON_DISABLED,  # 7
    (Cia402State.READY, ControlwordCommand.DISABLE_VOLTAGE): Cia402State.SWITCH_ON_DISABLED,  # 7
    (Cia402State.ENABLED, ControlwordCommand.SHUTDOWN): Cia402State.READY,  # 8
    (Cia402State.ENABLED, ControlwordCommand.DISABLE_VOLTAGE): Cia402State.SWITCH_ON_DISABLED,  # 9
    # 10
    (Cia402State.SWITCHED_ON, ControlwordCommand.DISABLE_VOLTAGE): Cia402State.SWITCH_ON_DISABLED,
    (Cia402State.SWITCHED_ON, ControlwordCommand.QUICK_STOP): Cia402State.SWITCH_ON_DISABLED,  # 10
    (Cia402State.ENABLED, ControlwordCommand.QUICK_STOP): Cia402State.QUICK_STOP,  # 11
    # 12
    (Cia402State.QUICK_STOP, ControlwordCommand.DISABLE_VOLTAGE): Cia402State.SWITCH_ON_DISABLED,
    # 16, if the quick stop option (605A) stays
    (Cia402State.QUICK_STOP, ControlwordCommand.ENABLE): Cia402State.ENABLED,
}

#: States with power
POWERED = (Cia402State.ENABLED, Cia402State.QUICK_STOP, Cia402State.FAULT_REACTION)


BY_BITS = tuple(
    next(command for command in ControlwordCommand if bits & command.value[0] == command.value[1])
    for bits in range(16)
)  #: Command by the low four bits of a controlword: exactly one matches


def command(controlword: int) -> ControlwordCommand:
    """Return the command in a controlword."""
    return BY_BITS[controlword & 0x0F]
