"""Parameters of a robot from files and the command line."""

import re
from collections.abc import Container, Sequence
from pathlib import Path
from typing import Any

from omniman_ros.console.errors import CommandError
from omniman_ros.core.errors import FileError
from omniman_ros.yaml_files import parse_value


def existing_file(file: str | None) -> str | None:
    """Return the path of a parameter file, if given; CommandError if it does not exist."""
    if file is not None and not Path(file).is_file():
        raise CommandError(f"there is no parameter file '{file}'", 2)
    return file


def parse_parameters(params: Sequence[str], known: Container[str], what: str) -> dict[str, Any]:
    """Return the values of parameters by name.

    Args:
        params: Parameters, each NAME:=VALUE, where VALUE is YAML.
        what: What they affect, for the message.

    Raises:
        CommandError: A text is not of this form, or is not a known parameter.
    """
    values: dict[str, Any] = {}
    for text in params:
        name, separator, value = text.partition(":=")
        if not separator or not re.fullmatch(r"[^\s:=]+", name) or not value:
            raise CommandError(f"parameter '{text}' is not NAME:=VALUE", 2)
        if name not in known:
            raise CommandError(f"parameter '{name}' does not affect {what}", 2)
        try:
            values[name] = parse_value(value)
        except FileError as error:
            raise CommandError(f"parameter '{text}': {value} is not YAML", 2) from error
    return values
