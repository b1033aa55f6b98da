"""RTDE session: the sequence of requests to a controller, and the checks of its data.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide": version, outputs, start, data.
"""

import math
from collections import deque
from enum import Enum, auto

from omniman_ros.core.errors import ParameterError
from omniman_ros.ur.feedback import ArmSample, RuntimeState
from omniman_ros.ur.parameters import PERIOD
from omniman_ros.ur.rtde_packets import (
    PacketReader,
    PacketType,
    ProtocolError,
    Recipe,
    RtdePacket,
    accepted,
    request_version,
    setup_outputs,
    start,
    text_message,
)

RATE = 1.0 / PERIOD  #: Requested rate of the data [Hz]
#: Output that the oldest controllers do not have: position of the speed slider
SLIDER = "target_speed_fraction"
OUTPUTS = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D",
    "target_q": "VECTOR6D",
    "actual_current": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "runtime_state": "UINT32",
    "speed_scaling": "DOUBLE",
    SLIDER: "DOUBLE",
}  #: Requested outputs and their types; the register of the program is requested in addition
REGISTERS = 48  #: Number of output integer registers of a controller
#: Largest plausible joint angle [rad]: the safety limits of the arm end at 363 degrees
MAX_ANGLE = math.tau + 0.1
MAX_SPEED = 20.0  #: Largest plausible joint speed [rad/s]: several times that of any arm
#: Step between two timestamps above which a packet counts as skipped [s]
MAX_TIMESTAMP_STEP = 1.5 * PERIOD
#: Backward step of the timestamps from which on the controller counts as restarted [s]
RESTART_STEP = 2.0
#: Largest number of samples, and of texts, that are kept until they are read; the newest stay
MAX_UNREAD_SAMPLES = 1000
#: Program states in which the arm stands, whatever the speed slider reports
STANDING_STATES = (RuntimeState.PAUSED, RuntimeState.RESUMING)


class SessionPhase(Enum):
    """Phase of the dialogue: the answer that is awaited from the controller."""

    NEW = auto()
    VERSION = auto()
    OUTPUTS = auto()
    START = auto()
    RUNNING = auto()
    ENDED = auto()


EXPECTED = {
    SessionPhase.VERSION: PacketType.PROTOCOL_VERSION,
    SessionPhase.OUTPUTS: PacketType.SETUP_OUTPUTS,
    SessionPhase.START: PacketType.START,
    SessionPhase.RUNNING: PacketType.DATA,
}  #: The only packet, apart from texts, that a controller may send in each phase


