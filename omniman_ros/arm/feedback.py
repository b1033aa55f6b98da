"""What a UR controller says of itself, 125 times a second."""

from dataclasses import dataclass
from enum import IntEnum

Joints = tuple[float, ...]


class RobotMode(IntEnum):
    """RTDE `robot_mode`."""

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
    """RTDE `safety_mode`."""

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
    """RTDE `runtime_state`, of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MOVABLE = (SafetyMode.NORMAL, SafetyMode.REDUCED)
"""Safety modes in which the arm may move."""


@dataclass(frozen=True)
class ArmSample:
    """One packet of real-time data.

    Attributes:
        at: When it arrived, on the clock of this machine, s.
        timestamp: The controller's own time, s.
        position: Measured joint angles (6,), rad.
        velocity: Measured, rad/s.
        target: Joint angles that the controller asks of its joints, rad.
        current: Of the motors, A.
        robot_mode, safety_mode, runtime_state: As the controller numbers them; see the enums.
        speed_scaling: 0 to 1: speed slider times what the controller itself slows down by.
        read: Setpoints that the program says it has read since it began.
    """

    at: float
    timestamp: float
    position: Joints
    velocity: Joints
    target: Joints
    current: Joints
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_scaling: float
    read: int

    @property
    def trouble(self) -> str:
        """Why the arm cannot be moved, or an empty string."""
        if self.safety_mode not in MOVABLE:
            return f"safety mode: {_words(SafetyMode, self.safety_mode)}"
        if self.robot_mode != RobotMode.RUNNING:
            return f"robot mode: {_words(RobotMode, self.robot_mode)}"
        return ""


def _words(kind: type[IntEnum], number: int) -> str:
    try:
        return kind(number).name.lower().replace("_", " ")
    except ValueError:
        return f"unknown ({number})"


def runtime_words(number: int) -> str:
    """State of the program for people."""
    return _words(RuntimeState, number)
