"""RTDE: what one client and the controller say to each other, without a socket.

Protocol version 2. Packages begin with their size, itself included, and a letter. Source:
Universal Robots, "Real-Time Data Exchange (RTDE) Guide", "Protocol".
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from omniman_ros.simulated_ur.rtde_types import INPUTS, OUTPUTS, Value, codec, flatten, regroup

HEADER = struct.Struct(">HB")
FREQUENCY = 125.0
"""Of the controller's cycle [Hz]; the largest that a client can have."""
VERSION = 2
URCONTROL = (3, 15, 8, 106339)
"""Major, minor, bugfix and build: software of a CB3 controller."""
REQUEST_VERSION, URCONTROL_VERSION, TEXT = ord("V"), ord("v"), ord("M")
SETUP_OUTPUTS, SETUP_INPUTS, START, PAUSE, DATA = (ord(letter) for letter in "OISPU")
ERROR_MESSAGE, SOURCE = 1, b"RTDE"
NAMES = 2048
"""Longest list of names, in bytes."""
RECIPES = 255


class Variables(Protocol):
    """The controller's variables, as clients see them."""

    def output(self, name: str) -> Value:
        """Value of an output now."""
        ...

    def write_inputs(self, values: dict[str, Value]) -> None:
        """Inputs that came together."""
        ...


@dataclass(frozen=True)
class Oddities:
    """Faults of the server.

    Attributes:
        refuse_version: No version of the protocol is accepted.
        not_found: Outputs that it has not.
        in_use: Inputs that somebody else has.
    """

    refuse_version: bool = False
    not_found: tuple[str, ...] = ()
    in_use: tuple[str, ...] = ()


class Broken(Exception):
    """What came is no package of this protocol; the connection ends."""


def package(kind: int, payload: bytes = b"") -> bytes:
    """A package with its header."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def text_message(text: str) -> bytes:
    """A message for people: text, source and level."""
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


class Session:
    """One client.

    Args:
        variables: What it reads and writes.
        owners: Who writes which input, shared by all sessions.

    Attributes:
        oddities: Faults, for as long as they are set.
        started: Whether data flow.
    """

    def __init__(self, variables: Variables, owners: "dict[str, Session]") -> None:
        self.oddities = Oddities()
        self.started = False
        self._variables, self._owners = variables, owners
        self._buffer = b""
        self._agreed = False
        self._output: _Recipe | None = None
        self._valid = True
        self._share, self._phase = 1.0, 0.0
        self._inputs: dict[int, _Recipe] = {}

    def close(self) -> None:
        """The client has gone: others may write its inputs."""
        for name in [name for name, owner in self._owners.items() if owner is self]:
            del self._owners[name]

    # ---- from the client ----------------------------------------------------------------------

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they come and return the answers.

        Raises:
            Broken: They are no package of this protocol, or none that fits here.
        """
        self._buffer += data
        return b"".join(self._answer(kind, payload) for kind, payload in self._packages())

    def _packages(self) -> Iterator[tuple[int, bytes]]:
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                raise Broken(f"a size of {size} bytes")
            if kind not in self._HANDLERS:
                raise Broken(f"package type {kind}")
            if len(self._buffer) < size:
                return
            payload, self._buffer = self._buffer[HEADER.size : size], self._buffer[size:]
            yield kind, payload

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if not self._agreed and kind not in (REQUEST_VERSION, URCONTROL_VERSION, TEXT):
            raise Broken("version 1 of the protocol, which is not simulated")
        try:
            return self._HANDLERS[kind](self, payload)
        except struct.error as error:
            raise Broken(f"package {chr(kind)} of {len(payload)} bytes: {error}") from error

    def _on_version(self, payload: bytes) -> bytes:
        (version,) = struct.unpack(">H", payload)
        self._agreed = version == VERSION and not self.oddities.refuse_version
        return package(REQUEST_VERSION, bytes([self._agreed]))

    def _on_urcontrol(self, payload: bytes) -> bytes:
        return package(URCONTROL_VERSION, struct.pack(">4I", *URCONTROL))

    def _on_text(self, payload: bytes) -> bytes:
        return b""

    def _on_outputs(self, payload: bytes) -> bytes:
        (frequency,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        missing = {name for name in names if name not in OUTPUTS}
        missing |= set(self.oddities.not_found)
        kinds = tuple("NOT_FOUND" if name in missing else OUTPUTS[name] for name in names)
        self._valid = "NOT_FOUND" not in kinds
        self._output = _Recipe(names, kinds, codec(kinds)) if self._valid and names else None
        # Not a number is below every limit, and 0 means the default.
        self._share = min(frequency, FREQUENCY) / FREQUENCY if frequency > 0.0 else 1.0
        self._phase = 0.0
        return package(SETUP_OUTPUTS, bytes([self._valid]) + ",".join(kinds).encode())

    def _on_inputs(self, payload: bytes) -> bytes:
        names = _names(payload)
        kinds = tuple(self._input_kind(name) for name in names)
        number = len(self._inputs) + 1
        if number > RECIPES or {"NOT_FOUND", "IN_USE"} & set(kinds) or not names:
            return package(SETUP_INPUTS, b"\0" + ",".join(kinds).encode())
        self._inputs[number] = _Recipe(names, kinds, codec(kinds))
        self._owners.update(dict.fromkeys(names, self))
        return package(SETUP_INPUTS, bytes([number]) + ",".join(kinds).encode())

    def _input_kind(self, name: str) -> str:
        if name not in INPUTS:
            return "NOT_FOUND"
        taken = self._owners.get(name, self) is not self or name in self.oddities.in_use
        return "IN_USE" if taken else INPUTS[name]

    def _on_start(self, payload: bytes) -> bytes:
        self.started = self._valid
        return package(START, bytes([self.started]))

    def _on_pause(self, payload: bytes) -> bytes:
        self.started = False
        return package(PAUSE, b"\1")

    def _on_data(self, payload: bytes) -> bytes:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            raise Broken(f"input recipe {payload[:1].hex() or 'missing'}")
        values = regroup(recipe.struct.unpack(payload[1:]), recipe.kinds)
        if self.started:
            self._variables.write_inputs(dict(zip(recipe.names, values, strict=True)))
        return b""

    _HANDLERS: "dict[int, Callable[[Session, bytes], bytes]]" = {
        REQUEST_VERSION: _on_version,
        URCONTROL_VERSION: _on_urcontrol,
        TEXT: _on_text,
        SETUP_OUTPUTS: _on_outputs,
        SETUP_INPUTS: _on_inputs,
        START: _on_start,
        PAUSE: _on_pause,
        DATA: _on_data,
    }

    # ---- to the client ------------------------------------------------------------------------

    def data(self) -> bytes:
        """The data package of this cycle, empty if none is due; called once a cycle."""
        if not self.started or self._output is None:
            return b""
        self._phase += self._share
        if self._phase < 1.0 - 1e-9:
            return b""
        self._phase -= 1.0
        values = flatten(self._variables.output(name) for name in self._output.names)
        return package(DATA, b"\1" + self._output.struct.pack(*values))


def _names(payload: bytes) -> tuple[str, ...]:
    """Names between commas; a last comma is followed by none."""
    if len(payload) > NAMES:
        raise Broken(f"names of {len(payload)} bytes")
    return tuple(
        name for name in payload.decode("ascii", errors="replace").split(",") if name.strip()
    )
