"""One RTDE session: what to ask of a controller, in which order, and what its data are worth.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide": version, outputs, start, data.
"""

import math
from collections import deque
from enum import Enum, auto

from omniman_ros.arm.errors import ProtocolError
from omniman_ros.arm.feedback import ArmSample, RuntimeState
from omniman_ros.arm.parameters import PERIOD
from omniman_ros.arm.rtde_packets import (
    Packet,
    PacketReader,
    PacketType,
    Recipe,
    accepted,
    request_version,
    setup_outputs,
    start,
    text_message,
)
from omniman_ros.core.errors import ParameterError

RATE = 1.0 / PERIOD
"""Of the data, Hz."""
SLIDER = "target_speed_fraction"
"""Output that the oldest controllers do not have."""
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
}
"""Outputs that are asked for and their types; the register of the program comes on top."""
REGISTERS = 48
"""Output integer registers of a controller."""
LARGEST_ANGLE = math.tau + 0.1
"""Of a joint, rad: the safety limits of the arm end at 363 degrees."""
LARGEST_SPEED = 20.0
"""Of a joint, rad/s: several times what an arm does."""
GAP = 1.5 * PERIOD
"""Between two timestamps, s: with more a packet was skipped."""
RESTART = 2.0
"""Step back of the controller's time, s, that means that it was started anew."""
KEPT = 1000
"""Samples and texts that are kept at most until they are taken: the newest."""
STANDING = (RuntimeState.PAUSED, RuntimeState.RESUMING)
"""Program states in which the arm stands though the speed slider does not say so."""


class Phase(Enum):
    """What is awaited of the controller."""

    NEW = auto()
    VERSION = auto()
    OUTPUTS = auto()
    START = auto()
    RUNNING = auto()
    ENDED = auto()


EXPECTED = {
    Phase.VERSION: PacketType.PROTOCOL_VERSION,
    Phase.OUTPUTS: PacketType.SETUP_OUTPUTS,
    Phase.START: PacketType.START,
    Phase.RUNNING: PacketType.DATA,
}
"""The one packet, next to texts, that a controller may send in a phase."""


