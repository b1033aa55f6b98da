"""The terminal as a keyboard: single keys without echo."""

import codecs
import contextlib
import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Self

from omniman_ros.console.errors import CommandError


class Keyboard:
    """Reads single keys from the terminal on stdin, without echo, as a context manager.

    The terminal's settings are restored when the context is left.

    Raises:
        CommandError: Stdin is not a terminal; raised when the context is entered.
    """

    def __enter__(self) -> Self:
        try:
            self._descriptor = sys.stdin.fileno()
            self._settings = termios.tcgetattr(self._descriptor)
        except (OSError, ValueError, termios.error) as error:
            raise CommandError("stdin is not a terminal: keys cannot be read", 2) from error
        self._decoder = codecs.getincrementaldecoder("utf-8")("ignore")
        tty.setcbreak(self._descriptor)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(termios.error):  # the terminal may be gone
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._settings)

    def read(self) -> str | None:
        """Return the text typed since the last call, without waiting.

        Escape sequences are included. The text is None if the terminal is gone.
        """
        try:
            if not select.select([self._descriptor], [], [], 0.0)[0]:
                return ""
            data = os.read(self._descriptor, 1024)
        except OSError:
            return None
        return self._decoder.decode(data) if data else None
