"""Values of URScript and what operators do with them.

A list is a tuple, for lists are copied when they are assigned or passed: an assignment to an
element makes a new tuple (URScript manual, "Numbers, Variables, and Types"; "Function").

The manual leaves open what an overflow of a 32-bit integer does, and the sign of a remainder:
here the first is a fault, the second is the sign of the dividend, as in C.
"""

import math
import operator
from collections.abc import Callable
from typing import TypeAlias

from omniman_ros.simulated_ur.urscript.errors import Fault

Value: TypeAlias = "bool | int | float | str | tuple[Value, ...] | None"
"""None is what a function without a value returns."""

Operator: TypeAlias = Callable[[Value, Value], Value]
Number: TypeAlias = Callable[[float, float], float]

LEAST, MOST = -(2**31), 2**31 - 1
LONGEST = 4096  # of a string; so a program cannot take all memory
JOINTS = 6


class Pose(tuple[Value, ...]):
    """A pose: three coordinates, m, and a rotation vector, rad."""

    __slots__ = ()


def name_of(value: Value) -> str:
    """Name of a value's type, for messages."""
    return "none" if value is None else NAMES[type(value)]


NAMES: dict[type, str] = {
    bool: "bool",
    int: "int",
    float: "float",
    str: "string",
    tuple: "list",
    Pose: "pose",
}


def is_number(value: Value) -> bool:
    """Whether it is an int or a float; a bool is neither."""
    return type(value) is float or type(value) is int


def number(value: Value, what: str) -> float:
    """The value as a float.

    Raises:
        Fault: It is no number.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise Fault(f"{what} is no number but {name_of(value)} {to_str(value)}")


def integer(value: Value, what: str) -> int:
    """The value as an int; a float without a fraction is one.

    Raises:
        Fault: It is no whole number of 32 bits.
    """
    whole = number(value, what)
    if not whole.is_integer():  # infinity and NaN neither
        raise Fault(f"{what} is no whole number but {to_str(value)}")
    return checked(int(whole))


def text(value: Value, what: str) -> str:
    """The value as a string.

    Raises:
        Fault: It is no string.
    """
    if isinstance(value, str):
        return value
    raise Fault(f"{what} is no string but {name_of(value)} {to_str(value)}")


def elements(value: Value, what: str) -> tuple[Value, ...]:
    """The value as a list; a pose counts as one.

    Raises:
        Fault: It is neither.
    """
    if isinstance(value, tuple):
        return value
    raise Fault(f"{what} is no list but {name_of(value)} {to_str(value)}")


def joints(value: Value, what: str) -> tuple[float, ...]:
    """The value as six numbers, rad or rad/s.

    Raises:
        Fault: It is a pose, which would need the inverse kinematics, or not six numbers.
    """
    if isinstance(value, Pose):
        raise Fault(f"{what} is a pose: inverse kinematics are not simulated")
    found = elements(value, what)
    if len(found) != JOINTS:
        raise Fault(f"{what} has {len(found)} elements, not {JOINTS}")
    return tuple(number(each, what) for each in found)


def truth(value: Value) -> bool:
    """The value as a condition.

    Raises:
        Fault: It is neither a bool nor a number.
    """
    if value is True or value is False:
        return value
    if isinstance(value, int | float):
        return value != 0
    raise Fault(f"a condition is no bool but {name_of(value)} {to_str(value)}")


def checked(value: int) -> int:
    """An int that fits.

    Raises:
        Fault: It does not fit into 32 bits.
    """
    if LEAST <= value <= MOST:
        return value
    raise Fault("an integer overflows its 32 bits")


def short(value: str) -> str:
    """A string that fits.

    Raises:
        Fault: It is longer than strings may be.
    """
    if len(value) <= LONGEST:
        return value
    raise Fault(f"a string has more than {LONGEST} characters")


def make_list(values: tuple[Value, ...]) -> tuple[Value, ...]:
    """A list of scalars, poses or flat lists (a matrix).

    Raises:
        Fault: It is nested deeper, or holds no value.
    """
    for value in values:
        if isinstance(value, tuple):
            if any(isinstance(inner, tuple) for inner in value):
                raise Fault("lists are nested more than two deep")
        elif value is None:
            raise Fault("an element has no value")
    return values


def make_pose(values: tuple[Value, ...]) -> Pose:
    """A pose of six numbers.

    Raises:
        Fault: One is no number.
    """
    return Pose(number(each, "an element of a pose") for each in values)


def to_str(value: Value) -> str:
    """A value as to_str and textmsg write it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        inside = ", ".join(map(to_str, value))
        return f"p[{inside}]" if isinstance(value, Pose) else f"[{inside}]"
    return str(value)


