"""Real-time data that a UR controller sends 125 times per second."""

from dataclasses import dataclass
from enum import IntEnum

Joints = tuple[float, ...]  #: One value for each joint, from the base on


class RobotMode(IntEnum):
    """Mode of the robot (RTDE `robot_mode`)."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """Safety mode of the controller (RTDE `safety_mode`)."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED = 11


class RuntimeState(IntEnum):
    """State of the program (RTDE `runtime_state`)."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MOVABLE = (SafetyMode.NORMAL, SafetyMode.REDUCED)  #: Safety modes in which the arm may move


@dataclass(frozen=True)
class ArmSample:
    """One packet of real-time data."""

    at: float  #: Time of arrival, on the monotonic clock of this machine [s]
    timestamp: float  #: Time of the controller [s]
    position: Joints  #: Measured joint angles (6,) [rad]
    velocity: Joints  #: Measured joint velocities (6,) [rad/s]
    target: Joints  #: Joint angles that the controller commands (6,) [rad]
    current: Joints  #: Currents of the motors (6,) [A]
    robot_mode: int  #: Number of the :class:`RobotMode`
    safety_mode: int  #: Number of the :class:`SafetyMode`
    runtime_state: int  #: Number of the :class:`RuntimeState`
    speed_scaling: float  #: Speed slider times the slowdown by the controller itself, 0 to 1
    read: int  #: Number of setpoints that the program reports to have read since it began

    @property
    def blocking_reason(self) -> str:
        """Why the arm cannot be moved, or an empty string."""
        if self.safety_mode not in MOVABLE:
            return f"safety mode: {_enum_text(SafetyMode, self.safety_mode)}"
        if self.robot_mode != RobotMode.RUNNING:
            return f"robot mode: {_enum_text(RobotMode, self.robot_mode)}"
        return ""


def _enum_text(kind: type[IntEnum], number: int) -> str:
    try:
        return kind(number).name.lower().replace("_", " ")
    except ValueError:
        return f"unknown ({number})"


def runtime_state_text(number: int) -> str:
    """Return the number of a :class:`RuntimeState` as text."""
    return _enum_text(RuntimeState, number)
