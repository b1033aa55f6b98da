"""Errors of a program: in its text, and while it runs."""

from omniman_ros.core.errors import OmnimanError


class ScriptError(OmnimanError, ValueError):
    """The text is not a program."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(f"line {line}: {reason}")
        self.line = line  #: Line of the error, counted from 1


class ScriptRuntimeError(OmnimanError):
    """A statement cannot be executed; the machine adds the line and ends the program."""
