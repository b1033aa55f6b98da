"""The journal of a platform controller: its state, and every call that may change it, in order.

A tick is a pure function of state, inputs and time. So a controller that begins with the state of
a journal, and gets the same calls, returns the same commands, bit for bit.
"""

import io
import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import wraps
from hashlib import blake2b
from operator import attrgetter
from typing import Any

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.wheel_cascade import WheelCommand
from omniman_ros.core.errors import InputError, OmnimanError

#: Methods of a controller, and of its parts, through which a node changes its state
CALLS = {
    "": (
        "configure",
        "set_arm",
        "update_wheels",
        "set_twist",
        "set_preview",
        "set_voltages",
        "reset",
        "set_pose",
        "reset_odometry",
        "tick",
    ),
    "latch": ("stop", "shut_down", "set_emergency", "set_peer", "lose_peer"),
    "motion_limit": ("update",),
    "imu": ("update",),
    "feedback": ("note_restart",),
}
#: Length of the digest before a part [bytes]: a damaged pickle can break numpy in the process that
#: reads it, before anything is found wrong
DIGEST = 8
PUBLISHED = "published"  #: Name of the entry with the stamp [ns] of a tick's command
#: Packages whose classes a journal may contain: reading one runs no code of anybody else's
PACKAGES = ("omniman_ros.core.", "omniman_ros.control.")
#: What numpy and the standard library need to restore arrays, numbers and queues
RESTORERS = {
    ("collections", "deque"),
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    *(
        (f"numpy.{core}.{module}", name)
        for core in ("core", "_core")
        for module, name in (
            ("multiarray", "scalar"),
            ("multiarray", "_reconstruct"),
            ("numeric", "_frombuffer"),
        )
    ),
}


@dataclass(frozen=True)
class Chunk:
    """A part of a journal."""

    segment: int  #: Number of the segment, which begins with the state of the controller
    number: int  #: Number of the part in its segment, from 0
    state: bytes  #: State in which the segment begins, in its first part; else empty
    entries: tuple[bytes, ...]  #: Calls, and stamps of what was published


@dataclass(frozen=True)
class ReplayedTick:
    """A tick that was repeated."""

    now: float  #: Time of the tick [s]
    command: WheelCommand | None  #: What it commands
    stamp: int | None  #: Stamp of the command that was published then [ns]; None without one


class Journal:
    """Notes the calls of a controller while it is open, whoever makes them."""

    def __init__(self, core: PlatformController) -> None:
        self._core, self._is_open, self._is_called = core, False, False
        self._segment, self._number, self._state = 0, 0, b""
        self._entries: list[bytes] = []

    def open(self, segment: int) -> None:
        """Begin a segment with the present state; the number tells it from all others."""
        self.close()
        self._segment, self._number, self._state = segment, 0, pickle.dumps(self._core)
        for part, name in _calls():
            owner = attrgetter(part)(self._core) if part else self._core
            setattr(owner, name, self._noting(getattr(owner, name), _entry_name(part, name)))
        self._is_open = True

    def close(self) -> None:
        """Note nothing any more, and forget what was noted."""
        if self._is_open:
            for part, name in _calls():
                delattr(attrgetter(part)(self._core) if part else self._core, name)
        self._is_open = False
        self._entries.clear()

    def _noting(self, method: Callable[..., Any], name: str) -> Callable[..., Any]:
        @wraps(method)
        def noting(*args: Any, **options: Any) -> Any:
            if self._is_called:  # by the controller itself, which will do it again
                return method(*args, **options)
            self._note(name, args, options)
            self._is_called = True
            try:
                return method(*args, **options)
            finally:
                self._is_called = False

        return noting

    def _note(self, name: str, args: tuple[Any, ...], options: dict[str, Any]) -> None:
        self._entries.append(pickle.dumps((name, args, options)))

    def note_published(self, stamp: int) -> None:
        """Note the stamp [ns] with which the command of the last tick was published."""
        if self._is_open:
            self._note(PUBLISHED, (stamp,), {})

    def take(self) -> bytes:
        """Return what was noted since the last time, as bytes for :func:`read_chunk`."""
        chunk = Chunk(self._segment, self._number, self._state, tuple(self._entries))
        self._number, self._state = self._number + 1, b""
        self._entries.clear()
        return pack(chunk)


def _calls() -> Iterator[tuple[str, str]]:
    return ((part, name) for part, names in CALLS.items() for name in names)


def _entry_name(part: str, name: str) -> str:
    return f"{part}.{name}" if part else name


class _Reader(pickle.Unpickler):
    """Reads pickles of nothing but the controller's own classes."""

    def find_class(self, module: str, name: str) -> Any:
        found = super().find_class(module, name) if module.startswith(PACKAGES) else None
        is_own = isinstance(found, type) and found.__module__.startswith(PACKAGES)
        if not is_own and (module, name) not in RESTORERS:
            raise pickle.UnpicklingError(f"{module}.{name} is not part of a journal")
        return found if is_own else super().find_class(module, name)


def _read(data: bytes, kind: type) -> Any:
    """Return the object of a class in a pickle.

    Raises:
        InputError: It was written by another version, or is no part of a journal.
    """
    try:
        read = _Reader(io.BytesIO(data)).load()
    except Exception as error:  # a class of another version raises anything
        raise InputError(f"the journal cannot be read by this version: {error}") from error
    if not isinstance(read, kind):
        raise InputError(f"the journal contains a {type(read).__name__}, not a {kind.__name__}")
    return read


def _digest(data: bytes) -> bytes:
    return blake2b(data, digest_size=DIGEST).digest()


def pack(content: object) -> bytes:
    """Return a part of a journal as bytes for :func:`read_chunk`: digest and pickle."""
    data = pickle.dumps(content)
    return _digest(data) + data


def read_chunk(data: bytes) -> Chunk:
    """Return a part of a journal; InputError if it is damaged or cannot be read."""
    if data[:DIGEST] != _digest(data[DIGEST:]):
        raise InputError("the journal is damaged")
    chunk: Chunk = _read(data[DIGEST:], Chunk)
    return chunk


def restore(chunk: Chunk) -> PlatformController:
    """Return the controller with which a segment begins; InputError if it cannot be read."""
    core: PlatformController = _read(chunk.state, PlatformController)
    return core


def replay(core: PlatformController, entries: Iterable[bytes]) -> Iterator[ReplayedTick]:
    """Repeat the calls of a part of a journal; yield its ticks.

    Raises:
        InputError: An entry cannot be read, or is no call that this version has.
    """
    names = {_entry_name(part, name) for part, name in _calls()}
    last: ReplayedTick | None = None
    for entry in entries:
        name, args, options = _read(entry, tuple)
        if name == PUBLISHED and last is not None:
            last = ReplayedTick(last.now, last.command, args[0])
            continue
        if last is not None:
            yield last
            last = None
        if name not in names:
            raise InputError(f"the journal has a call '{name}', which this version has not")
        result = None
        try:
            with suppress(OmnimanError):  # the input was refused then, too
                result = attrgetter(name)(core)(*args, **options)
        except Exception as error:  # with a state of another version, anything
            raise InputError(f"this version has another '{name}': {error!r}") from error
        if name == "tick":
            last = ReplayedTick(args[0], result, None)
    if last is not None:
        yield last
