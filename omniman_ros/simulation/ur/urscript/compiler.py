"""Translation of a program to Python.

Each function, thread and program becomes a generator function, which yields a Wait where its
thread waits and receives the value of the wait. It is built as an `ast` on the lines of the
program, so that Python's traceback tells the line of an error (see `line_of_error`).

A generator function has three parameters: the `thread` that executes it, its `own` variables
(`context.Variables`), and the `depth` of its call. What it uses has names that no program has: "+"
is an operator, "ur.sin" a function of the controller.

A call of a function that does not exist, or with arguments that it does not accept, becomes code
that fails: a program may mention what it never executes.
"""

import ast
import inspect
import traceback
from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from types import GeneratorType
from typing import Any, TypeAlias, TypeVar

from lark import Token, Tree

from omniman_ros.simulation.ur.urscript.context import Wait
from omniman_ros.simulation.ur.urscript.errors import ScriptError, ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.functions import FUNCTIONS
from omniman_ros.simulation.ur.urscript.grammar import MAX_NESTING, nested_too_deeply, parse
from omniman_ros.simulation.ur.urscript.values import (
    BINARY,
    JOINTS,
    LARGEST,
    Value,
    element,
    make_list,
    make_pose,
    truth,
)

Node: TypeAlias = Tree

#: Execution of a function, thread or program
Run: TypeAlias = "GeneratorType[Wait, Any, Value]"

Code = TypeVar("Code", ast.expr, ast.stmt)

MAX_LOOPS = 20  #: Largest number of loops within each other, which is Python's
CALL_WORK = 10  #: Work of a function of the controller, counted in nodes of expressions
FILE = "<urscript>"  #: Name of the file of translated code, by which it is found in a traceback


class Program:
    """A program, ready to run.

    The text is either one definition, `def name(): ... end`, whose body is the program, or bare
    statements, among which there may be definitions. `pass`, which does nothing, counts as no
    statement. `sec` defines a secondary program.

    Raises:
        ScriptError: The text is not a program.
    """

    def __init__(self, text: str) -> None:
        block = _subtrees(parse(text))[0]
        statements = [node for node in _subtrees(block) if node.data != "pass_statement"]
        defined = [node for node in statements if node.data == "definition"]
        #: Whether it is a secondary program, which takes no time
        self.secondary = any(_keyword(node) == "SECONDARY" for node in defined)
        translation = _Translation()
        main = _Function("", "program")
        translation.add(main, translation.body(block))
        if len(defined) == len(statements):
            programs = [each for each in translation.scope.values() if not each.is_thread]
            if len(programs) != 1 or programs[0].parameters:
                raise ScriptError(1, "the text is not one program")
            main = programs[0]
        #: Generator function of the main thread, whose own variables are the global ones
        self.main: Callable[..., Run] = translation.compiled()[main.symbol]


def line_of_error(error: Exception, run: Run) -> int:
    """Return the line at which a program failed, or where it waits if the wait failed."""
    lines = [
        line
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_code.co_filename == FILE
    ]
    while not lines and isinstance(run.gi_yieldfrom, GeneratorType):
        run = run.gi_yieldfrom
    if not lines and run.gi_frame is not None:
        lines = [run.gi_frame.f_lineno]
    return lines[-1]


@dataclass(frozen=True)
class _Function:
    """A function, thread or program of the text."""

    name: str
    symbol: str  #: Name of its generator function
    is_thread: bool = False  #: Whether it is run rather than called
    parameters: tuple[str, ...] = ()  #: Names of its parameters, in order
    optional: frozenset[str] = frozenset()  #: Names of those that have a default


