"""Socket functions of a program.

A read that cannot be completed at once waits; it ends when all bytes have arrived, after its
time-out, or when the socket is closed. Bytes that arrive too late for one read are available to
the next: numbers stay in the socket until all of them have arrived, and text that was read in
part is kept.

A failed read of numbers returns the count 0 and then, for each number, -1, or NaN for a float.
"""

import math
import struct
from collections.abc import Callable
from typing import TypeVar

from omniman_ros.simulation.ur.urscript.context import PENDING, Context, Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.values import (
    Value,
    checked_string,
    integer,
    number,
    text,
    to_str,
)

SOCKET = "socket_0"  #: Name of the socket that is used if a program gives none
MOST_NUMBERS = 30  #: Largest count of numbers in one read
TIMING = 1e-6  #: Tolerance of a time-out [s]
ENCODING = "latin-1"  #: Encoding of text, in which every byte is a character

T = TypeVar("T")
Attempt = Callable[[bool], object]  #: Tries to read, for the last time or not; may return PENDING


def socket_open(
    context: Context, address: Value, port: Value, socket_name: Value = SOCKET
) -> bool:
    """Connect, and return whether that succeeded."""
    name = text(socket_name, "socket_name")
    context.kept.pop(name, None)
    if not context.host.socket_open(text(address, "address"), integer(port, "port"), name):
        return False
    context.sockets.add(name)
    return True


def socket_close(context: Context, socket_name: Value = SOCKET) -> None:
    """Close a socket."""
    name = text(socket_name, "socket_name")
    context.kept.pop(name, None)
    context.sockets.discard(name)
    context.host.socket_close(name)


def reading(context: Context, timeout: Value, attempt: Attempt) -> object:
    """Try at once, then once per cycle until the time-out [s]; 0 or less is no time-out."""
    result = attempt(False)
    if result is not PENDING:
        return result
    host, limit = context.host, number(timeout, "timeout")
    end = host.time + limit - TIMING if limit > 0 else math.inf
    return Wait(lambda: attempt(host.time >= end))


def count_of(count: Value) -> int:
    """Return how many numbers to read; too many raise a ScriptRuntimeError."""
    checked_count = integer(count, "number")
    if not 1 <= checked_count <= MOST_NUMBERS:
        raise ScriptRuntimeError(
            f"{checked_count} numbers cannot be read at once, only 1 to {MOST_NUMBERS}"
        )
    return checked_count


def binary(layout: str) -> Callable[..., object]:
    """Return a function that reads big-endian binary numbers of a `struct` layout."""
    size = struct.calcsize(layout)

    def read(
        context: Context, number: Value, socket_name: Value = SOCKET, timeout: Value = 2
    ) -> object:
        count, name = count_of(number), text(socket_name, "socket_name")

        def attempt(is_last: bool) -> object:
            data = take(context, name, count * size)
            if data:
                return (count, *struct.unpack(f">{count}{layout}", data))
            return (0, *[-1] * count) if is_last or data is None else PENDING

        return reading(context, timeout, attempt)

    return read


def take(context: Context, name: str, count: int) -> bytes | None:
    """Return `count` bytes, kept ones first; b"" while fewer have arrived, None if closed."""
    kept = context.kept.get(name)
    if not kept:
        return context.host.socket_take(name, count)
    if len(kept) < count:
        more = context.host.socket_take(name, count - len(kept))
        if not more:
            return more
        kept += more
    data = bytes(kept[:count])
    del kept[:count]
    return data


def gather(context: Context, name: str, is_end: Callable[[bytearray], bool]) -> bytes | None:
    """Return the bytes up to an end; b"" while it has not arrived, None if closed."""
    kept = context.kept.setdefault(name, bytearray())
    last_kept = bytes(kept)
    kept.clear()
    for kept_byte in last_kept:
        kept.append(kept_byte)
        if is_end(kept):
            break
    else:
        while True:
            byte = context.host.socket_take(name, 1)
            if not byte:
                return byte
            kept += byte
            if is_end(kept):
                break
    message, rest = bytes(kept), last_kept[len(kept) :]
    kept[:] = rest
    return message


def socket_read_ascii_float(
    context: Context, number: Value, socket_name: Value = SOCKET, timeout: Value = 2
) -> object:
    """Read numbers in brackets, commas between them."""
    count, name = count_of(number), text(socket_name, "socket_name")
    failed = (0, *[math.nan] * count)

    def attempt(is_last: bool) -> object:
        data = gather(context, name, lambda kept: kept.endswith(b")"))
        if not data:
            return failed if is_last or data is None else PENDING
        inside = data.decode(ENCODING).rpartition("(")[2].rstrip(")")
        try:
            values = [float(word) for word in inside.split(",")]
        except ValueError:
            return failed
        return (count, *values) if len(values) == count else failed

    return reading(context, timeout, attempt)


def socket_read_line(context: Context, socket_name: Value = SOCKET, timeout: Value = 2) -> object:
    """Read a line, and return it without its end; "" if the end does not arrive."""
    name = text(socket_name, "socket_name")

    def attempt(is_last: bool) -> object:
        data = gather(context, name, lambda kept: kept.endswith(b"\n"))
        if not data:
            return "" if is_last or data is None else PENDING
        return checked_string(data.decode(ENCODING).rstrip("\r\n"))

    return reading(context, timeout, attempt)


def socket_read_string(
    context: Context, socket_name: Value = SOCKET, timeout: Value = 2
) -> object:
    """Read all bytes that have arrived, at least one; "" if none arrives."""
    name = text(socket_name, "socket_name")

    def attempt(is_last: bool) -> object:
        found = bytearray()
        while len(found) < 1023 and (byte := take(context, name, 1)):
            found += byte
        if found:
            return found.decode(ENCODING)
        return "" if is_last or byte is None else PENDING

    return reading(context, timeout, attempt)


def socket_send_int(context: Context, value: Value, socket_name: Value = SOCKET) -> bool:
    """Send 32 bits, big-endian."""
    return send(context, socket_name, struct.pack(">i", integer(value, "value")))


def socket_send_byte(context: Context, value: Value, socket_name: Value = SOCKET) -> bool:
    """Send one byte."""
    byte = integer(value, "value")
    if not 0 <= byte <= 255:
        raise ScriptRuntimeError(f"{byte} is no byte")
    return send(context, socket_name, bytes([byte]))


def socket_send_string(context: Context, str: Value, socket_name: Value = SOCKET) -> bool:
    """Send a string."""
    return send(context, socket_name, to_str(str).encode(ENCODING, "replace"))


def socket_send_line(context: Context, str: Value, socket_name: Value = SOCKET) -> bool:
    """Send a string and the end of a line."""
    return send(context, socket_name, to_str(str).encode(ENCODING, "replace") + b"\n")


def send(context: Context, socket_name: Value, data: bytes) -> bool:
    """Send; false if that fails."""
    return context.host.socket_send(text(socket_name, "socket_name"), data)


FUNCTIONS: dict[str, Callable[..., object]] = {
    "socket_read_binary_integer": binary("i"),
    "socket_read_byte_list": binary("B"),
    **{
        function.__name__: function
        for function in (
            *(socket_open, socket_close),
            *(socket_read_ascii_float, socket_read_line, socket_read_string),
            *(socket_send_int, socket_send_byte, socket_send_string, socket_send_line),
        )
    },
}  #: Functions of this module, by name
