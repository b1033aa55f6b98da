"""Compilation of calls, and of starts of threads.

A call of a function that does not exist, or with arguments that it does not accept, becomes code
that fails: a program may mention what it never executes.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from omniman_ros.simulation.ur.urscript.combinators import apply
from omniman_ros.simulation.ur.urscript.context import Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptError, ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.execution import (
    Call,
    Code,
    Expression,
    Function,
    StackFrame,
    Start,
    Suspending,
)
from omniman_ros.simulation.ur.urscript.functions import FUNCTIONS, SUSPENDING_FUNCTIONS
from omniman_ros.simulation.ur.urscript.syntax import Node, line_of, subtrees
from omniman_ros.simulation.ur.urscript.values import Value


@dataclass
class Scope:
    """Functions that a body defines; others are looked up in the scope around it."""

    parent: "Scope | None" = None
    functions: dict[str, Function] = field(default_factory=dict)

    def find(self, name: str) -> Function | None:
        """Return the function of that name, or None."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.functions:
                return scope.functions[name]
            scope = scope.parent
        return None


@dataclass(frozen=True)
class _Arguments:
    values: tuple[Expression, ...]  #: Code of all of them, in the order of the text
    positional: int  #: How many of them come by position, before those by name
    names: tuple[str, ...]  #: Names of the others


class CallCompiler:
    """Compiles the calls in one body."""

    def __init__(self, scope: Scope, expression: Callable[[Node], Expression]) -> None:
        self._scope = scope
        self._expression = expression

    def call(self, node: Node) -> Expression:
        """Compile a call of a function of the program or of the controller."""
        name, arguments = str(node.children[0]), self._arguments(node)
        function = self._scope.find(name)
        if function is None:
            return _controller_call(name, arguments, line_of(node))
        if function.is_thread:
            return _failing(arguments, f"'{name}' is a thread: run it", line_of(node))
        return _program_call(function, arguments, line_of(node))

    def run(self, node: Node) -> Expression:
        """Compile the start of a thread, whose value is the handle of the thread."""
        name, arguments, line = str(node.children[0]), self._arguments(node), line_of(node)
        thread = self._scope.find(name)
        if thread is None:
            return _failing(arguments, f"thread '{name}' is not defined", line)
        if not thread.is_thread:
            return _failing(arguments, f"'{name}' is no thread", line)
        if arguments.values:
            return _failing(arguments, _mismatch(thread), line)

        def suspending(frame: StackFrame) -> Suspending[Value]:
            frame.thread.line = line
            handle: int = yield Start(thread)
            return handle

        return Code(suspending=suspending)

    def _arguments(self, node: Node) -> _Arguments:
        values, names = [], list[str]()
        for argument in subtrees(subtrees(node)[0]):
            name, value = argument.children
            if name is not None:
                names.append(str(name))
            elif names:
                raise ScriptError(line_of(node), "a positional argument behind one by name")
            values.append(self._expression(value))
        return _Arguments(tuple(values), len(values) - len(names), tuple(names))


def _controller_call(name: str, arguments: _Arguments, line: int) -> Expression:
    if name not in FUNCTIONS:
        return _failing(arguments, f"function '{name}' is not defined", line)
    positional, names = arguments.positional, arguments.names
    try:
        _signature(name).bind(None, *range(positional), **dict.fromkeys(names))
    except TypeError as error:
        return _failing(arguments, f"'{name}': {error}", line)
    if len({*names}) < len(names):
        return _failing(arguments, f"'{name}': an argument stands there twice", line)
    function = FUNCTIONS[name]

    def call(frame: StackFrame, *values: Value) -> Any:
        named = dict(zip(names, values[positional:], strict=True))
        return function(frame.context, *values[:positional], **named)

    code: Code[Any] = apply(arguments.values, call, line)
    if name not in SUSPENDING_FUNCTIONS:
        return code

    def suspending(frame: StackFrame) -> Suspending[Value]:
        result = yield from code.execute(frame)
        if isinstance(result, Wait):
            frame.thread.line = line
            result = yield result
        return result  # type: ignore[no-any-return]

    return Code(suspending=suspending)


def _program_call(function: Function, arguments: _Arguments, line: int) -> Expression:
    parameters, names = function.parameters, arguments.names
    given = (*parameters[: arguments.positional], *names)
    missing = {*parameters} - {*given} - function.optional
    excess = arguments.positional > len(parameters) or {*given} - {*parameters}
    if missing or excess or len({*given}) < len(given):
        return _failing(arguments, _mismatch(function), line)

    def bind(frame: StackFrame, *values: Value) -> Call:
        return Call(function, dict(zip(given, values, strict=True)))

    call = apply(arguments.values, bind, line)

    def suspending(frame: StackFrame) -> Suspending[Value]:
        request = yield from call.execute(frame)
        frame.thread.line = line
        value: Value = yield request
        return value

    return Code(suspending=suspending)


def _mismatch(function: Function) -> str:
    return f"'{function.name}' takes other arguments: {[*function.parameters]}"


def _failing(arguments: _Arguments, message: str, line: int) -> Expression:
    """Compile a call that can only go wrong, after its arguments were evaluated."""

    def fail(frame: StackFrame, *values: Value) -> Value:
        raise ScriptRuntimeError(message)

    return apply(arguments.values, fail, line)


@cache
def _signature(name: str) -> inspect.Signature:
    """Return the parameters of a function of the controller; the first is the context."""
    return inspect.signature(FUNCTIONS[name])
