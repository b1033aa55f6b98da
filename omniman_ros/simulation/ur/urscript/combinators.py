"""Combination of compiled code: operands, operators, conditions, sequences and loops.

If all combined parts are plain functions, the result is a plain function; otherwise it is a
generator function, which can suspend the thread of the program.
"""

from collections.abc import Callable, Sequence
from typing import Any

from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.execution import (
    Code,
    LoopControl,
    Outcome,
    Return,
    StackFrame,
    Suspending,
)
from omniman_ros.simulation.ur.urscript.values import Value


def constant(value: Value) -> Code[Value]:
    """Return the code of a constant value."""
    return Code(lambda frame: value)


def apply(operands: Sequence[Code[Any]], function: Callable[..., Any], line: int) -> Code[Any]:
    """Return the code that applies a Python function to the values of operands.

    Args:
        operands: Code of the operands, which are evaluated from left to right.
        function: Function of the frame and of the operands' values.
        line: Line in the program, to which an error of the function is attributed.
    """

    def on_line(frame: StackFrame, *values: Value) -> Any:
        try:
            return function(frame, *values)
        except Exception:
            frame.thread.line = line
            raise

    plains = [operand.plain for operand in operands if operand.plain]
    if len(plains) < len(operands):

        def suspending(frame: StackFrame) -> Suspending[Any]:
            values = []
            for operand in operands:
                values.append((yield from operand.execute(frame)))
            return on_line(frame, *values)

        return Code(suspending=suspending)
    if len(plains) == 1:
        single = plains[0]
        return Code(lambda frame: on_line(frame, single(frame)))
    return Code(lambda frame: on_line(frame, *[plain(frame) for plain in plains]))


def fold(
    operands: Sequence[Code[Value]], operators: Sequence[tuple[Callable[..., Value], int]]
) -> Code[Value]:
    """Return the code of binary operators between operands, applied from left to right.

    Args:
        operands: Code of the operands, one more than operators.
        operators: Functions of the left and right value, each with its line in the program.
    """

    def combine(frame: StackFrame, left: Value, right: Value, index: int) -> Value:
        operator, line = operators[index]
        try:
            return operator(left, right)
        except ScriptRuntimeError:
            frame.thread.line = line
            raise

    def suspending(frame: StackFrame) -> Suspending[Value]:
        value = yield from operands[0].execute(frame)
        for index, operand in enumerate(operands[1:]):
            value = combine(frame, value, (yield from operand.execute(frame)), index)
        return value

    first, *others = [operand.plain for operand in operands]
    if first is None or None in others:
        return Code(suspending=suspending)

    def plain(frame: StackFrame) -> Value:
        value = first(frame)
        for index, operand in enumerate(others):
            value = combine(frame, value, operand(frame), index)  # type: ignore[misc]
        return value

    return Code(plain)


def short_circuit(conditions: Sequence[Code[bool]], decisive: bool) -> Code[Value]:
    """Return the code of conditions that are evaluated from left to right until one decides.

    Args:
        decisive: Value of a condition that decides the result: False for `and`, True for `or`.
    """

    def suspending(frame: StackFrame) -> Suspending[Value]:
        for condition in conditions:
            if (yield from condition.execute(frame)) is decisive:
                return decisive
        return not decisive

    tests = [condition.plain for condition in conditions if condition.plain]

    def plain(frame: StackFrame) -> Value:
        return decisive if any(test(frame) is decisive for test in tests) else not decisive

    return Code(plain) if len(tests) == len(conditions) else Code(suspending=suspending)


def sequence(statements: Sequence[tuple[int, Code[Outcome]]]) -> Code[Outcome]:
    """Return the code of statements, each with its line, that are executed in order.

    It ends early at a statement whose outcome is a break, continue or return.
    """

    def suspending(frame: StackFrame) -> Suspending[Outcome]:
        for line, statement in statements:
            frame.charge(line)
            step = statement.plain
            outcome = step(frame) if step else (yield from statement.execute(frame))
            if outcome is not None:
                return outcome
        return None

    steps = [(line, statement.plain) for line, statement in statements if statement.plain]

    def plain(frame: StackFrame) -> Outcome:
        for line, step in steps:
            frame.charge(line)
            outcome = step(frame)
            if outcome is not None:
                return outcome
        return None

    return Code(plain) if len(steps) == len(statements) else Code(suspending=suspending)


def branch(
    branches: Sequence[tuple[Code[bool], Code[Outcome]]], otherwise: Code[Outcome]
) -> Code[Outcome]:
    """Return the code that executes the block of the first true condition, else `otherwise`."""

    def suspending(frame: StackFrame) -> Suspending[Outcome]:
        for condition, block in branches:
            if (yield from condition.execute(frame)):
                return (yield from block.execute(frame))
        return (yield from otherwise.execute(frame))

    plains = [(c.plain, b.plain) for c, b in branches if c.plain and b.plain]
    default = otherwise.plain
    if default is None or len(plains) < len(branches):
        return Code(suspending=suspending)

    def plain(frame: StackFrame) -> Outcome:
        for condition, block in plains:
            if condition(frame):
                return block(frame)
        return default(frame)

    return Code(plain)


def loop(condition: Code[bool], body: Code[Outcome], line: int) -> Code[Outcome]:
    """Return the code of a loop that executes a body while a condition is true."""

    def suspending(frame: StackFrame) -> Suspending[Outcome]:
        while (yield from condition.execute(frame)):
            frame.charge(line)
            outcome = yield from body.execute(frame)
            if outcome is LoopControl.BREAK:
                break
            if isinstance(outcome, Return):
                return outcome
        return None

    test, step = condition.plain, body.plain
    if test is None or step is None:
        return Code(suspending=suspending)

    def plain(frame: StackFrame) -> Outcome:
        while test(frame):
            frame.charge(line)
            outcome = step(frame)
            if outcome is LoopControl.BREAK:
                break
            if isinstance(outcome, Return):
                return outcome
        return None

    return Code(plain)
