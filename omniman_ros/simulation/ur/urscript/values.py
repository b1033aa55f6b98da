"""Values of URScript and what operators do with them.

A list is a tuple, for lists are copied when they are assigned or passed: an assignment to an
element makes a new tuple (URScript manual, "Numbers, Variables, and Types"; "Function").

The manual leaves open what an overflow of a 32-bit integer does, and the sign of a remainder:
here the first is a fault, the second is the sign of the dividend, as in C. What a function does
not accept raises a ScriptRuntimeError.
"""

import math
import operator
from collections.abc import Callable
from typing import TypeAlias

from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError

#: Value of an expression; None is the value of a function that returns nothing
Value: TypeAlias = "bool | int | float | str | tuple[Value, ...] | None"

Operator: TypeAlias = Callable[[Value, Value], Value]  #: Function of a binary operator
Number: TypeAlias = Callable[[float, float], float]  #: Function of two numbers

SMALLEST = -(2**31)  #: Smallest integer
LARGEST = 2**31 - 1  #: Largest integer
MAX_LIST_LENGTH = 100  #: Largest number of scalars in a list, which bounds the work of a statement
MAX_STRING_LENGTH = 4096  #: Largest length of a string, which bounds the memory
JOINTS = 6  #: Number of joints, and of elements of a pose


class Pose(tuple[Value, ...]):
    """A pose: three coordinates [m] and a rotation vector [rad]."""

    __slots__ = ()


def name_of(value: Value) -> str:
    """Return the name of a value's type, for messages."""
    return "none" if value is None else NAMES[type(value)]


NAMES: dict[type, str] = {
    bool: "bool",
    int: "int",
    float: "float",
    str: "string",
    tuple: "list",
    Pose: "pose",
}  #: Names of the types in URScript


def is_number(value: Value) -> bool:
    """Return whether a value is an int or a float; a bool is neither."""
    return type(value) is float or type(value) is int


def number(value: Value, what: str) -> float:
    """Return a value as a float; `what` names it in messages."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise ScriptRuntimeError(f"{what} is no number but {name_of(value)} {to_str(value)}")


def integer(value: Value, what: str) -> int:
    """Return a value as an int; a float without a fraction is accepted."""
    whole = number(value, what)
    if not whole.is_integer():  # infinity and NaN neither
        raise ScriptRuntimeError(f"{what} is no whole number but {to_str(value)}")
    return checked(int(whole))


def text(value: Value, what: str) -> str:
    """Return a value as a string."""
    if isinstance(value, str):
        return value
    raise ScriptRuntimeError(f"{what} is no string but {name_of(value)} {to_str(value)}")


def elements(value: Value, what: str) -> tuple[Value, ...]:
    """Return a value as a list; a pose is accepted."""
    if isinstance(value, tuple):
        return value
    raise ScriptRuntimeError(f"{what} is no list but {name_of(value)} {to_str(value)}")


def joints(value: Value, what: str) -> tuple[float, ...]:
    """Return a value as six numbers [rad] or [rad/s]."""
    if isinstance(value, Pose):
        raise ScriptRuntimeError(f"{what} is a pose: inverse kinematics are not simulated")
    angles = elements(value, what)
    if len(angles) != JOINTS:
        raise ScriptRuntimeError(f"{what} has {len(angles)} elements, not {JOINTS}")
    return tuple(number(angle, what) for angle in angles)


def truth(value: Value) -> bool:
    """Return a value as a condition."""
    if value is True or value is False:
        return value
    if isinstance(value, int | float):
        return value != 0
    raise ScriptRuntimeError(f"a condition is no bool but {name_of(value)} {to_str(value)}")


def checked(value: int) -> int:
    """Return an int if it fits into 32 bits."""
    if SMALLEST <= value <= LARGEST:
        return value
    raise ScriptRuntimeError("an integer overflows its 32 bits")


def checked_string(value: str) -> str:
    """Return a string if it is not too long."""
    if len(value) <= MAX_STRING_LENGTH:
        return value
    raise ScriptRuntimeError(f"a string has more than {MAX_STRING_LENGTH} characters")


def make_list(values: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return a list of scalars, poses or flat lists (a matrix)."""
    scalars = len(values)
    for value in values:
        if isinstance(value, tuple):
            scalars += len(value) - 1
            if any(isinstance(inner, tuple) for inner in value):
                raise ScriptRuntimeError("lists are nested more than two deep")
        elif value is None:
            raise ScriptRuntimeError("an element has no value")
    if scalars > MAX_LIST_LENGTH:
        raise ScriptRuntimeError(f"a list has more than {MAX_LIST_LENGTH} scalars")
    return values


