"""The grammar of URScript (URScript manual, CB3), and the parser that `lark` makes of it.

`lark` is the parser generator of ROS's own rosidl. Its releases from 0.12, which comes with the
wheels of ROS, to 1.x will do.
"""

from collections.abc import Iterator

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedToken

from omniman_ros.simulation.ur.urscript.errors import ScriptError

#: Largest number of definitions, blocks and expressions within each other.
#:
#: It keeps Python's stack shallow where a program is translated.
MAX_NESTING = 40

KEYWORDS = (
    *("and", "or", "xor", "not", "True", "False"),
    *("if", "elif", "else", "while", "break", "continue", "end", "pass"),
    *("def", "thread", "return", "global", "local"),
    *("run", "join", "kill", "halt", "enter_critical", "exit_critical"),
)  #: Words that cannot be names

GRAMMAR = r"""
start: block
block: (statement? _NEWLINE)* statement?

?statement: definition | if | while | assignment | expression_statement
    | "break" -> break_statement
    | "continue" -> continue_statement
    | "return" expression? -> return_statement
    | "kill" expression -> kill_statement
    | "join" expression -> join_statement
    | "halt" _empty? -> halt_statement
    | ("pass" | "enter_critical" | "exit_critical") _empty? -> pass_statement
_empty: "(" ")"

definition: (DEF | THREAD | SECONDARY) NAME parameters ":" block "end"
parameters: "(" (parameter ("," parameter)* ","?)? ")"
parameter: NAME ["=" expression]

if: "if" branch ("elif" branch)* ["else" ":" block] "end"
branch: expression ":" block
while: "while" expression ":" block "end"

assignment: expression "=" expression
    | GLOBAL NAME "=" expression -> global_assignment
    | LOCAL NAME "=" expression -> local_assignment
expression_statement: expression

?expression: or
?or: xor ("or" xor)*
?xor: and ("xor" and)*
?and: comparison ("and" comparison)*
?comparison: sum (COMPARISON sum)*
?sum: product (SIGN product)*
?product: _operand (SCALE _operand)*
_operand: not | sign | value
not: "not" comparison
sign: SIGN _operand

?value: call | run | index | list | "(" expression ")" -> parentheses
    | NUMBER -> number | STRING -> string | "True" -> true | "False" -> false | NAME -> name
list: "[" _elements? "]"
index: value "[" _elements "]"
_elements: expression ("," expression)* ","?
call: NAME arguments
run: "run" NAME arguments
arguments: "(" (argument ("," argument)* ","?)? ")"
argument: [NAME "="] expression

DEF: "def"
THREAD: "thread"
SECONDARY.2: /sec(?=[ \t]+[A-Za-z_])/
GLOBAL: "global"
LOCAL: "local"
COMPARISON: /==|!=|<=|>=|<|>/
SIGN: /[-+]/
SCALE: /[*\/%]/
NAME: /(?!(?:KEYWORDS)(?![A-Za-z0-9_]))[A-Za-z_][A-Za-z0-9_]*/
NUMBER: /0[xX][0-9a-fA-F]+|([0-9]+\.[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[0-9]+([eE][+-]?[0-9]+)?/
STRING: /"[^"\n]*"|'[^'\n]*'/

_NEWLINE: "\n"
LABEL.2: /^[ \t]*[$@][^\n]*/m
COMMENT: /#[^\n]*/
BLANK: /[ \t\f\v]+/
%ignore LABEL
%ignore COMMENT
%ignore BLANK
""".replace("KEYWORDS", "|".join(KEYWORDS))

BRACKETS = {"LPAR": 1, "LSQB": 1, "RPAR": -1, "RSQB": -1}
BLOCKS = {"DEF": 1, "THREAD": 1, "SECONDARY": 1, "IF": 1, "WHILE": 1, "END": -1}
NESTING = BRACKETS | BLOCKS  #: By how many levels a terminal deepens the nesting of a program
PREFIXES = {"NOT", "SIGN"}  #: Terminals before an operand, which nest until it begins
#: Terminals after which an expression continues on the next line
CONTINUED_AFTER = {"OR", "XOR", "AND", "COMPARISON", "SIGN", "SCALE"}
SYMBOLS = {"_NEWLINE": "newline", "$END": "end of text"}


class _LineJoiner:
    """Drops the ends of lines within brackets and after operators."""

    always_accept = ("_NEWLINE",)

    def process(self, stream: Iterator[Token]) -> Iterator[Token]:
        """Yield the tokens of a program whose statements each end on their line."""
        depth, previous = 0, ""
        for token in _limit_nesting(stream):
            depth += BRACKETS.get(token.type, 0)
            if token.type == "_NEWLINE" and (depth > 0 or previous in CONTINUED_AFTER):
                continue
            previous = token.type
            yield token


def _limit_nesting(stream: Iterator[Token]) -> Iterator[Token]:
    """Yield the tokens of a program up to where they nest too deeply.

    The translation counts exactly, but only what has been parsed, and a parser that reads 100,000
    brackets takes seconds.

    Raises:
        ScriptError: A token is nested too deeply.
    """
    depth, prefixes = 1, 0  # the body of the program is a block
    for token in stream:
        depth += NESTING.get(token.type, 0)
        prefixes = prefixes + 1 if token.type in PREFIXES else 0
        if depth + prefixes > MAX_NESTING:
            raise nested_too_deeply(int(token.line or 1))
        yield token


PARSER = Lark(
    GRAMMAR,
    parser="lalr",
    lexer="contextual",
    postlex=_LineJoiner(),
    propagate_positions=True,
    maybe_placeholders=True,
)  #: Made with the module: it takes 0.2 s, in which a running controller would miss its cycles

WARM_UP = """
def f(a, b=[1, -a[0]], c="s",):
  thread t():
    while not a or b and True xor c == 0.5 * (2 + 3):
      break
    end
  end
  global g = f(a, b=1, c=[2, 3])
  local h = run t()
  if False:
    a[0] = p[1, 2]
    continue
  elif a < -1:
    kill h
  else:
    join h
    halt()
  end
  enter_critical
  return
end
sec s():
  pass
end
"""
PARSER.parse(WARM_UP)  # lark compiles the expressions of a state when it first comes to it


def parse(text: str) -> Tree:
    """Parse the text of a program.

    Returns:
        Tree whose nodes are named after the rules of the grammar, with the line of each.

    Raises:
        ScriptError: The text does not follow the grammar, or nests too deeply.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n")
    try:
        return PARSER.parse(lines)
    except UnexpectedCharacters as error:
        raise ScriptError(error.line, _complaint(lines[error.pos_in_stream])) from None
    except UnexpectedToken as error:
        line = lines.count("\n") + 1 if error.token.type == "$END" else error.token.line
        found = SYMBOLS.get(error.token.type, f"'{error.token}'")
        raise ScriptError(line or 1, f"unexpected {found}") from None


def nested_too_deeply(line: int) -> ScriptError:
    """Return the error of a line where a program nests more than MAX_NESTING deep."""
    return ScriptError(line, f"nested more than {MAX_NESTING} deep")


def _complaint(character: str) -> str:
    if character in "\"'":
        return "the string does not end on its line"
    return f"unexpected character {character!r}"
