"""Text to tokens."""

import re
from typing import NamedTuple

from omniman_ros.simulated_ur.urscript.errors import ScriptError
from omniman_ros.simulated_ur.urscript.values import MOST

KEYWORDS = frozenset(
    (
        *("and", "or", "xor", "not", "True", "False"),
        *("if", "elif", "else", "while", "break", "continue", "end", "pass"),
        *("def", "thread", "return", "global", "local"),
        *("run", "join", "kill", "halt", "enter_critical", "exit_critical"),
    )
)

PATTERN = re.compile(
    r"""
    (?P<skip>    ^[ \t]*[$@][^\r\n]* | [ \t\f\v]+ | \#[^\r\n]* )  # labels, annotations, comments
  | (?P<newline> \r\n | \n | \r )
  | (?P<hex>     0[xX][0-9a-fA-F]+ )
  | (?P<float>   (?: [0-9]+\.[0-9]* | \.[0-9]+ ) (?: [eE][+-]?[0-9]+ )? | [0-9]+[eE][+-]?[0-9]+ )
  | (?P<int>     [0-9]+ )
  | (?P<name>    [A-Za-z_][A-Za-z0-9_]* )
  | (?P<string>  "[^"\r\n]*" | '[^'\r\n]*' )
  | (?P<symbol>  == | != | <= | >= | [-+*/%<>=()\[\],:] )
    """,
    re.VERBOSE | re.MULTILINE,
)

DEPTH = {"(": 1, "[": 1, ")": -1, "]": -1}


class Token(NamedTuple):
    """A word of the program.

    Attributes:
        kind: "name", "number", "string", "newline", "end of text", or the symbol or keyword.
        value: Of a name, number or string.
        line: From 1.
    """

    kind: str
    value: str | int | float
    line: int

    def __str__(self) -> str:
        return f"'{self.value}'" if self.kind in ("name", "number", "string") else self.kind


def tokens(text: str) -> list[Token]:
    """The words of a program; inside brackets a line goes on.

    Raises:
        ScriptError: A character has no meaning; a string has no end; an integer does not fit.
    """
    found: list[Token] = []
    at, line, depth = 0, 1, 0
    while at < len(text):
        match = PATTERN.match(text, at)
        if match is None:
            raise ScriptError(line, complaint(text[at]))
        kind, word = str(match.lastgroup), match.group()
        at = match.end()
        if kind == "newline":
            if depth <= 0:
                found.append(Token("newline", "", line))
            line += 1
        elif kind != "skip":
            found.append(token(kind, word, line))
            depth += DEPTH.get(word, 0)
    if depth <= 0:
        found.append(Token("newline", "", line))
    found.append(Token("end of text", "", line))
    return found


def complaint(character: str) -> str:
    """Why nothing can begin with this character."""
    if character in "\"'":
        return "the string does not end on its line"
    return f"unexpected character {character!r}"


def token(kind: str, word: str, line: int) -> Token:
    """One word of a group of the pattern; ScriptError for an integer that does not fit."""
    if kind in ("int", "hex"):
        digits = word[2:] if kind == "hex" else word
        value = int(digits, 16 if kind == "hex" else 10) if len(digits) < 20 else MOST + 1
        if value > MOST:
            raise ScriptError(line, "the integer does not fit into 32 bits")
        return Token("number", value, line)
    if kind == "float":
        return Token("number", float(word), line)
    if kind == "string":
        return Token("string", word[1:-1], line)
    if kind == "name" and word not in KEYWORDS:
        return Token("name", word, line)
    return Token(word, "", line)
