"""Lines that the user types, read without blocking."""

import os
import select
from collections.abc import Callable

from omniman_ros.console.errors import CommandError


class EndOfInputError(CommandError):
    """The user's input has ended."""


class LineReader:
    """Reads lines from a file descriptor without blocking."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._text = ""
        self._has_ended = False

    def next(self, wait: Callable[[], None]) -> str:
        """Return the next line, without its end; an EndOfInputError after the last."""
        while "\n" not in self._text:
            if self._has_ended:
                raise EndOfInputError("the input has ended: the answer cannot be typed in")
            wait()
            if select.select([self._file], [], [], 0.0)[0]:
                data = os.read(self._file, 4096)
                self._has_ended = not data
                self._text += data.decode(errors="replace")
        line, _, self._text = self._text.partition("\n")
        return line.rstrip("\r")
