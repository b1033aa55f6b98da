"""Frames of the link: setpoints of the joints one way, their measured state the other way.

A frame has a fixed size, in network byte order:

* 4 bytes: MAGIC, which includes the version;
* uint8: kind, 1 for a setpoint, 2 for a state;
* uint8: flags of a setpoint, bit 0 for one that begins anew, bit 1 for a braked one; 0 in a state;
* 2 bytes: zero;
* uint32: sequence;
* float64: due, six angles and six speeds of a setpoint; six angles, speeds and torques of a state.

Other bytes raise an InputError; nothing after them can be read.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from omniman_ros.core.errors import InputError

JOINTS = 6  #: Number of joints
MAGIC = b"OAL1"  #: First bytes of each frame
MAX_VALUE = 1e4  #: Magnitude above which no angle, speed or torque is meant [rad, rad/s, N m]
MAX_SEQUENCE = 2**32 - 1  #: Largest sequence number; at 125 Hz, it is reached after a year

_HEADER = struct.Struct(">4sBBHI")
_SETPOINT = struct.Struct(">13d")
_STATE = struct.Struct(">18d")
_SETPOINT_KIND, _STATE_KIND = 1, 2
_BEGINS_ANEW, _BRAKED = 1, 2
SETPOINT_SIZE = _HEADER.size + _SETPOINT.size  #: Length of the frame of a setpoint [bytes]
STATE_SIZE = _HEADER.size + _STATE.size  #: Length of the frame of a state [bytes]

Joints = tuple[float, ...]  #: A value per joint, (6,)


@dataclass(frozen=True)
class ArmSetpoint:
    """Where the joints shall be, and how fast."""

    sequence: int  #: Number of the setpoint, which the state that answers it has as well
    due: float  #: Instant at which the joints shall be there, on the clock of both sides [s]
    positions: Joints  #: Angles (6,) [rad]
    velocities: Joints  #: Speeds (6,) [rad/s]
    #: Whether the way to the setpoint is one of constant speeds that begins elsewhere than the
    #: last one has ended; else it continues that one smoothly.
    begins_anew: bool = False
    braked: bool = False  #: Whether the brakes hold the joints, without motor torque


@dataclass(frozen=True)
class ArmState:
    """What the joints measure."""

    sequence: int  #: Number of the setpoint that was due at this instant; 0 before the first one
    positions: Joints  #: Angles (6,) [rad]
    velocities: Joints  #: Speeds (6,) [rad/s]
    torques: Joints  #: Mean torques of the drives since the last state (6,) [N m]


def encode_setpoint(setpoint: ArmSetpoint) -> bytes:
    """Return the frame of a setpoint."""
    flags = _BEGINS_ANEW * setpoint.begins_anew | _BRAKED * setpoint.braked
    header = _HEADER.pack(MAGIC, _SETPOINT_KIND, flags, 0, setpoint.sequence)
    return header + _SETPOINT.pack(setpoint.due, *setpoint.positions, *setpoint.velocities)


def encode_state(state: ArmState) -> bytes:
    """Return the frame of a state."""
    header = _HEADER.pack(MAGIC, _STATE_KIND, 0, 0, state.sequence)
    return header + _STATE.pack(*state.positions, *state.velocities, *state.torques)


class _FrameReader:
    """Cuts a stream of bytes into frames of one kind."""

    def __init__(self, kind: int, body: struct.Struct) -> None:
        self._kind, self._body = kind, body
        self._buffer = b""

    def frames(self, data: bytes) -> list[tuple[int, int, Sequence[float]]]:
        """Return flags, sequence and values of each frame that is complete now."""
        self._buffer += data
        size = _HEADER.size + self._body.size
        found: list[tuple[int, int, Sequence[float]]] = []
        while self._buffer:
            begin = self._buffer[: len(MAGIC)]
            if begin != MAGIC[: len(begin)]:
                raise InputError(f"a frame begins with {MAGIC!r}, not with {begin!r}")
            if len(self._buffer) < size:
                break
            _, kind, flags, zero, sequence = _HEADER.unpack_from(self._buffer)
            values = self._body.unpack_from(self._buffer, _HEADER.size)
            self._buffer = self._buffer[size:]
            if kind != self._kind or zero or flags & ~(_BEGINS_ANEW | _BRAKED):
                raise InputError(f"no such frame: kind {kind}, flags {flags}, then {zero}")
            if not all(map(math.isfinite, values)):
                raise InputError(f"all numbers of a frame must be finite, not {values}")
            found.append((flags, sequence, values))
        return found


def _require_magnitude(values: Sequence[float]) -> None:
    largest = max(map(abs, values))
    if largest > MAX_VALUE:
        raise InputError(f"{largest:g} is above {MAX_VALUE:g}, the largest value of a joint")


class SetpointReader:
    """Decodes setpoints from a stream of bytes that arrive in pieces."""

    def __init__(self) -> None:
        self._reader = _FrameReader(_SETPOINT_KIND, _SETPOINT)

    def receive(self, data: bytes) -> list[ArmSetpoint]:
        """Return the setpoints that are complete with these bytes."""
        setpoints = []
        for flags, sequence, values in self._reader.frames(data):
            _require_magnitude(values[1:])
            setpoints.append(
                ArmSetpoint(
                    sequence,
                    values[0],
                    tuple(values[1 : 1 + JOINTS]),
                    tuple(values[1 + JOINTS :]),
                    begins_anew=bool(flags & _BEGINS_ANEW),
                    braked=bool(flags & _BRAKED),
                )
            )
        return setpoints


class StateReader:
    """Decodes states from a stream of bytes that arrive in pieces."""

    def __init__(self) -> None:
        self._reader = _FrameReader(_STATE_KIND, _STATE)

    def receive(self, data: bytes) -> list[ArmState]:
        """Return the states that are complete with these bytes."""
        states = []
        for _, sequence, values in self._reader.frames(data):
            _require_magnitude(values)
            rows = [tuple(values[k : k + JOINTS]) for k in range(0, len(values), JOINTS)]
            states.append(ArmState(sequence, *rows))
        return states
