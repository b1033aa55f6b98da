"""Calls to instructions, once all functions of a program are known.

A call of a function that does not exist, or with arguments that it does not take, becomes an
instruction that fails: a program may mention what it never executes.
"""

import inspect
from dataclasses import dataclass, field
from functools import cache

from omniman_ros.simulated_ur.urscript import instructions as do
from omniman_ros.simulated_ur.urscript.functions import FUNCTIONS
from omniman_ros.simulated_ur.urscript.instructions import Function, Instruction


@dataclass
class Scope:
    """Functions that a body defines; what it cannot find is looked for around it."""

    around: "Scope | None" = None
    functions: dict[str, Function] = field(default_factory=dict)

    def find(self, name: str) -> Function | None:
        """The function of that name, or None."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.functions:
                return scope.functions[name]
            scope = scope.around
        return None


@dataclass
class Call:
    """A call to be linked."""

    function: Function  # in which it stands
    at: int  # index of its instruction
    scope: Scope
    name: str
    positional: int
    names: tuple[str, ...]
    starts_thread: bool


def linked(call: Call) -> Instruction:
    """The instruction of a call, once all functions are known."""
    function = call.scope.find(call.name)
    if function is not None and function.is_thread != call.starts_thread:
        wrong = "is a thread: run it" if function.is_thread else "is no thread"
        return do.fail, f"'{call.name}' {wrong}"
    if function is not None:
        given = (*function.parameters[: call.positional], *call.names)
        missing = [p for p in function.parameters if p not in given and p not in function.defaults]
        excess = call.positional > len(function.parameters) or set(given) - {*function.parameters}
        if missing or excess or len({*given}) < len(given):
            return do.fail, f"'{call.name}' takes other arguments: {function.parameters}"
        return (do.run, function) if call.starts_thread else (do.call, (function, given))
    if call.starts_thread or call.name not in FUNCTIONS:
        kind = "thread" if call.starts_thread else "function"
        return do.fail, f"{kind} '{call.name}' is not defined"
    try:
        signature(call.name).bind(None, *range(call.positional), **dict.fromkeys(call.names))
    except TypeError as error:
        return do.fail, f"'{call.name}': {error}"
    if len({*call.names}) < len(call.names):
        return do.fail, f"'{call.name}': an argument stands there twice"
    return do.builtin, (FUNCTIONS[call.name], call.positional, call.names)


@cache
def signature(name: str) -> inspect.Signature:
    """Parameters of a function of the controller; the first is the thread."""
    return inspect.signature(FUNCTIONS[name])