def size(values: tuple[Value, ...]) -> int:
    """Return the number of scalars in a list, those of its inner lists included."""
    return sum(len(value) if isinstance(value, tuple) else 1 for value in values)


def make_pose(values: tuple[Value, ...]) -> Pose:
    """Return a pose of six numbers."""
    return Pose(number(value, "an element of a pose") for value in values)


def to_str(value: Value) -> str:
    """Return a value as text, as to_str and textmsg write it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        inside = ", ".join(map(to_str, value))
        return f"p[{inside}]" if isinstance(value, Pose) else f"[{inside}]"
    return str(value)


def position(container: Value, index: Value) -> int:
    """Return an index after checking it against a list or pose."""
    found = elements(container, "what is indexed")
    if type(index) is not int:
        raise ScriptRuntimeError(f"an index is no int but {name_of(index)} {to_str(index)}")
    if not 0 <= index < len(found):
        raise ScriptRuntimeError(f"index {index} is out of range of a list of {len(found)}")
    return index


def element(container: Value, index: Value) -> Value:
    """Return an element of a list or pose; ScriptRuntimeError as in `position`."""
    where = position(container, index)
    return elements(container, "what is indexed")[where]


def with_element(container: Value, index: Value, value: Value) -> Value:
    """Return a list or pose with one element replaced; errors as in `position` and the makers."""
    where = position(container, index)
    found = elements(container, "what is indexed")
    changed = (*found[:where], value, *found[where + 1 :])
    return make_pose(changed) if isinstance(container, Pose) else make_list(changed)


def calculate(function: Number, a: float, b: float) -> Value:
    """Return the result of a function of two numbers; it must fit into 32 bits if it is an int."""
    try:
        result = function(a, b)
    except ZeroDivisionError:
        raise ScriptRuntimeError("division by zero") from None
    except (OverflowError, ValueError) as error:
        raise ScriptRuntimeError(str(error)) from None
    if type(result) is int and not SMALLEST <= result <= LARGEST:
        raise ScriptRuntimeError("an integer overflows its 32 bits")
    return result


def remainder(a: float, b: float) -> float:
    """Return the remainder with the sign of the dividend; an int for two ints."""
    if b == 0:
        raise ZeroDivisionError
    whole = type(a) is int and type(b) is int
    return int(math.fmod(a, b)) if whole else math.fmod(a, b)


def arithmetic(symbol: str, function: Number, shapes: str) -> Operator:
    """Return an operator on numbers, and on the shapes of lists that it accepts.

    Args:
        symbol: Symbol of the operator, for messages.
        shapes: Accepted operands, separated by blanks: "ll" for two lists of equal length, "ln"
            for a list and a number, "nl" for a number and a list.
    """

    def apply(a: Value, b: Value) -> Value:
        ta, tb = type(a), type(b)
        if (ta is float or ta is int) and (tb is float or tb is int):
            return calculate(function, a, b)  # type: ignore[arg-type]
        kinds = "".join(
            "l" if t is tuple else "n" if is_number(v) else "?" for t, v in ((ta, a), (tb, b))
        )
        if kinds in shapes.split():
            left = a if isinstance(a, tuple) else (a,) * len(elements(b, "operand"))
            right = b if isinstance(b, tuple) else (b,) * len(left)
            if len(left) != len(right):
                raise ScriptRuntimeError(
                    f"'{symbol}' of lists of {len(left)} and {len(right)} elements"
                )
            return tuple(apply(x, y) for x, y in zip(left, right, strict=True))
        if symbol == "+" and isinstance(a, str) and isinstance(b, str):
            return checked_string(a + b)
        raise ScriptRuntimeError(f"'{symbol}' is not for {name_of(a)} and {name_of(b)}")

    return apply


def ordering(symbol: str, function: Callable[[float, float], bool]) -> Operator:
    """Return a comparison that requires an order, and therefore numbers."""

    def apply(a: Value, b: Value) -> Value:
        if is_number(a) and is_number(b):
            return function(a, b)  # type: ignore[arg-type]
        raise ScriptRuntimeError(f"'{symbol}' is not for {name_of(a)} and {name_of(b)}")

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
}  #: Functions of the binary operators, by symbol
