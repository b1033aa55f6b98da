"""Compilation of a program to Python functions of a frame.

Expressions and statements that cannot suspend their thread become plain functions; the others
become generator functions (see `execution`). Functions are linked when all are known.
"""

from omniman_ros.simulation.ur.urscript.calls import Scope
from omniman_ros.simulation.ur.urscript.errors import ScriptError
from omniman_ros.simulation.ur.urscript.execution import Function, Statement
from omniman_ros.simulation.ur.urscript.expressions import ExpressionCompiler
from omniman_ros.simulation.ur.urscript.grammar import parse
from omniman_ros.simulation.ur.urscript.statements import StatementCompiler
from omniman_ros.simulation.ur.urscript.syntax import (
    Nesting,
    Node,
    definitions,
    keyword,
    line_of,
    subtrees,
)


class Program:
    """A program, ready to run.

    The text is either one definition, `def name(): ... end`, whose body is the program, or bare
    statements, among which there may be definitions. `pass`, which does nothing, counts as no
    statement. `sec` defines a secondary program.

    Raises:
        ScriptError: The text is not a program.
    """

    def __init__(self, text: str) -> None:
        block = subtrees(parse(text))[0]
        statements = [node for node in subtrees(block) if node.data != "pass_statement"]
        defined = [node for node in statements if node.data == "definition"]
        #: Whether it is a secondary program, which takes no time
        self.secondary = any(keyword(node).type == "SECONDARY" for node in defined)
        scope = Scope()
        main = Function("program", body=_body(block, scope, Nesting()))
        if len(defined) == len(statements):
            programs = [each for each in scope.functions.values() if not each.is_thread]
            if len(programs) != 1 or programs[0].parameters:
                raise ScriptError(1, "the text is not one program")
            main = programs[0]
        self.main = main  #: Function of the main thread, whose variables are global


def _body(block: Node, scope: Scope, nesting: Nesting) -> Statement:
    """Compile the body of a function; all of its statements can call the functions it defines."""
    declared = [(node, _declare(node, scope)) for node in definitions(block)]
    for node, function in declared:
        with nesting.enter(node):
            _define(node, function, scope, nesting)
    return StatementCompiler(scope, nesting).block(block)


def _declare(node: Node, scope: Scope) -> Function:
    _, name, parameters, _ = node.children
    names = tuple(str(each.children[0]) for each in subtrees(parameters))
    for index, parameter in enumerate(names):
        if parameter in names[:index]:
            raise ScriptError(line_of(node), f"parameter '{parameter}' stands there twice")
    is_thread = keyword(node).type == "THREAD"
    if is_thread and names:
        raise ScriptError(line_of(node), f"thread '{name}' cannot have parameters")
    optional = {str(p.children[0]) for p in subtrees(parameters) if p.children[1] is not None}
    function = Function(str(name), is_thread, names, frozenset(optional))
    scope.functions[function.name] = function
    return function


def _define(node: Node, function: Function, scope: Scope, nesting: Nesting) -> None:
    parameters, block = subtrees(node)
    own = Scope(scope)
    expressions = ExpressionCompiler(own, nesting)
    for parameter in subtrees(parameters):
        name, default = parameter.children
        if default is not None:
            function.defaults[str(name)] = expressions.compile(default)
    function.body = _body(block, own, nesting)