class _Translation:
    """Translates a program; the methods below `expression` and `block` are named after rules."""

    def __init__(self) -> None:
        #: Functions that can be called, those of the innermost definition first
        self.scope: ChainMap[str, _Function] = ChainMap()
        self._module = ast.Module([], [])
        self._depth, self._loops, self._symbols = 0, 0, 0
        self._nodes = 0  # of the expressions of the statement that is being translated

    def compiled(self) -> dict[str, Any]:
        """Return the generator functions, by symbol.

        Raises:
            ScriptError: Python does not accept the translation.
        """
        found = dict(RUNTIME)
        try:
            exec(compile(ast.fix_missing_locations(self._module), FILE, "exec"), found)
        except SyntaxError as error:
            raise ScriptError(error.lineno or 1, f"not translated: {error.msg}") from error
        except RecursionError as error:
            raise ScriptError(1, f"not translated: {error}") from error
        return found

    def add(self, function: _Function, statements: list[ast.stmt]) -> None:
        """Add the generator function of translated statements."""
        parameters = [ast.arg(name) for name in ("thread", "own", "depth")]
        arguments = ast.arguments([], parameters, None, [], [], None, [])
        # Its only yield may stand behind all that is executed: it makes a generator function.
        body = [*statements, ast.Return(None), ast.Expr(ast.Yield(None))]
        self._module.body.append(ast.FunctionDef(function.symbol, arguments, body, []))

    def body(self, block: Node) -> list[ast.stmt]:
        """Translate the definitions in a body, then its statements, which can call them all."""
        declared = [(node, self._declare(node)) for node in _definitions(block)]
        for node, function in declared:
            with self._deeper(node):
                self._define(node, function)
        return self.block(block)

    def _declare(self, node: Node) -> _Function:
        _, name, parameters, _ = node.children
        names = tuple(str(each.children[0]) for each in _subtrees(parameters))
        for index, parameter in enumerate(names):
            if parameter in names[:index]:
                raise ScriptError(_line(node), f"parameter '{parameter}' stands there twice")
        is_thread = _keyword(node) == "THREAD"
        if is_thread and names:
            raise ScriptError(_line(node), f"thread '{name}' cannot have parameters")
        optional = frozenset(
            str(each.children[0]) for each in _subtrees(parameters) if each.children[1] is not None
        )
        self._symbols += 1
        symbol = f"{name} {self._symbols}"
        function = _Function(str(name), symbol, is_thread, names, optional)
        self.scope[function.name] = function
        return function

    def _define(self, node: Node, function: _Function) -> None:
        parameters, block = _subtrees(node)
        self.scope, self._nodes = self.scope.new_child(), 0
        defaults: list[ast.stmt] = []
        for parameter in _subtrees(parameters):
            name, default = parameter.children
            if default is not None:
                missing = ast.Compare(_constant(name), [ast.NotIn()], [_load("own")])
                value = self.expression(default)
                defaults.append(ast.If(missing, [ast.Assign([_variable("own", name)], value)], []))
        if defaults:
            defaults.insert(0, _on_line(node, _charge(self._nodes)))
        self.add(function, defaults + self.body(block))
        self.scope = self.scope.parents

    @contextmanager
    def _deeper(self, node: Node) -> Iterator[None]:
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise nested_too_deeply(_line(node))
        yield
        self._depth -= 1

    def _temporary(self) -> tuple[ast.Name, ast.Name]:
        """Return a local variable of the generator function, to store and to load.

        There is one per depth: what is around a node, and may be in use, is less deep.
        """
        name = f"_{self._depth}"
        return ast.Name(name, ast.Store()), _load(name)

    # ---- statements --------------------------------------------------------------------------

    def block(self, block: Node) -> list[ast.stmt]:
        """Translate statements, definitions left out; an invalid one raises a ScriptError."""
        statements: list[ast.stmt] = []
        with self._deeper(block):
            for node in _subtrees(block):
                if node.data not in ("definition", "pass_statement"):
                    around, self._nodes = self._nodes, 0
                    translated = getattr(self, f"_{node.data}")(node)
                    charge = _charge(1 + self._nodes)
                    statements += [_on_line(node, each) for each in (charge, *translated)]
                    self._nodes = around
        return statements or [ast.Pass()]

    def _expression_statement(self, node: Node) -> list[ast.stmt]:
        call = _without_parentheses(node.children[0])
        if call.data not in ("call", "run"):
            raise ScriptError(_line(node), "neither a call nor an assignment")
        return [ast.Expr(self.expression(call))]

    def _assignment(self, node: Node) -> list[ast.stmt]:
        target, value = _subtrees(node)
        if target.data == "name":
            name = _constant(target.children[0])
            return [ast.Expr(_call("own.assign", name, self.expression(value)))]
        container, *index = target.children if target.data == "index" else [None]
        name_found = _name_in(container)
        if name_found is None or len(index) != 1:
            raise ScriptError(_line(node), "neither a call nor an assignment")
        parts = [self.expression(index[0]), self.expression(value)]
        return [ast.Expr(_call("own.assign_element", _constant(name_found), *parts))]

    def _global_assignment(self, node: Node) -> list[ast.stmt]:
        _, name, value = node.children
        return [ast.Assign([_variable("own.shared", name)], self.expression(value))]

    def _local_assignment(self, node: Node) -> list[ast.stmt]:
        _, name, value = node.children
        return [ast.Assign([_variable("own", name)], self.expression(value))]

    def _if(self, node: Node) -> list[ast.stmt]:
        """Translate branches, which Python would nest, to one `if` after the other."""
        *branches, last = _subtrees(node)
        done_later, done = self._temporary()
        untaken = ast.UnaryOp(ast.Not(), done)
        statements: list[ast.stmt] = [ast.Assign([done_later], ast.Constant(False))]
        for branch in [*branches, last] if last.data == "branch" else branches:
            taken = ast.NamedExpr(done_later, self._condition(branch.children[0]))
            test = ast.BoolOp(ast.And(), [untaken, taken])
            statements.append(ast.If(test, self.block(_subtrees(branch)[-1]), []))
        if last.data == "block":
            statements.append(ast.If(untaken, self.block(last), []))
        return statements

    def _while(self, node: Node) -> list[ast.stmt]:
        condition, block = node.children
        test = self._condition(condition)
        charge = _charge(1 + self._nodes)
        self._loops += 1
        if self._loops > MAX_LOOPS:
            raise ScriptError(_line(node), f"loops are nested more than {MAX_LOOPS} deep")
        body = [_on_line(node, charge), *self.block(block)]
        self._loops -= 1
        return [ast.While(test, body, [])]

    def _break_statement(self, node: Node) -> list[ast.stmt]:
        self._require_loop(node, "break")
        return [ast.Break()]

    def _continue_statement(self, node: Node) -> list[ast.stmt]:
        self._require_loop(node, "continue")
        return [ast.Continue()]

    def _require_loop(self, node: Node, word: str) -> None:
        if not self._loops:
            raise ScriptError(_line(node), f"{word} outside a loop")

    def _return_statement(self, node: Node) -> list[ast.stmt]:
        return [ast.Return(self.expression(node.children[0]) if node.children else None)]

    def _kill_statement(self, node: Node) -> list[ast.stmt]:
        return [ast.Expr(self._wait(_call("thread.kill", self.expression(node.children[0]))))]

    def _join_statement(self, node: Node) -> list[ast.stmt]:
        return [ast.Expr(self._wait(_call("thread.join", self.expression(node.children[0]))))]

    def _halt_statement(self, node: Node) -> list[ast.stmt]:
        return [ast.Expr(self._wait(_call("thread.halt")))]

    # ---- expressions -------------------------------------------------------------------------

    def expression(self, node: Any) -> ast.expr:
        """Translate an expression; an invalid one raises a ScriptError."""
        inner = _without_parentheses(node)
        self._nodes += 1
        with self._deeper(inner):
            translated: ast.expr = getattr(self, f"_{inner.data}")(inner)
        return _on_line(inner, translated)

    def _condition(self, node: Any) -> ast.expr:
        return _on_line(node, _call("truth", self.expression(node)))

    def _number(self, node: Node) -> ast.expr:
        word = str(node.children[0])
        is_hex = word[:2] in ("0x", "0X")
        if not is_hex and not word.isdigit():
            return ast.Constant(float(word))
        number = int(word, 16 if is_hex else 10) if len(word) < 20 else LARGEST + 1
        if number > LARGEST:
            raise ScriptError(_line(node), "the integer does not fit into 32 bits")
        return ast.Constant(number)

    def _string(self, node: Node) -> ast.expr:
        return ast.Constant(str(node.children[0])[1:-1])

    def _true(self, node: Node) -> ast.expr:
        return ast.Constant(True)

    def _false(self, node: Node) -> ast.expr:
        return ast.Constant(False)

    def _name(self, node: Node) -> ast.expr:
        return ast.Subscript(_load("own"), _constant(node.children[0]), ast.Load())

    def _chain(self, node: Node) -> ast.expr:
        """Translate binary operators of equal precedence, which apply from left to right.

        Python would nest them: `a - b + c` becomes `(_1 := a) is Wait or charged(_1 := _1 - b) or
        charged(_1 := _1 + c) or _1`, where `charged(x)` is `type(x) is tuple and
        thread.charge_list(_1)`. None but the last of these is true, so every step is made, and
        none but the last result is kept.
        """
        later, result = self._temporary()
        first, *rest = node.children
        begun = ast.NamedExpr(later, self.expression(first))
        steps: list[ast.expr] = [ast.Compare(begun, [ast.Is()], [_load("Wait")])]
        for symbol, operand in zip(rest[::2], rest[1::2], strict=True):
            applied = _on_line(symbol, _call(str(symbol), result, self.expression(operand)))
            kind = _call("type", ast.NamedExpr(later, applied))
            is_list = ast.Compare(kind, [ast.Is()], [_load("tuple")])
            charged = [is_list, _on_line(symbol, _call("thread.charge_list", result))]
            steps.append(ast.BoolOp(ast.And(), charged))
        return ast.BoolOp(ast.Or(), [*steps, result])

    _comparison = _sum = _product = _chain

    def _xor(self, node: Node) -> ast.expr:
        xor = Token("XOR", "xor", line=_line(node))
        parts = [part for operand in node.children for part in (xor, operand)]
        return self._chain(Tree("xor", parts[1:]))

    def _and(self, node: Node) -> ast.expr:
        return ast.BoolOp(ast.And(), [self._condition(child) for child in node.children])

    def _or(self, node: Node) -> ast.expr:
        return ast.BoolOp(ast.Or(), [self._condition(child) for child in node.children])

    def _not(self, node: Node) -> ast.expr:
        return ast.UnaryOp(ast.Not(), self._condition(node.children[0]))

    def _sign(self, node: Node) -> ast.expr:
        sign, operand = node.children
        if sign == "+":
            return self.expression(operand)
        times, minus_one = Token("SCALE", "*", line=_line(node)), Tree("minus_one", [])
        return self._chain(Tree("product", [minus_one, times, operand]))

    def _minus_one(self, node: Node) -> ast.expr:
        return ast.Constant(-1)

    def _list(self, node: Node) -> ast.expr:
        return _call("make_list", self._elements(node.children))

    def _index(self, node: Node) -> ast.expr:
        """Translate `list[index]`, or `p[...]` with several elements, which is a pose."""
        container, *inside = node.children
        if len(inside) == 1:
            return _call("element", self.expression(container), self.expression(inside[0]))
        if _name_in(container) != "p":
            raise ScriptError(_line(node), "unexpected ','")
        if len(inside) != JOINTS:
            raise ScriptError(_line(node), f"a pose has {JOINTS} elements, not {len(inside)}")
        return _call("make_pose", self._elements(inside))

    def _elements(self, nodes: Sequence[Any]) -> ast.expr:
        return ast.Tuple([self.expression(each) for each in nodes], ast.Load())

    # ---- calls -------------------------------------------------------------------------------

    def _call(self, node: Node) -> ast.expr:
        name, (values, names) = str(node.children[0]), self._arguments(node)
        function = self.scope.get(name)
        if function is None:
            self._nodes += CALL_WORK
            return self._controller_call(name, values, names)
        if function.is_thread:
            return _failing(values, f"'{name}' is a thread: run it")
        positional = len(values) - len(names)
        given = (*function.parameters[:positional], *names)
        missing = {*function.parameters} - {*given} - function.optional
        excess = positional > len(function.parameters) or {*given} - {*function.parameters}
        if missing or excess or len({*given}) < len(given):
            return _failing(values, _mismatch(function))
        arguments = ast.Dict([_constant(each) for each in given], values)
        own = _call("own.of_call", arguments)
        depth = _call("thread.enter", _load("depth"), _constant(name))
        return ast.YieldFrom(_call(function.symbol, _load("thread"), own, depth))

    def _run(self, node: Node) -> ast.expr:
        """Translate the start of a thread, whose value is the handle of the thread."""
        name, (values, _) = str(node.children[0]), self._arguments(node)
        thread = self.scope.get(name)
        if thread is None:
            return _failing(values, f"thread '{name}' is not defined")
        if not thread.is_thread:
            return _failing(values, f"'{name}' is no thread")
        if values:
            return _failing(values, _mismatch(thread))
        return _call("thread.start", _load(thread.symbol))

    def _arguments(self, node: Node) -> tuple[list[ast.expr], list[str]]:
        """Translate arguments; those behind the positional ones have names."""
        values, names = [], list[str]()
        for argument in _subtrees(_subtrees(node)[0]):
            name, value = argument.children
            if name is not None:
                names.append(str(name))
            elif names:
                raise ScriptError(_line(node), "a positional argument behind one by name")
            values.append(self.expression(value))
        return values, names

    def _controller_call(self, name: str, values: list[ast.expr], names: list[str]) -> ast.expr:
        if name not in FUNCTIONS:
            return _failing(values, f"function '{name}' is not defined")
        positional = len(values) - len(names)
        by_position, by_name = values[:positional], values[positional:]
        try:
            _signature(name).bind(None, *by_position, **dict.fromkeys(names))
        except TypeError as error:
            return _failing(values, f"'{name}': {error}")
        if len({*names}) < len(names):
            return _failing(values, f"'{name}': an argument stands there twice")
        call = _call(f"ur.{name}", _path("thread.context"), *by_position)
        if names:
            # In a dictionary, for Python reserves names that a function without effect accepts.
            call.keywords = [ast.keyword(None, ast.Dict([*map(_constant, names)], by_name))]
        return self._wait(call)

    def _wait(self, call: ast.expr) -> ast.expr:
        """Translate a call that may return a Wait, for which the thread then waits."""
        later, result = self._temporary()
        is_wait = _call("isinstance", ast.NamedExpr(later, call), _load("Wait"))
        return ast.IfExp(is_wait, ast.Yield(result), result)


