"""Progress of a show: a bar that fills on a terminal, a plain line a part elsewhere."""

import shutil
import sys
import time
from typing import TextIO

from omniman_ros.cli.terminal import BOLD, DIM, GREEN, is_terminal, paint, say

BAR = 24
REDRAW = 0.1
"""Shortest time between two drawings [s]."""


class Progress:
    """Shows one part after the other.

    Args:
        stream: Where to; stdout if None.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._live = is_terminal(self._stream)
        blocks = (self._stream.encoding or "").lower().startswith("utf")
        self._full, self._rest, self._tick = ("█", "░", "✓") if blocks else ("#", "-", "*")
        self._name = ""
        self._drawn = 0.0

    def headline(self, text: str) -> None:
        """A line of its own, in bold."""
        say(paint(text, BOLD, self._stream), self._stream)

    def begin(self, name: str) -> None:
        """Begin a part."""
        self._name = name
        self._drawn = 0.0
        self.update(0.0, "")

    def update(self, fraction: float, note: str) -> None:
        """Show how far it is, from 0 to 1; drawn a few times a second, and only on a terminal."""
        now = time.monotonic()
        if not self._live or now - self._drawn < REDRAW:
            return
        self._drawn = now
        full = round(BAR * min(max(fraction, 0.0), 1.0))
        bar = self._full * full + paint(self._rest * (BAR - full), DIM, self._stream)
        self._rewrite(f"  {self._name:<17}", bar, f"  {note}")

    def end(self, note: str) -> None:
        """End the part with a line that stays."""
        if self._live:
            bar = paint(self._full * BAR, GREEN, self._stream)
            self._rewrite(f"  {self._name:<17}", bar, f"  {note}")
            say("", self._stream)
        else:
            say(f"  {self._name:<17}{self._tick} {note}", self._stream)

    def abandon(self) -> None:
        """Leave the part as it is, on a line of its own."""
        if self._live and self._name:
            say("", self._stream)

    def _rewrite(self, name: str, bar: str, note: str) -> None:
        room = shutil.get_terminal_size().columns - len(name) - BAR - 1
        try:
            self._stream.write(f"\r{name}{bar}{note[: max(room, 0)]}\033[K")
            self._stream.flush()
        except OSError:
            self._live = False
