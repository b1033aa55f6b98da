"""The policy of streaming: when setpoints go out, and every reason to stop them."""

from collections import deque
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.arm import reverse
from omniman_ros.arm.feedback import ArmSample, RuntimeState, runtime_words
from omniman_ros.arm.guard import GuardError, JointLimits
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.program import program
from omniman_ros.arm.program_link import ProgramState
from omniman_ros.arm.report import Phase
from omniman_ros.arm.reverse import Mode
from omniman_ros.arm.stream import JointStream, StreamSettings
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]

NAMING = 0.02
"""How long after the end of the program's connection the data is awaited that says why [s]."""
STANDING = 0.01
"""Measured joint speeds below it are rest [rad/s]."""
REMEMBERED = 256
"""Setpoints whose times are kept: those that the program has not read yet are fewer."""


class Link(Protocol):
    """The connections; see `link.ArmLink`."""

    parameters: UrParameters

    @property
    def connected(self) -> bool: ...  # noqa: D102

    @property
    def trouble(self) -> str: ...  # noqa: D102

    @property
    def sample(self) -> ArmSample | None: ...  # noqa: D102

    @property
    def program(self) -> ProgramState: ...  # noqa: D102

    @property
    def program_trouble(self) -> str: ...  # noqa: D102

    @property
    def address(self) -> tuple[str, int]: ...  # noqa: D102

    def start_program(self, text: str, now: float) -> None: ...  # noqa: D102

    def end_program(self) -> None: ...  # noqa: D102

    def send(self, data: bytes) -> bool: ...  # noqa: D102


def joint_limits(arm: ArmParameters, ur: UrParameters) -> JointLimits:
    """Limits of the joints for the guard."""
    columns = [np.array(arm.each(k)) for k in ("lower", "upper", "velocity", "acceleration")]
    lower, upper, velocity, acceleration = columns
    distance = np.full(len(arm.joints), ur.following_error)
    return JointLimits(arm.joints, lower, upper, velocity, acceleration, distance)


