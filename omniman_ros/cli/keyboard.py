"""The terminal as a keyboard: single keys, no echo, and everything put back at the end."""

import codecs
import contextlib
import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Self

from omniman_ros.cli.errors import CommandError


class Keyboard:
    """Reads single keys from the terminal on stdin, as a context manager.

    Raises:
        CommandError: Stdin is no terminal.
    """

    def __enter__(self) -> Self:
        try:
            self._file = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._file)
        except (OSError, ValueError, termios.error) as error:
            raise CommandError("stdin is not a terminal: keys cannot be read", 2) from error
        self._decoder = codecs.getincrementaldecoder("utf-8")("ignore")
        tty.setcbreak(self._file)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        with contextlib.suppress(termios.error):  # the terminal may be gone
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def read(self) -> str | None:
        """What was typed since the last call, at once; None if the terminal is gone."""
        try:
            if not select.select([self._file], [], [], 0.0)[0]:
                return ""
            data = os.read(self._file, 1024)
        except OSError:
            return None
        return self._decoder.decode(data) if data else None