def _subtrees(node: Node) -> list[Node]:
    return [child for child in node.children if isinstance(child, Tree)]


def _line(node: Any) -> int:
    """Return the line on which a node begins, or on which a token stands."""
    return int(getattr(node.meta if isinstance(node, Tree) else node, "line", None) or 1)


def _name_in(node: Any) -> str | None:
    """Return the name that an expression consists of, or None."""
    return str(node.children[0]) if isinstance(node, Tree) and node.data == "name" else None


def _without_parentheses(node: Any) -> Any:
    while isinstance(node, Tree) and node.data == "parentheses":
        (node,) = node.children
    return node


def _keyword(definition: Node) -> str:
    """Return the type of the word that begins a definition."""
    word = definition.children[0]
    assert isinstance(word, Token)
    return str(word.type)


def _definitions(block: Node) -> Iterator[Node]:
    """Yield the definitions of a body, also those within its branches and loops."""
    pending = _subtrees(block)[::-1]
    while pending:
        node = pending.pop()
        if node.data == "definition":
            yield node
        elif node.data in ("if", "while", "branch", "block"):
            pending += _subtrees(node)[::-1]


def _on_line(node: Any, translated: Code) -> Code:
    """Attribute Python code to the line of a node, unless it has a line already."""
    if not hasattr(translated, "lineno"):
        translated.lineno = translated.end_lineno = _line(node)
        translated.col_offset = translated.end_col_offset = 0
    return translated


