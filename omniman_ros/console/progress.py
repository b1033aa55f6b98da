"""Display of progress: a bar on a terminal, plain lines now and then elsewhere."""

import shutil
import sys
import time
from typing import TextIO

from omniman_ros.console.terminal import BOLD, DIM, GREEN, is_terminal, paint, say

BAR_WIDTH = 24  #: Width of the bar [characters]
REDRAW_PERIOD = 0.1  #: Shortest time between two drawings of the bar [s]
LINE_PERIOD = 5.0  #: Shortest time between two lines about a part that is not on a terminal [s]


class Progress:
    """Shows the progress of a command that has several parts, one part after the other."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._live = is_terminal(self._stream)
        blocks = (self._stream.encoding or "").lower().startswith("utf")
        self._full, self._rest, self._tick = ("█", "░", "✓") if blocks else ("#", "-", "*")
        self._name = ""
        self._drawn = 0.0

    def headline(self, text: str) -> None:
        """Write a line in bold."""
        say(paint(text, BOLD, self._stream), self._stream)

    def begin(self, name: str) -> None:
        """Begin a part with the given name."""
        self._name = name
        self._drawn = 0.0 if self._live else time.monotonic()
        self.update(0.0, "")

    def update(self, fraction: float, note: str) -> None:
        """Display the progress of the part: a bar on a terminal, now and then a line elsewhere.

        Args:
            fraction: Completed fraction of the part, 0 to 1; values outside are clamped.
            note: Text beside the bar, cut to the width of the terminal.
        """
        now = time.monotonic()
        if now - self._drawn < (REDRAW_PERIOD if self._live else LINE_PERIOD):
            return
        self._drawn = now
        if not self._live:
            say(f"  {self._name:<17}{note}", self._stream)
            return
        full = round(BAR_WIDTH * min(max(fraction, 0.0), 1.0))
        bar = self._full * full + paint(self._rest * (BAR_WIDTH - full), DIM, self._stream)
        self._rewrite(f"  {self._name:<17}", bar, f"  {note}")

    def end(self, note: str) -> None:
        """End the part with a line that is not overwritten."""
        if self._live:
            bar = paint(self._full * BAR_WIDTH, GREEN, self._stream)
            self._rewrite(f"  {self._name:<17}", bar, f"  {note}")
            say("", self._stream)
        else:
            say(f"  {self._name:<17}{self._tick} {note}", self._stream)

    def abandon(self) -> None:
        """Leave the unfinished part on its line, and continue on the next line."""
        if self._live and self._name:
            say("", self._stream)

    def _rewrite(self, name: str, bar: str, note: str) -> None:
        room = shutil.get_terminal_size().columns - len(name) - BAR_WIDTH - 1
        try:
            self._stream.write(f"\r{name}{bar}{note[: max(room, 0)]}\033[K")
            self._stream.flush()
        except OSError:
            self._live = False