def position(container: Value, index: Value) -> int:
    """Where an index points in a list or pose.

    Raises:
        Fault: Not a list or pose; no int; out of range (there are no negative indices).
    """
    found = elements(container, "what is indexed")
    if type(index) is not int:
        raise Fault(f"an index is no int but {name_of(index)} {to_str(index)}")
    if not 0 <= index < len(found):
        raise Fault(f"index {index} is out of range of a list of {len(found)}")
    return index


def element(container: Value, index: Value) -> Value:
    """An element of a list or pose; Fault as in `position`."""
    where = position(container, index)
    return elements(container, "what is indexed")[where]


def with_element(container: Value, index: Value, value: Value) -> Value:
    """The list or pose with one element replaced; Fault as in `position` and the makers."""
    where = position(container, index)
    found = elements(container, "what is indexed")
    changed = (*found[:where], value, *found[where + 1 :])
    return make_pose(changed) if isinstance(container, Pose) else make_list(changed)


def calculate(function: Number, a: float, b: float) -> Value:
    """An operation on two numbers: an int if both are and the function gives one.

    Raises:
        Fault: Division by zero, an overflow, or no real result.
    """
    try:
        result = function(a, b)
    except ZeroDivisionError:
        raise Fault("division by zero") from None
    except (OverflowError, ValueError) as error:
        raise Fault(str(error)) from None
    if type(result) is int and not LEAST <= result <= MOST:
        raise Fault("an integer overflows its 32 bits")
    return result


def remainder(a: float, b: float) -> float:
    """Remainder with the sign of the dividend; of two ints an int."""
    if b == 0:
        raise ZeroDivisionError
    whole = type(a) is int and type(b) is int
    return int(math.fmod(a, b)) if whole else math.fmod(a, b)


def arithmetic(symbol: str, function: Number, shapes: str) -> Operator:
    """An operator on numbers, and on the shapes of lists that it takes.

    Args:
        symbol: For messages.
        function: On numbers.
        shapes: "ll" if two lists of one length, "ln" a list and a number, "nl" the other way.
    """

    def apply(a: Value, b: Value) -> Value:
        ta, tb = type(a), type(b)
        if (ta is float or ta is int) and (tb is float or tb is int):
            return calculate(function, a, b)  # type: ignore[arg-type]
        kinds = "".join("l" if t is tuple else "n" if is_number(v) else "?"
                        for t, v in ((ta, a), (tb, b)))  # fmt: skip
        if kinds in shapes.split():
            left = a if isinstance(a, tuple) else (a,) * len(elements(b, "operand"))
            right = b if isinstance(b, tuple) else (b,) * len(left)
            if len(left) != len(right):
                raise Fault(f"'{symbol}' of lists of {len(left)} and {len(right)} elements")
            return tuple(apply(x, y) for x, y in zip(left, right, strict=True))
        if symbol == "+" and isinstance(a, str) and isinstance(b, str):
            return short(a + b)
        raise Fault(f"'{symbol}' is not for {name_of(a)} and {name_of(b)}")

    return apply


def ordering(symbol: str, function: Callable[[float, float], bool]) -> Operator:
    """A comparison that needs an order, so numbers."""

    def apply(a: Value, b: Value) -> Value:
        if is_number(a) and is_number(b):
            return function(a, b)  # type: ignore[arg-type]
        raise Fault(f"'{symbol}' is not for {name_of(a)} and {name_of(b)}")

    return apply


BINARY: dict[str, Operator] = {
    "+": arithmetic("+", operator.add, "ll"),
    "-": arithmetic("-", operator.sub, "ll"),
    "*": arithmetic("*", operator.mul, "ln nl"),
    "/": arithmetic("/", operator.truediv, "ln"),
    "%": arithmetic("%", remainder, ""),
    "==": operator.eq,
    "!=": operator.ne,
    "<": ordering("<", operator.lt),
    ">": ordering(">", operator.gt),
    "<=": ordering("<=", operator.le),
    ">=": ordering(">=", operator.ge),
    "xor": lambda a, b: truth(a) != truth(b),
}


def negative(value: Value) -> Value:
    """Unary minus, of a number or list."""
    return BINARY["*"](-1, value)
