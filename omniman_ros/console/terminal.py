"""Text on a terminal: colours, tables, and output to a terminal that may be closed."""

import contextlib
import os
import sys
from typing import TextIO

BOLD = "1"  #: Escape code of bold text
DIM = "2"  #: Escape code of faint text
RED = "31"  #: Escape code of red text
GREEN = "32"  #: Escape code of green text
YELLOW = "33"  #: Escape code of yellow text
BLUE = "34"  #: Escape code of blue text


def is_terminal(stream: TextIO) -> bool:
    """Return whether a stream writes to a terminal that understands escape sequences."""
    try:
        return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    except ValueError:  # the stream is closed
        return False


def paint(text: str, colour: str, stream: TextIO) -> str:
    """Return a text in a colour if the stream is a terminal and `NO_COLOR` is not set.

    The colour is an escape code, such as `RED`.
    """
    if not is_terminal(stream) or os.environ.get("NO_COLOR"):
        return text
    return f"\033[{colour}m{text}\033[0m"


def say(text: str = "", stream: TextIO | None = None) -> None:
    """Write a line for the user and flush it.

    A stream that cannot be written is ignored: a terminal that was closed must not keep a command
    from stopping a robot.
    """
    stream = stream or sys.stdout
    with contextlib.suppress(OSError, ValueError):
        stream.write(text + "\n")
        stream.flush()


def write_output(text: str) -> None:
    """Write the output that a command was asked for to stdout.

    Raises:
        OSError: Stdout cannot be written, for instance because the disk is full.
    """
    sys.stdout.write(text)


def table(rows: list[tuple[str, ...]], indent: str = "  ") -> list[str]:
    """Lay out a table with its first column aligned to the left and the others to the right.

    The first row is the header; others may be shorter.
    """
    widths = [max(len(row[i]) for row in rows if i < len(row)) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=False))
        ]
        lines.append((indent + "  ".join(cells)).rstrip())
    return lines
