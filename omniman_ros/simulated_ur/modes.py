"""Modes of robot, safety and program, as RTDE and the dashboard tell them.

Numbers and names: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", "Robot mode", "Safety
mode", "robot_status_bits", "safety_status_bits"; "Dashboard Server CB-Series, port 29999".
runtime_state is not documented; its numbers are those that users found on real robots
(forum.universal-robots.com, "RTDE runtime_state enumeration").
"""

from dataclasses import dataclass, replace
from enum import IntEnum


class RobotMode(IntEnum):
    """What the arm's power and brakes are doing."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """Why the arm may move, or may not."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class Runtime(IntEnum):
    """What the program is doing."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
"""safety_status_bits: 0 normal, 2 protective stopped, 5 system and 6 robot emergency stopped,
7 emergency stopped, 10 stopped due to safety."""
POWERED = (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING)
MOVING = (Runtime.PLAYING, Runtime.RESUMING)
"""In which the program runs."""
JOINT_RUNNING, JOINT_IDLE, JOINT_POWER_OFF = 253, 255, 239
"""joint_mode (RTDE guide, "Joint modes")."""

UNLOCK = 5.0
"""How long after a protective stop it cannot be unlocked [s] (Dashboard Server)."""
SWITCHING = 0.5
"""How long power and brakes take each [s]; a real arm takes some seconds."""


@dataclass(frozen=True)
class Modes:
    """All modes together.

    Attributes:
        robot: Of the arm.
        safety: Of the safety system.
        wanted: Where the arm's mode is going.
        due: When it makes its next step [s].
        stopped: When the last protective stop came [s].
    """

    robot: RobotMode = RobotMode.RUNNING
    safety: SafetyMode = SafetyMode.NORMAL
    wanted: RobotMode = RobotMode.RUNNING
    due: float = 0.0
    stopped: float = 0.0

    @property
    def ready(self) -> bool:
        """Whether a program may move the arm."""
        return self.robot is RobotMode.RUNNING and self.safety is SafetyMode.NORMAL

    @property
    def powered(self) -> bool:
        """Whether the joints have power."""
        return self.robot in POWERED

    @property
    def safety_bits(self) -> int:
        """safety_status_bits."""
        return SAFETY_BITS[self.safety]

    @property
    def joint_mode(self) -> int:
        """joint_mode of each joint."""
        if not self.powered:
            return JOINT_POWER_OFF
        return JOINT_RUNNING if self.robot is RobotMode.RUNNING else JOINT_IDLE

    def protective_stop(self, now: float) -> "Modes":
        """A protective stop comes at a time [s]; an emergency stop is the stronger."""
        if self.safety is not SafetyMode.NORMAL or not self.powered:
            return self
        return replace(self, safety=SafetyMode.PROTECTIVE_STOP, stopped=now)

    def unlock(self, now: float) -> "Modes | None":
        """Unlock the protective stop; None if it came less than 5 s ago, or there is none."""
        if self.safety is not SafetyMode.PROTECTIVE_STOP or now - self.stopped < UNLOCK:
            return None
        return replace(self, safety=SafetyMode.NORMAL)

    def emergency_stop(self, pressed: bool) -> "Modes":
        """The button is pressed or released; power stays off after its release."""
        if pressed:
            return replace(
                self, safety=SafetyMode.ROBOT_EMERGENCY_STOP, wanted=RobotMode.POWER_OFF
            )
        if self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            return replace(self, safety=SafetyMode.NORMAL)
        return self

    def power(self, wanted: RobotMode, now: float) -> "Modes | None":
        """Go towards a mode; None if an emergency stop is pressed and it needs power."""
        if wanted in POWERED and self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            return None
        if wanted is RobotMode.IDLE and self.robot is RobotMode.RUNNING:
            return self
        return replace(self, wanted=wanted, due=now + SWITCHING)

    def advance(self, now: float, at_rest: bool) -> "Modes":
        """Where the modes are at a time [s]; power goes off only with the arm at rest."""
        if self.robot is self.wanted:
            return self
        if self.wanted is RobotMode.POWER_OFF:
            return replace(self, robot=RobotMode.POWER_OFF) if at_rest else self
        if now < self.due:
            return self
        following = {
            RobotMode.POWER_OFF: RobotMode.POWER_ON,
            RobotMode.POWER_ON: RobotMode.IDLE,
            RobotMode.IDLE: RobotMode.RUNNING,
        }
        return replace(self, robot=following[self.robot], due=now + SWITCHING)