def _constant(value: Any) -> ast.Constant:
    return ast.Constant(str(value))


def _load(name: str) -> ast.Name:
    return ast.Name(name, ast.Load())


def _path(path: str) -> ast.expr:
    """Return the code of a name with attributes, as "thread.context"."""
    first, *attributes = path.split(".")
    found: ast.expr = _load(first)
    for attribute in attributes:
        found = ast.Attribute(found, attribute, ast.Load())
    return found


def _call(function: str, *arguments: ast.expr) -> ast.Call:
    """Return the code of a call, of a method of `own` and `thread` or of a global function."""
    is_method = function.startswith(("own.", "thread."))
    return ast.Call(_path(function) if is_method else _load(function), list(arguments), [])


def _variable(variables: str, name: Any) -> ast.Subscript:
    """Return the code that stores a variable."""
    return ast.Subscript(_path(variables), _constant(name), ast.Store())


def _charge(work: int) -> ast.stmt:
    return ast.Expr(_call("thread.charge", ast.Constant(work)))


def _failing(values: list[ast.expr], message: str) -> ast.expr:
    """Return the code of a call that can only go wrong, after its arguments were evaluated."""
    return _call("fail", _constant(message), *values)


def _mismatch(function: _Function) -> str:
    return f"'{function.name}' takes other arguments: {[*function.parameters]}"


def _fail(message: str, *values: Value) -> None:
    raise ScriptRuntimeError(message)


@cache
def _signature(name: str) -> inspect.Signature:
    """Return the parameters of a function of the controller; the first is the context."""
    return inspect.signature(FUNCTIONS[name])


RUNTIME: dict[str, Any] = {
    **BINARY,
    **{f"ur.{name}": function for name, function in FUNCTIONS.items()},
    **{"fail": _fail, "Wait": Wait, "truth": truth},
    **{"element": element, "make_list": make_list, "make_pose": make_pose},
}  #: What translated code uses, by name
