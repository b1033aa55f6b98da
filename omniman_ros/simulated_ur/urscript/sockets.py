"""Socket functions of a program.

A read that cannot be done at once waits; it ends when all has come, after its time-out, or when
the socket is closed. What came too late for one read is there for the next: whole numbers stay in
the socket until all of them are there, and text that was read in part is kept.

A failed read of numbers gives the count 0 and then -1, or NaN for floats, in each place.
"""

import math
import struct
from collections.abc import Callable
from typing import TypeVar

from omniman_ros.simulated_ur.urscript.errors import Fault
from omniman_ros.simulated_ur.urscript.instructions import PENDING, Thread, Wait
from omniman_ros.simulated_ur.urscript.values import Value, integer, number, short, text, to_str

SOCKET = "socket_0"
MOST_NUMBERS = 30  # of a read
TIMING = 1e-6  # s
ENCODING = "latin-1"

T = TypeVar("T")
Attempt = Callable[[bool], object]
"""Tries to read; told whether it is the last time. PENDING if it is to be tried again."""


def socket_open(thread: Thread, address: Value, port: Value, socket_name: Value = SOCKET) -> bool:
    """Connect."""
    machine, name = thread.machine, text(socket_name, "socket_name")
    machine.kept.pop(name, None)
    if not machine.host.socket_open(text(address, "address"), integer(port, "port"), name):
        return False
    machine.sockets.add(name)
    return True


def socket_close(thread: Thread, socket_name: Value = SOCKET) -> None:
    """Close."""
    name = text(socket_name, "socket_name")
    thread.machine.kept.pop(name, None)
    thread.machine.sockets.discard(name)
    thread.machine.host.socket_close(name)


def reading(thread: Thread, timeout: Value, attempt: Attempt) -> object:
    """Try at once, then once a cycle until the time-out, s; 0 or less waits for ever."""
    result = attempt(False)
    if result is not PENDING:
        return result
    host, limit = thread.machine.host, number(timeout, "timeout")
    end = host.time + limit - TIMING if limit > 0 else math.inf
    return Wait(lambda: attempt(host.time >= end))


def count_of(count: Value) -> int:
    """How many numbers are read; Fault if the controller cannot read so many."""
    found = integer(count, "number")
    if not 1 <= found <= MOST_NUMBERS:
        raise Fault(f"{found} numbers cannot be read at once, only 1 to {MOST_NUMBERS}")
    return found


def binary(layout: str) -> Callable[..., object]:
    """A function that reads binary numbers, each of a layout of `struct`, big-endian."""
    size = struct.calcsize(layout)

    def read(
        thread: Thread, number: Value, socket_name: Value = SOCKET, timeout: Value = 2
    ) -> object:
        count, name = count_of(number), text(socket_name, "socket_name")

        def attempt(is_last: bool) -> object:
            data = take(thread, name, count * size)
            if data:
                return (count, *struct.unpack(f">{count}{layout}", data))
            return (0, *[-1] * count) if is_last or data is None else PENDING

        return reading(thread, timeout, attempt)

    return read


def take(thread: Thread, name: str, count: int) -> bytes | None:
    """Exactly so many bytes, those that are kept first; b"" if there are fewer; None: closed."""
    kept = thread.machine.kept.get(name)
    if not kept:
        return thread.machine.host.socket_take(name, count)
    if len(kept) < count:
        more = thread.machine.host.socket_take(name, count - len(kept))
        if not more:
            return more
        kept += more
    data = bytes(kept[:count])
    del kept[:count]
    return data


def gather(thread: Thread, name: str, is_end: Callable[[bytearray], bool]) -> bytes | None:
    """Bytes up to an end, kept until it comes: b"" as long as it has not; None: closed."""
    machine = thread.machine
    kept = machine.kept.setdefault(name, bytearray())
    held = bytes(kept)
    kept.clear()
    for each in held:
        kept.append(each)
        if is_end(kept):
            break
    else:
        while True:
            byte = machine.host.socket_take(name, 1)
            if not byte:
                return byte
            kept += byte
            if is_end(kept):
                break
    found, rest = bytes(kept), held[len(kept) :]
    kept[:] = rest
    return found


def socket_read_ascii_float(
    thread: Thread, number: Value, socket_name: Value = SOCKET, timeout: Value = 2
) -> object:
    """Read numbers in brackets, commas between them."""
    count, name = count_of(number), text(socket_name, "socket_name")
    failed = (0, *[math.nan] * count)

    def attempt(is_last: bool) -> object:
        data = gather(thread, name, lambda kept: kept.endswith(b")"))
        if not data:
            return failed if is_last or data is None else PENDING
        inside = data.decode(ENCODING).rpartition("(")[2].rstrip(")")
        try:
            values = [float(word) for word in inside.split(",")]
        except ValueError:
            return failed
        return (count, *values) if len(values) == count else failed

    return reading(thread, timeout, attempt)


def socket_read_line(thread: Thread, socket_name: Value = SOCKET, timeout: Value = 2) -> object:
    """Read up to the end of a line, which is dropped; "" if it does not come."""
    name = text(socket_name, "socket_name")

    def attempt(is_last: bool) -> object:
        data = gather(thread, name, lambda kept: kept.endswith(b"\n"))
        if not data:
            return "" if is_last or data is None else PENDING
        return short(data.decode(ENCODING).rstrip("\r\n"))

    return reading(thread, timeout, attempt)


def socket_read_string(thread: Thread, socket_name: Value = SOCKET, timeout: Value = 2) -> object:
    """Read what there is, at least one byte; "" if nothing comes."""
    name = text(socket_name, "socket_name")

    def attempt(is_last: bool) -> object:
        found = bytearray()
        while len(found) < 1023 and (byte := take(thread, name, 1)):
            found += byte
        if found:
            return found.decode(ENCODING)
        return "" if is_last or byte is None else PENDING

    return reading(thread, timeout, attempt)


def socket_send_int(thread: Thread, value: Value, socket_name: Value = SOCKET) -> bool:
    """Send 32 bits, big-endian."""
    return send(thread, socket_name, struct.pack(">i", integer(value, "value")))


def socket_send_byte(thread: Thread, value: Value, socket_name: Value = SOCKET) -> bool:
    """Send one byte."""
    byte = integer(value, "value")
    if not 0 <= byte <= 255:
        raise Fault(f"{byte} is no byte")
    return send(thread, socket_name, bytes([byte]))


def socket_send_string(thread: Thread, str: Value, socket_name: Value = SOCKET) -> bool:  # noqa: A002
    """Send a string."""
    return send(thread, socket_name, to_str(str).encode(ENCODING, "replace"))


def socket_send_line(thread: Thread, str: Value, socket_name: Value = SOCKET) -> bool:  # noqa: A002
    """Send a string and the end of a line."""
    return send(thread, socket_name, to_str(str).encode(ENCODING, "replace") + b"\n")


def send(thread: Thread, socket_name: Value, data: bytes) -> bool:
    """Send; false if that fails."""
    return thread.machine.host.socket_send(text(socket_name, "socket_name"), data)


FUNCTIONS: dict[str, Callable[..., object]] = {
    **{each.__name__: each for each in (
        socket_open, socket_close, socket_read_ascii_float, socket_read_line, socket_read_string,
        socket_send_int, socket_send_byte, socket_send_string, socket_send_line,
    )},
    "socket_read_binary_integer": binary("i"),
    "socket_read_byte_list": binary("B"),
}  # fmt: skip
