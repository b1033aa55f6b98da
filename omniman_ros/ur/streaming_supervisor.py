"""Policy of the streaming: the conditions under which setpoints are sent, and stops."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.ur import reverse_interface
from omniman_ros.ur.controller_link import ControllerLink
from omniman_ros.ur.feedback import ArmSample, RuntimeState, runtime_state_text
from omniman_ros.ur.joint_guard import GuardError, JointLimits
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.reverse_interface import ProgramMode
from omniman_ros.ur.servo_program import servo_program
from omniman_ros.ur.setpoint_generator import GeneratorSettings, JointSetpointGenerator
from omniman_ros.ur.streaming_messages import StreamingPhase

#: How long data that name the cause are awaited after the program's connection has ended [s]
LOSS_REASON_DELAY = 0.02
REST_SPEED = 0.01  #: Measured joint speed below which the arm counts as standing [rad/s]
#: Delay of a setpoint beyond which the arm has gone on by its last step instead [s].
#: After shorter ones the program on the controller catches up.
COASTING_DELAY = 4.5 * PERIOD
#: Number of setpoints whose send times are kept: more than the program can leave unread
SEND_TIMES = 256


def joint_limits(arm: ArmParameters, ur: UrParameters) -> JointLimits:
    """Return the limits of the joints that the guard enforces."""
    columns = [np.array(arm.each(k)) for k in ("lower", "upper", "velocity", "acceleration")]
    lower, upper, velocity, acceleration = columns
    following_error = np.full(len(arm.joints), ur.following_error)
    return JointLimits(arm.joints, lower, upper, velocity, acceleration, following_error)


class StreamingSupervisor:
    """Runs a program on the controller, sends it setpoints, and latches a stop on any fault.

    Between :meth:`start` and :meth:`finish`, and while not stopped, a program runs and a setpoint
    is sent every period: the present position until there is a preview. A stop brings the arm to
    rest along the preview and ends the program. If the controller has stopped the arm itself, or
    the program is lost, the connection is closed at once, so that setpoints in transit are not
    executed. After a stop no program runs until :meth:`reset`; the next one begins at the arm's
    position.

    Attributes:
        failure: Why the first program since :meth:`start` did not start, or an empty string.
        ages: Age of the newest setpoint that the program had read, for each sample since the last
            report [s].
    """

    def __init__(self, link: ControllerLink, arm: ArmParameters, ur: UrParameters) -> None:
        self._link = link
        self._limits = self._program_limits = joint_limits(arm, ur)
        self._generator = JointSetpointGenerator(
            self._limits, GeneratorSettings(ur.start_distance, ur.servo_lag), PERIOD
        )
        self._ur = ur
        self.phase = StreamingPhase.IDLE
        self.stop_reason = self.failure = ""
        self.ages: deque[float] = deque(maxlen=SEND_TIMES)
        self._is_requested = self._is_held = False
        self._has_streamed = False  # whether a program has streamed since start()
        self._has_played = False  # whether the controller has reported that this program plays
        self._ignore_feedback = False
        self._stream_start = 0.0
        self._loss_time: float | None = None
        self._count = 0
        self._send_times: deque[float] = deque(maxlen=SEND_TIMES)
        self._refusals: list[str] = []

    def configure(self, arm: ArmParameters, ur: UrParameters) -> None:
        """Replace the limits and timeouts.

        A program keeps the limits with which it began, so higher speeds and accelerations apply
        from the next one on.
        """
        self._ur = self._link.parameters = ur
        self._limits = limits = joint_limits(arm, ur)
        if self.phase is not StreamingPhase.IDLE:
            limits = replace(
                limits,
                velocity=np.minimum(limits.velocity, self._program_limits.velocity),
                acceleration=np.minimum(limits.acceleration, self._program_limits.acceleration),
            )
        self._generator.limits = limits
        self._generator.settings.start_distance = ur.start_distance

    def start(self, now: float) -> None:
        """Start a program at time `now` [s], and send setpoints until :meth:`finish`."""
        self.stop_reason = ""  # the node starts programs only while it is not stopped
        self._is_requested, self._has_streamed, self.failure = True, False, self.blocking_reason
        self._begin_program(now)

    def resume(self) -> None:
        """Replace a supervisor that has ended: :meth:`reset` starts the program."""
        self._is_requested = self._has_streamed = True

    def finish(self) -> None:
        """Bring the arm to rest, then end the program."""
        self._is_requested, self.failure = False, ""
        self._brake()

    def pause(self, reason: str) -> None:
        """Bring the arm to rest; the next preview moves it again."""
        if self.phase is StreamingPhase.STREAMING and self._generator.pause():
            self._refusals.append(f"the arm is brought to rest: {reason}")

    def stop(self, reason: str) -> None:
        """Latch a stop and bring the arm to rest; the first reason is kept."""
        self.stop_reason = self.stop_reason or reason
        self._brake()

    def hold(self, is_held: bool) -> None:
        """Bring the arm to rest and refuse previews while held; the program keeps running."""
        self._is_held = is_held
        if is_held:
            self._generator.hold()
        elif self.phase is StreamingPhase.STREAMING:
            self._generator.release()

    def limit_speed(self, fraction: float) -> None:
        """Keep to a fraction of the joints' speed limits, 0 to 1, from now on."""
        self._generator.allowed.target = fraction

    def reset(self, now: float) -> None:
        """Clear the stop if the arm can be moved, and start a program if one was requested."""
        if self.blocking_reason or not self.at_rest:
            return
        self.stop_reason = ""
        if self._is_requested:
            self._begin_program(now)

    def follow(self, preview: JointPreview, now: float) -> None:
        """Follow a preview; :meth:`take_refusals` returns why it was refused."""
        try:
            if self.phase is not StreamingPhase.STREAMING:
                state = f"stopped: {self.stop_reason}" if self.stop_reason else self.phase.value
                raise InputError(f"no setpoints are streamed ({state})")
            self._generator.follow(preview, now)
        except InputError as error:
            self._refusals.append(str(error))

    def take_refusals(self) -> tuple[str, ...]:
        """Return the refusals since the last call."""
        refusals, self._refusals = tuple(self._refusals), []
        return refusals

    @property
    def at_rest(self) -> bool:
        """Whether the setpoints stand still or, while none are sent, the arm does."""
        if self.phase in (StreamingPhase.STREAMING, StreamingPhase.ENDING):
            return self._generator.at_rest
        sample = self._link.sample
        if sample is None or not self._link.connected:
            return True
        return max(map(abs, sample.velocity)) < REST_SPEED

    @property
    def blocking_reason(self) -> str:
        """Why the arm cannot be moved now, or an empty string."""
        sample = self._link.sample
        return self._link.blocking_reason or (sample.blocking_reason if sample else "no data yet")

    def check(self, samples: Sequence[ArmSample], now: float) -> None:
        """Check received samples, oldest first, and whether data are overdue at `now` [s]."""
        if self.phase is StreamingPhase.IDLE:
            return
        reason = self.blocking_reason
        if reason and self._link.connected:
            return self._abort(reason)  # the controller itself stops the arm, then the program
        for sample in samples:
            self._check_sample(sample)
        if self._link.program is ProgramState.LOST:
            return self._lose(now)
        if self.phase is StreamingPhase.STARTING:
            if reason:
                self._abort(reason)
            elif self._link.program is ProgramState.RUNNING:
                self._begin_stream(now)
            return
        reason = reason or self._stall_reason(now)
        if reason and self.phase is StreamingPhase.STREAMING:
            self._ignore_feedback = True
            self.stop(reason)

    def tick(self, due: float, now: float) -> None:
        """Send the setpoint of a cycle.

        Args:
            due: Time at which it is due, one period after the last one [s]; the setpoint is that
                of `ur.servo_lag` later.
        """
        if self.phase not in (StreamingPhase.STREAMING, StreamingPhase.ENDING):
            return
        if self._link.program is ProgramState.LOST:
            return self._lose(now)
        if now - due > self._ur.read_timeout:
            return self._abort(f"a setpoint was delayed by {now - due:.3f} s")
        try:
            if now - due > COASTING_DELAY:
                setpoint = self._generator.coast(due)
            else:
                setpoint = self._generator.tick(due, self._measured())
        except GuardError as error:
            self._ignore_feedback = True
            self.stop(str(error))
            setpoint = self._generator.tick(due, None)
        self._send(setpoint, now)
        if self.phase is StreamingPhase.ENDING and self._generator.at_rest:
            self._end_program()

    def _begin_program(self, now: float) -> None:
        if self.phase is not StreamingPhase.IDLE or self.stop_reason or self.blocking_reason:
            return
        self._program_limits = self._generator.limits = self._limits
        program = servo_program(self._ur, self._limits, *self._link.address)
        self._link.start_program(program, now)
        self.phase = StreamingPhase.STARTING

    def _begin_stream(self, now: float) -> None:
        """Send the first setpoint, the measured position, to a program that has connected."""
        sample = self._link.sample
        assert sample is not None
        try:
            first = self._generator.begin(np.array(sample.position), now)
        except GuardError as error:
            return self._abort(str(error))
        if self._is_held:
            self._generator.hold()
        self.phase, self._stream_start = StreamingPhase.STREAMING, now
        self._has_streamed, self._ignore_feedback, self._has_played = True, False, False
        self._count = 0
        self._send_times.clear()
        self._send(first, now)

    def _brake(self) -> None:
        if self.phase is StreamingPhase.STARTING:
            self._end_program()
        elif self.phase is StreamingPhase.STREAMING:
            self._generator.hold()
            self.phase = StreamingPhase.ENDING

    def _abort(self, reason: str) -> None:
        """Close the connection: the program ends, and reads no setpoints in transit."""
        if not self._has_streamed:
            self._is_requested, self.failure = False, reason
        elif self._is_requested:
            self.stop_reason = self.stop_reason or reason
        self._link.end_program()
        self._generator.hold()
        self.phase, self._loss_time = StreamingPhase.IDLE, None

    def _lose(self, now: float) -> None:
        """Abort after a short delay, in which the controller's data may name the cause."""
        if self._loss_time is None:
            self._loss_time = now
        if self.phase is StreamingPhase.STARTING or now - self._loss_time >= LOSS_REASON_DELAY:
            self._abort(self._link.program_loss_reason)

    def _end_program(self) -> None:
        if self.phase is StreamingPhase.ENDING:
            self._link.send(self._message(self._generator.setpoint, ProgramMode.STOPPED))
        self._link.end_program()
        self.phase, self._loss_time = StreamingPhase.IDLE, None

    def _send(self, setpoint: Array, now: float) -> None:
        self._count += 1
        self._send_times.append(now)
        if not self._link.send(self._message(setpoint, ProgramMode.SERVO)):
            self._lose(now)

    def _message(self, setpoint: Array, mode: ProgramMode) -> bytes:
        return reverse_interface.pack(setpoint.tolist(), mode, self._ur.read_timeout)

    def _measured(self) -> Array | None:
        sample = self._link.sample
        if self._ignore_feedback or sample is None:
            return None
        return np.array(sample.position)

    def _check_sample(self, sample: ArmSample) -> None:
        if self.phase not in (StreamingPhase.STREAMING, StreamingPhase.ENDING):
            return
        is_playing = sample.runtime_state == RuntimeState.PLAYING
        if self._has_played and not is_playing:
            self._abort(f"the program is {runtime_state_text(sample.runtime_state)}")
            return
        self._has_played = self._has_played or is_playing
        sent = self._send_time(sample.read)
        if sent is not None:
            self.ages.append(sample.at - sent)

    def _send_time(self, number: int) -> float | None:
        """Return when a setpoint, counted from 1, was sent [s]; None if that is unknown."""
        setpoints_ago = self._count - number
        is_known = 0 <= setpoints_ago < len(self._send_times) and number > 0
        return self._send_times[-1 - setpoints_ago] if is_known else None

    def _stall_reason(self, now: float) -> str:
        """Return why the program seems to be stuck, or an empty string."""
        sample, timeout = self._link.sample, self._ur.feedback_timeout
        if not self._has_played:
            is_late = now - self._stream_start > timeout
            return "the controller does not report that the program plays" if is_late else ""
        assert sample is not None
        if sample.read >= self._count:
            return ""
        oldest_unread = self._send_time(sample.read + 1)
        if oldest_unread is None or sample.at - oldest_unread > timeout:
            return "the program reads no setpoints"
        return ""
