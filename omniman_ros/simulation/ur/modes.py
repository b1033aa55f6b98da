"""Modes of robot, safety and program, as RTDE and the dashboard report them.

Numbers and names: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", "Robot mode", "Safety
mode", "robot_status_bits", "safety_status_bits"; "Dashboard Server CB-Series, port 29999".
runtime_state is not documented; its numbers are those that users found on real robots
(forum.universal-robots.com, "RTDE runtime_state enumeration").
"""

from dataclasses import dataclass, replace
from enum import IntEnum


class Cb3RobotMode(IntEnum):
    """State of the arm's power and brakes."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class Cb3SafetyMode(IntEnum):
    """State of the safety system, which lets the arm move or not."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class Cb3RuntimeState(IntEnum):
    """State of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


#: safety_status_bits: 0 normal, 2 protective stopped, 5 system and 6 robot emergency stopped, 7
#: emergency stopped, 10 stopped due to safety.
SAFETY_BITS = {
    Cb3SafetyMode.NORMAL: 1 << 0,
    Cb3SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    Cb3SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    Cb3SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
#: Modes in which the joints have power
POWERED = (Cb3RobotMode.POWER_ON, Cb3RobotMode.IDLE, Cb3RobotMode.BACKDRIVE, Cb3RobotMode.RUNNING)
MOVING = (Cb3RuntimeState.PLAYING, Cb3RuntimeState.RESUMING)  #: States in which the program runs
JOINT_RUNNING = 253  #: joint_mode of a joint that runs (RTDE guide, "Joint modes")
JOINT_IDLE = 255  #: joint_mode of a joint with its brake on
JOINT_POWER_OFF = 239  #: joint_mode of a joint without power

UNLOCK_DELAY = 5.0  #: Time after a protective stop in which it stays locked [s] (Dashboard Server)
SWITCHING_TIME = 0.5  #: Time of each step of switching power and brakes [s]; longer in reality


@dataclass(frozen=True)
class Modes:
    """All modes together."""

    robot: Cb3RobotMode = Cb3RobotMode.RUNNING  #: Mode of the arm
    safety: Cb3SafetyMode = Cb3SafetyMode.NORMAL  #: Mode of the safety system
    wanted: Cb3RobotMode = Cb3RobotMode.RUNNING  #: Mode to which the arm is being switched
    due: float = 0.0  #: Time at which the next step of switching is complete [s]
    stopped: float = 0.0  #: Time of the last protective stop [s]

    @property
    def ready(self) -> bool:
        """Whether a program may move the arm."""
        return self.robot is Cb3RobotMode.RUNNING and self.safety is Cb3SafetyMode.NORMAL

    @property
    def powered(self) -> bool:
        """Whether the joints have power."""
        return self.robot in POWERED

    @property
    def braked(self) -> bool:
        """Whether the brakes hold the joints."""
        return self.robot is not Cb3RobotMode.RUNNING

    @property
    def safety_bits(self) -> int:
        """Value of safety_status_bits."""
        return SAFETY_BITS[self.safety]

    @property
    def joint_mode(self) -> int:
        """Value of joint_mode, the same for each joint."""
        if not self.powered:
            return JOINT_POWER_OFF
        return JOINT_RUNNING if self.robot is Cb3RobotMode.RUNNING else JOINT_IDLE

    def with_arm(self, is_connected: bool) -> "Modes":
        """Return the modes after the joints began to answer, or ceased to.

        Joints that were lost are without power when they answer again.
        """
        if is_connected is (self.robot is not Cb3RobotMode.DISCONNECTED):
            return self
        if is_connected:
            return replace(self, robot=self.wanted)
        return replace(self, robot=Cb3RobotMode.DISCONNECTED, wanted=Cb3RobotMode.POWER_OFF)

    def protective_stop(self, now: float) -> "Modes":
        """Return the modes after a protective stop at time `now` [s]; emergency stops prevail."""
        if self.safety is not Cb3SafetyMode.NORMAL or not self.powered:
            return self
        return replace(self, safety=Cb3SafetyMode.PROTECTIVE_STOP, stopped=now)

    def unlock(self, now: float) -> "Modes | None":
        """Return the modes after unlocking; None within 5 s of the stop, or without one."""
        if self.safety is not Cb3SafetyMode.PROTECTIVE_STOP or now - self.stopped < UNLOCK_DELAY:
            return None
        return replace(self, safety=Cb3SafetyMode.NORMAL)

    def emergency_stop(self, pressed: bool) -> "Modes":
        """Return the modes after the button is pressed or released; the power stays off."""
        if pressed:
            return replace(
                self, safety=Cb3SafetyMode.ROBOT_EMERGENCY_STOP, wanted=Cb3RobotMode.POWER_OFF
            )
        if self.safety is Cb3SafetyMode.ROBOT_EMERGENCY_STOP:
            return replace(self, safety=Cb3SafetyMode.NORMAL)
        return self

    def power(self, wanted: Cb3RobotMode, now: float) -> "Modes | None":
        """Begin to switch to a mode; None without an arm, or if the emergency stop forbids it."""
        if self.robot is Cb3RobotMode.DISCONNECTED:
            return None
        if wanted in POWERED and self.safety is Cb3SafetyMode.ROBOT_EMERGENCY_STOP:
            return None
        if wanted is Cb3RobotMode.IDLE and self.robot is Cb3RobotMode.RUNNING:
            return self
        return replace(self, wanted=wanted, due=now + SWITCHING_TIME)

    def advance(self, now: float, at_rest: bool) -> "Modes":
        """Return the modes at time `now` [s]; power goes off only with the arm at rest."""
        if self.robot in (self.wanted, Cb3RobotMode.DISCONNECTED):
            return self
        if self.wanted is Cb3RobotMode.POWER_OFF:
            return replace(self, robot=Cb3RobotMode.POWER_OFF) if at_rest else self
        if now < self.due:
            return self
        following = {
            Cb3RobotMode.POWER_OFF: Cb3RobotMode.POWER_ON,
            Cb3RobotMode.POWER_ON: Cb3RobotMode.IDLE,
            Cb3RobotMode.IDLE: Cb3RobotMode.RUNNING,
        }
        return replace(self, robot=following[self.robot], due=now + SWITCHING_TIME)