class ArmStreamer:
    """Runs a program on the controller, feeds it, and stops for good when something is wrong.

    While it is wanted (see :meth:`start`) and not stopped, a program runs and setpoints go out
    every period: the present place until there is a preview. A stop brings the arm to rest along
    the preview and ends the program; where the controller has stopped the arm itself, or the
    program is lost, the connection is closed at once, so that nothing goes on from what waits in
    it. After a stop there is no program until :meth:`reset`; the next begins where the arm is.

    Args:
        link: The connections.
        arm, ur: Parameters.

    Attributes:
        phase: See :class:`Phase`.
        stop_reason: Why it was stopped for good, or empty.
        failure: Why the first program since :meth:`start` did not come up, or empty.
        ages: Of the newest setpoint that the program had read, at the samples since they were
            taken [s].
    """

    def __init__(self, link: Link, arm: ArmParameters, ur: UrParameters) -> None:
        self._link = link
        self._stream = JointStream(
            joint_limits(arm, ur), StreamSettings(ur.start_distance, ur.servo_lag), PERIOD
        )
        self._ur = ur
        self.phase = Phase.IDLE
        self.stop_reason = self.failure = ""
        self.ages: deque[float] = deque(maxlen=REMEMBERED)
        self._wanted = self._held = False
        self._proven = self._played = self._blind = False
        self._since = 0.0
        self._lost: float | None = None
        self._count = 0
        self._times: deque[float] = deque(maxlen=REMEMBERED)
        self._refusals: list[str] = []

    def configure(self, arm: ArmParameters, ur: UrParameters) -> None:
        """Take over new limits and times."""
        self._ur = self._link.parameters = ur
        self._stream.limits = joint_limits(arm, ur)
        self._stream.settings.start_distance = ur.start_distance

    # ---- what is asked of it --------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Bring a program up, and keep the arm led until :meth:`finish`."""
        self.stop_reason = ""  # what asks for it has none
        self._wanted, self._proven, self.failure = True, False, self.trouble
        self._begin_program(now)

    def resume(self) -> None:
        """Be in another streamer's place, stopped: the program is begun by :meth:`reset`."""
        self._wanted = self._proven = True

    def finish(self) -> None:
        """Bring the arm to rest, then end the program."""
        self._wanted, self.failure = False, ""
        self._brake()

    def pause(self, why: str) -> None:
        """Bring the arm to rest; it goes on with the next preview."""
        if self.phase is Phase.STREAMING and self._stream.pause():
            self._refusals.append(f"the arm is brought to rest: {why}")

    def stop(self, reason: str) -> None:
        """Stop for good: the first reason is kept."""
        self.stop_reason = self.stop_reason or reason
        self._brake()

    def hold(self, held: bool) -> None:
        """Bring the arm to rest, and take no previews while held; the program runs on."""
        self._held = held
        if held:
            self._stream.hold()
        elif self.phase is Phase.STREAMING:
            self._stream.release()

    def reset(self, now: float) -> None:
        """Clear the stop, if the arm can be moved; where it is wanted a program is begun."""
        if self.trouble or not self.at_rest:
            return
        self.stop_reason = ""
        if self._wanted:
            self._begin_program(now)

    def preview(self, preview: JointPreview, now: float) -> None:
        """Follow a preview; a refusal is told by :meth:`take_refusals`."""
        try:
            if self.phase is not Phase.STREAMING:
                why = f"stopped: {self.stop_reason}" if self.stop_reason else self.phase.value
                raise InputError(f"no setpoints are streamed ({why})")
            self._stream.preview(preview, now)
        except InputError as error:
            self._refusals.append(str(error))

    def take_refusals(self) -> tuple[str, ...]:
        """What was refused since the last call."""
        result, self._refusals = tuple(self._refusals), []
        return result

    # ---- what it says ---------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether the setpoints stand; where none are sent, the arm."""
        if self.phase in (Phase.STREAMING, Phase.ENDING):
            return self._stream.at_rest
        sample = self._link.sample
        if sample is None or not self._link.connected:
            return True
        return max(map(abs, sample.velocity)) < STANDING

    @property
    def trouble(self) -> str:
        """Why the arm cannot be moved now, or an empty string."""
        sample = self._link.sample
        return self._link.trouble or (sample.trouble if sample else "no data yet")

    # ---- time -----------------------------------------------------------------------------------

    def watch(self, samples: Sequence[ArmSample], now: float) -> None:
        """Look at what came in, and at what did not.

        Args:
            samples: New real-time data.
            now: Time [s].
        """
        if self.phase is Phase.IDLE:
            return
        why = self.trouble
        if why and self._link.connected:
            return self._abort(why)  # the controller stops the arm itself; its program follows
        for sample in samples:
            self._hear(sample)
        if self._link.program is ProgramState.LOST:
            return self._lose(now)
        if self.phase is Phase.STARTING:
            if why:
                self._abort(why)
            elif self._link.program is ProgramState.RUNNING:
                self._begin_stream(now)
            return
        why = why or self._unread(now)
        if why and self.phase is Phase.STREAMING:
            self._blind = True
            self.stop(why)

    def tick(self, due: float, now: float) -> None:
        """Send the setpoint of a time.

        Args:
            due: One period after the last [s]; the setpoint is that of `ur.servo_lag` later.
            now: Time [s].
        """
        if self.phase not in (Phase.STREAMING, Phase.ENDING):
            return
        if self._link.program is ProgramState.LOST:
            return self._lose(now)
        if now - due > self._ur.read_timeout:
            return self._abort(f"held up for {now - due:.3f} s")
        try:
            setpoint = self._stream.tick(due, self._measured())
        except GuardError as error:
            self._blind = True
            self.stop(str(error))
            setpoint = self._stream.tick(due, None)
        self._send(setpoint, now)
        if self.phase is Phase.ENDING and self._stream.at_rest:
            self._end_program()

    # ---- the program ----------------------------------------------------------------------------

    def _begin_program(self, now: float) -> None:
        if self.phase is not Phase.IDLE or self.stop_reason or self.trouble:
            return
        self._link.start_program(program(self._ur, *self._link.address), now)
        self.phase = Phase.STARTING

    def _begin_stream(self, now: float) -> None:
        sample = self._link.sample
        assert sample is not None
        try:
            first = self._stream.begin(np.array(sample.position), now)
        except GuardError as error:
            return self._abort(str(error))
        if self._held:
            self._stream.hold()
        self.phase, self._since = Phase.STREAMING, now
        self._proven, self._blind, self._played = True, False, False
        self._count = 0
        self._times.clear()
        self._send(first, now)

    def _brake(self) -> None:
        if self.phase is Phase.STARTING:
            self._end_program()
        elif self.phase is Phase.STREAMING:
            self._stream.hold()
            self.phase = Phase.ENDING

    def _abort(self, reason: str) -> None:
        """Close the connection: the program ends, and nothing that waits in it is read."""
        if not self._proven:
            self._wanted, self.failure = False, reason
        elif self._wanted:
            self.stop_reason = self.stop_reason or reason
        self._link.end_program()
        self._stream.hold()
        self.phase, self._lost = Phase.IDLE, None

    def _lose(self, now: float) -> None:
        """The program's connection is gone: the controller's data may say why a little later."""
        if self._lost is None:
            self._lost = now
        if self.phase is Phase.STARTING or now - self._lost >= NAMING:
            self._abort(self._link.program_trouble)

    def _end_program(self) -> None:
        if self.phase is Phase.ENDING:
            self._link.send(self._message(self._stream.setpoint, Mode.STOPPED))
        self._link.end_program()
        self.phase, self._lost = Phase.IDLE, None

    def _send(self, setpoint: Array, now: float) -> None:
        self._count += 1
        self._times.append(now)
        if not self._link.send(self._message(setpoint, Mode.SERVO)):
            self._lose(now)

    def _message(self, setpoint: Array, mode: Mode) -> bytes:
        return reverse.pack(setpoint.tolist(), mode, self._ur.read_timeout)

    # ---- what comes in --------------------------------------------------------------------------

    def _measured(self) -> Array | None:
        sample = self._link.sample
        return None if self._blind or sample is None else np.array(sample.position)

    def _hear(self, sample: ArmSample) -> None:
        if self.phase not in (Phase.STREAMING, Phase.ENDING):
            return
        playing = sample.runtime_state == RuntimeState.PLAYING
        if self._played and not playing:
            self._abort(f"the program is {runtime_words(sample.runtime_state)}")
            return
        self._played = self._played or playing
        sent = self._sent_at(sample.read)
        if sent is not None:
            self.ages.append(sample.at - sent)

    def _sent_at(self, number: int) -> float | None:
        """When a setpoint was sent, by its number from 1 on [s]; None if that is not known."""
        back = self._count - number
        return self._times[-1 - back] if 0 <= back < len(self._times) and number > 0 else None

    def _unread(self, now: float) -> str:
        """Why the program seems to be stuck, or an empty string."""
        sample, patience = self._link.sample, self._ur.feedback_timeout
        if not self._played:
            late = now - self._since > patience
            return "the controller does not say that the program plays" if late else ""
        assert sample is not None
        if sample.read >= self._count:
            return ""
        oldest = self._sent_at(sample.read + 1)
        if oldest is None or sample.at - oldest > patience:
            return "the program reads no setpoints"
        return ""
