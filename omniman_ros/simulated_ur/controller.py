"""The controller: modes, program, trajectory and joints, one cycle of 8 ms after the other."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.simulated_ur import outputs
from omniman_ros.simulated_ur.arm import JOINTS, Arm, UrArmParameters
from omniman_ros.simulated_ur.faults import UrFaultParameters
from omniman_ros.simulated_ur.modes import MOVING, Modes, RobotMode, Runtime, SafetyMode
from omniman_ros.simulated_ur.motion import Motion, MoveJ, ServoJ, SpeedJ, Stop, Target
from omniman_ros.simulated_ur.registers import Registers
from omniman_ros.simulated_ur.rtde_types import Value
from omniman_ros.simulated_ur.urscript.errors import Fault, ScriptError
from omniman_ros.simulated_ur.urscript.host import Done, Host, Joints

Array = NDArray[np.float64]

CYCLE = 0.008
"""Period of a CB3 controller [s]."""
RAMP = 2.0
"""How fast the speed slider's effect and a pause's change [1/s]."""
RESUMING = 0.1
"""How long the controller is resuming a program [s]."""
UNCOMMANDED = 20.0
"""Deceleration when a program no longer says what to do [rad/s^2]."""
ENDING = 4.0
"""Deceleration when a program ends [rad/s^2]."""
STEADY = 0.1
"""How long the arm must stand to be steady [s]."""
LEAST_SLIDER = 0.01
LOG = 100
"""Number of lines that are kept."""


class Program(Protocol):
    """A program that runs."""

    def step(self) -> None:
        """Run all threads until each waits; called once a cycle."""
        ...

    def stop(self, reason: str) -> None:
        """End it; nothing if it has ended."""
        ...

    def close_popups(self) -> None:
        """The person at the pendant closes all messages."""
        ...

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        ...

    @property
    def end_reason(self) -> str:
        """Why it has ended."""
        ...


Launch = Callable[[str, Host], Program]
"""Reads a program's text and starts it; raises ScriptError."""


class Network(Protocol):
    """Connections of the program; see `Host`."""

    def open(self, host: str, port: int, name: str) -> bool:
        """Connect."""
        ...

    def close(self, name: str) -> None:
        """Close."""
        ...

    def take(self, name: str, count: int) -> bytes | None:
        """Take exactly so many bytes."""
        ...

    def send(self, name: str, data: bytes) -> bool:
        """Send."""
        ...


@dataclass
class Counts:
    """What has happened since the start.

    Attributes:
        servo_calls: Calls of servoj.
        servo_repeats: Those of them for the same angles as the call before.
        servo_gaps: Cycles in which a program that was servoing gave no command.
        programs: Programs started.
        refused: Programs not started.
        protective_stops: Protective stops.
    """

    servo_calls: int = 0
    servo_repeats: int = 0
    servo_gaps: int = 0
    programs: int = 0
    refused: int = 0
    protective_stops: int = 0


