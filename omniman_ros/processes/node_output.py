"""Consumers of the nodes' output: one prints it, the other keeps the last lines for errors."""

import re
import sys
import threading
from collections import deque
from collections.abc import Sequence

from omniman_ros.console.terminal import paint, say

#: Escape codes of the colours of the nodes' names, in turn
PREFIX_COLOURS = ("36", "35", "33", "32", "34")
#: Number of last lines of the nodes' output that are printed after a failure
OUTPUT_TAIL_LINES = 30


class PrefixedPrinter:
    """Prints each line of output, with the name of its process in front.

    It may be called from several threads.
    """

    def __init__(self, names: Sequence[str]) -> None:
        width = max(map(len, names))
        self._prefixes = {
            name: paint(
                f"[{name}]".ljust(width + 3), PREFIX_COLOURS[i % len(PREFIX_COLOURS)], sys.stdout
            )
            for i, name in enumerate(names)
        }
        self._lock = threading.Lock()

    def __call__(self, name: str, line: str) -> None:
        """Print a line of a process."""
        with self._lock:
            say(self._prefixes[name] + line)


class NodeOutputLog:
    """Keeps the last lines of the nodes' output, to print them on stderr after a failure."""

    def __init__(self, verbose: bool = False) -> None:
        self._verbose = verbose
        self._lines: deque[str] = deque(maxlen=OUTPUT_TAIL_LINES)

    def __call__(self, name: str, line: str) -> None:
        """Add a line of a node."""
        self._lines.append(f"  [{name}] {line}")
        if self._verbose:
            say(f"[{name}] {line}", sys.stderr)

    @property
    def text(self) -> str:
        """The kept lines."""
        return "\n".join(self._lines)

    def find(self, name: str, pattern: re.Pattern[str]) -> str:
        """Return the group of a pattern in a node's latest kept line that matches it, or ""."""
        for line in reversed(self._lines):
            match = pattern.search(line) if line.startswith(f"  [{name}] ") else None
            if match:
                return match[1]
        return ""

    def show(self) -> None:
        """Print the kept lines, unless all lines have been printed already."""
        if self._lines and not self._verbose:
            say(f"the last output of the nodes:\n{self.text}", sys.stderr)
