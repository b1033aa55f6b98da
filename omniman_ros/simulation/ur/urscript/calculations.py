"""Functions of the controller that need only their arguments: lists, strings, mathematics."""

import math
from collections.abc import Callable

from omniman_ros.simulation.ur.urscript.context import Context
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.values import (
    Value,
    calculate,
    checked_string,
    elements,
    integer,
    number,
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
}  #: Functions of one number, by their names in URScript


# Lists and strings


def length(context: Context, v: Value) -> int:
    """Return the number of elements of a list, or of characters of a string."""
    return len(v) if isinstance(v, str) else len(elements(v, "v"))


def get_list_length(context: Context, v: Value) -> int:
    """Return the number of elements of a list."""
    return len(elements(v, "v"))


def string_of(context: Context, val: Value) -> str:
    """Return a value as text, as URScript's to_str does."""
    return checked_string(to_str(val))


def to_num(context: Context, s: Value) -> float:
    """Return the number in a string: an int unless it has a point or an exponent."""
    word = text(s, "s").strip()
    try:
        return float(word) if "." in word or "e" in word.lower() else integer(int(word), "s")
    except (ValueError, OverflowError):
        raise ScriptRuntimeError(f"'{word}' is no number") from None


def str_cat(context: Context, op1: Value, op2: Value) -> str:
    """Return two values as one string."""
    return checked_string(to_str(op1) + to_str(op2))


def str_len(context: Context, s: Value) -> int:
    """Return the number of characters of a string."""
    return len(text(s, "str"))


def str_empty(context: Context, s: Value) -> bool:
    """Return whether a string has no characters."""
    return not text(s, "str")


def str_at(context: Context, src: Value, index: Value) -> str:
    """Return the character at an index."""
    string, position = text(src, "src"), integer(index, "index")
    if not 0 <= position < len(string):
        raise ScriptRuntimeError(f"index {position} is out of range of a string of {len(string)}")
    return string[position]


def str_sub(context: Context, src: Value, index: Value, len: Value = -1) -> str:
    """Return `len` characters of a string from an index on, or all if `len` is negative."""
    string, start, count = text(src, "src"), integer(index, "index"), integer(len, "len")
    if start < 0:
        raise ScriptRuntimeError(f"index {start} is out of range of a string")
    return string[start:] if count < 0 else string[start : start + count]


def str_find(context: Context, src: Value, target: Value, start_from: Value = 0) -> int:
    """Return the index at which a string contains another one, or -1."""
    start = max(integer(start_from, "start_from"), 0)
    return text(src, "src").find(text(target, "target"), start)


# Mathematics


def single(name: str, function: Callable[[float], float]) -> Callable[[Context, Value], Value]:
    """Return a function of one number that raises ScriptRuntimeError without a real result."""

    def apply(context: Context, f: Value) -> Value:
        value = number(f, f"argument of {name}")
        return calculate(lambda a, _: function(a), value, 0)

    return apply


def atan2(context: Context, x: Value, y: Value) -> float:
    """Return the angle [rad] of an opposite side x and an adjacent side y."""
    return math.atan2(number(x, "x"), number(y, "y"))


def power(context: Context, base: Value, exponent: Value) -> Value:
    """Return base to the power of exponent."""
    return calculate(math.pow, number(base, "base"), number(exponent, "exponent"))


def logarithm(context: Context, b: Value, f: Value) -> Value:
    """Return the logarithm of f to the base b."""
    return calculate(lambda base, x: math.log(x, base), number(b, "b"), number(f, "f"))


def norm(context: Context, a: Value) -> Value:
    """Return the magnitude of a number, or the Euclidean norm of a list."""
    if isinstance(a, tuple):
        return math.hypot(*(number(element, "a") for element in a))
    magnitude = abs(number(a, "a"))
    return int(magnitude) if isinstance(a, int) else magnitude


def integer_to_binary_list(context: Context, x: Value) -> Value:
    """Return the 32 bits of an int as bools, the least significant first."""
    value = integer(x, "x")
    return tuple(bool(value >> bit & 1) for bit in range(32))


def binary_list_to_integer(context: Context, l: Value) -> int:  # noqa: E741  (manual)
    """Return the int that has these bits, the least significant first."""
    bits = [truth(bit) for bit in elements(l, "l")]
    if len(bits) > 32:
        raise ScriptRuntimeError(f"a list of {len(bits)} bits is no integer")
    value = sum(1 << index for index, bit in enumerate(bits) if bit)
    return value - (1 << 32) if value > 0x7FFFFFFF else value


FUNCTIONS: dict[str, Callable[..., object]] = {
    **{name: single(name, function) for name, function in MATHS.items()},
    **{
        function.__name__: function
        for function in (
            length,
            get_list_length,
            to_num,
            str_cat,
            str_len,
            str_empty,
            str_at,
            str_sub,
            str_find,
            atan2,
            norm,
            integer_to_binary_list,
            binary_list_to_integer,
        )
    },
    "pow": power,
    "log": logarithm,
    "to_str": string_of,
}  #: Functions of this module, by their names in URScript
