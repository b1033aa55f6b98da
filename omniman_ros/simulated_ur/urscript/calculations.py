"""Functions of the controller that need only their arguments: lists, strings, mathematics."""

import math
from collections.abc import Callable

from omniman_ros.simulated_ur.urscript.errors import Fault
from omniman_ros.simulated_ur.urscript.instructions import Thread
from omniman_ros.simulated_ur.urscript.values import (
    Value,
    calculate,
    elements,
    integer,
    number,
    short,
    text,
    to_str,
    truth,
)

MATHS: dict[str, Callable[[float], float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "sqrt": math.sqrt,
    "floor": math.floor,
    "ceil": math.ceil,
    "d2r": math.radians,
    "r2d": math.degrees,
}


# Lists and strings


def length(thread: Thread, v: Value) -> int:
    """Number of elements of a list, or of characters of a string."""
    return len(v) if isinstance(v, str) else len(elements(v, "v"))


def get_list_length(thread: Thread, v: Value) -> int:
    """Number of elements of a list."""
    return len(elements(v, "v"))


def string_of(thread: Thread, val: Value) -> str:
    """to_str."""
    return short(to_str(val))


def to_num(thread: Thread, s: Value) -> float:
    """Number that a string holds: an int unless it has a point."""
    word = text(s, "s").strip()
    try:
        return float(word) if "." in word or "e" in word.lower() else integer(int(word), "s")
    except ValueError:
        raise Fault(f"'{word}' is no number") from None


def str_cat(thread: Thread, op1: Value, op2: Value) -> str:
    """Two values as one string."""
    return short(to_str(op1) + to_str(op2))


def str_len(thread: Thread, s: Value) -> int:
    """Number of characters."""
    return len(text(s, "str"))


def str_empty(thread: Thread, s: Value) -> bool:
    """Whether a string has no characters."""
    return not text(s, "str")


def str_at(thread: Thread, src: Value, index: Value) -> str:
    """A character."""
    found, at = text(src, "src"), integer(index, "index")
    if not 0 <= at < len(found):
        raise Fault(f"index {at} is out of range of a string of {len(found)}")
    return found[at]


def str_sub(thread: Thread, src: Value, index: Value, len: Value = -1) -> str:  # noqa: A002
    """Part of a string: so many characters, or all that follow if negative."""
    found, at, count = text(src, "src"), integer(index, "index"), integer(len, "len")
    if at < 0:
        raise Fault(f"index {at} is out of range of a string")
    return found[at:] if count < 0 else found[at : at + count]


def str_find(thread: Thread, src: Value, target: Value, start_from: Value = 0) -> int:
    """Where a string holds another one, or -1."""
    start = max(integer(start_from, "start_from"), 0)
    return text(src, "src").find(text(target, "target"), start)


# Mathematics


def single(name: str, function: Callable[[float], float]) -> Callable[[Thread, Value], Value]:
    """A function of one number; Fault where it has no real result."""

    def apply(thread: Thread, f: Value) -> Value:
        value = number(f, f"argument of {name}")
        return calculate(lambda a, _: function(a), value, 0)

    return apply


def atan2(thread: Thread, x: Value, y: Value) -> float:
    """Angle of two sides: the opposite first, then the adjacent."""
    return math.atan2(number(x, "x"), number(y, "y"))


def power(thread: Thread, base: Value, exponent: Value) -> Value:
    """Pow."""
    return calculate(math.pow, number(base, "base"), number(exponent, "exponent"))


def logarithm(thread: Thread, b: Value, f: Value) -> Value:
    """log, to a base b."""
    return calculate(lambda base, x: math.log(x, base), number(b, "b"), number(f, "f"))


def norm(thread: Thread, a: Value) -> Value:
    """Magnitude of a number, length of a list."""
    if isinstance(a, tuple):
        return math.hypot(*(number(each, "a") for each in a))
    size = abs(number(a, "a"))
    return int(size) if isinstance(a, int) else size


def integer_to_binary_list(thread: Thread, x: Value) -> Value:
    """32 bools, the least significant first."""
    value = integer(x, "x")
    return tuple(bool(value >> bit & 1) for bit in range(32))


def binary_list_to_integer(thread: Thread, l: Value) -> int:  # noqa: E741
    """The int whose bits these are, the least significant first."""
    bits = [truth(each) for each in elements(l, "l")]
    if len(bits) > 32:
        raise Fault(f"a list of {len(bits)} bits is no integer")
    value = sum(1 << at for at, bit in enumerate(bits) if bit)
    return value - (1 << 32) if value > 0x7FFFFFFF else value


FUNCTIONS: dict[str, Callable[..., object]] = {
    **{name: single(name, function) for name, function in MATHS.items()},
    **{each.__name__: each for each in (
        length, get_list_length, to_num, str_cat, str_len, str_empty, str_at, str_sub, str_find,
        atan2, norm, integer_to_binary_list, binary_list_to_integer,
    )},
    "pow": power,
    "log": logarithm,
    "to_str": string_of,
}  # fmt: skip
