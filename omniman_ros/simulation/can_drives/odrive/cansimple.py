"""Identifiers, codes and constants of the protocol CANSimple, as far as they are modelled."""

import enum


class CanSimpleCommand(enum.IntEnum):
    """Command ids of frames: the lower five bits of the identifier."""

    VERSION = 0x00
    HEARTBEAT = 0x01
    ESTOP = 0x02
    ERROR = 0x03
    AXIS_STATE = 0x07
    ENCODER = 0x09
    CONTROLLER_MODE = 0x0B
    INPUT_VELOCITY = 0x0D
    INPUT_TORQUE = 0x0E
    LIMITS = 0x0F
    IQ = 0x14
    TEMPERATURE = 0x15
    REBOOT = 0x16
    BUS = 0x17
    CLEAR_ERRORS = 0x18


class Error(enum.IntFlag):
    """Bits of Active_Errors and Disarm_Reason (DBC 0.6.10)."""

    NONE = 0
    BAD_CONFIG = 0x10
    DRV_FAULT = 0x20
    MISSING_INPUT = 0x40
    UNDER_VOLTAGE = 0x200
    VELOCITY_LIMIT = 0x8000
    WATCHDOG = 0x1000000
    ESTOP = 0x2000000
    SPINOUT = 0x4000000


class OdriveAxisState(enum.IntEnum):
    """Axis states that are modelled."""

    IDLE = 1
    CLOSED_LOOP = 8


class Result(enum.IntEnum):
    """Procedure results that are modelled."""

    SUCCESS = 0
    DISARMED = 3
    INVALID_STATE = 13
    NOT_CALIBRATED = 14


class Control(enum.IntEnum):
    """Control modes that are modelled."""

    TORQUE = 1
    VELOCITY = 2


class Input(enum.IntEnum):
    """Input modes that are modelled."""

    PASSTHROUGH = 1
    VELOCITY_RAMP = 2
    TORQUE_RAMP = 6


MODES = {
    (Control.TORQUE, Input.PASSTHROUGH),
    (Control.TORQUE, Input.TORQUE_RAMP),
    (Control.VELOCITY, Input.PASSTHROUGH),
    (Control.VELOCITY, Input.VELOCITY_RAMP),
}  #: Modelled pairs of control mode and input mode; in other modes the axis disarms itself

#: Content of Get_Version.
#:
#: Protocol; hardware: product line, version, variant; firmware: major, minor, revision,
#: unreleased.
VERSION = (2, 4, 4, 58, 0, 6, 10, 0)