class RtdeSession:
    """Talks to a controller from the first byte of a connection to its last.

    Args:
        register: Output integer register in which the program counts the setpoints it has read.
        slider: Whether to ask for the position of the speed slider. A controller that does not
            have it spoils the recipe; another session, on a new connection, does without. (The
            guide does not say that a second recipe may be set up on the same one.)

    Attributes:
        phase: What is awaited.
        progress: When the last step forward was made: a good answer or a usable sample, s. Texts
            and data that are of no use are none.
        missing: Outputs that the controller does not have.
        counts: Data so far by kind: "repeated" and "backward" timestamps and "implausible" values
            were dropped; "skipped" counts gaps, the data after them were used.

    Raises:
        ParameterError: There is no such register.
    """

    def __init__(self, register: int, slider: bool = True) -> None:
        if not 0 <= register < REGISTERS:
            raise ParameterError("ur.register", register, f"from 0 to {REGISTERS - 1}")
        self._counter = f"output_int_register_{register}"
        self._types = {name: t for name, t in OUTPUTS.items() if slider or name != SLIDER}
        self._types[self._counter] = "INT32"
        self._reader = PacketReader()
        self._recipe = Recipe(0, (), ())
        self._timestamp = -math.inf
        self._samples: deque[ArmSample] = deque(maxlen=KEPT)
        self._texts: deque[str] = deque(maxlen=KEPT)
        self.phase = Phase.NEW
        self.progress = -math.inf
        self.missing: frozenset[str] = frozenset()
        self.counts = {"repeated": 0, "backward": 0, "implausible": 0, "skipped": 0}

    @property
    def running(self) -> bool:
        """Whether data flow: the first usable sample is there."""
        return self.phase is Phase.RUNNING and self._timestamp > -math.inf

    def begin(self, now: float) -> bytes:
        """Return what to send first.

        Args:
            now: Time, s.
        """
        self._step(Phase.VERSION, now)
        return request_version()

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes as they come; return what to send.

        Args:
            data: From the controller, cut anywhere.
            now: Time, s: that of the samples.

        Raises:
            ProtocolError: The controller refuses or says what cannot be; the session has ended.
                What was usable before can still be taken.
        """
        answer = b""
        if self.phase in (Phase.NEW, Phase.ENDED):
            raise ProtocolError(f"RTDE: data in a session that is {self.phase.name.lower()}")
        try:
            for packet in self._reader.feed(data):
                answer += self._take(packet, now)
        except ProtocolError:
            self.phase = Phase.ENDED
            raise
        return answer

    def take_samples(self) -> list[ArmSample]:
        """Return the usable samples since the last call, oldest first."""
        result = list(self._samples)
        self._samples.clear()
        return result

    def take_texts(self) -> list[str]:
        """Return what the controller has said in words since the last call."""
        result = list(self._texts)
        self._texts.clear()
        return result

    def _step(self, phase: Phase, now: float) -> None:
        self.phase, self.progress = phase, now

    def _take(self, packet: Packet, now: float) -> bytes:
        if packet.kind == PacketType.TEXT_MESSAGE:
            self._texts.append(text_message(packet.payload))
            return b""
        if packet.kind != EXPECTED[self.phase]:
            raise ProtocolError(
                f"RTDE: a packet of type {packet.kind} out of turn, "
                f"expected {EXPECTED[self.phase].name} ({EXPECTED[self.phase]})"
            )
        if self.phase is Phase.RUNNING:
            self._data(packet.payload, now)
            return b""
        if self.phase is Phase.VERSION:
            if not accepted(packet.payload):
                raise ProtocolError("RTDE: version 2 of the protocol is refused")
            self._step(Phase.OUTPUTS, now)
            return setup_outputs(RATE, list(self._types))
        if self.phase is Phase.OUTPUTS:
            self._recipe = self._confirmed(packet.payload)
            self._step(Phase.START, now)
            return start()
        if not accepted(packet.payload):
            raise ProtocolError("RTDE: the start of the data is refused")
        self._step(Phase.RUNNING, now)
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
        for name, found in zip(recipe.names, recipe.types, strict=True):
            if found != self._types[name]:
                raise ProtocolError(
                    f"RTDE: output '{name}' is {found}, expected {self._types[name]}"
                )
        return recipe

    def _data(self, payload: bytes, now: float) -> None:
        values = self._recipe.values(payload)
        (timestamp,), (scaling,), (state,) = (
            values["timestamp"], values["speed_scaling"], values["runtime_state"]
        )  # fmt: skip
        (slider,) = values.get(SLIDER, (1.0,))
        q, qd, target = values["actual_q"], values["actual_qd"], values["target_q"]
        current = values["actual_current"]
        if not (
            max(map(abs, q)) <= LARGEST_ANGLE
            and max(map(abs, target)) <= LARGEST_ANGLE
            and max(map(abs, qd)) <= LARGEST_SPEED
            and math.isfinite(sum(q) + sum(target) + sum(qd) + sum(current))  # max passes NaN over
            and math.isfinite(timestamp + scaling + slider)
        ):
            self.counts["implausible"] += 1
            return
        step = timestamp - self._timestamp
        if step < -RESTART:
            raise ProtocolError(f"RTDE: the controller's time went back by {-step:.3f} s")
        if step <= 0.0:
            self.counts["repeated" if step == 0.0 else "backward"] += 1
            return
        if GAP < step < math.inf:  # infinite: the first one
            self.counts["skipped"] += 1
        self._timestamp = timestamp
        self.progress = now
        # Product, and nothing while a pause ends: ur_robot_driver, hardware_interface.cpp, read().
        speed = 0.0 if state in STANDING else min(max(scaling * slider, 0.0), 1.0)
        self._samples.append(
            ArmSample(
                at=now, timestamp=timestamp, position=q, velocity=qd, target=target,
                current=current, robot_mode=int(values["robot_mode"][0]),
                safety_mode=int(values["safety_mode"][0]), runtime_state=int(state),
                speed_scaling=speed, read=int(values[self._counter][0]),
            )
        )  # fmt: skip