class Controller:
    """A UR5 with a CB3 controller, without its ports; the `Host` of its program.

    Args:
        parameters: Of the arm.
        launch: Starts programs.
        network: Connections of the program.

    Attributes:
        faults: What is played; set at any time.
        slider: Speed slider, 0.01 to 1; set at any time.
        arm: The joints.
        target: Where they are to be.
        modes, runtime: See `modes`.
        registers: Shared with RTDE clients.
        log: Lines for people: messages of programs and what has happened.
        end_reason: Why the last program ended; empty while one runs.
        counts: Statistics.
        pace: Share of full speed: slider and pause together, 0 to 1.
    """

    def __init__(self, parameters: UrArmParameters, launch: Launch, network: Network) -> None:
        self.faults = UrFaultParameters()
        self.slider = 1.0
        self.arm = Arm(parameters)
        self.target = Target(self.arm.q.copy())
        self.target_qdd: Array = np.zeros(JOINTS)
        self.modes, self.runtime = Modes(), Runtime.STOPPED
        self.registers = Registers()
        self.log: deque[str] = deque(maxlen=LOG)
        self.end_reason = ""
        self.counts = Counts()
        self.fraction, self.limiter = 1.0, 1.0
        self._launch, self._network = launch, network
        self._played = self.faults
        self._begin_time: float | None = None
        self._now = 0.0
        self._program: Program | None = None
        self._secondary: list[Program] = []
        self._motion: Motion = Stop(UNCOMMANDED)
        self._suspended: MoveJ | None = None
        self._commanded = False
        self._servo: Joints = ()
        self._resumed = 0.0
        self._still_since = 0.0

    # ---- cycle --------------------------------------------------------------------------------

    def cycle(self, now: float) -> None:
        """Run one cycle at a time [s] that grows by CYCLE from one to the next."""
        if self._begin_time is None:
            self._begin_time = now
        self._now = now
        self._play_faults()
        if self.faults.freeze_all:
            self.arm.brake(CYCLE)
            return
        self.modes = self.modes.advance(self._now, self.arm.still)
        self._ramp()
        self._run_programs()
        self._advance()
        if not self.arm.still:
            self._still_since = now

    def _play_faults(self) -> None:
        before, self._played = self._played, self.faults
        new = self._played
        if new.protective_stop and not before.protective_stop:
            self.protective_stop("by hand")
        if new.pause_program and not before.pause_program:
            self.pause()
        if new.emergency_stop != before.emergency_stop:
            self.modes = self.modes.emergency_stop(new.emergency_stop)
            self._note(f"emergency stop {'pressed' if new.emergency_stop else 'released'}")
            if new.emergency_stop:
                self._halt()
                self.stop("emergency stop")

    def _ramp(self) -> None:
        """Let slider and pause take effect little by little."""
        if self.runtime is Runtime.RESUMING and self._now - self._resumed >= RESUMING:
            self.runtime = Runtime.PLAYING
        held = self.runtime in (Runtime.PAUSING, Runtime.PAUSED, Runtime.RESUMING)
        self.fraction = _towards(self.fraction, self.slider)
        self.limiter = _towards(self.limiter, 0.0 if held else 1.0)
        if self.runtime is Runtime.PAUSING and self.limiter == 0.0 and self.arm.still:
            self.runtime = Runtime.PAUSED

    def _run_programs(self) -> None:
        self._commanded = False
        if self.faults.freeze_program:
            return
        for each in self._secondary:
            each.step()
        self._secondary = [each for each in self._secondary if each.running]
        program = self._program
        if program is None or self.runtime is not Runtime.PLAYING:
            return
        program.step()
        if self._program is program and not program.running:
            self.stop(program.end_reason)

    def _advance(self) -> None:
        """Move target and joints on by a cycle, or stop them."""
        if not self.modes.powered:
            self.target = Target(self.arm.q.copy())
            self.arm.brake(CYCLE)
            self.target_qdd = np.zeros(JOINTS)
            return
        if self._motion.over and not self._commanded and self.runtime in MOVING:
            if isinstance(self._motion, ServoJ):
                self.counts.servo_gaps += 1
            if not isinstance(self._motion, Stop):
                self._begin(Stop(UNCOMMANDED))
        before = self.target_qd
        self._motion.advance(self.target, CYCLE * self._stretch)
        self.target_qdd = (self.target_qd - before) / CYCLE
        self.arm.follow(self.target.q, CYCLE)
        broken = self.arm.violation(self.target.q)
        if broken and self.modes.safety is SafetyMode.NORMAL:
            self.protective_stop(broken)

    @property
    def pace(self) -> float:
        """Share of full speed at which the program's motion runs, 0 to 1."""
        return self.fraction * self.limiter

    @property
    def _stretch(self) -> float:
        return self.pace if self._motion.stretched else 1.0

    @property
    def target_qd(self) -> Array:
        """Speed of the target in real time [rad/s]."""
        return self.target.w * self._stretch

    def _begin(self, motion: Motion) -> None:
        """Another motion goes on at the speed of the last one."""
        real = self.target_qd
        self._motion = motion
        stretch = self._stretch
        self.target.w = real / stretch if stretch >= LEAST_SLIDER else np.zeros(JOINTS)
        self._commanded = True

    def _halt(self) -> None:
        """Stop hard from where the joints are, at the speed they have."""
        # Where the target of joints is that move as these do.
        ahead = self.arm.q + self.arm.parameters.lag * self.arm.qd
        self.target = Target(ahead, self.arm.qd.copy())
        self._suspended = self._motion if isinstance(self._motion, MoveJ) else None
        self._motion = Stop(self.arm.parameters.protective_deceleration)

    # ---- stops, pauses, programs --------------------------------------------------------------

    def protective_stop(self, reason: str) -> None:
        """A protective stop comes; it pauses the program."""
        stopped = self.modes.protective_stop(self._now)
        if stopped is self.modes:
            return
        self.modes = stopped
        self.counts.protective_stops += 1
        self._note(f"protective stop: {reason}")
        self._halt()
        self.limiter = 0.0
        if self.runtime in MOVING:
            self.runtime = Runtime.PAUSING

    def start(self, text: str) -> bool:
        """Read and run a program; another one that runs ends. False if it cannot be run."""
        try:
            if not self.modes.ready:
                safety, robot = self.modes.safety.name, self.modes.robot.name
                raise Fault(f"the robot is {safety} and {robot}")
            program = self._launch(text, self)
        except (ScriptError, Fault) as error:
            self.counts.refused += 1
            self._note(f"program refused: {error}")
            return False
        if text.lstrip().startswith("sec"):
            self._secondary.append(program)
            return True
        self.stop("another program came")
        self.counts.programs += 1
        self.end_reason = ""
        self._program, self._servo = program, ()
        self.runtime, self.limiter = Runtime.PLAYING, 1.0
        return True

    def stop(self, reason: str) -> bool:
        """End the program; false if there is none."""
        program, self._program = self._program, None
        if program is None:
            return False
        program.stop(reason)
        self.end_reason, self._suspended = program.end_reason, None
        self._note(f"program ended: {self.end_reason}")
        if self.modes.safety is SafetyMode.NORMAL and not isinstance(self._motion, Stop):
            self._begin(Stop(ENDING))
        self.runtime = Runtime.STOPPED
        return True

    def pause(self) -> bool:
        """Pause the program; false if none is playing."""
        if self.runtime not in MOVING:
            return False
        self.runtime = Runtime.PAUSING
        return True

    def play(self) -> bool:
        """Go on with a program that is paused; false if there is none or it must not move."""
        if self.runtime is not Runtime.PAUSED or not self.modes.ready:
            return False
        self.runtime, self._resumed = Runtime.RESUMING, self._now
        self.limiter = 0.0
        if self._suspended is not None:
            # It was stopped on its way, and goes on from where the arm is.
            self._suspended.hold_up()
            self._motion, self._suspended = self._suspended, None
        return True

    def unlock(self) -> bool:
        """Unlock the protective stop; the program stays paused."""
        unlocked = self.modes.unlock(self._now)
        if unlocked is None:
            return False
        self.modes = unlocked
        self.target = Target(self.arm.q.copy())
        return True

    def close_popups(self) -> None:
        """Close what a program shows, and waits for."""
        if self._program is not None:
            self._program.close_popups()

    def power(self, wanted: RobotMode) -> bool:
        """Switch power and brakes; a program ends when power goes."""
        modes = self.modes.power(wanted, self._now)
        if modes is None:
            return False
        self.modes = modes
        if wanted is RobotMode.POWER_OFF:
            self._halt()
            self.stop("power off")
        return True

    @property
    def robot_mode(self) -> RobotMode:
        """Of the arm."""
        return self.modes.robot

    @property
    def safety_mode(self) -> SafetyMode:
        """Of the safety system."""
        return self.modes.safety

    @property
    def frozen(self) -> bool:
        """Whether ports are served, too."""
        return self.faults.freeze_all

    # ---- RTDE ---------------------------------------------------------------------------------

    def output(self, name: str) -> Value:
        """Value of an RTDE output now."""
        return outputs.value(self, name)

    def write_inputs(self, values: Mapping[str, Value]) -> None:
        """RTDE inputs that came together."""
        self.registers.write_inputs(values)
        fraction = values.get("speed_slider_fraction", 1.0)
        if values.get("speed_slider_mask") and isinstance(fraction, (int, float)):
            self.slider = min(max(fraction, LEAST_SLIDER), 1.0)

    @property
    def timestamp(self) -> float:
        """What RTDE tells as time since the start [s]."""
        return self.time + self.faults.timestamp_offset

    # ---- host of the program ------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time since the start, the same throughout a cycle [s]."""
        return self._now - (self._now if self._begin_time is None else self._begin_time)

    def servoj(self, q: Joints, t: float, lookahead_time: float, gain: float) -> Done:
        """Servo to joint angles [rad] for a time [s]."""
        self.counts.servo_calls += 1
        self.counts.servo_repeats += q == self._servo
        self._servo = q
        if not np.all(np.isfinite(q)):
            self.protective_stop(f"servoj to {q}")
            return lambda: True
        # What the last command took too long, since a cycle is no whole part of its time.
        last = self._motion
        overrun = last.overrun if isinstance(last, ServoJ) else 0.0
        t = max(t, CYCLE) - overrun
        return self._command(ServoJ(_six(q), t, lookahead_time, gain))

    def speedj(self, qd: Joints, a: float, t: float) -> Done:
        """Accelerate to joint speeds [rad/s] with a [rad/s^2]; t = 0: until they are reached."""
        return self._command(SpeedJ(_six(qd), _positive(a), t))

    def stopj(self, a: float) -> Done:
        """Decelerate to rest with a [rad/s^2]."""
        return self._command(Stop(_positive(a)))

    def movej(self, q: Joints, a: float, v: float, t: float, r: float) -> Done:
        """Move to joint angles [rad] and come to rest there; blends are not simulated."""
        return self._command(MoveJ(_six(q), _positive(a), _positive(v), t))

    def _command(self, motion: Motion) -> Done:
        self._begin(motion)
        return lambda: motion.over or motion not in (self._motion, self._suspended)

    def joints(self, what: str) -> Joints:
        """Six values, see `Host`."""
        value = self.output(what)
        assert isinstance(value, tuple)
        return value

    def is_steady(self) -> bool:
        """Whether the arm has been at rest for a moment."""
        return self._now - self._still_since >= STEADY

    def speed_scaling(self) -> float:
        """Speed slider, 0 to 1."""
        return self.fraction

    def read_register(self, kind: str, index: int) -> float:
        """Input register that an RTDE client writes."""
        return self.registers.read("input", kind, index)

    def write_register(self, kind: str, index: int, value: float) -> None:
        """Output register that RTDE clients read."""
        self.registers.write("output", kind, index, value)

    def socket_open(self, host: str, port: int, name: str) -> bool:
        """Connect; false if that fails."""
        return self._network.open(host, port, name)

    def socket_close(self, name: str) -> None:
        """Close; nothing if it is not open."""
        self._network.close(name)

    def socket_take(self, name: str, count: int) -> bytes | None:
        """Exactly `count` bytes if so many have come, else b""; None: closed."""
        return self._network.take(name, count)

    def socket_send(self, name: str, data: bytes) -> bool:
        """Send; false if it is not open or the peer does not take it."""
        return self._network.send(name, data)

    def textmsg(self, text: str) -> None:
        """A line for the log."""
        self._note(f"program says: {text}")

    def popup(self, text: str) -> None:
        """A message for the person at the pendant."""
        self._note(f"popup: {text}")

    def _note(self, line: str) -> None:
        self.log.append(line)


def _towards(value: float, wanted: float) -> float:
    step = RAMP * CYCLE
    return value + min(max(wanted - value, -step), step)


def _positive(value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise Fault(f"{value} is no acceleration or speed")
    return value


def _six(values: Joints) -> Array:
    if len(values) != JOINTS or not np.all(np.isfinite(values)):
        raise Fault(f"{values} are no {JOINTS} numbers")
    return np.array(values, dtype=float)
