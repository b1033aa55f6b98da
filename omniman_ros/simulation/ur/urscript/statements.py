"""Compilation of statements."""

from collections.abc import Callable
from functools import partial
from typing import Any

from omniman_ros.simulation.ur.urscript.calls import Scope
from omniman_ros.simulation.ur.urscript.combinators import apply, branch, loop, sequence
from omniman_ros.simulation.ur.urscript.errors import ScriptError, ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.execution import (
    Code,
    Halt,
    Join,
    Kill,
    LoopControl,
    Outcome,
    Return,
    StackFrame,
    Statement,
    Suspending,
)
from omniman_ros.simulation.ur.urscript.expressions import ExpressionCompiler
from omniman_ros.simulation.ur.urscript.syntax import (
    Nesting,
    Node,
    line_of,
    name_of,
    subtrees,
    without_parentheses,
)
from omniman_ros.simulation.ur.urscript.values import Value, to_str, with_element


class StatementCompiler:
    """Compiles the statements of one body."""

    def __init__(self, scope: Scope, nesting: Nesting) -> None:
        self._nesting = nesting
        self._expressions = ExpressionCompiler(scope, nesting)
        self._loops = 0
        self._compilers: dict[str, Callable[[Node], Statement]] = {
            "expression_statement": self._call_statement,
            "assignment": self._assignment,
            "global_assignment": self._store_global,
            "local_assignment": self._store_local,
            "if": self._if,
            "while": self._while,
            "break_statement": self._leave_round,
            "continue_statement": self._leave_round,
            "return_statement": self._return,
            "kill_statement": partial(self._request, request=Kill),
            "join_statement": partial(self._request, request=Join),
            "halt_statement": _halt,
        }

    def block(self, block: Node) -> Statement:
        """Compile statements, definitions left out; an invalid one raises a ScriptError."""
        with self._nesting.enter(block):
            return sequence(
                [
                    (line_of(node), self._compilers[node.data](node))
                    for node in subtrees(block)
                    if node.data not in ("definition", "pass_statement")
                ]
            )

    def _call_statement(self, node: Node) -> Statement:
        call = without_parentheses(node.children[0])
        if call.data not in ("call", "run"):
            raise ScriptError(line_of(node), "neither a call nor an assignment")
        return apply([self._expressions.compile(call)], lambda frame, value: None, line_of(node))

    def _assignment(self, node: Node) -> Statement:
        target, value = subtrees(node)
        line = line_of(node)
        if target.data == "name":
            return self._store(str(target.children[0]), value, line)
        name, *index = target.children if target.data == "index" else [None]
        if name_of(name) is None or len(index) != 1:
            raise ScriptError(line, "neither a call nor an assignment")
        return self._store_element(str(name_of(name)), index[0], value, line)

    def _store(self, name: str, value: Node, line: int) -> Statement:
        """Assign to whichever variable is in scope (URScript manual, "Scoping rules").

        That is the function's own variable if there is one, else the global one if there is
        one, else a new one of the function's own.
        """

        def store(frame: StackFrame, value: Value) -> Outcome:
            own = name in frame.variables or name not in frame.globals
            (frame.variables if own else frame.globals)[name] = value
            return None

        return apply([self._expressions.compile(value)], store, line)

    def _store_element(self, name: str, index: Any, value: Node, line: int) -> Statement:
        def store(frame: StackFrame, index: Value, value: Value) -> Outcome:
            variables = _variables(frame, name)
            variables[name] = with_element(variables[name], index, value)
            return None

        operands = [self._expressions.compile(index), self._expressions.compile(value)]
        return apply(operands, store, line)

    def _store_global(self, node: Node) -> Statement:
        _, name, value = node.children

        def store(frame: StackFrame, value: Value) -> Outcome:
            frame.globals[str(name)] = value
            return None

        return apply([self._expressions.compile(value)], store, line_of(node))

    def _store_local(self, node: Node) -> Statement:
        _, name, value = node.children

        def store(frame: StackFrame, value: Value) -> Outcome:
            frame.variables[str(name)] = value
            return None

        return apply([self._expressions.compile(value)], store, line_of(node))

    def _if(self, node: Node) -> Statement:
        parts = subtrees(node)
        branches = [
            (self._expressions.condition(part.children[0]), self.block(subtrees(part)[-1]))
            for part in parts
            if part.data == "branch"
        ]
        otherwise = self.block(parts[-1]) if parts[-1].data == "block" else sequence([])
        return branch(branches, otherwise)

    def _while(self, node: Node) -> Statement:
        line = line_of(node)
        condition, block = node.children
        test = self._expressions.condition(condition)
        self._loops += 1
        body = self.block(block)
        self._loops -= 1
        return loop(test, body, line)

    def _leave_round(self, node: Node) -> Statement:
        control = LoopControl(str(node.data).removesuffix("_statement"))
        if not self._loops:
            raise ScriptError(line_of(node), f"{control.value} outside a loop")
        return Code(lambda frame: control)

    def _return(self, node: Node) -> Statement:
        if not node.children:
            return Code(lambda frame: Return(None))
        value = self._expressions.compile(node.children[0])
        return apply([value], lambda frame, value: Return(value), line_of(node))

    def _request(self, node: Node, request: type[Kill] | type[Join]) -> Statement:
        line = line_of(node)
        handle = apply([self._expressions.compile(node.children[0])], _handle, line)

        def suspending(frame: StackFrame) -> Suspending[Outcome]:
            number = yield from handle.execute(frame)
            frame.thread.line = line
            yield request(number)
            return None

        return Code(suspending=suspending)


def _halt(node: Node) -> Statement:
    def suspending(frame: StackFrame) -> Suspending[Outcome]:
        yield Halt()
        return None

    return Code(suspending=suspending)


def _handle(frame: StackFrame, value: Value) -> int:
    """Return a value as the handle of a thread; those of no thread, as 0, are handles too."""
    if type(value) is not int:
        raise ScriptRuntimeError(f"{to_str(value)} is no thread")
    return value


def _variables(frame: StackFrame, name: str) -> dict[str, Value]:
    """Return the variables among which a name is; the function's own come first."""
    for variables in (frame.variables, frame.globals):
        if name in variables:
            return variables
    raise ScriptRuntimeError(f"name '{name}' is not defined")
