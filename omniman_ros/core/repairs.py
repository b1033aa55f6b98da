"""Notes of input that is used although it is not quite right, for whoever reports it.

What reads input may be several calls below what knows a log: it notes here what it repaired.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_NOTES: ContextVar[list[str] | None] = ContextVar("notes", default=None)


def note_repair(text: str) -> None:
    """Note what was repaired in the input that is being read; nothing happens if nobody asks."""
    notes = _NOTES.get()
    if notes is not None:
        notes.append(text)


@contextmanager
def noted_repairs() -> Iterator[list[str]]:
    """Collect what is noted within, in this thread."""
    notes: list[str] = []
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)
