"""What becomes of the nodes' output: printed with their names, or kept for the worst case."""

import re
import sys
import threading
from collections import deque
from collections.abc import Sequence

from omniman_ros.cli.terminal import paint, say

COLOURS = ("36", "35", "33", "32", "34")
LAST_WORDS = 30
"""Lines of the nodes' output that are shown when something went wrong."""


class PrefixedLines:
    """Prints lines with the name of the process they come from; for several threads."""

    def __init__(self, names: Sequence[str]) -> None:
        width = max(map(len, names))
        self._prefixes = {
            name: paint(f"[{name}]".ljust(width + 3), COLOURS[i % len(COLOURS)], sys.stdout)
            for i, name in enumerate(names)
        }
        self._lock = threading.Lock()

    def __call__(self, name: str, line: str) -> None:
        """Print a line."""
        with self._lock:
            say(self._prefixes[name] + line)


class NodeLog:
    """Keeps the nodes' last words, or shows all of them at once, on stderr."""

    def __init__(self, verbose: bool = False) -> None:
        self._verbose = verbose
        self._last: deque[str] = deque(maxlen=LAST_WORDS)

    def __call__(self, name: str, line: str) -> None:
        """Take a line."""
        self._last.append(f"  [{name}] {line}")
        if self._verbose:
            say(f"[{name}] {line}", sys.stderr)

    def find(self, name: str, pattern: re.Pattern[str]) -> str:
        """The pattern's group in the last of a node's last words that has it, or nothing."""
        for line in reversed(self._last):
            found = pattern.search(line) if line.startswith(f"  [{name}] ") else None
            if found:
                return found[1]
        return ""

    def show(self) -> None:
        """Show the last lines, unless they were."""
        if self._last and not self._verbose:
            say("the nodes' last words:\n" + "\n".join(self._last), sys.stderr)
