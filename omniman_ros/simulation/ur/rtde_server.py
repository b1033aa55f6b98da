"""RTDE server: the protocol with one client, without a socket.

Protocol version 2. Packages begin with their size, itself included, and a letter. Source:
Universal Robots, "Real-Time Data Exchange (RTDE) Guide", "Protocol".
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.rtde_fields import INPUTS, OUTPUTS, codec, flatten, regroup

HEADER = struct.Struct(">HB")  #: Header of a package: size of all of it [bytes], and type
FREQUENCY = 125.0  #: Frequency of the cycle, and largest one of a client's output [Hz]
VERSION = 2  #: Version of the protocol that is simulated
URCONTROL = (3, 15, 8, 106339)  #: Software of a CB3 controller: major, minor, bugfix and build
REQUEST_VERSION, URCONTROL_VERSION, TEXT = ord("V"), ord("v"), ord("M")
#: Types of packages
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE, DATA = (ord(letter) for letter in "OISPU")
ERROR_MESSAGE, SOURCE = 1, b"RTDE"  #: Level and source of text messages
MAX_NAMES_LENGTH = 2048  #: Length of the longest list of names [bytes]
MAX_RECIPES = 255  #: Largest number of input recipes of a client


@dataclass(frozen=True)
class RtdeFaults:
    """Faults of the server."""

    refuse_version: bool = False  #: Accept no version of the protocol
    not_found: tuple[str, ...] = ()  #: Outputs that the server does not have
    in_use: tuple[str, ...] = ()  #: Inputs that are reported to be in use by somebody else


class RtdeError(Exception):
    """The client violates the protocol; its connection is closed."""


def package(kind: int, payload: bytes = b"") -> bytes:
    """Return a package with its header."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def text_message(text: str) -> bytes:
    """Return a text message: text, source and level."""
    line = text.encode()[:255]
    return package(
        TEXT,
        bytes([len(line)]) + line + bytes([len(SOURCE)]) + SOURCE + bytes([ERROR_MESSAGE]),
    )


@dataclass(frozen=True)
class _Recipe:
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    struct: struct.Struct


