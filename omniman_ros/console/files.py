"""Files that commands write."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import write_output


def write_atomically(path: Path, text: str) -> None:
    """Write a text file completely or not at all; create its folder where it does not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
        file.write(text)
    Path(file.name).chmod(0o644)
    os.replace(file.name, path)


@contextmanager
def output_errors(option: str) -> Iterator[None]:
    """Turn an error of writing a file into a CommandError of the option `--output`."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"--output {option}: {error.strerror}") from error


def write_file_or_stdout(option: str | None, text: str) -> None:
    """Write the text that a command was asked for to the file of `--output`, or to stdout.

    Raises:
        CommandError: The file cannot be written.
        OSError: Stdout cannot be written, for instance because the disk is full.
    """
    if option is None:
        write_output(text)
        return
    with output_errors(option):
        Path(option).write_text(text, encoding="utf-8")
