"""Simulated controller: modes, programs, trajectory and joints, in cycles of 8 ms."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur import rtde_outputs
from omniman_ros.simulation.ur.arm import CYCLE, JOINTS, UrArmParameters
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.faults import UrFaultParameters
from omniman_ros.simulation.ur.modes import (
    MOVING,
    Cb3RobotMode,
    Cb3RuntimeState,
    Cb3SafetyMode,
    Modes,
)
from omniman_ros.simulation.ur.motion import MotionCommand, MoveJ, ServoJ, StopJ, Target
from omniman_ros.simulation.ur.registers import Registers
from omniman_ros.simulation.ur.rtde_fields import Value
from omniman_ros.simulation.ur.safety_checks import SafetyChecks
from omniman_ros.simulation.ur.urscript.errors import ScriptError, ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.host import Done

SCALING_RATE = 2.0  #: Rate at which the speed slider and a pause take effect [1/s]
RESUMING_TIME = 0.1  #: Time for which the controller resumes a program before the program runs [s]
UNCOMMANDED_DECELERATION = 20.0  #: Deceleration while a program gives no command [rad/s^2]
END_DECELERATION = 4.0  #: Deceleration when a program ends [rad/s^2]
STEADY_TIME = 0.1  #: Time for which the arm must be at rest to count as steady [s]
MIN_SLIDER = 0.01  #: Lowest position of the speed slider
LOG_LENGTH = 100  #: Largest number of log lines; older ones are deleted


class RunningProgram(Protocol):
    """A program in execution."""

    def step(self) -> None:
        """Run all threads until each waits; called once per cycle."""

    def stop(self, reason: str) -> None:
        """End the program; do nothing if it has ended."""

    def close_popups(self) -> None:
        """Close all messages on the pendant."""

    @property
    def is_secondary(self) -> bool:
        """Whether it runs beside the program, and takes no time."""

    @property
    def running(self) -> bool:
        """Whether the program has not ended."""

    @property
    def end_reason(self) -> str:
        """Why the program has ended, or an empty string."""


#: Parses the text of a program and starts it on a controller, or raises ScriptError
Launch = Callable[[str, "Cb3Controller"], RunningProgram]


@dataclass
class Counts:
    """Numbers of events since the start."""

    servo_calls: int = 0  #: Calls of servoj
    servo_repeats: int = 0  #: Calls of servoj with the same angles as the call before
    servo_gaps: int = 0  #: Cycles in which a servoing program gave no command
    programs: int = 0  #: Programs that were started
    refused: int = 0  #: Programs that were refused
    protective_stops: int = 0


class Cb3Controller:
    """A UR5 with a CB3 controller, without its ports.

    Attributes:
        is_booting: Whether the joints have never answered, so that nobody knows where they are.
        modes: Modes of robot and safety.
        runtime: State of the program.
        fraction: Speed slider as it is in effect, 0 to 1.
        limiter: Speed limit of a pause as it is in effect, 0 to 1.
    """

    def __init__(self, parameters: UrArmParameters, arm: ArmBody, launch: Launch) -> None:
        self.faults = UrFaultParameters()  #: Simulated faults; may be replaced at any time
        self.slider = 1.0  #: Position of the speed slider, 0.01 to 1; may be set at any time
        self.arm, self.is_booting = arm, not arm.is_connected
        self.target = Target(arm.q.copy())  #: Point of the trajectory that the joints follow
        self.target_qdd: Array = np.zeros(JOINTS)  #: Acceleration of the target (6,) [rad/s^2]
        robot = Cb3RobotMode.RUNNING if arm.is_connected else Cb3RobotMode.DISCONNECTED
        self.modes, self.runtime = Modes(robot), Cb3RuntimeState.STOPPED
        self.registers = Registers()  #: Registers shared by programs and RTDE clients
        self.log: deque[str] = deque(maxlen=LOG_LENGTH)  #: Messages of programs, and events
        self.end_reason = ""  #: Why the last program ended; empty while one runs
        self.counts = Counts()  #: Numbers of events
        self.fraction, self.limiter = 1.0, 1.0
        self._parameters, self._checks = parameters, SafetyChecks(parameters)
        self._launch = launch
        self._last_faults = self.faults
        self._begin_time: float | None = None
        self._now = 0.0
        self._program: RunningProgram | None = None
        self._secondary: list[RunningProgram] = []
        self._motion: MotionCommand = StopJ(UNCOMMANDED_DECELERATION)
        self._suspended: MoveJ | None = None
        self._commanded = False
        self._resumed = 0.0
        self._still_since = 0.0

    # ---- cycle --------------------------------------------------------------------------------

    def cycle(self, now: float) -> None:
        """Run one cycle at time `now` [s], which is CYCLE after the last one."""
        if self._begin_time is None:
            self._begin_time = now
        self._now = now
        self._look_for_arm()
        self._apply_faults()
        if self.faults.freeze_all:
            self.arm.brake(CYCLE)
            return
        self.modes = self.modes.advance(self._now, self.arm.still)
        self._ramp()
        self._run_programs()
        self._advance()
        if not self.arm.still:
            self._still_since = now

    def _look_for_arm(self) -> None:
        """Begin when the joints answer, and stop for good when they do not any more."""
        modes = self.modes.with_arm(self.arm.is_connected)
        if modes is self.modes:
            return
        self.modes = modes
        if self.arm.is_connected:
            self.is_booting = False
            self.target = Target(self.arm.q.copy())
            self._log(f"the arm answers: {modes.robot.name}")
            return
        self._log(f"the arm does not answer: {self.arm.failure}")
        self._halt()
        self.stop("the arm does not answer")

    def _apply_faults(self) -> None:
        last, self._last_faults = self._last_faults, self.faults
        new = self._last_faults
        if new.protective_stop and not last.protective_stop:
            self.protective_stop("triggered by a fault parameter")
        if new.pause_program and not last.pause_program:
            self.pause()
        if new.emergency_stop != last.emergency_stop:
            self.modes = self.modes.emergency_stop(new.emergency_stop)
            self._log(f"emergency stop {'pressed' if new.emergency_stop else 'released'}")
            if new.emergency_stop:
                self._halt()
                self.stop("emergency stop")

    def _ramp(self) -> None:
        """Move the effective slider and speed limit gradually to their set values."""
        if self.runtime is Cb3RuntimeState.RESUMING and self._now - self._resumed >= RESUMING_TIME:
            self.runtime = Cb3RuntimeState.PLAYING
        paused = self.runtime in (
            Cb3RuntimeState.PAUSING,
            Cb3RuntimeState.PAUSED,
            Cb3RuntimeState.RESUMING,
        )
        self.fraction = _towards(self.fraction, self.slider)
        self.limiter = _towards(self.limiter, 0.0 if paused else 1.0)
        if self.runtime is Cb3RuntimeState.PAUSING and self.limiter == 0.0 and self.arm.still:
            self.runtime = Cb3RuntimeState.PAUSED

    def _run_programs(self) -> None:
        self._commanded = False
        if self.faults.freeze_program:
            return
        for secondary in self._secondary:
            secondary.step()
        self._secondary = [secondary for secondary in self._secondary if secondary.running]
        program = self._program
        if program is None or self.runtime is not Cb3RuntimeState.PLAYING:
            return
        program.step()
        if self._program is program and not program.running:
            self.stop(program.end_reason)

    def _advance(self) -> None:
        if self.modes.braked:
            self.target = Target(self.arm.q.copy())
            self.arm.lock()
            self.target_qdd = np.zeros(JOINTS)
            return
        if self._motion.over and not self._commanded and self.runtime in MOVING:
            if isinstance(self._motion, ServoJ):
                self.counts.servo_gaps += 1
            if not isinstance(self._motion, StopJ):
                self._begin(StopJ(UNCOMMANDED_DECELERATION))
        last_qd = self.target_qd
        self._motion.advance(self.target, CYCLE * self._stretch)
        self.target_qdd = (self.target_qd - last_qd) / CYCLE
        self.arm.follow(self.target.q, CYCLE)
        self._check()

    def _check(self) -> None:
        """Stop where a limit is exceeded, and do not press on, stopped or not."""
        violation = self._checks.violation(self.arm, self.target.q)
        if violation is None:
            return
        if violation.is_hindered:
            self.arm.give_way()
        if self.modes.safety is Cb3SafetyMode.NORMAL:
            self.protective_stop(violation.reason)
        elif violation.is_hindered:
            self.target = Target(self.arm.reference.q.copy(), self.arm.reference.qd.copy())

    @property
    def pace(self) -> float:
        """Fraction of full speed at which the program's motion runs: slider and pause, 0 to 1."""
        return self.fraction * self.limiter

    @property
    def _stretch(self) -> float:
        return self.pace if self._motion.stretched else 1.0

    @property
    def target_qd(self) -> Array:
        """Velocity of the target in real time (6,) [rad/s]."""
        return self.target.w * self._stretch

    def _begin(self, motion: MotionCommand) -> None:
        """Begin a motion at the velocity of the last one."""
        real = self.target_qd
        self._motion = motion
        stretch = self._stretch
        self.target.w = real / stretch if stretch >= MIN_SLIDER else np.zeros(JOINTS)
        self._commanded = True

    def _halt(self) -> None:
        """Stop hard from the position and velocity of the reference that the joints follow."""
        # This is the target that a reference with this motion would follow.
        reference = self.arm.reference
        ahead = reference.q + self._parameters.lag * reference.qd
        self.target = Target(ahead, reference.qd.copy())
        self._suspended = self._motion if isinstance(self._motion, MoveJ) else None
        self._motion = StopJ(self._parameters.protective_deceleration)

    # ---- stops, pauses, programs --------------------------------------------------------------

    def protective_stop(self, reason: str) -> None:
        """Trigger a protective stop, which pauses the program."""
        stopped = self.modes.protective_stop(self._now)
        if stopped is self.modes:
            return
        self.modes = stopped
        self.counts.protective_stops += 1
        self._log(f"protective stop: {reason}")
        self._halt()
        self.limiter = 0.0
        if self.runtime in MOVING:
            self.runtime = Cb3RuntimeState.PAUSING

    def start(self, text: str) -> bool:
        """Start a program, which ends a running one; return whether it could be started."""
        try:
            if not self.modes.ready:
                safety, robot = self.modes.safety.name, self.modes.robot.name
                raise ScriptRuntimeError(
                    f"the robot must be NORMAL and RUNNING, not {safety} and {robot}"
                )
            program = self._launch(text, self)
        except (ScriptError, ScriptRuntimeError) as error:
            self.counts.refused += 1
            self._log(f"program refused: {error}")
            return False
        if program.is_secondary:
            self._secondary.append(program)
            return True
        self.stop("another program was started")
        self.counts.programs += 1
        self.end_reason = ""
        self._program = program
        self.runtime, self.limiter = Cb3RuntimeState.PLAYING, 1.0
        return True

    def stop(self, reason: str) -> bool:
        """End the program; return False if there is none."""
        program, self._program = self._program, None
        if program is None:
            return False
        program.stop(reason)
        self.end_reason, self._suspended = program.end_reason, None
        self._log(f"program ended: {self.end_reason}")
        if self.modes.safety is Cb3SafetyMode.NORMAL and not isinstance(self._motion, StopJ):
            self._begin(StopJ(END_DECELERATION))
        self.runtime = Cb3RuntimeState.STOPPED
        return True

    def pause(self) -> bool:
        """Pause the program; return False if none is playing."""
        if self.runtime not in MOVING:
            return False
        self.runtime = Cb3RuntimeState.PAUSING
        return True

    def play(self) -> bool:
        """Resume a paused program; return False if there is none, or the arm must not move."""
        if self.runtime is not Cb3RuntimeState.PAUSED or not self.modes.ready:
            return False
        self.runtime, self._resumed = Cb3RuntimeState.RESUMING, self._now
        self.limiter = 0.0
        if self._suspended is not None:
            # The motion was interrupted, and continues from where the arm is.
            self._suspended.restart()
            self._motion, self._suspended = self._suspended, None
        return True

    def unlock(self) -> bool:
        """Unlock the protective stop; the program stays paused."""
        unlocked = self.modes.unlock(self._now)
        if unlocked is None:
            return False
        self.modes = unlocked
        self.target = Target(self.arm.reference.q.copy())
        return True

    def close_popups(self) -> None:
        """Close the popups that a program shows and waits for."""
        if self._program is not None:
            self._program.close_popups()

    def power(self, wanted: Cb3RobotMode) -> bool:
        """Switch to POWER_OFF, IDLE or RUNNING; return False if that is not possible now.

        Switching off ends the program.
        """
        modes = self.modes.power(wanted, self._now)
        if modes is None:
            return False
        self.modes = modes
        if wanted is Cb3RobotMode.POWER_OFF:
            self._halt()
            self.stop("power off")
        return True

    @property
    def robot_mode(self) -> Cb3RobotMode:
        """Mode of the arm."""
        return self.modes.robot

    @property
    def safety_mode(self) -> Cb3SafetyMode:
        """Mode of the safety system."""
        return self.modes.safety

    # ---- RTDE ---------------------------------------------------------------------------------

    def output(self, name: str) -> Value:
        """Return the present value of an RTDE output."""
        return rtde_outputs.value(self, name)

    def write_inputs(self, values: Mapping[str, Value]) -> None:
        """Apply RTDE inputs that arrived in one package."""
        self.registers.write_inputs(values)
        fraction = values.get("speed_slider_fraction", 1.0)
        if values.get("speed_slider_mask") and isinstance(fraction, (int, float)):
            self.slider = min(max(fraction, MIN_SLIDER), 1.0)

    @property
    def timestamp(self) -> float:
        """Time since the start as RTDE reports it [s]."""
        return self.time + self.faults.timestamp_offset

    # ---- for the program ----------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time since the start, the same throughout a cycle [s]."""
        return self._now - (self._now if self._begin_time is None else self._begin_time)

    @property
    def motion(self) -> MotionCommand:
        """Motion that is being executed."""
        return self._motion

    def command(self, motion: MotionCommand) -> Done:
        """Begin a motion; the returned function tells whether it has ended or was replaced."""
        self._begin(motion)
        return lambda: motion.over or motion not in (self._motion, self._suspended)

    @property
    def is_steady(self) -> bool:
        """Whether the arm has been at rest for a moment."""
        return self._now - self._still_since >= STEADY_TIME

    def textmsg(self, text: str) -> None:
        """Write a message of the program into the log."""
        self._log(f"program says: {text}")

    def popup(self, text: str) -> None:
        """Show a message on the pendant."""
        self._log(f"popup: {text}")

    def _log(self, line: str) -> None:
        self.log.append(line)


def _towards(value: float, goal: float) -> float:
    step = SCALING_RATE * CYCLE
    return value + min(max(goal - value, -step), step)