class RtdeSession:
    """Dialogue with a controller from the first byte of a connection to the last.

    Args:
        register: Output integer register in which the program counts the setpoints it has read.
        slider: Whether to request the position of the speed slider. A controller without that
            output rejects the recipe; a session on a new connection then does not request it.
            (The guide does not say that a second recipe may be set up on the same connection.)

    Attributes:
        progress: Time of the last positive answer or usable sample [s]; texts and unusable data do
            not count.
        counts: Number of data packets so far by kind: those with "repeated" or "backward"
            timestamps or "implausible" values were discarded; "skipped" counts gaps, after
            which the data were used.

    Raises:
        ParameterError: There is no such register.
    """

    def __init__(self, register: int, slider: bool = True) -> None:
        if not 0 <= register < REGISTERS:
            raise ParameterError("ur.register", register, f"must be 0 to {REGISTERS - 1}")
        self._counter = f"output_int_register_{register}"
        self._types = {name: t for name, t in OUTPUTS.items() if slider or name != SLIDER}
        self._types[self._counter] = "INT32"
        self._reader = PacketReader()
        self._recipe = Recipe(0, (), ())
        self._timestamp = -math.inf
        self._samples: deque[ArmSample] = deque(maxlen=MAX_UNREAD_SAMPLES)
        self._texts: deque[str] = deque(maxlen=MAX_UNREAD_SAMPLES)
        self.phase = SessionPhase.NEW
        self.progress = -math.inf
        self.missing: frozenset[str] = frozenset()
        self.counts = {"repeated": 0, "backward": 0, "implausible": 0, "skipped": 0}

    @property
    def running(self) -> bool:
        """Whether data flow: the first usable sample has arrived."""
        return self.phase is SessionPhase.RUNNING and self._timestamp > -math.inf

    def begin(self, now: float) -> bytes:
        """Begin the dialogue at time `now` [s], and return the first bytes to send."""
        self._step(SessionPhase.VERSION, now)
        return request_version()

    def feed(self, data: bytes, now: float) -> bytes:
        """Process bytes that came at `now` [s], in pieces of any length; return those to send.

        Raises:
            ProtocolError: The controller refuses a request or violates the protocol. The session
                has ended; earlier usable samples can still be read.
        """
        answer = b""
        if self.phase in (SessionPhase.NEW, SessionPhase.ENDED):
            raise ProtocolError(f"RTDE: data in a session that is {self.phase.name.lower()}")
        try:
            for packet in self._reader.feed(data):
                answer += self._process(packet, now)
        except ProtocolError:
            self.phase = SessionPhase.ENDED
            raise
        return answer

    def take_samples(self) -> list[ArmSample]:
        """Return the usable samples since the last call, oldest first."""
        result = list(self._samples)
        self._samples.clear()
        return result

    def take_texts(self) -> list[str]:
        """Return the text messages of the controller since the last call."""
        result = list(self._texts)
        self._texts.clear()
        return result

    def _step(self, phase: SessionPhase, now: float) -> None:
        self.phase, self.progress = phase, now

    def _process(self, packet: RtdePacket, now: float) -> bytes:
        if packet.kind == PacketType.TEXT_MESSAGE:
            self._texts.append(text_message(packet.payload))
            return b""
        if packet.kind != EXPECTED[self.phase]:
            raise ProtocolError(
                f"RTDE: a packet of type {packet.kind} is unexpected, "
                f"must be {EXPECTED[self.phase].name} ({EXPECTED[self.phase]})"
            )
        if self.phase is SessionPhase.RUNNING:
            self._process_data(packet.payload, now)
            return b""
        if self.phase is SessionPhase.VERSION:
            if not accepted(packet.payload):
                raise ProtocolError("RTDE: version 2 of the protocol is refused")
            self._step(SessionPhase.OUTPUTS, now)
            return setup_outputs(RATE, list(self._types))
        if self.phase is SessionPhase.OUTPUTS:
            self._recipe = self._confirmed(packet.payload)
            self._step(SessionPhase.START, now)
            return start()
        if not accepted(packet.payload):
            raise ProtocolError("RTDE: the start of the data is refused")
        self._step(SessionPhase.RUNNING, now)
        return b""

    def _confirmed(self, payload: bytes) -> Recipe:
        words = payload[1:].decode("ascii", "replace").split(",")
        if len(words) == len(self._types):
            pairs = zip(self._types, words, strict=True)
            self.missing = frozenset(name for name, word in pairs if word == "NOT_FOUND")
        if self._counter in self.missing:
            raise ProtocolError(
                f"RTDE: output '{self._counter}': NOT_FOUND; parameter ur.register chooses it"
            )
        if len(self.missing) > 1:
            raise ProtocolError(f"RTDE: outputs {', '.join(sorted(self.missing))}: NOT_FOUND")
        recipe = Recipe.confirmed(list(self._types), payload)
        for name, actual_type in zip(recipe.names, recipe.types, strict=True):
            if actual_type != self._types[name]:
                raise ProtocolError(
                    f"RTDE: output '{name}' is {actual_type}, must be {self._types[name]}"
                )
        return recipe

    def _process_data(self, payload: bytes, now: float) -> None:
        values = self._recipe.values(payload)
        (timestamp,), (scaling,), (state,) = (
            values["timestamp"],
            values["speed_scaling"],
            values["runtime_state"],
        )
        (slider,) = values.get(SLIDER, (1.0,))
        q, qd, target = values["actual_q"], values["actual_qd"], values["target_q"]
        current = values["actual_current"]
        if not (
            max(map(abs, q)) <= MAX_ANGLE
            and max(map(abs, target)) <= MAX_ANGLE
            and max(map(abs, qd)) <= MAX_SPEED
            and math.isfinite(sum(q) + sum(target) + sum(qd) + sum(current))  # max ignores NaN
            and math.isfinite(timestamp + scaling + slider)
        ):
            self.counts["implausible"] += 1
            return
        step = timestamp - self._timestamp
        if step < -RESTART_STEP:
            raise ProtocolError(f"RTDE: the controller's time went back by {-step:.3f} s")
        if step <= 0.0:
            self.counts["repeated" if step == 0.0 else "backward"] += 1
            return
        if MAX_TIMESTAMP_STEP < step < math.inf:  # the step of the first packet is infinite
            self.counts["skipped"] += 1
        self._timestamp = timestamp
        self.progress = now
        # The product, and zero while a pause ends, as in ur_robot_driver, hardware_interface.cpp,
        # read().
        speed = 0.0 if state in STANDING_STATES else min(max(scaling * slider, 0.0), 1.0)
        self._samples.append(
            ArmSample(
                at=now,
                timestamp=timestamp,
                position=q,
                velocity=qd,
                target=target,
                current=current,
                robot_mode=int(values["robot_mode"][0]),
                safety_mode=int(values["safety_mode"][0]),
                runtime_state=int(state),
                speed_scaling=speed,
                read=int(values[self._counter][0]),
            )
        )