class RtdeServerSession:
    """Session of one client.

    Args:
        owners: Session that writes each input; shared by all sessions.
    """

    def __init__(self, controller: Cb3Controller, owners: "dict[str, RtdeServerSession]") -> None:
        self.faults = RtdeFaults()  #: Faults of the server; may be replaced at any time
        self.started = False  #: Whether the client has started the exchange of data
        self._controller, self._owners = controller, owners
        self._buffer = b""
        self._agreed = False
        self._output: _Recipe | None = None
        self._valid = True
        self._rate, self._phase = 1.0, 0.0
        self._inputs: dict[int, _Recipe] = {}
        self._handlers: dict[int, Callable[[bytes], bytes]] = {
            REQUEST_VERSION: self._on_version,
            URCONTROL_VERSION: self._on_urcontrol,
            TEXT: self._on_text,
            SETUP_OUTPUTS: self._on_outputs,
            SETUP_INPUTS: self._on_inputs,
            START: self._on_start,
            PAUSE: self._on_pause,
            DATA: self._on_data,
        }

    def close(self) -> None:
        """Release the inputs of the client, so that others may write them."""
        for name in [name for name, owner in self._owners.items() if owner is self]:
            del self._owners[name]

    def receive(self, data: bytes) -> bytes:
        """Return the answers to bytes; what is no package now raises an RtdeError."""
        self._buffer += data
        return b"".join(self._answer(kind, payload) for kind, payload in self._packages())

    def _packages(self) -> Iterator[tuple[int, bytes]]:
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                raise RtdeError(f"a package must have at least {HEADER.size} bytes, not {size}")
            if kind not in self._handlers:
                raise RtdeError(f"there is no package type {kind}")
            if len(self._buffer) < size:
                return
            payload, self._buffer = self._buffer[HEADER.size : size], self._buffer[size:]
            yield kind, payload

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if not self._agreed and kind not in (REQUEST_VERSION, URCONTROL_VERSION, TEXT):
            raise RtdeError("the client uses version 1 of the protocol, which is not simulated")
        try:
            return self._handlers[kind](payload)
        except struct.error as error:
            raise RtdeError(
                f"package {chr(kind)} has a wrong payload of {len(payload)} bytes: {error}"
            ) from error

    def _on_version(self, payload: bytes) -> bytes:
        (version,) = struct.unpack(">H", payload)
        self._agreed = version == VERSION and not self.faults.refuse_version
        return package(REQUEST_VERSION, bytes([self._agreed]))

    def _on_urcontrol(self, payload: bytes) -> bytes:
        return package(URCONTROL_VERSION, struct.pack(">4I", *URCONTROL))

    def _on_text(self, payload: bytes) -> bytes:
        return b""

    def _on_outputs(self, payload: bytes) -> bytes:
        (frequency,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        missing = {name for name in names if name not in OUTPUTS}
        missing |= set(self.faults.not_found)
        kinds = tuple("NOT_FOUND" if name in missing else OUTPUTS[name] for name in names)
        self._valid = "NOT_FOUND" not in kinds
        self._output = _Recipe(names, kinds, codec(kinds)) if self._valid and names else None
        # NaN fails every comparison, and 0 means the default.
        self._rate = min(frequency, FREQUENCY) / FREQUENCY if frequency > 0.0 else 1.0
        self._phase = 0.0
        return package(SETUP_OUTPUTS, bytes([self._valid]) + ",".join(kinds).encode())

    def _on_inputs(self, payload: bytes) -> bytes:
        names = _names(payload)
        kinds = tuple(self._input_kind(name) for name in names)
        number = len(self._inputs) + 1
        if number > MAX_RECIPES or {"NOT_FOUND", "IN_USE"} & set(kinds) or not names:
            return package(SETUP_INPUTS, b"\0" + ",".join(kinds).encode())
        self._inputs[number] = _Recipe(names, kinds, codec(kinds))
        self._owners.update(dict.fromkeys(names, self))
        return package(SETUP_INPUTS, bytes([number]) + ",".join(kinds).encode())

    def _input_kind(self, name: str) -> str:
        if name not in INPUTS:
            return "NOT_FOUND"
        in_use = self._owners.get(name, self) is not self or name in self.faults.in_use
        return "IN_USE" if in_use else INPUTS[name]

    def _on_start(self, payload: bytes) -> bytes:
        self.started = self._valid
        return package(START, bytes([self.started]))

    def _on_pause(self, payload: bytes) -> bytes:
        self.started = False
        return package(PAUSE, b"\1")

    def _on_data(self, payload: bytes) -> bytes:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            raise RtdeError(f"there is no input recipe {payload[:1].hex() or 'in the package'}")
        values = regroup(recipe.struct.unpack(payload[1:]), recipe.kinds)
        if self.started:
            self._controller.write_inputs(dict(zip(recipe.names, values, strict=True)))
        return b""

    def data(self) -> bytes:
        """Return the data package of this cycle, empty if none is due; called once per cycle."""
        if not self.started or self._output is None:
            return b""
        self._phase += self._rate
        if self._phase < 1.0 - 1e-9:
            return b""
        self._phase -= 1.0
        values = flatten(self._controller.output(name) for name in self._output.names)
        return package(DATA, b"\1" + self._output.struct.pack(*values))


def _names(payload: bytes) -> tuple[str, ...]:
    """Return the names between commas; nothing follows a trailing comma."""
    if len(payload) > MAX_NAMES_LENGTH:
        raise RtdeError(f"names must be at most {MAX_NAMES_LENGTH} bytes long, not {len(payload)}")
    return tuple(
        name for name in payload.decode("ascii", errors="replace").split(",") if name.strip()
    )
