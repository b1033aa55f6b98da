"""Access to the nodes of a parsed program."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

from lark import Token, Tree

from omniman_ros.simulation.ur.urscript.errors import ScriptError

Node: TypeAlias = Tree

#: Largest number of definitions, blocks and expressions within each other.
#:
#: It keeps Python's stack shallow, both where a program is compiled and where it is executed.
MAX_NESTING = 40


def subtrees(node: Node) -> list[Node]:
    """Return the children of a node that are nodes."""
    return [child for child in node.children if isinstance(child, Tree)]


def line_of(node: Node) -> int:
    """Return the line on which a node begins."""
    return int(getattr(node.meta, "line", 1))


def name_of(node: Any) -> str | None:
    """Return the name that an expression consists of, or None."""
    return str(node.children[0]) if isinstance(node, Tree) and node.data == "name" else None


def without_parentheses(node: Any) -> Any:
    """Return the expression within all the parentheses around it."""
    while isinstance(node, Tree) and node.data == "parentheses":
        (node,) = node.children
    return node


def keyword(definition: Node) -> Token:
    """Return the word that begins a definition."""
    word = definition.children[0]
    assert isinstance(word, Token)
    return word


def definitions(block: Node) -> Iterator[Node]:
    """Yield the definitions of a body, also those within its branches and loops."""
    pending = subtrees(block)[::-1]
    while pending:
        node = pending.pop()
        if node.data == "definition":
            yield node
        elif node.data in ("if", "while", "branch", "block"):
            pending += subtrees(node)[::-1]


def nested_too_deeply(line: int) -> ScriptError:
    """Return the error of a line where a program nests more than MAX_NESTING deep."""
    return ScriptError(line, f"nested more than {MAX_NESTING} deep")


class Nesting:
    """Depth of definitions, blocks and expressions of a program within each other."""

    def __init__(self) -> None:
        self._depth = 0

    @contextmanager
    def enter(self, node: Node) -> Iterator[None]:
        """Go a level deeper, to compile a node; too deep a one raises a ScriptError."""
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise nested_too_deeply(line_of(node))
        yield
        self._depth -= 1
