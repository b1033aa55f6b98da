"""Statements of a program to instructions, in one pass; calls are linked at the end."""

from collections.abc import Callable

from omniman_ros.simulated_ur.urscript import instructions as do
from omniman_ros.simulated_ur.urscript.errors import ScriptError
from omniman_ros.simulated_ur.urscript.expressions import Body, Expressions
from omniman_ros.simulated_ur.urscript.instructions import Function, Operation
from omniman_ros.simulated_ur.urscript.linker import Scope, linked

BLOCK_ENDS = {"end", "elif", "else", "end of text"}


class Program:
    """A program, ready to run.

    The text is either one definition, `def name(): ... end`, whose body is the program, or bare
    statements, among which there may be definitions. `sec` defines a secondary program.

    Args:
        text: Its text.

    Attributes:
        main: What the main thread executes; its variables are the global ones.
        secondary: Whether it is a secondary program, which takes no time.

    Raises:
        ScriptError: The text is no program.
    """

    def __init__(self, text: str) -> None:
        parser = Parser(text)
        self.main = parser.program()
        self.secondary = parser.secondary


class Parser(Expressions):
    """Reads one text."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.secondary = False

    # Definitions

    def program(self) -> Function:
        """The whole text."""
        self.block()
        if self.now.kind != "end of text":
            raise self.error(f"unexpected {self.now}")
        main = self.body.function
        if not main.code:
            programs = [f for f in self.body.scope.functions.values() if not f.is_thread]
            if len(programs) != 1 or programs[0].parameters:
                raise ScriptError(1, "the text is not one program")
            main = programs[0]
        else:
            self.finish()
        for each in self.calls:
            each.function.code[each.at] = linked(each)
        return main

    def finish(self) -> None:
        """The end of a body gives back no value."""
        self.emit(do.constant, None)
        self.emit(do.give_back)

    def definition(self, is_thread: bool) -> None:
        """From the name to `end`."""
        name = str(self.expect("name").value)
        around, function = self.body, Function(name, is_thread)
        around.scope.functions[name] = function
        self.body = Body(function, Scope(around.scope))
        self.expect("(")
        while self.now.kind != ")":
            self.parameter(function)
            if not self.accept(","):
                break
        if is_thread and function.parameters:
            raise self.error(f"thread '{name}' cannot have parameters")
        self.expect(")")
        self.expect(":")
        self.block()
        self.finish()
        self.expect("end")
        self.body = around

    def parameter(self, function: Function) -> None:
        """A parameter and its default, which the callee evaluates if it was not given."""
        name = str(self.expect("name").value)
        if name in function.parameters:
            raise self.error(f"parameter '{name}' stands there twice")
        function.parameters.append(name)
        if self.accept("="):
            function.defaults.add(name)
            jump = self.emit(do.jump_given)
            self.expression()
            self.emit(do.store_local, name)
            function.code[jump] = (do.jump_given, (name, self.here))

    # Statements

    def block(self) -> None:
        """Statements, up to the word that ends them."""
        self.deeper()
        while True:
            while self.accept("newline"):
                pass
            if self.now.kind in BLOCK_ENDS:
                break
            self.statement()
            if self.now.kind not in BLOCK_ENDS:
                self.expect("newline")
        self.depth -= 1

    def statement(self) -> None:
        """One statement."""
        known = STATEMENTS.get(self.now.kind)
        if known is not None:
            self.at += 1
            known(self)
        elif self.now == ("name", "sec", self.now.line) and self.next_kind == "name":
            self.at += 1
            self.secondary = self.secondary or self.body.scope.around is None
            self.definition(is_thread=False)
        elif self.now.kind == "name" and self.next_kind == "=":
            self.assignment(do.store)
        elif self.is_element_assignment():
            name = self.advance().value
            self.expect("[")
            self.expression()
            self.expect("]")
            self.expect("=")
            self.expression()
            self.emit(do.store_element, name)
        else:
            self.call_statement()

    def call_statement(self) -> None:
        """A call whose value is dropped."""
        line, before = self.now.line, self.here
        self.expression()
        at = self.here - 1
        function = self.body.function
        if at < before or not any(c.at == at and c.function is function for c in self.calls[-1:]):
            raise ScriptError(line, "neither a call nor an assignment")
        self.emit(do.drop)

    def is_element_assignment(self) -> bool:
        """Whether we stand at `name[...] =`."""
        if self.now.kind != "name" or self.next_kind != "[":
            return False
        behind, _ = self.bracket(self.at + 1)
        return self.tokens[behind].kind == "="

    def assignment(self, operation: Operation) -> None:
        """`name = expression`."""
        name = self.expect("name").value
        self.expect("=")
        self.expression()
        self.emit(operation, name)

    def branches(self) -> None:
        """From behind `if` to `end`."""
        ends = []
        while True:
            self.expression()
            self.expect(":")
            otherwise = self.emit(do.jump_unless)
            self.block()
            if self.now.kind in ("elif", "else"):
                ends.append(self.emit(do.jump))
            self.patch(otherwise)
            if self.accept("elif"):
                continue
            if self.accept("else"):
                self.expect(":")
                self.block()
            break
        self.expect("end")
        for each in ends:
            self.patch(each)

    def loop(self) -> None:
        """From behind `while` to `end`."""
        start, breaks = self.here, list[int]()
        self.expression()
        self.expect(":")
        breaks.append(self.emit(do.jump_unless))
        self.body.loops.append((start, breaks))
        self.block()
        self.expect("end")
        self.body.loops.pop()
        self.emit(do.jump, start)
        for each in breaks:
            self.patch(each)

    def leave_loop(self) -> None:
        """`break`."""
        if not self.body.loops:
            raise self.error("break outside a loop")
        self.body.loops[-1][1].append(self.emit(do.jump))

    def next_round(self) -> None:
        """`continue`."""
        if not self.body.loops:
            raise self.error("continue outside a loop")
        self.emit(do.jump, self.body.loops[-1][0])

    def return_value(self) -> None:
        """`return`, with a value or without."""
        if self.now.kind == "newline" or self.now.kind in BLOCK_ENDS:
            self.emit(do.constant, None)
        else:
            self.expression()
        self.emit(do.give_back)

    def of_handle(self, operation: Operation) -> None:
        """`kill` or `join`."""
        self.expression()
        self.emit(operation)
        if operation is do.join:
            self.emit(do.drop)

    def word_alone(self, operation: Operation | None) -> None:
        """A word that stands alone, with or without brackets."""
        if self.accept("("):
            self.expect(")")
        if operation is not None:
            self.emit(operation)


STATEMENTS: dict[str, Callable[[Parser], None]] = {
    "def": lambda parser: parser.definition(is_thread=False),
    "thread": lambda parser: parser.definition(is_thread=True),
    "if": Parser.branches,
    "while": Parser.loop,
    "break": Parser.leave_loop,
    "continue": Parser.next_round,
    "return": Parser.return_value,
    "global": lambda parser: parser.assignment(do.store_global),
    "local": lambda parser: parser.assignment(do.store_local),
    "kill": lambda parser: parser.of_handle(do.kill),
    "join": lambda parser: parser.of_handle(do.join),
    "halt": lambda parser: parser.word_alone(do.halt),
    "pass": lambda parser: parser.word_alone(None),
    # Time slices change only at calls that wait, and those let other threads run here too: the
    # public drivers' programs join a thread, and wait for their socket, in a critical section.
    "enter_critical": lambda parser: parser.word_alone(None),
    "exit_critical": lambda parser: parser.word_alone(None),
}
