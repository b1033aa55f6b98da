"""Words and expressions of a program: recursive descent that emits code as it reads."""

from dataclasses import dataclass, field

from omniman_ros.simulated_ur.urscript import instructions as do
from omniman_ros.simulated_ur.urscript.errors import ScriptError
from omniman_ros.simulated_ur.urscript.instructions import Function, Operation
from omniman_ros.simulated_ur.urscript.lexer import Token, tokens
from omniman_ros.simulated_ur.urscript.linker import Call, Scope
from omniman_ros.simulated_ur.urscript.values import BINARY, JOINTS

DEEPEST = 40  # of blocks and brackets; far below the depth of Python's own stack

LEVELS = ["or"], ["xor"], ["and"], ["==", "!=", "<", ">", "<=", ">="], ["+", "-"], ["*", "/", "%"]
LEVEL = {symbol: level for level, symbols in enumerate(LEVELS, 1) for symbol in symbols}
COMPARISON, TIGHTEST = LEVEL["=="], len(LEVELS) + 1  # operands of `not`, and of a minus sign

SKIPS = {"and": do.skip_and, "or": do.skip_or}
CONSTANTS = {"True": True, "False": False}


@dataclass
class Body:
    """A function whose text is being read."""

    function: Function
    scope: Scope
    loops: list[tuple[int, list[int]]] = field(default_factory=list)  # start, jumps to its end


class Expressions:
    """Reads words and expressions of one text.

    Args:
        text: The program's.

    Raises:
        ScriptError: It has words that are none.
    """

    def __init__(self, text: str) -> None:
        self.tokens = tokens(text)
        self.at = 0
        self.depth = 0
        self.calls: list[Call] = []
        self.body = Body(Function("program"), Scope())

    # Words

    @property
    def now(self) -> Token:
        """The word at which we stand."""
        return self.tokens[self.at]

    @property
    def next_kind(self) -> str:
        """Kind of the word behind it."""
        return self.tokens[min(self.at + 1, len(self.tokens) - 1)].kind

    def advance(self) -> Token:
        """The word at which we stand; step behind it."""
        word = self.tokens[self.at]
        self.at += 1
        return word

    def accept(self, kind: str) -> bool:
        """Step behind a word of this kind if there is one."""
        if self.now.kind != kind:
            return False
        self.at += 1
        return True

    def expect(self, kind: str) -> Token:
        """The word at which we stand, which must be of this kind."""
        if self.now.kind != kind:
            raise self.error(f"expected {kind}, found {self.now}")
        return self.advance()

    def error(self, reason: str) -> ScriptError:
        """An error on the line at which we stand."""
        return ScriptError(self.now.line, reason)

    def deeper(self) -> None:
        """Enter a block or an expression; ScriptError if it is one too many."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.error(f"nested more than {DEEPEST} deep")

    # Code

    def emit(self, operation: Operation, argument: object = None, line: int | None = None) -> int:
        """Append an instruction; its index."""
        function = self.body.function
        function.code.append((operation, argument))
        function.lines.append(self.now.line if line is None else line)
        return len(function.code) - 1

    @property
    def here(self) -> int:
        """Index of the next instruction."""
        return len(self.body.function.code)

    def patch(self, at: int) -> None:
        """Let the jump at an index go to the next instruction."""
        code = self.body.function.code
        code[at] = (code[at][0], self.here)

    def bracket(self, at: int) -> tuple[int, int]:
        """What a bracket at an index holds: index of the word behind it, and its commas."""
        depth = commas = 0
        while self.tokens[at].kind != "end of text":
            kind = self.tokens[at].kind
            depth += (kind in "[(") - (kind in "])")
            commas += kind == "," and depth == 1
            at += 1
            if depth == 0:
                break
        return min(at, len(self.tokens) - 1), commas

    # Expressions

    def expression(self, loosest: int = 1) -> None:
        """Operators that bind at least as tightly as `loosest`, and their operands."""
        self.deeper()
        self.operand()
        while LEVEL.get(self.now.kind, 0) >= loosest:
            line = self.now.line
            symbol = self.advance().kind
            while self.accept("newline"):  # behind an operator the line goes on
                pass
            if symbol in SKIPS:
                skip = self.emit(SKIPS[symbol])
                self.expression(LEVEL[symbol] + 1)
                self.emit(do.to_bool)
                self.patch(skip)
            else:
                self.expression(LEVEL[symbol] + 1)
                self.emit(do.binary, BINARY[symbol], line)
        self.depth -= 1

    def operand(self) -> None:
        """A value, with what stands before and behind it."""
        if self.accept("not"):
            self.expression(COMPARISON)
            self.emit(do.invert)
        elif self.accept("-"):
            self.expression(TIGHTEST)
            self.emit(do.negate)
        elif self.accept("+"):
            self.expression(TIGHTEST)
        else:
            self.value()
            while self.accept("["):
                self.expression()
                self.expect("]")
                self.emit(do.index)

    def value(self) -> None:
        """A value that stands alone."""
        word = self.advance()
        if word.kind in ("number", "string"):
            self.emit(do.constant, word.value)
        elif word.kind in CONSTANTS:
            self.emit(do.constant, CONSTANTS[word.kind])
        elif word.kind == "(":
            self.expression()
            self.expect(")")
        elif word.kind == "[":
            self.emit(do.build_list, self.sequence())
        elif word.kind == "run":
            self.call(self.expect("name"), starts_thread=True)
        elif word.kind == "name" and self.now.kind == "(":
            self.call(word, starts_thread=False)
        elif word[:2] == ("name", "p") and self.now.kind == "[" and self.bracket(self.at)[1]:
            self.advance()
            count = self.sequence()
            if count != JOINTS:
                raise self.error(f"a pose has {JOINTS} elements, not {count}")
            self.emit(do.build_pose, count)
        elif word.kind == "name":
            self.emit(do.load, word.value, word.line)
        else:
            raise ScriptError(word.line, f"expected a value, found {word}")

    def sequence(self) -> int:
        """Values up to the closing bracket; their number."""
        count = 0
        while self.now.kind != "]":
            self.expression()
            count += 1
            if not self.accept(","):
                break
        self.expect("]")
        return count

    def call(self, name: Token, starts_thread: bool) -> None:
        """Arguments and the call."""
        self.expect("(")
        positional, names = 0, list[str]()
        while self.now.kind != ")":
            if self.now.kind == "name" and self.next_kind == "=":
                names.append(str(self.advance().value))
                self.advance()
            elif names:
                raise self.error("a positional argument behind one by name")
            else:
                positional += 1
            self.expression()
            if not self.accept(","):
                break
        self.expect(")")
        at = self.emit(do.fail, None, name.line)
        self.calls.append(
            Call(
                self.body.function,
                at,
                self.body.scope,
                str(name.value),
                positional,
                tuple(names),
                starts_thread,
            )
        )
