"""Compilation of expressions."""

from collections.abc import Callable
from typing import Any

from omniman_ros.simulation.ur.urscript.calls import CallCompiler, Scope
from omniman_ros.simulation.ur.urscript.combinators import apply, constant, fold, short_circuit
from omniman_ros.simulation.ur.urscript.errors import ScriptError, ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.execution import Code, Expression, StackFrame
from omniman_ros.simulation.ur.urscript.syntax import (
    Nesting,
    Node,
    line_of,
    name_of,
    without_parentheses,
)
from omniman_ros.simulation.ur.urscript.values import (
    BINARY,
    JOINTS,
    LARGEST,
    Value,
    element,
    make_list,
    make_pose,
    negative,
    truth,
)


class ExpressionCompiler:
    """Compiles the expressions in one body."""

    def __init__(self, scope: Scope, nesting: Nesting) -> None:
        self._nesting = nesting
        calls = CallCompiler(scope, self.compile)
        self._compilers: dict[str, Callable[[Node], Expression]] = {
            "number": _number,
            "string": _string,
            "true": _true,
            "false": _false,
            "name": _load,
            "comparison": self._chain,
            "sum": self._chain,
            "product": self._chain,
            "xor": self._xor,
            "and": self._and,
            "or": self._or,
            "not": self._not,
            "sign": self._sign,
            "list": self._list,
            "index": self._index,
            "call": calls.call,
            "run": calls.run,
        }

    def compile(self, node: Any) -> Expression:
        """Compile an expression; an invalid one raises a ScriptError."""
        inner = without_parentheses(node)
        with self._nesting.enter(inner):
            return self._compilers[inner.data](inner)

    def condition(self, node: Any) -> Code[bool]:
        """Compile an expression whose value must be a truth value."""
        return apply([self.compile(node)], lambda frame, value: truth(value), line_of(node))

    def _chain(self, node: Node) -> Expression:
        """Compile binary operators of equal precedence, which apply from left to right."""
        first, *rest = node.children
        operands = [self.compile(first), *map(self.compile, rest[1::2])]
        operators = [(BINARY[str(symbol)], int(symbol.line or 1)) for symbol in rest[::2]]
        return fold(operands, operators)

    def _xor(self, node: Node) -> Expression:
        operands = [self.compile(child) for child in node.children]
        return fold(operands, [(BINARY["xor"], line_of(node))] * (len(operands) - 1))

    def _and(self, node: Node) -> Expression:
        return short_circuit([self.condition(child) for child in node.children], decisive=False)

    def _or(self, node: Node) -> Expression:
        return short_circuit([self.condition(child) for child in node.children], decisive=True)

    def _not(self, node: Node) -> Expression:
        operand = self.condition(node.children[0])
        return apply([operand], lambda frame, value: not value, line_of(node))

    def _sign(self, node: Node) -> Expression:
        sign, operand = node.children
        value = self.compile(operand)
        if sign == "+":
            return value
        return apply([value], lambda frame, value: negative(value), line_of(node))

    def _list(self, node: Node) -> Expression:
        elements = [self.compile(child) for child in node.children]
        return apply(elements, lambda frame, *values: make_list(values), line_of(node))

    def _index(self, node: Node) -> Expression:
        """Compile `list[index]`, or `p[...]` with several elements, which is a pose."""
        container, *inside = node.children
        if len(inside) == 1:
            parts = [self.compile(container), self.compile(inside[0])]
            return apply(parts, lambda frame, value, index: element(value, index), line_of(node))
        if name_of(container) != "p":
            raise ScriptError(line_of(node), "unexpected ','")
        if len(inside) != JOINTS:
            raise ScriptError(line_of(node), f"a pose has {JOINTS} elements, not {len(inside)}")
        elements = [self.compile(child) for child in inside]
        return apply(elements, lambda frame, *values: make_pose(values), line_of(node))


def _number(node: Node) -> Expression:
    word = str(node.children[0])
    is_hex = word[:2] in ("0x", "0X")
    if not is_hex and not word.isdigit():
        return constant(float(word))
    number = int(word, 16 if is_hex else 10) if len(word) < 20 else LARGEST + 1
    if number > LARGEST:
        raise ScriptError(line_of(node), "the integer does not fit into 32 bits")
    return constant(number)


def _string(node: Node) -> Expression:
    return constant(str(node.children[0])[1:-1])


def _true(node: Node) -> Expression:
    return constant(True)


def _false(node: Node) -> Expression:
    return constant(False)


def _load(node: Node) -> Expression:
    name, line = str(node.children[0]), line_of(node)

    def load(frame: StackFrame) -> Value:
        if name in frame.variables:
            return frame.variables[name]
        if name in frame.globals:
            return frame.globals[name]
        frame.thread.line = line
        raise ScriptRuntimeError(f"name '{name}' is not defined")

    return Code(load)
